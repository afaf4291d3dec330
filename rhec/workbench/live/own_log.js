// A reader's own log: columns, samples of 0.2 s as rhec.replay makes them, and their estimates.
"use strict";

const NEEDED = ["t_s", "x_m", "y_m", "speed_mps", "yaw_rate_radps"];
const ENCODER_GAP = 3.25; // samples: over longer gaps the speeds are unknown; then the robot
const STANDING_GAP = 15; // is assumed to stand
const CLOCK = 5; // samples by which a clock may be off
const SEGMENT_GAP = 3000;
const SAME_S = 1e-3; // a sample takes the exact time of a row that is so near
const HEADING_S = 60; // the first heading is chosen by the innovations until then

const own_log = { lines: [], columns: [], found: [] };

const plain = name => name.trim().toLowerCase()
  .replace(/[ _([]+(m|s|ms|us|ns|m\/s|mps|rad\/s|radps|rad_s|deg\/s|dps)[)\]]*$/, "")
  .replaceAll(" ", "_");

function read_header(text) {
  own_log.lines = text.split("\n").filter(line => line.trim());
  const [header] = own_log.lines;
  own_log.comma = [",", ";", "\t"].find(each => header.includes(each)) ?? ",";
  own_log.columns = header.trim().split(own_log.comma).map(name => name.trim());
}

function likely_column(name, others) { // of the log, as rhec.replay suggests it
  const { columns } = own_log;
  if (columns.includes(name)) return name;
  const by_name = new Map(columns.toReversed().map(column => [plain(column), column]));
  return by_name.get([plain(name), ...others].find(other => by_name.has(other))) ?? "";
}

const FLAGS = { true: 1, false: 0 };

function number_in(word = "") {
  const text = word.trim();
  return text ? FLAGS[text.toLowerCase()] ?? Number(text) : NaN;
}

// Whether a time fits the median of itself and the two times before it.
function fits(time, before, dt_s) {
  const [low, middle = low, high = middle] = [time, ...before].sort((a, b) => a - b);
  const usual = before.length === 1 ? (low + middle) / 2 : before.length ? middle : high;
  return Math.abs(time - usual) <= CLOCK * dt_s;
}

// The segments of the log, each with its rows by name; NaN is missing. A segment also begins where
// the clock is set back or after a long pause; a row must be later than those before it.
function segments_of(chosen) {
  const { lines, columns, comma } = own_log;
  const { dt_s } = page.world;
  const names = [...NEEDED, "pos_ok", "encoders_ok"];
  const place = names.map(name => columns.indexOf(chosen[name] ?? name));
  const of_segment = columns.indexOf("segment");
  const segments = [];
  const times = new Map(); // the last two of each segment
  let before = {};
  for (let i = 1; i < lines.length; i++) {
    const words = lines[i].split(comma);
    const segment = words[of_segment];
    const time = number_in(words[place[0]]);
    const earlier = times.get(segment) ?? [];
    if (!isFinite(time)) continue;
    times.set(segment, [...earlier.slice(-1), time]);
    if (!fits(time, earlier, dt_s)) continue;
    const step = time - before.time;
    const goes_on = step >= -CLOCK * dt_s && step <= SEGMENT_GAP * dt_s;
    if (!goes_on || segment !== before.segment) segments.push(names.map(() => []));
    before = { segment, time };
    const rows = segments.at(-1);
    if (time > (rows[0].at(-1) ?? -Infinity))
      place.forEach((at, j) => rows[j].push(at < 0 ? 1 : number_in(words[at])));
  }
  return segments.filter(([t]) => t.length > 1).map(rows =>
    Object.fromEntries(names.map((name, j) => [name, Float64Array.from(rows[j])])));
}

// What no sensor can have measured, and positions that were only repeated, become NaN.
function leave_out(rows) {
  const { x_m, y_m, speed_mps, yaw_rate_radps } = rows;
  let last = [NaN, NaN];
  x_m.forEach((_, i) => {
    const is_there = Math.abs(x_m[i]) <= 1e8 && Math.abs(y_m[i]) <= 1e8 && rows.pos_ok[i] === 1;
    if (!is_there || (x_m[i] === last[0] && y_m[i] === last[1])) x_m[i] = y_m[i] = NaN;
    else last = [x_m[i], y_m[i]];
    for (const speed of [speed_mps, yaw_rate_radps])
      if (!(Math.abs(speed[i]) <= 100) || rows.encoders_ok[i] !== 1) speed[i] = NaN;
  });
}

// Means of a signal that is linear between its measurements (t, value), over each (begin, end].
function means_of(t, value, begin, end, gap_s) {
  const there = [...value.keys()].filter(i => isFinite(value[i]));
  if (!there.length) return end.map(() => NaN);
  const [times, values] = [t, value].map(of => Float64Array.from(there, i => of[i]));
  const edges = [Math.min(begin[0], times[0]), ...times];
  const covered = [0]; // until each edge
  const integral = [0];
  times.forEach((time, i) => {
    const long_s = time - edges[i];
    const is_covered = long_s <= gap_s;
    covered.push(covered[i] + is_covered * long_s);
    integral.push(integral[i] + is_covered * long_s * (values[i] + values[Math.max(i - 1, 0)]) / 2);
  });
  let n = 0;
  let from = 0;
  return end.map((until, k) => {
    while (n < times.length && times[n] <= until) n++;
    const first = Math.min(begin[k], edges[n]);
    while (from + 1 < edges.length && edges[from + 1] <= first) from++;
    const part = from + 1 < edges.length
      ? Math.max(0, first - edges[from]) / (edges[from + 1] - edges[from]) || 0 : 0;
    const before = sum => sum[from] + (part && part * (sum[from + 1] - sum[from]));
    const held_s = n && until - edges[n] <= gap_s ? until - Math.max(begin[k], edges[n]) : 0;
    const long_s = covered[n] - before(covered) + held_s;
    const whole = integral[n] - before(integral) + held_s * (n ? values[n - 1] : 0);
    return long_s >= 0.5 * (until - begin[k]) ? whole / long_s : NaN;
  });
}

// The stream of a segment: (x, y, ν, ω, age of the position) a sample.
function resampled(rows, dt_s) {
  const { t_s: t } = rows;
  const number = Math.floor((t.at(-1) - t[0] + SAME_S) / dt_s) + 1;
  let row = 0;
  let newest = 0;
  const at = Array.from({ length: number }, (_, k) => {
    const grid = t[0] + dt_s * k;
    while (row < t.length - 1 && t[row] < grid - SAME_S) row++;
    return Math.abs(t[row] - grid) <= SAME_S ? t[row] : grid;
  });
  const before = [at[0] - dt_s, ...at.slice(0, -1)];
  const speeds = [rows.speed_mps, rows.yaw_rate_radps]
    .map(value => means_of(t, value, before, at, ENCODER_GAP * dt_s));
  const stream = new Float64Array(5 * number).fill(NaN);
  let was_silent = false;
  let last = -1;
  at.forEach((until, k) => {
    for (; newest < t.length && t[newest] <= until; newest++)
      if (isFinite(rows.x_m[newest])) last = newest;
    if (last >= 0 && t[last] > before[k])
      stream.set([rows.x_m[last], rows.y_m[last], NaN, NaN, until - t[last]], 5 * k);
    const is_silent = until - t[newest - 1] > STANDING_GAP * dt_s;
    speeds.forEach((of, i) => { stream[5 * k + 2 + i] = is_silent && !was_silent ? 0 : of[k]; });
    was_silent = is_silent;
  });
  return { at, stream };
}

class Replay extends Loop { // the estimator of a log, which begins at its first position
  estimate(stream, theta_rad, sigma_m) {
    const { memory, directions, settings, row } = this.data;
    for (const name in settings) this[`at_${name}`]?.set(settings[name]);
    this.at_V.set([sigma_m ** 2, sigma_m ** 2]);
    const start = { x_m: stream[0], y_m: stream[1], theta_rad, nu_mps: stream[2] || 0 };
    const slopes = Object.entries(directions);
    this.at_memory.set(memory.map((value, i) =>
      slopes.reduce((sum, [of, slope]) => sum + start[of] * slope[i], value ?? NaN)));
    this.at_stream.set(stream);
    if (this.wasm.run(stream.length / 5)) throw new Error("the estimator failed");
    return this.at_row.slice(0, row * stream.length / 5);
  }

  heading(stream, sigma_m) { // by the least innovations of the beginning
    const { n_headings, row } = this.data;
    const beginning = stream.subarray(0, 5 * Math.round(HEADING_S / page.world.dt_s));
    const tried = Array.from({ length: n_headings }, (_, i) => 2 * Math.PI / n_headings * i);
    const sums = tried.map(theta => {
      const rows = this.estimate(beginning, theta, sigma_m);
      let sum = 0;
      for (let k = row; k < rows.length; k += row)
        sum += (rows[k + row - 2] ** 2 || 0) + (rows[k + row - 1] ** 2 || 0);
      return sum;
    });
    return tried[sums.indexOf(Math.min(...sums))];
  }
}

function estimated(replay, rows, sigma_m) { // of a segment, from its first position on
  leave_out(rows);
  const { at, stream } = resampled(rows, page.world.dt_s);
  let k = 0;
  while (k < at.length && !isFinite(stream[5 * k])) k++;
  if (at.length - k > replay.data.max_samples)
    throw new Error("A segment of the log is longer than four hours.");
  const used = stream.subarray(5 * k);
  const yaw_rad = used.length ? replay.heading(used, sigma_m) : 0;
  return { t_s: at.slice(k), stream: used, yaw_rad, rows: replay.estimate(used, yaw_rad, sigma_m) };
}

async function estimate_own_log() {
  const chosen = Object.fromEntries(NEEDED.map(name => [name, $(`own_${name}`).value]));
  const missing = NEEDED.filter(name => !chosen[name]);
  if (missing.length) {
    $("own_said").textContent = `Which column is ${missing.join(", ")}?`;
    return;
  }
  const data = await load("own_log_module");
  data.module ??= unpack(data.wasm).then(WebAssembly.compile);
  const replay = await Replay.from(await data.module, { data });
  const sigma_m = Number($("own_sigma").value);
  const begun = performance.now();
  own_log.found = segments_of(chosen).map(rows => estimated(replay, rows, sigma_m));
  const took = performance.now() - begun;
  const samples = own_log.found.reduce((sum, { t_s }) => sum + t_s.length, 0);
  $("own_said").textContent = `${own_log.lines.length - 1} rows, ${samples} samples of 0.2 s, `
    + `estimated in ${took.toFixed(0)} ms. In Python: rhec.replay(log, sigma_v=(${sigma_m}, `
    + `${sigma_m}, 0.05, 0.0175))`;
  own_log.data = data;
  $("own_pictures").hidden = false;
  draw_own_log();
}

function draw_own_log() {
  const { found: parts, data: { names, row } } = own_log;
  const all = (of, width, i) => parts.flatMap(part =>
    Array.from({ length: part.t_s.length }, (_, k) => part[of][width * k + i]));
  const range = values => values.filter(isFinite).reduce(
    ([low, high], value) => [Math.min(low, value), Math.max(high, value)], [Infinity, -Infinity]);
  const x = all("stream", 5, 0);
  const y = all("stream", 5, 1);
  const map = new Plot($("own_map"), range(x), range(y), { equal: true });
  map.dots(x.length, k => x[k], k => y[k], "--measured", { radius: 1.5 });
  for (const { rows, t_s } of parts)
    map.line(t_s.length, k => rows[row * k], k => rows[row * k + 1], "--ink");
  const times = parts.flatMap(({ t_s }) => t_s);
  const over_time = new Plot($("own_traction"), range(times), [0, 1.08]);
  ["mu", "kappa"].forEach((name, i) => {
    const place = names.indexOf(name);
    for (const { rows, t_s } of parts) {
      const value = k => rows[row * k + place];
      const sigma = k => rows[row * k + names.length + place];
      over_time.band(t_s.length, k => t_s[k], value, k => 2 * sigma(k), COLOURS[i]);
      over_time.line(t_s.length, k => t_s[k], value, COLOURS[i]);
    }
  });
}

async function take(file) {
  read_header(await file.text());
  const { other_names } = await load("own_log_module");
  for (const name of NEEDED) {
    const options = ["", ...own_log.columns].map(column => new Option(column || "–", column));
    $(`own_${name}`).replaceChildren(...options);
    $(`own_${name}`).value = likely_column(name, other_names[name]);
  }
  return estimate_own_log();
}

const refused = error => { $("own_said").textContent = error.message; };

const redraw_own_log = () => own_log.found.length && draw_own_log();
new ResizeObserver(redraw_own_log).observe($("own_pictures"));
matchMedia("(prefers-color-scheme: dark)").addEventListener("change", redraw_own_log);
$("own_file").onchange = ({ target }) => take(target.files[0]).catch(refused);
$("own").ondragover = event => event.preventDefault();
$("own").ondrop = event => {
  event.preventDefault();
  take(event.dataTransfer.files[0]).catch(refused);
};
for (const id of [...NEEDED.map(name => `own_${name}`), "own_sigma"])
  $(id).onchange = () => own_log.lines.length && estimate_own_log().catch(refused);
