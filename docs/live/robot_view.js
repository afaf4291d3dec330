// The robot between its rows of plants at one sample, drawn with Plot (plot.js). The camera follows
// the robot along its path: ahead is right.
const spread = places => [places.length, k => places[k][0], k => places[k][1]];
const PLANTS = "--plants";
const TOUCHED = "--touched";
const CELLS = 49; // of the soil along either side, the middle one under the camera
// Looks of marks [px].
const THIN = { width: 1 };
const BOLD = { width: 2 };
const DASHED = { ...THIN, dash: [5, 4] };
const PATH = { ...DASHED, alpha: 0.6 };
const SHADE = { alpha: 0.3 };
const DOT = { radius: 5 };
const RING = { ...DOT, full: false };
const NODE = { radius: 2.5 };

// From the plane to the camera's frame: [ahead, left] of the pose (x, y, θ).
function seen_from([x, y, theta]) {
  const cosine = Math.cos(theta);
  const sine = Math.sin(theta);
  return ([u, v]) => [cosine * (u - x) + sine * (v - y), cosine * (v - y) - sine * (u - x)];
}

// A function from [ahead, left] of a pose to the plane.
function placed_at([x, y, theta]) {
  const cosine = Math.cos(theta);
  const sine = Math.sin(theta);
  return ([ahead, left]) => [x + cosine * ahead - sine * left, y + sine * ahead + cosine * left];
}

function box_around(length, width, [ahead, left] = [0, 0]) {
  const signs = [[1, 1], [-1, 1], [-1, -1], [1, -1]];
  return signs.map(([i, j]) => [ahead + i * length / 2, left + j * width / 2]);
}

// Two standard deviations of a Gaussian around its mean, as 41 points; covariance: [xx, xy, yy].
function ellipse_around([x, y], [xx, xy, yy]) {
  // Cholesky: points of the unit circle go to the ellipse.
  const first = Math.sqrt(xx);
  const mixed = xy / first;
  const second = Math.sqrt(Math.max(0, yy - mixed ** 2));
  return Array.from({ length: 41 }, (_, i) => {
    const cosine = Math.cos(i * Math.PI / 20);
    const sine = Math.sin(i * Math.PI / 20);
    return [x + 2 * first * cosine, y + 2 * (mixed * cosine + second * sine)];
  });
}

// Sample at which the robot's outline first covers the tip of each plant's leaf; n where none does.
// plants: [x, y] of the tip, then of the plant's middle.
function first_touches(n, x, y, theta, plants, [length, width]) {
  const first = new Int32Array(plants.length).fill(n);
  const reach = Math.hypot(length, width) / 2;
  const [tip_x, tip_y] = [0, 1].map(axis => Float64Array.from(plants, plant => plant[axis]));
  for (let k = 0; k < n; k++) {
    const at_x = x(k);
    const at_y = y(k);
    const cosine = Math.cos(theta(k));
    const sine = Math.sin(theta(k));
    for (let i = 0; i < plants.length; i++) {
      const dx = tip_x[i] - at_x;
      const dy = tip_y[i] - at_y;
      if (Math.abs(dx) > reach || Math.abs(dy) > reach || first[i] < n) continue;
      const ahead = Math.abs(cosine * dx + sine * dy);
      const left = Math.abs(cosine * dy - sine * dx);
      if (ahead <= length / 2 && left <= width / 2) first[i] = k;
    }
  }
  return first;
}

function draw_field(plot, view, see, back) {
  const { path, tolerance_m, plants, touched, traction, reach_m: reach } = view;
  const cell = reach / (CELLS >> 1);
  const at = (i, j) => traction(...back([-reach + i * cell, -reach + j * cell]));
  plot.soil([CELLS, CELLS], [-reach, -reach], cell, at);
  const beside = across => path.map(([x, y, theta]) => see(placed_at([x, y, theta])([0, across])));
  const corridor = [...beside(tolerance_m), ...beside(-tolerance_m).reverse()];
  plot.area(...spread(corridor), "--soft", SHADE);
  plot.line(...spread(path.map(see)), "--ink", PATH);
  plants.forEach(([x, y, u, v], i) => {
    const [ahead, left] = see([u, v]);
    if (Math.abs(ahead) > 1.2 * reach || Math.abs(left) > 1.2 * reach) return;
    const radius = Math.hypot(u - x, v - y) * plot.scale;
    const [colour, alpha] = touched(i) ? [TOUCHED, 0.9] : [PLANTS, 0.45];
    plot.dots(...spread([[ahead, left]]), colour, { radius, alpha });
  });
}

// Both tracks: a ring where the track would be after a second as commanded, an arrow to where it is
// after a second over ground.
function draw_robot_on_tracks(plot, view, see) {
  const { pose, robot_m: [length, width], track_width_m: apart, commanded_mps, ground_mps } = view;
  const out = placed_at(pose);
  const put = points => spread(points.map(out).map(see));
  plot.area(...put(box_around(length, width)), "--soft", SHADE);
  [1, -1].forEach((side, i) => {
    const across = side * apart / 2;
    plot.area(...put(box_around(length, width - apart, [0, across])), "--ink", SHADE);
    const [wanted, driven] = [commanded_mps[i], ground_mps[i]].map(ahead => [ahead, across]);
    const head = [[-0.06, 0.03], [0, 0], [-0.06, -0.03]]
      .map(([ahead, left]) => [driven[0] + ahead * Math.sign(driven[0]), across + left]);
    plot.line(...put([wanted, driven]), TOUCHED, BOLD);
    plot.line(...put([[0, across], driven]), "--ink", BOLD);
    plot.line(...put(head), "--ink", BOLD);
    plot.dots(...put([wanted]), "--ink", RING);
  });
}

// The estimated robot, the ellipse of two standard deviations of its position, and its heading's
// fan. covariance: of (x, y, θ), as [xx, xy, yy, θθ].
function draw_estimate(plot, { estimate, covariance, robot_m, colour }, see) {
  const out = placed_at(estimate);
  const put = points => spread(points.map(see));
  const outline = box_around(...robot_m).map(out);
  plot.line(...put([...outline, outline[0]]), colour);
  const [xx, xy, yy, yaw] = covariance;
  const [x, y, theta] = estimate;
  const around = ellipse_around([x, y], [xx, xy, yy]);
  const tip = turn => placed_at([x, y, theta + turn])([robot_m[0], 0]);
  const turns = [-1, -0.5, 0, 0.5, 1].map(share => share * Math.min(2 * Math.sqrt(yaw), Math.PI));
  plot.area(...put([[x, y], ...turns.map(tip)]), colour, SHADE);
  plot.area(...put(around), colour, SHADE);
  plot.line(...put(around), colour, THIN);
}

function draw_memory(plot, { driven, measured, window, desired, plan, colour }, see) {
  plot.line(...spread(driven.map(see)), "--soft");
  measured.forEach((place, i) => {
    const alpha = (i + 1) / measured.length;
    plot.dots(...spread([see(place)]), "--measured", { ...DOT, alpha });
  });
  plot.line(...spread(window.map(see)), colour);
  plot.dots(...spread(window.map(see)), colour, NODE);
  plot.dots(...spread(desired.map(see)), "--ink", RING);
  plot.line(...spread(plan.map(see)), "--plan");
  plot.dots(...spread(plan.map(see)), "--plan", NODE);
}

// Draw a view: field (path with headings, plants, tolerance_m), pose and tracks, estimate with its
// covariance, memory (driven, measured, window) and plan; camera: a pose of the path.
function draw_robot_view(canvas, view) {
  const { camera, pose, reach_m } = view;
  const [, left] = seen_from(camera)(pose);
  // The corridor stands still while the robot is near it.
  const aside = left - Math.max(-0.25, Math.min(left, 0.25));
  const eye = [...placed_at(camera)([0, aside]), camera[2]];
  const see = seen_from(eye);
  const plot = new Plot(canvas, [-reach_m, reach_m], [-0.55, 0.55], { equal: true });
  draw_field(plot, view, see, placed_at(eye));
  draw_robot_on_tracks(plot, view, see);
  draw_memory(plot, view, see);
  draw_estimate(plot, view, see);
}
