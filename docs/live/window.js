// One sample of the RHE, taken apart by the Functions of window.py, on the loop's own memory.
"use strict";

const FORGOTTEN = 1e6; // switched off, the arrival cost has a covariance so many times as large

// Call one of the Functions: inputs by name -> results by name.
function call(tools, name, inputs) {
  const { order, results } = tools.data;
  for (const of in inputs) tools[`at_${name}_${of}`].set(inputs[of]);
  if (tools.wasm.run(order.indexOf(name))) throw new Error(`${name} failed`);
  return Object.fromEntries(Object.entries(results[name]).map(
    ([of, n]) => [of, tools[`at_${name}_new_${of}`].slice(0, n)]));
}

const noises = loop => ({ V: loop.at_V.slice(0, 4), W: loop.at_W.slice(0, 6) });

const measured = (loop, k) =>
  ["x_meas_m", "y_meas_m", "nu_meas_mps", "omega_meas_radps"].map(name => loop.get(name)(k));

// A piece of an RHE's memory, column by column.
const piece_of = (tools, memory, name) =>
  tools.data.places[name].map(column => column.map(i => memory[i]));

// Sample k: the shifted window, and what the measurement makes of it with and without bounds.
function take_sample(loop, tools, k, arrival) {
  const { first, places } = tools.data;
  const size = tools.data.results.shift.memory;
  const from = k * loop.data.memory.length + first;
  const { V, W } = noises(loop);
  const memory = loop.at_memory.slice(from, from + size);
  const shifted = call(tools, "shift", { memory, V, W }).memory;
  if (!arrival) for (const column of places.P) for (const i of column) shifted[i] *= FORGOTTEN;
  const given = { memory: shifted, z_N: measured(loop, k), V, P_0: tools.data.P_0 };
  const bounded = call(tools, "solve", given);
  return { shifted, bounded, free: call(tools, "free", given) };
}

function solve(A, b) { // A x = b by Gauss's elimination with pivots
  const rows = A.map((row, i) => [...row, b[i]]);
  for (let i = 0; i < rows.length; i++) {
    const size = row => Math.abs(row[i]);
    const best = rows.slice(i).reduce((a, c) => size(c) > size(a) ? c : a);
    rows.splice(rows.indexOf(best), 1);
    rows.splice(i, 0, best);
    rows.forEach((row, j) => {
      const share = row[i] / best[i];
      if (j !== i) rows[j] = row.map((value, column) => value - share * best[column]);
    });
  }
  return rows.map((row, i) => row.at(-1) / row[i]);
}

// What the measurements of a window cost, half the square of each residual over its variance, node
// by node: position, speed, and the yaw rate of the interval before; and the arrival cost.
function costs_of(tools, memory, V) {
  const [s, v, z, [[age]], [m], P] = ["s", "v", "z", "age", "m", "P"]
    .map(name => piece_of(tools, memory, name));
  const half = (residual, variance) => Number.isNaN(residual) ? 0 : residual ** 2 / variance / 2;
  const oldest = s.length - 1 - age;
  const nodes = s.map(([x, y, , nu], i) => i < oldest ? [0, 0, 0] : [
    half(z[i][0] - x, V[0]) + half(z[i][1] - y, V[1]),
    half(z[i][2] - nu, V[2]),
    i > oldest ? half(z[i][3] - v[i - 1][0], V[3]) : 0,
  ]);
  const gap = s[0].map((value, i) => value - m[i]);
  const arrival = solve(P, gap).reduce((sum, value, i) => sum + value * gap[i], 0) / 2;
  return { nodes, arrival };
}

// The same measurements for the RHE with one interval and for the EKF with the same six states:
// [x, y, θ, ν, μ, κ] of each, by sample.
function compare(loop, tools, bounds) {
  const { P_0, first_memories } = tools.data;
  const one = bounds ? "shortest" : "shortest_free";
  const memories = { ...first_memories };
  const settings = noises(loop);
  const step = (name, z_N, more) => {
    const found = call(tools, name, { memory: memories[name], z_N, ...settings, ...more });
    memories[name] = found.memory;
    return [...found.estimate];
  };
  return Array.from({ length: loop.samples }, (_, k) => {
    const z_N = measured(loop, k);
    const [x, y, theta, , ...p] = step("kalman", z_N, {}); // the input ω stands before ν
    return [step(one, z_N, { P_0 }), [x, y, theta, ...p]];
  });
}

function reckon(loop, tools) { // the poses of one who believes the encoders
  const poses = [pose_of(loop, 0)];
  for (let k = 1; k < loop.samples; k++) // the yaw rate of an interval is measured at its end
    poses.push([...call(tools, "reckon", { pose: poses[k - 1], z_N: measured(loop, k) }).pose]);
  return poses;
}
