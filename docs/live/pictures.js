// The live page's six pictures, drawn with Plot (plot.js) and the robot view (robot_view.js).
"use strict";

// As in the figures (rhec/style.py): weights and estimators keep their colours in all scenes.
const COLOURS = { "Q¹": "--q1", "Q²": "--q2", "Q³": "--run0", RHE: "--run0", EKF: "--run1" };
const colour_of = i => COLOURS[page.runs[i].name] ?? `--run${i}`;

function draw_soil(plot, { field, slip, n, origin_m }) { // and the path
  const { cell_m, soil_shape } = page.world;
  plot.soil(n, origin_m, cell_m, (i, j) => slip[1 + 2 * (i + soil_shape[0] * j)]);
  plot.line(...spread(field.path), "--ink", PATH);
}

function pose_of(loop, k) {
  return ["x_m", "y_m", "theta_rad"].map(name => loop.get(name)(k));
}

// Draw the runs that the reader has not hidden, the first one on top.
function each_shown(draw_run) {
  for (const [i, loop] of [...page.loops.entries()].reverse())
    if (!page.hidden.has(page.runs[i].name)) draw_run(loop, i);
}

function draw_map(now) {
  const { loops, soil: { field: { lowest, highest } }, values } = page;
  const map = page.views.plot($("map"), [lowest[0] - 2, highest[0] + 2],
    [lowest[1] - 3.5, highest[1] + 2], { equal: true });
  draw_soil(map, page.soil);
  each_shown((loop, i) => {
    const label = page.runs[i].name;
    map.line(loop.samples, loop.get("x_m"), loop.get("y_m"), colour_of(i), { label });
    const outline = box_around(...page.world.robot_m).map(placed_at(pose_of(loop, now)));
    map.area(...spread(outline), colour_of(i), SHADE);
  });
  const yaw = values.start_yaw_rad;
  page.map = map;
  page.start = [0, values.start_offset_m];
  page.heading = [3 * Math.cos(yaw), page.start[1] + 3 * Math.sin(yaw)];
  map.line(...spread([page.start, page.heading]), "--ink", THIN);
  map.dots(...spread([page.start]), "--ink", DOT);
  map.dots(...spread([page.heading]), "--ink", RING);
}

function touches_of(loop) { // first sample at which each plant is touched
  const { field: { plants }, world: { robot_m } } = loop;
  const pose = ["x_m", "y_m", "theta_rad"].map(name => loop.get(name));
  return loop.touches ??= first_touches(loop.samples, ...pose, plants, robot_m);
}

function view_of(loop, now, colour) { // what draw_robot_view needs to know of a run
  const { world, values, soil } = page;
  const { tolerance_m, robot_m, track_width_m } = world;
  const { field, field: { plants } } = loop;
  const row = name => loop.get(name)(now);
  const [age] = loop.piece("age", now)[0] ?? [0]; // intervals in the window
  const window = loop.piece("s", now).slice(-1 - age);
  const reach_m = 3.2 * values.speed_mps + 0.7;
  const near = Array.from({ length: 13 }, (_, i) => (i - 6) * reach_m / 5);
  const past = Array.from({ length: Math.min(now + 1, 60) }, (_, i) => Math.max(now - 59, 0) + i);
  const touches = touches_of(loop);
  const pair = (nu, omega) => [-1, 1].map(side => nu + side * track_width_m / 2 * omega);
  const P = (of, and) => loop.covariance(of, and, now);
  return {
    path: near.map(ahead => field.pose_on_path(row("s_m") + ahead)),
    camera: field.pose_on_path(row("s_m")),
    pose: pose_of(loop, now),
    estimate: ["x_hat_m", "y_hat_m", "theta_hat_rad"].map(row),
    covariance: [P("x_m", "x_m"), P("x_m", "y_m"), P("y_m", "y_m"), P("theta_rad", "theta_rad")],
    driven: past.map(k => pose_of(loop, k)),
    measured: past.slice(-25).map(k => ["x_meas_m", "y_meas_m"].map(name => loop.get(name)(k))),
    desired: loop.desired(now, values.look_ahead_m),
    plan: loop.piece("plan", now),
    commanded_mps: pair(values.speed_mps, loop.get("omega_cmd_radps")(Math.max(now - 1, 0))),
    ground_mps: pair(row("mu") * row("nu_mps"),
      row("kappa") * row("omega_radps") + row("mu") * row("nu_mps") * row("yaw_drift_radpm")),
    traction: (x, y) => world.traction(soil, x, y),
    touched: i => touches[i] <= now,
    window, reach_m, plants, tolerance_m, robot_m, track_width_m, colour,
  };
}

function draw_near(now) {
  const loop = page.loops[page.followed];
  draw_robot_view($("near"), view_of(loop, now, colour_of(page.followed)));
  $("touched").value = touches_of(loop).filter(k => k <= now).length;
}

// A picture over time, with the fault shaded and the chosen time marked.
function draw_over_time(id, [low, high], now, draw_loop) {
  const { loops, world: { dt_s, shaded } } = page;
  const time = k => k * dt_s;
  const end_s = time(loops[0].samples);
  const plot = page.views.plot($(id), [0, end_s], [low, high], { across: "t [s]" });
  if (loops.some(({ data }) => data.faulty)) {
    for (const [from, to] of shaded[$("fault").value]) {
      const across = [from, Math.min(to, end_s)];
      const up = i => [low, high, high, low][i];
      plot.area(4, i => across[i >> 1], up, "--measured", SHADE);
    }
  }
  each_shown((loop, i) => draw_loop(plot, loop, colour_of(i), time, page.runs[i].name));
  plot.line(2, () => time(now), i => [low, high][i], "--soft", THIN);
  plot.limit = value =>
    plot.line(2, i => i * end_s, () => value, "--ink", DASHED);
  return plot;
}

function draw_error(now) {
  const { loops, world } = page;
  const largest = Math.max(0.3, ...loops.map(({ metrics }) => 1.1 * metrics.max_error_true_m));
  const plot = draw_over_time("error", [0, Math.min(largest, 5)], now,
    (plot, loop, colour, time, label) =>
      plot.line(loop.samples, time, loop.get("error_true_m"), colour, { label }));
  plot.limit(world.tolerance_m);
}

function lowest_of(loop, name) {
  const value = loop.get(name);
  let lowest = 1;
  for (let k = 0; k < loop.samples; k++) lowest = Math.min(lowest, value(k));
  return lowest;
}

function draw_traction(name, now) {
  const least = Math.min(...page.loops.flatMap(loop =>
    [name, `${name}_hat`].map(each => lowest_of(loop, each))));
  const low = [0.8, 0.6, 0.4, 0.2].find(floor => floor < least) ?? 0;
  draw_over_time(name, [low, 1.02], now, (plot, loop, colour, time, label) => {
    const sigma = loop.sigma(name);
    const estimate = loop.get(`${name}_hat`);
    if (sigma) plot.band(loop.samples, time, estimate, k => 2 * sigma(k), colour);
    plot.line(loop.samples, time, loop.get(name), "--ink",
      { ...THIN, label: `truth of ${label}` });
    plot.line(loop.samples, time, estimate, colour, { label });
  });
}

function draw_yaw_rate(now) {
  const bound = page.values.omega_max_radps;
  const plot = draw_over_time("omega", [-1.2 * bound, 1.2 * bound], now,
    (plot, loop, colour, time, label) =>
      plot.line(loop.samples, time, loop.get("omega_cmd_radps"), colour, { label }));
  plot.limit(bound);
  plot.limit(-bound);
}

function draw() {
  const { samples } = page.loops[0];
  const now = Math.min(Math.floor($("moment").value * samples), samples - 1);
  $("time").value = `${(now * page.world.dt_s).toFixed(1)} s`;
  draw_map(now);
  draw_near(now);
  draw_error(now);
  draw_traction("mu", now);
  draw_traction("kappa", now);
  draw_yaw_rate(now);
  page.views.point(page.views.k);
}
