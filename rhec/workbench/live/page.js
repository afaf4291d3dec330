"use strict"; // the live page's controls, words and pictures
const $ = id => document.getElementById(id);
const page = { loops: [] };
const lines = ["--run0", "--run1", "--run2"];
// From the controls to runs

const failed = error => { $("said").textContent = error.message, console.error(error); };
const own_sigma_w = n => // of (x, y, θ, ν, μ, κ); dual: the RHE's, then the EKF's
  [...page.values.sigma_w, ...page.values.sigma_w.slice(0, 4)].slice(0, n);
function given(run, { given, sigma_w }) {
  const own = sigma_w[$("noise").value] ?? own_sigma_w(given.sigma_w);
  return { ...page.world.defaults, ...page.values, ...run.fields, sigma_w: own };
}
async function drive() {
  const { world, values, runs, patches } = page, seed = Number($("seed").value);
  const n = $("window").value, samples = Math.round(values.duration_s / world.dt_s);
  page.soil = world.soil(seed, $("soil").value, patches, values.start_offset_m);
  let took = 0;
  for (const [i, { module, ...run }] of runs.entries()) {
    const name = module === "rhe" && n !== "15" ? `rhe_${n}` : module;
    if (page.loops[i]?.name !== name) page.loops[i] = await Loop.of(name, world);
    const loop = page.loops[i], fault = loop.told.faulty && $("fault").value;
    const stream = await world.stream(seed, fault), begun = performance.now();
    loop.run(given(run, loop.told), stream, page.soil, samples);
    took += performance.now() - begun;
  }
  page.loops.length = runs.length;
  write(`${runs.length} runs of ${values.duration_s} s in ${took.toFixed(0)} ms`);
  draw();
}
let asked = null; // the newest wish, carried out in the next frame; dragging never queues
function ask(what) {
  if (!asked) page.busy = (page.busy ?? Promise.resolve()).then(() =>
    new Promise(requestAnimationFrame)).then(async () => {
    const now = asked;
    asked = null;
    await now();
    document.dispatchEvent(new Event("drawn"));
  }).catch(failed);
  if (asked !== drive) asked = what;
}

// In words and numbers

const python = value => Array.isArray(value)
  ? `(${value.map(python).join(", ")}${value.length === 1 ? "," : ""})`
  : { true: "True", false: "False" }[value] ?? JSON.stringify(value);
function lineOf(run, { told }) {
  const { defaults, soils, faults } = page.world, noise = $("noise").value, fields = {
    ...told.line, ...soils[$("soil").value], ...page.values, ...run.fields, patches: page.patches,
    seed: Number($("seed").value), process_noise: noise === "own" ? "printed" : noise };
  delete fields.sigma_w;
  if (noise === "own") fields.sigma_w = own_sigma_w(told.given.sigma_w);
  const words = Object.entries(fields).map(([name, value]) => [name, python(value)])
    .filter(([name, value]) => value !== python(defaults[name]));
  if (told.faulty) words.push(["faults", faults[$("fault").value]]);
  return `rhec.simulate(rhec.Scenario(${words.map(word => word.join("=")).join(", ")}))`;
}
function write(said) {
  const { loops, runs, world: { shown } } = page;
  const number = (value, digits) => Number.isFinite(value) ? value.toFixed(digits) : "never";
  const row = (title, cells) => `<tr><th scope="row">${title}</th>${cells.join("")}</tr>`;
  $("metrics").innerHTML = row("", shown.map(([, head, unit]) =>
    `<th scope="col">${head}<br>${unit}</th>`)) + loops.map(({ metrics }, i) =>
    row(`<span style="color: var(${lines[i]})">━</span> ${runs[i].name}`, shown.map(
      ([name, , , digits]) => `<td>${number(metrics[name], digits)}</td>`))).join("");
  $("line").textContent = loops.map((loop, i) => lineOf(runs[i], loop)).join("\n");
  $("said").textContent = said;
  const words = loops.map(({ metrics }, i) => `${runs[i].name}: largest true error `
    + `${number(metrics.max_error_true_m, 2)} m, mean ${number(metrics.mean_error_true_m, 3)} m`);
  for (const canvas of document.querySelectorAll("#pictures canvas"))
    canvas.ariaLabel = `${canvas.previousElementSibling.textContent} ${words.join("; ")}`;
}

// Pictures

const colour = name => page.colours[name] ??= getComputedStyle($("live")).getPropertyValue(name);
class Plot { // a canvas with axes, in the coordinates of the data
  constructor(id, [x0, x1], [y0, y1], equal) {
    const canvas = $(id), { clientWidth: w, clientHeight: h } = canvas, dots = devicePixelRatio;
    const [left, right, top, bottom] = [38, w - 12, 6, h - 20], c = canvas.getContext("2d");
    Object.assign(canvas, { width: w * dots, height: h * dots }); // clears it, too
    let [sx, sy] = [(right - left) / (x1 - x0), (bottom - top) / (y1 - y0)];
    if (equal) {
      sx = sy = Math.min(sx, sy);
      [x0, y0] = [(x0 + x1 - (right - left) / sx) / 2, (y0 + y1 - (bottom - top) / sy) / 2];
    }
    this.x = x => left + (x - x0) * sx, this.y = y => bottom - (y - y0) * sy, this.scale = sx;
    this.data = event => [x0 + (event.offsetX - left) / sx, y0 + (bottom - event.offsetY) / sy];
    this.c = c, c.scale(dots, dots);
    Object.assign(c, { font: "11px system-ui, sans-serif", lineJoin: "round", lineWidth: 1,
      fillStyle: colour("--soft"), strokeStyle: colour("--line") });
    const ticks = (low, pixels, per, apart, put) => {
      const ten = 10 ** Math.floor(Math.log10(apart / per));
      const step = ten * [1, 2, 5, 10].find(times => times * ten * per >= apart);
      for (let i = Math.ceil(low / step); i * step * per <= low * per + pixels; i++)
        put(i * step, Number((i * step).toPrecision(6)));
    };
    c.beginPath(), c.textAlign = "center";
    ticks(x0, right - left, sx, 60, (x, text) => {
      c.moveTo(this.x(x), top), c.lineTo(this.x(x), bottom), c.fillText(text, this.x(x), h - 5);
    });
    c.textAlign = "right";
    ticks(y0, bottom - top, sy, 32, (y, text) => {
      c.moveTo(left, this.y(y)), c.lineTo(right, this.y(y)), c.fillText(text, 34, this.y(y) + 4);
    });
    c.stroke(), c.beginPath(), c.rect(left, top, right - left, bottom - top), c.clip();
  }
  line(n, x, y, name, { width = 1.5, dash = [], alpha = 1 } = {}) {
    const { c } = this;
    Object.assign(c, { strokeStyle: colour(name), lineWidth: width, globalAlpha: alpha });
    c.setLineDash(dash), c.beginPath();
    for (let k = 0; k < n; k++) c.lineTo(this.x(x(k)), this.y(y(k)));
    c.stroke(), c.globalAlpha = 1, c.setLineDash([]);
  }
  through(places, name, look) {
    this.line(places.length, k => places[k][0], k => places[k][1], name, look);
  }
  dots(places, name, radius, full = true) {
    const { c } = this;
    Object.assign(c, { fillStyle: colour(name), strokeStyle: colour(name), lineWidth: 1 });
    for (const [x, y] of places)
      c.beginPath(), c.arc(this.x(x), this.y(y), radius, 0, 7), full ? c.fill() : c.stroke();
  }
  band(n, x, middle, half, name) {
    const { c } = this;
    Object.assign(c, { fillStyle: colour(name), globalAlpha: 0.15 }), c.beginPath();
    for (let k = 0; k < n; k++) c.lineTo(this.x(x(k)), this.y(middle(k) + half(k)));
    for (let k = n - 1; k >= 0; k--) c.lineTo(this.x(x(k)), this.y(middle(k) - half(k)));
    c.fill(), c.globalAlpha = 1;
  }
  soil(soil) { // and the path
    const [x, y] = soil.origin_m, { cell_m, path } = page.world, [wide, high] = soil.n;
    const image = page.world.keep("picture", soil, () => picture(soil)), size = cell_m * this.scale;
    this.c.drawImage(image, this.x(x - cell_m / 2), this.y(y + (high - 0.5) * cell_m), wide * size,
      high * size);
    this.through(path, "--ink", { width: 1, dash: [5, 4], alpha: 0.6 });
  }
  robot([x, y, theta], name) {
    const { c, scale } = this, [long, wide] = page.world.robot_m;
    c.save(), c.translate(this.x(x), this.y(y)), c.rotate(-theta), c.scale(scale, scale);
    Object.assign(c, { fillStyle: colour(name), globalAlpha: 0.5 });
    c.fillRect(-long / 2, -wide / 2, long, wide), c.restore();
  }
}

function draw() {
  const { loops, world, values, chosen } = page, { lowest, highest, dt_s } = world;
  const { samples } = loops[0], time = k => k * dt_s, seen = loops[chosen], mine = lines[chosen];
  const now = Math.min(Math.floor($("moment").value * samples), samples - 1);
  const poses = loops.map(loop => ["x_m", "y_m", "theta_rad"].map(name => loop.get(name)(now)));
  $("time").value = `${time(now).toFixed(1)} s`;

  const map = page.map = new Plot("map", [lowest[0] - 2, highest[0] + 2],
    [lowest[1] - 3.5, highest[1] + 2], true);
  map.soil(page.soil);
  loops.forEach((loop, i) => {
    map.line(samples, loop.get("x_m"), loop.get("y_m"), lines[i]), map.robot(poses[i], lines[i]);
  });
  const start = page.start = [0, values.start_offset_m], yaw = values.start_yaw_rad;
  const heading = page.heading = [3 * Math.cos(yaw), start[1] + 3 * Math.sin(yaw)];
  map.through([start, heading], "--ink", { width: 1 });
  map.dots([start], "--ink", 5), map.dots([heading], "--ink", 4, false);

  const [x, y] = poses[chosen], reach = 3.2 * values.speed_mps + 0.7;
  const near = new Plot("near", [x - reach, x + reach], [y - 0.5, y + 0.5], true);
  const [age] = seen.piece("estimator.age", now)[0] ?? [0], plan = seen.piece("controller.s", now);
  near.soil(page.soil), near.robot(poses[chosen], "--soft");
  near.line(now + 1, seen.get("x_m"), seen.get("y_m"), "--soft", { width: 1 });
  near.dots(seen.piece("estimator.z", now).slice(-1 - age), "--measured", 5, false);
  near.dots(seen.piece("estimator.s", now).slice(-1 - age), mine, 3);
  near.dots(seen.desired(now), "--ink", 5, false);
  near.through(plan, "--plan"), near.dots(plan, "--plan", 2);

  const over = (id, low, high, each) => {
    const plot = new Plot(id, [0, time(samples)], [low, high]);
    loops.forEach((loop, i) => each(plot, loop, lines[i]));
    plot.line(2, () => time(now), i => i ? high : low, "--soft", { width: 1 });
    return plot;
  };
  const limit = (plot, value) =>
    plot.line(2, i => time(i * samples), () => value, "--ink", { width: 1, dash: [5, 4] });
  const most = Math.max(0.3, ...loops.map(({ metrics }) => 1.1 * metrics.max_error_true_m));
  limit(over("error", 0, Math.min(most, 5), (plot, loop, name) =>
    plot.line(samples, time, loop.error(), name)), world.tolerance_m);
  for (const of of ["mu", "kappa"]) over(of, 0, 1.08, (plot, loop, name) => {
    const sigma = loop.sigma(of), estimate = loop.get(`${of}_hat`);
    if (sigma) plot.band(samples, time, estimate, k => 2 * sigma(k), name);
    plot.line(samples, time, loop.get(of), "--ink", { width: 0.8, alpha: 0.7 });
    plot.line(samples, time, estimate, name);
  });
  const bound = values.omega_max_radps, rates = over("omega", -1.2 * bound, 1.2 * bound,
    (plot, loop, name) => plot.line(samples, time, loop.get("omega_cmd_radps"), name));
  limit(rates, bound), limit(rates, -bound);
}
function picture({ slip, n: [wide, high] }) { // 1 - κ, a dot a cell
  const canvas = new OffscreenCanvas(wide, high), c = canvas.getContext("2d");
  const image = c.createImageData(wide, high), wet = colour("--wet").split(",").map(Number);
  for (let i = 0; i < wide; i++) for (let j = 0; j < high; j++) {
    const kappa = slip[1 + 2 * (i + page.world.grid[0] * j)];
    image.data.set([...wet, 255 * (1 - kappa)], 4 * (i + wide * (high - 1 - j)));
  }
  c.putImageData(image, 0, 0);
  return canvas;
}

// What the reader does

const inputs = () => document.querySelectorAll(`[data-scene="${page.scene}"] input[type=range]`);
function holder({ field, place }) { // where a control's value stands, and under which key
  const { fields } = page.runs[page.chosen], all = field in fields ? fields : page.values;
  return field === "patch" ? [page.patches.at(-1) ?? [], place] : place ? [all[field], place]
    : [all, field];
}
function show() {
  for (const input of inputs()) {
    const [where, key] = holder(input.dataset), value = where[key] ?? Number(input.min);
    input.value = input.dataset.kind === "log" ? Math.log10(value) : value;
    input.nextElementSibling.value = Number(value.toPrecision(3));
  }
}
function set(field, value) { // by a pointer, as the control would
  const input = [...inputs()].find(({ dataset }) => dataset.field === field);
  input.value = value, input.dispatchEvent(new Event("input", { bubbles: true }));
}
function choose(id) { // a scene as it begins
  const { scenes } = page.world, scene = structuredClone(scenes[id]);
  Object.assign(page, { scene: id, chosen: 0, patches: [], values: {}, loops: [] });
  page.runs = scene.runs.map(([name, module, fields]) => ({ name, module, fields }));
  for (const { field, place, value } of Object.values(scene.groups).flat()) {
    if (place === null) page.values[field] = value;
    else if (field !== "patch") (page.values[field] ??= [])[place] = value;
  }
  for (const each of document.querySelectorAll("[data-scene]"))
    each.hidden = each.dataset.scene !== id;
  $("controls").scene.value = id, $("controls")[`run-${id}`].value = "0";
  $("faulty").hidden = id !== "faults", show(), ask(drive);
}
function changed({ target }) {
  const { field, kind } = target.dataset, { name, value } = target;
  if (name === "scene") return choose(value);
  if (name === "moment") return ask(draw);
  if (name.startsWith("run-")) page.chosen = Number(value);
  if (field) {
    const [where, key] = holder(target.dataset);
    where[key] = kind === "log" ? Number((10 ** value).toPrecision(4)) : Number(value);
    if (field === "sigma_w") $("noise").value = "own";
  }
  show(), ask(drive);
}
function addPatch(x = page.world.new_patch[0], y = 0) {
  page.patches.push([x, y, ...page.world.new_patch.slice(2)]), show(), ask(drive);
}
function dragged(canvas, grasp) { // grasp: what is held at a place, as a function of the pointer
  let held = null;
  canvas.onpointerdown = event => {
    held = grasp(event), canvas.setPointerCapture(event.pointerId), held(event);
  };
  canvas.onpointermove = event => held?.(event);
  canvas.onpointerup = canvas.onpointercancel = () => { held = null; };
}
const far = ([x, y], [u, v]) => Math.hypot(x - u, y - v);
function toMoment(place) { // the sample that comes nearest
  const loop = page.loops[page.chosen], x = loop.get("x_m"), y = loop.get("y_m");
  let best = 0;
  for (let k = 0; k < loop.samples; k++)
    if (far(place, [x(k), y(k)]) < far(place, [x(best), y(best)])) best = k;
  $("moment").value = (best + 0.5) / loop.samples, ask(draw);
}
function grasped(event) {
  const at = event => page.map.data(event), place = at(event), patch = page.patches.at(-1);
  if (far(place, page.heading) < 1) return event => {
    const [x, y] = at(event);
    set("start_yaw_rad", Math.atan2(y - page.start[1], x));
  };
  if (far(place, page.start) < 1) return event => set("start_offset_m", at(event)[1]);
  if (patch && far(place, patch) < patch[2]) return event => {
    patch.splice(0, 2, ...at(event).map(x => Math.round(x * 10) / 10)), show(), ask(drive);
  };
  return event => toMoment(at(event));
}
load("world").then(World.of).then(world => {
  page.world = world, page.colours = {};
  $("controls").oninput = changed;
  $("controls").onreset = () => setTimeout(choose, 0, page.scene);
  $("patch").onclick = () => addPatch();
  $("dry").onclick = () => { page.patches = [], show(), ask(drive); };
  $("copy").onclick = () => { // a page from the disk may have no other way to the clipboard
    getSelection().selectAllChildren($("line")), document.execCommand("copy");
  };
  dragged($("map"), grasped);
  $("map").ondblclick = event => addPatch(...page.map.data(event).map(Math.round));
  for (const id of ["error", "mu", "kappa", "omega"]) dragged($(id), () => event => {
    $("moment").value = (event.offsetX - 38) / (event.target.clientWidth - 50), ask(draw);
  });
  new ResizeObserver(() => ask(draw)).observe($("map"));
  matchMedia("(prefers-color-scheme: dark)").onchange = () => {
    page.colours = {}, world.kept.picture = null, ask(draw);
  };
  choose(location.hash.slice(1) in world.scenes ? location.hash.slice(1) : "a");
}).catch(failed);
