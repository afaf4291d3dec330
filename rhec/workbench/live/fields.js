// Many fields: the page's runs with the noise and the soils of other seeds, in workers.
"use strict";

const WORKERS = Math.min(navigator.hardwareConcurrency || 2, 4);
const QUIET_MS = 250; // the controls must rest so long
const KEPT = 4; // of so many samples the pictures show one

const fields = { key: "", workers: [], results: [], pairs: [], streams: {}, begun: 0, took: 0 };

// In a worker: drive all runs on the fields of these pairs of seeds, of noise and of soil.
async function drive_fields({ data: { runs, world, streams, soils, pairs, samples } }) {
  const loops = await Promise.all(
    runs.map(({ module, data }) => Loop.from(module, { data, world })));
  for (const [noise, soil] of pairs) {
    const found = loops.map((loop, i) => {
      loop.run(runs[i].values, streams[runs[i].fault][noise], soils[soil], samples);
      return thinned(loop);
    });
    postMessage({ noise, soil, runs: found });
  }
}

function thinned(loop) { // metrics of a run, and every KEPT-th sample
  const n = Math.ceil(loop.samples / KEPT);
  const column = of => Float32Array.from({ length: n }, (_, k) => of(KEPT * k));
  const { metrics, world: { dt_s } } = loop;
  const names = ["x_m", "y_m", "error_true_m"];
  const columns = Object.fromEntries(names.map(name => [name, column(loop.get(name))]));
  return { n, metrics, ...columns, time_s: column(k => k * dt_s) };
}

// A page from the disk may not load a worker's script, but it may make one: of its own functions.
function worker_of_the_page() {
  const constants = `const SETTLING_S = ${SETTLING_S}, KEPT = ${KEPT};`;
  const parts = ["\"use strict\";", constants, metrics_of, Loop, thinned, drive_fields];
  const text = [...parts, "onmessage = drive_fields;"].join("\n");
  const address = URL.createObjectURL(new Blob([text], { type: "text/javascript" }));
  const worker = new Worker(address);
  URL.revokeObjectURL(address);
  return worker;
}

// Every seed's noise with every seed's soil, or each with its own.
function pairs_of(seeds, is_crossed) {
  const all = seeds.flatMap(noise => seeds.map(soil => [noise, soil]));
  return all.filter(([noise, soil]) => is_crossed || noise === soil);
}

async function streams_of(world, fault) { // of all seeds; they are kept
  return fields.streams[fault] ??= await Promise.all(
    world.seeds.map(seed => new World(world).stream(seed, fault)));
}

async function job_of() { // what all workers need to know
  const { world, values, patches, loops } = page;
  const streams = {};
  const runs = [];
  for (const [i, loop] of loops.entries()) {
    const { data: { wasm, module, ...data } } = loop;
    const fault = data.faulty ? $("fault").value : "";
    streams[fault] = await streams_of(world, fault);
    runs.push({ module: loop.module, data, fault, values: values_of(loop, page.runs[i].fields) });
  }
  const soils = await Promise.all(world.seeds.map(seed =>
    new World(world).soil(seed, $("soil").value, patches, values.start_offset_m)));
  const { columns, errors, dt_s, tolerance_m } = world;
  const samples = Math.round(values.duration_s / dt_s);
  return { runs, streams, soils, samples, world: { columns, errors, dt_s, tolerance_m } };
}

function stop_fields() {
  fields.workers.forEach(worker => worker.terminate());
  Object.assign(fields, { workers: [], results: [], pairs: [] });
}

async function drive_on_fields(pairs, key) {
  fields.begun = performance.now();
  const job = await job_of();
  if (key !== fields.key) return; // the controls have moved on
  fields.pairs = pairs;
  fields.workers = Array.from({ length: Math.min(WORKERS, pairs.length) }, worker_of_the_page);
  fields.workers.forEach((worker, i) => {
    worker.onmessage = ({ data }) => arrived(data);
    worker.onerror = failed;
    worker.postMessage({ ...job, pairs: pairs.filter((_, j) => j % fields.workers.length === i) });
  });
}

function arrived(result) {
  fields.results.push(result);
  const are_all = fields.results.length === fields.pairs.length;
  fields.took = performance.now() - fields.begun;
  if (are_all || fields.results.length % 25 === 0) {
    show_fields();
    ask(draw);
  }
}

// The followed run on these fields, where there are enough of them for a fan.
function fan() {
  if (!$("many").checked) return [];
  return fields.results.map(({ runs }) => runs[page.followed]);
}

function follow_the_controls() { // a picture was drawn: of other settings than the fields?
  const lists = ["soil", "noise", "window", "fault", "challenge"].map(id => $(id).value);
  const { scene, values, patches } = page;
  const key = JSON.stringify([scene, values, patches, lists, $("many").checked]);
  if (key === fields.key) return show_fields();
  const had_fan = fields.results.length;
  fields.key = key;
  clearTimeout(fields.timer);
  stop_fields();
  show_fields();
  if (had_fan) ask(draw);
  const is_many = $("many").checked;
  const pairs = is_many || challenge() ? pairs_of(page.world.seeds, is_many) : [];
  if (pairs.length)
    fields.timer = setTimeout(() => drive_on_fields(pairs, key).catch(failed), QUIET_MS);
  return null;
}

const violations_of = run => fields.results.map(({ runs }) => runs[run].metrics.violations);

function draw_histogram() { // of the violations by the measured position, as the paper counts them
  const counts = page.loops.map((_, i) => violations_of(i));
  const most = Math.max(20, ...counts.flat());
  const wide = Math.ceil(most / 24);
  const bins = Math.floor(most / wide) + 1;
  const bars = counts.map(all => {
    const bar = new Array(bins).fill(0);
    for (const count of all) bar[Math.floor(count / wide)]++;
    return bar;
  });
  const high = Math.max(...bars.flat(), 1);
  const plot = new Plot($("histogram"), [0, bins * wide], [0, 1.05 * high]);
  bars.forEach((bar, i) => bar.forEach((count, bin) => {
    const side = wide / bars.length;
    const from = bin * wide + i * side;
    const to = bin * wide + (i + 0.9) * side;
    plot.area(4, k => [from, from, to, to][k], k => [0, count, count, 0][k], COLOURS[i], {});
  }));
  const { paper_violations } = page.world;
  page.runs.forEach(({ name }, i) => {
    const at = page.scene === "b" ? paper_violations[name] : NaN;
    plot.line(2, () => at + 0.5, k => k * high, COLOURS[i], { width: 2, dash: [5, 4] });
  });
}

function violations_in_words() {
  const number = fields.results.length;
  const middle = all => all.toSorted((a, b) => a - b)[Math.floor(all.length / 2)];
  return page.runs.map(({ name }, i) => {
    const all = violations_of(i);
    const printed = page.scene === "b" ? `; the paper: ${page.world.paper_violations[name]}` : "";
    return `${name}: none on ${all.filter(each => !each).length} of ${number} fields, `
      + `median ${middle(all)}, most ${Math.max(...all)}${printed}`;
  });
}

function show_fields() {
  const { pairs, results, took } = fields;
  const are_all = pairs.length && results.length === pairs.length;
  $("fields_said").textContent = !pairs.length ? ""
    : are_all ? `${results.length} fields in ${(took / 1000).toFixed(1)} s`
      : `${results.length} of ${pairs.length} fields …`;
  const is_many = $("many").checked && results.length > 0;
  $("violations").hidden = !is_many;
  if (is_many) {
    draw_histogram();
    $("violations_said").textContent = violations_in_words().join(". ") + ".";
  }
  show_score();
}

$("many").onchange = () => follow_the_controls();
document.addEventListener("drawn", follow_the_controls);
