// The live page's controls, words and numbers.
"use strict";

const $ = id => document.getElementById(id);
const page = { loops: [], hidden: new Set(), views: new Views(() => ask(draw), { box: false }) };
const NOISES = ["sigma_w", "sigma_v"]; // sliders of what an estimator assumes

// From the controls to runs

const failed = error => {
  $("said").textContent = error.message;
  console.error(error);
};

// What an estimator assumes of noise, { sigma_w, sigma_v }: by a rule, or as the sliders say.
function noise_of({ noises }) {
  const { sigma_w, sigma_v } = page.values; // of (x, y, θ, ν, μ, κ), and of (x, y, ν, ω)
  return noises[$("noise").value]
    ?? { sigma_w: sigma_w.slice(0, noises.printed.sigma_w.length), sigma_v };
}

function values_of({ data }, fields) { // of the Scenario
  const turns = $("turns").value;
  return { ...page.world.defaults, ...page.values, ...fields, ...noise_of(data), turns };
}

async function drive() {
  const { world, values, runs, patches } = page;
  const seed = Number($("seed").value);
  const samples = Math.round(values.duration_s / world.dt_s);
  const where = { turns: $("turns").value, start_offset_m: values.start_offset_m };
  page.soil = await world.soil(seed, $("soil").value, patches, where);
  const streams = [];
  for (const [i, { module }] of runs.entries()) {
    const n = $("window").value;
    const name = module === "rhe" && n !== "15" ? `rhe_${n}` : module;
    if (page.loops[i]?.name !== name) page.loops[i] = await Loop.of(name, world);
    streams[i] = await world.stream(seed, page.loops[i].data.faulty && $("fault").value);
  }
  page.loops.length = runs.length;
  const begun = performance.now();
  page.loops.forEach((loop, i) =>
    loop.run(values_of(loop, runs[i].fields), streams[i], page.soil, samples));
  const took = performance.now() - begun;
  show();
  write(`${runs.length} runs of ${values.duration_s} s in ${took.toFixed(0)} ms`);
  draw();
}

let asked = null; // the newest wish, carried out in the next frame: dragging never queues
function ask(what) {
  if (!asked) {
    page.busy = (page.busy ?? Promise.resolve())
      .then(() => new Promise(requestAnimationFrame))
      .then(async () => {
        const now = asked;
        asked = null;
        await now();
        document.dispatchEvent(new Event("drawn"));
      })
      .catch(failed);
  }
  if (asked !== drive) asked = what;
}

// In words and numbers

function python(value) {
  if (!Array.isArray(value)) return JSON.stringify(value);
  return `(${value.map(python).join(", ")}${value.length === 1 ? "," : ""})`;
}

function line_of(run, { data }) { // the line of Python that is this run
  const { defaults, soils, faults } = page.world;
  const noise = $("noise").value;
  const fields = {
    ...data.line,
    ...soils[$("soil").value],
    ...page.values,
    ...run.fields,
    patches: page.patches,
    seed: Number($("seed").value),
    turns: $("turns").value,
    process_noise: noise === "own" ? defaults.process_noise : noise,
    sigma_w: defaults.sigma_w,
    sigma_v: defaults.sigma_v,
    ...noise === "own" && noise_of(data),
  };
  const words = Object.entries(fields)
    .map(([name, value]) => [name, python(value)])
    .filter(([name, value]) => value !== python(defaults[name]));
  if (data.faulty) words.push(["faults", faults[$("fault").value]]);
  return `rhec.simulate(rhec.Scenario(${words.map(word => word.join("=")).join(", ")}))`;
}

function write(said) {
  const { loops, runs, world: { metrics: shown } } = page;
  const number = (value, digits) => Number.isFinite(value) ? value.toFixed(digits) : "never";
  const row = (title, cells) => `<tr><th scope="row">${title}</th>${cells.join("")}</tr>`;
  const heads = shown.map(([, head, unit]) => `<th scope="col">${head}<br>${unit}</th>`);
  const rows = loops.map(({ metrics }, i) => {
    const { name } = runs[i];
    const swatch = `<span style="color: var(${colour_of(i)})">━</span> ${name}`;
    const line = `<button type="button" data-run="${name}" aria-pressed="${!page.hidden.has(name)}"`
      + ` title="a click hides or shows it">${swatch}</button>`;
    return row(line, shown.map(
      ([name, , , digits]) => `<td>${number(metrics[name], digits)}</td>`));
  });
  $("metrics").innerHTML = row("run", heads) + rows.join("");
  $("line").textContent = loops.map((loop, i) => line_of(runs[i], loop)).join("\n");
  $("said").textContent = said;
  const words = loops.map(({ metrics }, i) => `${runs[i].name}: largest true error `
    + `${number(metrics.max_error_true_m, 2)} m, mean ${number(metrics.mean_error_true_m, 3)} m`);
  for (const canvas of document.querySelectorAll("#pictures canvas"))
    canvas.ariaLabel = `${canvas.previousElementSibling.textContent} ${words.join("; ")}`;
}

// What the reader does

const sliders = () => document.querySelectorAll("#sliders input[type=range]");

// Where a slider's value is stored: [object, key], or null where the slider sets nothing.
function slot({ field, place }) {
  const { fields } = page.runs[page.followed];
  if (field === "patch") return page.patches.length ? [page.patches.at(-1), place] : null;
  if (NOISES.includes(field)) {
    const data = page.loops[page.followed]?.data;
    const sigma = (data ? noise_of(data) : page.values)[field];
    return place < sigma.length ? [sigma, place] : null;
  }
  const values = field in fields ? fields : page.values;
  return place ? [values[field], place] : [values, field];
}

function show() {
  for (const input of sliders()) {
    const found = slot(input.dataset);
    input.disabled = !found;
    input.nextElementSibling.value = "–";
    if (found) {
      const value = found[0][found[1]];
      input.value = input.dataset.kind === "log" ? Math.log10(value) : value;
      input.nextElementSibling.value = Number(value.toPrecision(3));
    }
  }
  $("dry").disabled = !page.patches.length;
  $("window").disabled = !page.runs.some(({ module }) => module === "rhe");
}

function move(field, value) { // by a pointer on the map, as the slider would
  const input = [...sliders()].find(({ dataset }) => dataset.field === field);
  input.value = value;
  input.dispatchEvent(new Event("input", { bubbles: true }));
}

function choose(id) { // a scene as it begins
  const scene = structuredClone(page.world.scenes[id]);
  const { values } = scene;
  const runs = scene.runs.map(([name, module, fields]) => ({ name, module, fields }));
  Object.assign(page, { scene: id, followed: 0, patches: [], loops: [], values, runs });
  for (const section of document.querySelectorAll("[data-scene]"))
    section.hidden = section.dataset.scene !== id;
  $("controls").scene.value = id;
  const followed = $("controls")[`run-${id}`];
  followed.value = "0";
  followed.forEach((input, i) => {
    input.parentElement.style.color = `var(${colour_of(i)})`;
  });
  $("faulty").hidden = id !== "faults";
  $("fault").value = scene.fault;
  $("moment").value = (scene.time_s + 0.1) / values.duration_s;
  show();
  ask(drive);
}

function changed({ target }) {
  const { field, place, kind } = target.dataset;
  const { name, value } = target;
  if (target.id === "pace") return;
  if (name === "scene") return choose(value);
  if (name === "moment") return ask(draw);
  if (name.startsWith("run-")) page.followed = Number(value);
  const is_noise = NOISES.includes(field);
  if (is_noise && $("noise").value !== "own") { // the sliders go on from what they show
    const shown = noise_of(page.loops[page.followed].data);
    for (const of of NOISES)
      page.values[of] = page.values[of].map((own, i) => shown[of][i] ?? own);
    $("noise").value = "own";
  }
  if (field) {
    const [values, key] = is_noise ? [page.values[field], place] : slot(target.dataset);
    values[key] = kind === "log" ? Number((10 ** value).toPrecision(4)) : Number(value);
  }
  show();
  ask(drive);
}

function add_patch(x = page.world.new_patch[0], y = 0) {
  page.patches.push([x, y, ...page.world.new_patch.slice(2)]);
  show();
  ask(drive);
}

function remove_patches() {
  page.patches = [];
  show();
  ask(drive);
}

function dragged(canvas, grasp) { // grasp: pointer -> what its moves do
  let held = null;
  canvas.onpointerdown = event => {
    held = grasp(event);
    canvas.setPointerCapture(event.pointerId);
    held(event);
  };
  canvas.onpointermove = event => held?.(event);
  canvas.onpointerup = canvas.onpointercancel = () => { held = null; };
}

const far = ([x, y], [u, v]) => Math.hypot(x - u, y - v);

function to_moment(place) { // the time when the followed robot comes nearest
  const loop = page.loops[page.followed];
  const away = k => far(place, [loop.get("x_m")(k), loop.get("y_m")(k)]);
  let best = 0;
  for (let k = 0; k < loop.samples; k++) if (away(k) < away(best)) best = k;
  $("moment").value = (best + 0.5) / loop.samples;
  ask(draw);
}

function grasped(event) { // what is held on the map
  const at = event => page.map.data(event);
  const place = at(event);
  const patch = page.patches.at(-1);
  if (far(place, page.heading) < 1) return event => {
    const [x, y] = at(event);
    move("start_yaw_rad", Math.atan2(y - page.start[1], x));
  };
  if (far(place, page.start) < 1) return event => move("start_offset_m", at(event)[1]);
  if (patch && far(place, patch) < patch[2]) return event => {
    patch.splice(0, 2, ...at(event).map(x => Math.round(x * 10) / 10));
    show();
    ask(drive);
  };
  return event => to_moment(at(event));
}

function begin(world) {
  page.world = world;
  $("controls").oninput = changed;
  $("controls").onreset = () => setTimeout(choose, 0, page.scene);
  $("patch").onclick = () => add_patch();
  $("dry").onclick = remove_patches;
  dragged($("map"), grasped);
  $("map").ondblclick = event => add_patch(...page.map.data(event).map(Math.round));
  for (const id of ["error", "mu", "kappa", "omega"]) dragged($(id), () => event => {
    const [time_s] = page.views.all.get($(id)).plot.data(event);
    $("moment").value = time_s / (page.loops[0].samples * page.world.dt_s);
    ask(draw);
  });
  $("metrics").onclick = ({ target }) => {
    const button = target.closest("button");
    if (!button) return;
    const { run } = button.dataset;
    if (!page.hidden.delete(run)) page.hidden.add(run);
    button.ariaPressed = !page.hidden.has(run);
    ask(draw);
  };
  new ResizeObserver(() => page.soil && ask(draw)).observe($("pictures"));
  matchMedia("(prefers-color-scheme: dark)").onchange = () => ask(draw);
  if (!open_address()) choose("a");
  addEventListener("hashchange", open_address);
}

// Choose the scene of an address such as #b, if it names one. Returns whether it does.
function open_address() {
  const scene = location.hash.slice(1);
  if (!Object.hasOwn(page.world.scenes, scene)) return false;
  choose(scene);
  (story.busy ?? Promise.resolve()).then(() => $("sandbox").scrollIntoView());
  return true;
}

addEventListener("DOMContentLoaded", () => // when all scripts are there
  load("world").then(data => begin(new World(data))).catch(failed));
