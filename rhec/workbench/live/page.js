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
function soil(plot, { slip, n, origin_m }) { // and the path
  const { cell_m, grid, path } = page.world;
  plot.soil(n, origin_m, cell_m, (i, j) => slip[1 + 2 * (i + grid[0] * j)]);
  plot.line(...spread(path), "--ink", { width: 1, dash: [5, 4], alpha: 0.6 });
}
function robot(plot, [x, y, theta], name) {
  const [a, b] = page.world.robot_m, [c, s] = [Math.cos(theta) / 2, Math.sin(theta) / 2];
  const corners = [[a, b], [-a, b], [-a, -b], [a, -b]].map(
    ([ahead, left]) => [x + ahead * c - left * s, y + ahead * s + left * c]);
  plot.area(...spread(corners), name, { alpha: 0.5 });
}
function draw() {
  const { loops, world, values, chosen } = page, { lowest, highest, dt_s } = world;
  const { samples } = loops[0], time = k => k * dt_s, seen = loops[chosen], mine = lines[chosen];
  const now = Math.min(Math.floor($("moment").value * samples), samples - 1);
  const poses = loops.map(loop => ["x_m", "y_m", "theta_rad"].map(name => loop.get(name)(now)));
  $("time").value = `${time(now).toFixed(1)} s`;
  const map = page.map = new Plot($("map"), [lowest[0] - 2, highest[0] + 2],
    [lowest[1] - 3.5, highest[1] + 2], { equal: true });
  soil(map, page.soil);
  loops.forEach((loop, i) => {
    map.line(samples, loop.get("x_m"), loop.get("y_m"), lines[i]), robot(map, poses[i], lines[i]);
  });
  const start = page.start = [0, values.start_offset_m], yaw = values.start_yaw_rad;
  const heading = page.heading = [3 * Math.cos(yaw), start[1] + 3 * Math.sin(yaw)];
  map.line(...spread([start, heading]), "--ink", { width: 1 });
  map.dots(...spread([start]), "--ink", { radius: 5 });
  map.dots(...spread([heading]), "--ink", { radius: 4, full: false });
  const [x, y] = poses[chosen], reach = 3.2 * values.speed_mps + 0.7;
  const near = new Plot($("near"), [x - reach, x + reach], [y - 0.5, y + 0.5], { equal: true });
  const [age] = seen.piece("estimator.age", now)[0] ?? [0], plan = seen.piece("controller.s", now);
  const past = name => spread(seen.piece(name, now).slice(-1 - age));
  soil(near, page.soil), robot(near, poses[chosen], "--soft");
  near.line(now + 1, seen.get("x_m"), seen.get("y_m"), "--soft", { width: 1 });
  near.dots(...past("estimator.z"), "--measured", { radius: 5, full: false });
  near.dots(...past("estimator.s"), mine, { radius: 3 });
  near.dots(...spread(seen.desired(now)), "--ink", { radius: 5, full: false });
  near.line(...spread(plan), "--plan"), near.dots(...spread(plan), "--plan", { radius: 2 });
  const over = (id, low, high, each) => {
    const plot = new Plot($(id), [0, time(samples)], [low, high]);
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
  page.world = world;
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
  matchMedia("(prefers-color-scheme: dark)").onchange = () => ask(draw);
  choose(location.hash.slice(1) in world.scenes ? location.hash.slice(1) : "a");
}).catch(failed);
