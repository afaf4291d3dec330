// The live page's six pictures, drawn with Plot (plot.js).
"use strict";

const COLOURS = ["--run0", "--run1", "--run2"]; // of the runs

function draw_soil(plot, { slip, n, origin_m }) { // and the path
  const { cell_m, loop_shape, path } = page.world;
  plot.soil(n, origin_m, cell_m, (i, j) => slip[1 + 2 * (i + loop_shape[0] * j)]);
  plot.line(...spread(path), "--ink", { width: 1, dash: [5, 4], alpha: 0.6 });
}

function draw_robot(plot, [x, y, theta], colour) {
  const [length, width] = page.world.robot_m;
  const cosine = Math.cos(theta) / 2;
  const sine = Math.sin(theta) / 2;
  const signs = [[1, 1], [-1, 1], [-1, -1], [1, -1]];
  const corners = signs.map(([ahead, left]) => [
    x + ahead * length * cosine - left * width * sine,
    y + ahead * length * sine + left * width * cosine,
  ]);
  plot.area(...spread(corners), colour, { alpha: 0.5 });
}

function pose_of(loop, k) {
  return ["x_m", "y_m", "theta_rad"].map(name => loop.get(name)(k));
}

function draw_map(now) {
  const { loops, world: { lowest, highest }, values } = page;
  const map = new Plot($("map"), [lowest[0] - 2, highest[0] + 2],
    [lowest[1] - 3.5, highest[1] + 2], { equal: true });
  draw_soil(map, page.soil);
  loops.forEach((loop, i) => {
    map.line(loop.samples, loop.get("x_m"), loop.get("y_m"), COLOURS[i]);
    draw_robot(map, pose_of(loop, now), COLOURS[i]);
  });
  const yaw = values.start_yaw_rad;
  page.map = map;
  page.start = [0, values.start_offset_m];
  page.heading = [3 * Math.cos(yaw), page.start[1] + 3 * Math.sin(yaw)];
  map.line(...spread([page.start, page.heading]), "--ink", { width: 1 });
  map.dots(...spread([page.start]), "--ink", { radius: 5 });
  map.dots(...spread([page.heading]), "--ink", { radius: 4, full: false });
}

function draw_near(now) { // what estimator and controller of the followed run know
  const loop = page.loops[page.followed];
  const colour = COLOURS[page.followed];
  const pose = pose_of(loop, now);
  const [x, y] = pose;
  const reach = 3.2 * page.values.speed_mps + 0.7;
  const near = new Plot($("near"), [x - reach, x + reach], [y - 0.5, y + 0.5], { equal: true });
  const [age] = loop.piece("age", now)[0] ?? [0]; // intervals in the window
  const window = name => spread(loop.piece(name, now).slice(-1 - age));
  const plan = spread(loop.piece("plan", now));
  draw_soil(near, page.soil);
  draw_robot(near, pose, "--soft");
  near.line(now + 1, loop.get("x_m"), loop.get("y_m"), "--soft", { width: 1 });
  near.dots(...window("z"), "--measured", { radius: 5, full: false });
  near.dots(...window("s"), colour, { radius: 3 });
  const desired = loop.desired(now, page.values.look_ahead_m);
  near.dots(...spread(desired), "--ink", { radius: 5, full: false });
  near.line(...plan, "--plan");
  near.dots(...plan, "--plan", { radius: 2 });
}

// A picture over time, with the fault shaded and the chosen time marked.
function draw_over_time(id, [low, high], now, draw_loop) {
  const { loops, world: { dt_s, shaded } } = page;
  const time = k => k * dt_s;
  const end_s = time(loops[0].samples);
  const plot = new Plot($(id), [0, end_s], [low, high]);
  if (loops.some(({ data }) => data.faulty)) {
    for (const [from, to] of shaded[$("fault").value]) {
      const across = [from, Math.min(to, end_s)];
      const up = i => [low, high, high, low][i];
      plot.area(4, i => across[i >> 1], up, "--measured", { alpha: 0.15 });
    }
  }
  loops.forEach((loop, i) => draw_loop(plot, loop, COLOURS[i], time));
  plot.line(2, () => time(now), i => [low, high][i], "--soft", { width: 1 });
  plot.limit = value =>
    plot.line(2, i => i * end_s, () => value, "--ink", { width: 1, dash: [5, 4] });
  return plot;
}

function draw_error(now) {
  const { loops, world } = page;
  const largest = Math.max(0.3, ...loops.map(({ metrics }) => 1.1 * metrics.max_error_true_m));
  const plot = draw_over_time("error", [0, Math.min(largest, 5)], now,
    (plot, loop, colour, time) =>
      plot.line(loop.samples, time, loop.get("error_true_m"), colour));
  plot.limit(world.tolerance_m);
}

function draw_traction(name, now) {
  draw_over_time(name, [0, 1.08], now, (plot, loop, colour, time) => {
    const sigma = loop.sigma(name);
    const estimate = loop.get(`${name}_hat`);
    if (sigma) plot.band(loop.samples, time, estimate, k => 2 * sigma(k), colour);
    plot.line(loop.samples, time, loop.get(name), "--ink", { width: 0.8, alpha: 0.7 });
    plot.line(loop.samples, time, estimate, colour);
  });
}

function draw_yaw_rate(now) {
  const bound = page.values.omega_max_radps;
  const plot = draw_over_time("omega", [-1.2 * bound, 1.2 * bound], now,
    (plot, loop, colour, time) =>
      plot.line(loop.samples, time, loop.get("omega_cmd_radps"), colour));
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
}
