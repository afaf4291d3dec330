// The steps of the story: what each one drives, draws and says. Its words are in story.toml.
"use strict";

const story = { steps: {}, wanted: new Set() };
const LATE = 25; // samples until an estimator has forgotten its first guess: 5 s

// What the reader chose, by the names of the controls.

const fields_of = step => [...step.form.elements].filter(({ name }) => name && name !== "next");

const value_of = field => field.type === "checkbox" ? field.checked
  : "log" in field.dataset ? Number((10 ** field.value).toPrecision(3))
    : field.type === "range" ? Number(field.value) : field.value;

const chosen = step =>
  Object.fromEntries(fields_of(step).map(field => [field.name, value_of(field)]));

// From the choice to a run.

async function drive_step(step, { soil, sigma }) {
  const { world } = page;
  const key = `${soil} ${sigma}`;
  if (step.key === key) return;
  const loop = step.loop ??= await Loop.of(step.run.module, world);
  const { sigma_v, sigma_w: [...sigma_w] } = loop.data.noises[step.run.noise];
  const of_kappa = sigma ?? step.run.sigma;
  if (of_kappa) sigma_w[5] = of_kappa;
  const values = { ...world.defaults, sigma_w, sigma_v };
  step.soil = await world.soil(values.seed, soil, [], values);
  loop.run(values, await world.stream(values.seed, false), step.soil, Math.round(120 / world.dt_s));
  Object.assign(step, { key, extra: {} });
}

// Numbers that a step needs once for each run.
const once = (step, name, compute) => step.extra[name] ??= compute();

const each_sample = loop => [...Array(loop.samples).keys()];
const share = (list, test) => list.filter(test).length / list.length;
const rms = list => Math.sqrt(list.reduce((sum, value) => sum + value ** 2, 0) / list.length);

// Pictures.

const over_time = (step, i, up, draw, now) => {
  const { loop } = step;
  const end_s = loop.samples * page.world.dt_s;
  const plot = new Plot(step.canvases[i], [0, end_s], up, { across: "t [s]" });
  draw(plot, k => k * page.world.dt_s);
  if (now !== undefined) plot.line(2, () => now, j => up[j], "--soft", THIN);
  return plot;
};

function draw_drive(step, i, now) {
  const { soil, loop } = step;
  const { lowest, highest } = soil.field;
  const plot = new Plot(step.canvases[i], [lowest[0] - 2, highest[0] + 2],
    [lowest[1] - 7, highest[1] + 2], { equal: true }); // below: where dead reckoning goes
  draw_soil(plot, soil);
  plot.line(now + 1, loop.get("x_m"), loop.get("y_m"), "--run0", BOLD);
  plot.dots(...spread([pose_of(loop, now)]), "--run0", DOT);
  return plot;
}

// Two standard deviations of quantities i and j of a Gaussian.
const ellipse = (mean, P, [i, j]) =>
  ellipse_around([mean[i], mean[j]], [P[i][i], P[i][j], P[j][j]]);

const square = flat => Array.from({ length: 6 }, (_, i) => [...flat.slice(6 * i, 6 * i + 6)]);

function draw_window(step, k, seen) { // in the frame of the window's middle pose
  const { memory, newest, P, own } = seen;
  const { tools, loop } = step;
  const [s, z, [m], P_m] = ["s", "z", "m", "P"].map(name => piece_of(tools, memory, name));
  const turned = seen_from(s[s.length >> 1]);
  const plot = new Plot(step.canvases[0], [-1, 1], [-0.12, 0.12]);
  const truth = each_sample(loop).slice(Math.max(k - 15, 0), k + 1)
    .map(i => turned(pose_of(loop, i)));
  plot.line(...spread(truth), "--soft", THIN);
  const fits = s.map(turned);
  const fixes = z.map(turned);
  fits.forEach((fit, i) => plot.line(...spread([fit, fixes[i]]), "--soft", THIN));
  plot.dots(...spread(fixes.filter(([x]) => !Number.isNaN(x))), "--measured", RING);
  plot.dots(...spread(fits), "--run0", DOT);
  const around = (mean, covariance) => spread(ellipse(mean, covariance, [0, 1]).map(turned));
  if (own.arrival) plot.line(...around(m, P_m), "--plan", BOLD);
  plot.line(...around(newest, P), "--ink");
}

function draw_costs(step, { nodes, arrival }, own) {
  const highest = Math.max(1.5, ...nodes.flat(), own.arrival ? arrival : 0) * 1.1;
  const plot = new Plot(step.canvases[1], [-1.6, nodes.length - 0.4], [0, highest]);
  const bar = (from, wide, high, colour) => plot.area(4, i => from + wide * (i >> 1),
    i => [0, high, high, 0][i], colour);
  const colours = ["--measured", "--run1", "--run2"];
  nodes.forEach((costs, i) =>
    costs.forEach((cost, j) => bar(i - 0.4 + 0.27 * j, 0.24, cost, colours[j])));
  if (own.arrival) bar(-1.4, 0.8, arrival, "--plan");
}

function draw_traction_plane(step, { bounded, unbound, memory, own }) {
  const { tools } = step;
  const [[m], P] = ["m", "P"].map(name => piece_of(tools, memory, name));
  const low = Math.min(0.9, bounded.estimate[4] - 0.05);
  const plot = new Plot(step.canvases[2], [0.3, 1.5], [low, 1.05]);
  for (const edge of [[[1, low], [1, 1]], [[0.3, 1], [1, 1]]])
    plot.line(...spread(edge), "--ink", DASHED);
  const place = ({ estimate }) => [estimate[5], estimate[4]];
  if (own.arrival) plot.line(...spread(ellipse(m, P, [5, 4])), "--plan", BOLD);
  const around = ellipse(unbound.estimate, square(unbound.covariance), [5, 4]);
  plot.line(...spread(around), "--run0");
  plot.dots(...spread([place(unbound)]), "--run0", RING);
  if (!own.bounds || !own.feedback) return; // only feedback knows the bounds
  plot.line(...spread([place(unbound), place(bounded)]), "--soft", THIN);
  plot.dots(...spread([place(bounded)]), "--run0", DOT);
}

// The steps: each draws, and returns the numbers that are said and whether the question is done.

const STEPS = {
  encoders(step, { time }) {
    const { loop, tools } = step;
    const poses = once(step, "poses", () => reckon(loop, tools));
    const k = Math.round(time / page.world.dt_s);
    const error = far(poses[k], pose_of(loop, k));
    const plot = draw_drive(step, 0, k);
    plot.line(k + 1, i => poses[i][0], i => poses[i][1], "--run1", BOLD);
    plot.dots(...spread([poses[k]]), "--run1", DOT);
    const pace = i => far(pose_of(loop, i), pose_of(loop, i - 1));
    const way = each_sample(loop).slice(1, k + 1).reduce((sum, i) => sum + pace(i), 0);
    return { time, error, way, ok: Math.abs(error - 0.39) <= 0.05, digits: { error: 2, way: 1 } };
  },

  filter(step) {
    const { loop } = step;
    const sigma = loop.sigma("theta_rad");
    const error = k => loop.get("theta_hat_rad")(k) - loop.get("theta_rad")(k);
    over_time(step, 0, [-0.25, 0.25], (plot, time) => {
      plot.band(loop.samples, time, () => 0, k => 2 * sigma(k), "--run0");
      plot.line(loop.samples, time, error, "--run1");
    });
    const late = each_sample(loop).slice(LATE);
    const outside = 100 * share(late, k => Math.abs(error(k)) > 2 * sigma(k));
    const kappa = late.reduce((sum, k) => sum + loop.get("kappa")(k), 0) / late.length;
    return { outside, kappa, ok: outside < 10, digits: { outside: 0, kappa: 2 } };
  },

  window(step, own) {
    const { loop, tools, form } = step;
    const k = Math.round(own.time / page.world.dt_s);
    const { V } = noises(loop);
    const { shifted, bounded, free } = take_sample(loop, tools, k, own.arrival);
    const solved = own.bounds ? bounded : free;
    const predicted = { estimate: bounded.m_N, covariance: bounded.P_N };
    const memory = own.feedback ? solved.memory : shifted;
    const { estimate: newest, covariance: P } = own.feedback ? solved : predicted;
    const unbound = own.feedback ? free : predicted;
    draw_window(step, k, { memory, newest, P: square(P), own });
    const costs = costs_of(tools, memory, V);
    draw_costs(step, costs, own);
    draw_traction_plane(step, { bounded, unbound, memory, own });
    const sum = j => costs.nodes.reduce((total, node) => total + node[j], 0);
    const [gnss, speed, input] = [0, 1, 2].map(sum);
    const arrival = own.arrival ? costs.arrival : 0;
    const sigma = Math.sqrt(P[35]);
    const known = loop.sigma("kappa")(k);
    const is_straight = k => Math.abs(loop.get("curvature_radpm")(k)) < 0.01;
    form.elements.next.textContent = own.feedback ? "next: preparation" : "next: feedback";
    return {
      time: own.time, phase: own.feedback ? "Feedback" : "Preparation (no bounds yet)",
      kappa: newest[5], free: unbound.estimate[5], sigma, known, factor: sigma / known,
      gnss, speed, input, arrival, cost: gnss + speed + input + arrival,
      ok: !own.arrival && own.feedback && is_straight(k) && sigma > 3 * known,
      digits: { kappa: 3, free: 3, sigma: 3, known: 3, factor: 0 },
    };
  },

  kalman(step, { bounds }) {
    const { loop, tools } = step;
    const both = once(step, `both ${bounds}`, () => compare(loop, tools, bounds));
    const gaps = both.map(([a, b]) => far(a, b));
    over_time(step, 0, [0, 0.02], (plot, time) =>
      plot.line(loop.samples, time, k => gaps[k], "--run0")).line(
      2, i => i * 120, () => 0.001, "--ink", DASHED);
    const late = gaps.slice(LATE);
    const largest = 1e3 * Math.max(...late);
    const gnss = 1e3 * rms(each_sample(loop).map(k => far(measured(loop, k), pose_of(loop, k))));
    const kappa = Math.max(...both.slice(LATE).map(([a, b]) => Math.abs(a[5] - b[5])));
    return { largest, rms: 1e3 * rms(late), kappa, gnss, ok: largest < 1,
      digits: { largest: 2, rms: 2, kappa: 3, gnss: 0 } };
  },

  row(step, { time }) {
    const { loop } = step;
    const sigma = loop.sigma("kappa");
    const k = Math.round(time / page.world.dt_s);
    over_time(step, 0, [0, 0.3], (plot, at) =>
      plot.line(loop.samples, at, sigma, "--run0"), time);
    draw_drive(step, 1, k);
    const late = each_sample(loop).slice(2 * LATE);
    const best = late.reduce((a, b) => sigma(b) > sigma(a) ? b : a);
    const after = Math.min(best + 50, loop.samples - 1);
    return { time, sigma: sigma(k), x: loop.get("x_m")(k), largest: sigma(best),
      later: (after - best) * page.world.dt_s, after: sigma(after),
      ok: k >= 2 * LATE && sigma(k) > 0.97 * sigma(best),
      digits: { sigma: 3, largest: 3, after: 3, later: 0, x: 1 } };
  },

  noise(step, { sigma }) {
    const { loop } = step;
    const estimate = loop.get("kappa_hat");
    over_time(step, 0, [0, 1.08], (plot, time) => {
      plot.line(loop.samples, time, loop.get("kappa"), "--ink", THIN);
      plot.line(loop.samples, time, estimate, "--run0");
    });
    const all = each_sample(loop);
    const jumps = all.filter(k => k && Math.abs(estimate(k) - estimate(k - 1)) > 0.2).length;
    const bound = 100 * share(all, k => estimate(k) <= 0 || estimate(k) >= 1);
    const error = rms(all.slice(LATE).map(k => estimate(k) - loop.get("kappa")(k)));
    return { sigma, jumps, bound, rms: error, ok: jumps < 5,
      digits: { sigma: 3, jumps: 0, bound: 0, rms: 2 } };
  },

  sandbox() { // the sandbox's own runs
    const [rhe, ekf] = page.loops.map(loop => loop.metrics?.max_error_true_m);
    if (page.scene !== "b" || !ekf) return { idle: true, ok: false };
    return { rhe, ekf, ratio: ekf / rhe, ok: ekf > 2 * rhe, digits: { rhe: 2, ekf: 2 } };
  },
};

// What is said, and when.

function say(step, { ok, idle, digits = {}, ...numbers }) {
  const word = name => typeof numbers[name] === "string" ? numbers[name]
    : numbers[name].toFixed(digits[name] ?? 1);
  const filled = text => text.replace(/\{(\w+)\}/g, (_, name) => word(name));
  const put = (name, text) => {
    const at = step.section.querySelector(name);
    if (at.textContent !== text) at.textContent = text;
  };
  put(".told", idle ? "" : filled(step.told));
  put(".answer", idle ? step.idle : filled(ok ? `✓ ${step.right}` : step.wrong));
  step.section.querySelector(".answer").classList.toggle("ok", ok);
}

async function update(step) {
  const own = chosen(step);
  if (step.run) {
    step.tools ??= await Loop.of("tools", page.world);
    await drive_step(step, own);
  }
  say(step, STEPS[step.id](step, own));
}

function want(step) { // a step is drawn once in a frame, however much is moved
  story.wanted.add(step);
  story.busy = (story.busy ?? Promise.resolve())
    .then(() => new Promise(requestAnimationFrame))
    .then(() => story.wanted.delete(step) && update(step))
    .catch(failed);
}

function next_phase(step) { // preparation of the next sample, then its feedback
  const { feedback, time } = step.form.elements;
  if (feedback.checked) time.stepUp();
  feedback.checked = !feedback.checked;
  want(step);
}

function begin_story() {
  for (const [id, own] of Object.entries(page.world.story)) {
    const section = $(`step-${id}`);
    const form = section.querySelector("form");
    const step = { id, ...own, section, form, extra: {},
      canvases: [...section.querySelectorAll("canvas")] };
    story.steps[id] = step;
    form.oninput = () => want(step);
    form.onsubmit = event => event.preventDefault();
    if (form.elements.next) form.elements.next.onclick = () => next_phase(step);
    want(step);
  }
  const all = () => Object.values(story.steps).forEach(want);
  document.addEventListener("drawn", () => want(story.steps.sandbox));
  matchMedia("(prefers-color-scheme: dark)").onchange = all;
  addEventListener("resize", all);
}

addEventListener("DOMContentLoaded", () => load("world").then(begin_story).catch(failed));
