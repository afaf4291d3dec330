// The engine of the live page. A closed loop is CasADi's own C as WebAssembly; noise, soils and
// sensor faults are data of the chosen seed. This script fills the loop's arrays and reads them.
"use strict";

const SETTLING_S = 5; // a robot that stays within the tolerance this long has settled

const live = {
  loading: {},
  waiting: {},
  arrived: (name, content) => live.waiting[name](content),
};

// Load live/name.js. A page from the disk may not fetch, so its data are scripts.
const load = name => live.loading[name] ??= new Promise((resolve, reject) => {
  live.waiting[name] = resolve;
  const script = document.createElement("script");
  script.src = `live/${name}.js`;
  script.onerror = () => reject(new Error(`live/${name}.js is missing`));
  document.head.append(script);
});

async function unpack(text) {
  const bytes = Uint8Array.from(atob(text), letter => letter.charCodeAt(0));
  const stream = new Blob([bytes]).stream().pipeThrough(new DecompressionStream("gzip"));
  return new Response(stream).arrayBuffer();
}

class Field { // a path, and where the soil around it lies
  constructor(data) {
    Object.assign(this, data);
  }

  on_path(s_m) { // the place at this distance from the path's beginning
    const { path, path_step_m } = this;
    const place = s_m / path_step_m;
    const first = Math.floor(place);
    const [a, b] = [first, first + 1].map(i => path.at(i % path.length));
    return a.map((value, axis) => value + (place - first) * (b[axis] - value));
  }

  pose_on_path(s_m) {
    const [[x, y], [u, v]] = [-1, 1].map(side => this.on_path(s_m + side * this.path_step_m));
    return [...this.on_path(s_m), Math.atan2(v - y, u - x)];
  }
}

class World { // noise, soils and sensor faults of the seeds
  constructor(data) {
    Object.assign(this, data);
    this.newest = {};
    for (const turns in this.fields) this.fields[turns] = new Field(this.fields[turns]);
  }

  // Keep what was computed last of a kind: most moves of a slider change neither noise nor soil.
  async keep(kind, key, compute) {
    if (this.newest[kind]?.key !== key) this.newest[kind] = { key, value: compute() };
    return this.newest[kind].value;
  }

  // A run's input, sample after sample: noise and, where sensors fail, the fault beside it.
  stream(seed, fault) {
    return this.keep(`stream ${!fault}`, `${seed} ${fault}`, async () => {
      const data = await load(`seed_${seed}`);
      const noise = new Int16Array(await unpack(data.noise));
      const faults = fault && new Float64Array(await unpack(data.faults[fault]));
      const { noise: { n, step }, n_fault, max_samples } = this;
      const width = n + (fault ? n_fault : 0);
      const stream = new Float64Array(max_samples * width);
      for (let k = 0; k < max_samples; k++) {
        for (let i = 0; i < n; i++) stream[k * width + i] = step * noise[k * n + i];
        if (fault) stream.set(faults.subarray(k * n_fault, (k + 1) * n_fault), k * width + n);
      }
      return stream;
    });
  }

  // The slip field (2, grid) as the loop reads it, beyond its edge as on it; origin and size.
  soil(seed, kind, patches, { turns, start_offset_m }) {
    const key = JSON.stringify([seed, kind, patches, turns, start_offset_m]);
    return this.keep("soil", key, async () => {
      const steps = new Uint16Array(await unpack((await load(`seed_${seed}`)).soils[kind]));
      const { soil_shape: [wide, long], cell_m } = this;
      for (const apart of [1, long]) { // the data are differences along both axes
        const begins = at => apart === 1 ? at % long === 0 : at % (wide * long) < long;
        steps.forEach((step, at) => { if (!begins(at)) steps[at] = step + steps[at - apart]; });
      }
      const field = this.fields[turns];
      const margin = field.margin_m + Math.abs(start_offset_m);
      const origin_m = field.lowest.map(low => low - margin);
      const end_m = field.highest.map(high => high + margin);
      const n = end_m.map((end, i) => Math.ceil((end - origin_m[i]) / cell_m) + 1);
      const slip = new Float64Array(2 * wide * long);
      for (let j = 0; j < long; j++) {
        for (let i = 0; i < wide; i++) {
          const column = Math.min(i, n[0] - 1);
          const row = Math.min(j, n[1] - 1);
          const x = origin_m[0] + cell_m * column;
          const y = origin_m[1] + cell_m * row;
          const patch = patches.findLast(([u, v, r]) => (x - u) ** 2 + (y - v) ** 2 <= r * r);
          for (let of = 0; of < 2; of++) {
            const traction = this.traction_step * steps[(of * wide + column) * long + row];
            slip[of + 2 * (i + wide * j)] = patch ? patch[3 + of] : traction;
          }
        }
      }
      return { field, slip, origin_m, n };
    });
  }

  traction({ slip, origin_m, n }, x, y) { // κ of the nearest cell
    const nearest = (value, axis) =>
      Math.max(0, Math.min(Math.round((value - origin_m[axis]) / this.cell_m), n[axis] - 1));
    return slip[1 + 2 * (nearest(x, 0) + this.soil_shape[0] * nearest(y, 1))];
  }
}

class Loop { // a closed loop; `run` leaves the log of a whole run in its arrays
  static async of(name, world) {
    const data = await load(name);
    data.module ??= unpack(data.wasm).then(WebAssembly.compile);
    const loop = new Loop();
    Object.assign(loop, { name, data, world });
    loop.wasm = (await WebAssembly.instantiate(await data.module, { Math })).exports;
    for (const array of Object.keys(loop.wasm).filter(each => each.startsWith("at_"))) {
      const from = loop.wasm[array].value; // each reaches to the memory's end
      loop[array] = new Float64Array(loop.wasm.memory.buffer, from);
    }
    return loop;
  }

  // What `set_up` in rhec/simulation/closed_loop.py makes of parameters of Scenario.
  set(values) {
    const square = each => each * each; // the bits of numpy.square
    const settings = {
      ...this.data.settings,
      Q: values.q,
      QN: values.q.map(weight => values.qn_factor * weight),
      R: [values.r],
      lower: [-values.omega_max_radps],
      upper: [values.omega_max_radps],
      W: values.sigma_w.map(square),
      V: values.sigma_v.map(square),
    };
    for (const name in settings) if (name in values) settings[name] = [values[name]];
    for (const name in settings) this[`at_${name}`]?.set(settings[name]);
    const { memory, directions } = this.data;
    this.at_memory.set(memory.map((value, i) => {
      let sum = value ?? NaN;
      for (const field in directions) sum += values[field] * directions[field][i];
      return sum;
    }));
  }

  run(values, stream, soil, samples) {
    this.set(values);
    this.field = soil.field;
    this.at_padded_segments.set(soil.field.segments);
    this.at_period_m[0] = soil.field.period_m;
    this.at_length_m[0] = soil.field.length_m;
    this.at_slip.set(soil.slip);
    this.at_origin_m.set(soil.origin_m);
    this.at_cell_m[0] = this.world.cell_m;
    this.at_noise.set(stream);
    this.touches = null; // the pictures keep them here
    if (this.wasm.run(samples)) throw new Error(`${this.name} failed`);
    this.samples = samples;
    this.metrics = metrics_of(this);
  }

  get(name) { // a column of the log or one of the errors, as a function of the sample
    const { columns, errors } = this.world;
    const names = errors.includes(name) ? errors : columns;
    const array = names === errors ? this.at_errors : this.at_row;
    const i = names.indexOf(name);
    return k => array[k * names.length + i];
  }

  sigma(name) { // standard deviation of a state, by sample; null where it is not estimated
    const { states } = this.data;
    return states.includes(name) ? k => Math.sqrt(this.covariance(name, name, k)) : null;
  }

  covariance(one, other, k) { // of two states
    const { states } = this.data;
    const n = states.length;
    const [i, j] = [one, other].map(name => states.indexOf(name));
    return this.at_covariance[(k * n + j) * n + i];
  }

  piece(name, k) { // of the memory after sample k, column by column
    const first = (k + 1) * this.data.memory.length;
    const columns = this.data.places[name] ?? [];
    return columns.map(column => column.map(i => this.at_memory[first + i]));
  }

  // Points of the path that the controller follows at sample k, eq. (17): one sample apart.
  desired(k, look_ahead_m) {
    const pace = Math.abs(this.get("mu_hat")(k) * this.get("nu_hat_mps")(k)) * this.world.dt_s;
    const from = this.get("s_m")(k) + look_ahead_m;
    return this.piece("plan", k).map((_, i) => this.field.on_path(from + i * pace));
  }
}

// The metrics of rhec/simulation/metrics.py: they count from when the robot has settled.
function metrics_of(loop) {
  const { samples, world: { dt_s, tolerance_m } } = loop;
  const error = loop.get("error_m");
  const error_true = loop.get("error_true_m");
  const on_straight = loop.get("on_straight");
  const left = loop.get("left_m");
  const enough = Math.round(SETTLING_S / dt_s);
  let inside = 0;
  let settled = 0; // samples until the robot has settled; 0: it never does
  for (let k = 0; k < samples && !settled; k++) {
    inside = error_true(k) < tolerance_m ? inside + 1 : 0;
    if (inside === enough) settled = k + 1;
  }
  const begin = settled < samples ? settled : 0;
  const gather = (value, start, add) => {
    let result = start;
    for (let k = begin; k < samples; k++) result = add(result, value(k));
    return result;
  };
  const sum = value => gather(value, 0, (total, each) => total + each);
  const mean = value => sum(value) / (samples - begin);
  const violations = value => sum(k => (value(k) > tolerance_m) * on_straight(k));
  const rms = (estimate, truth) =>
    Math.sqrt(mean(k => (loop.get(estimate)(k) - loop.get(truth)(k)) ** 2));
  const is_known = k => Number(!Number.isNaN(error(k)));
  let overshoot = 0; // on the first row
  for (let k = 0; k < samples && on_straight(k); k++)
    overshoot = Math.max(overshoot, -Math.sign(left(0)) * left(k));
  return {
    settling_time_s: settled ? (settled - enough) * dt_s : NaN,
    mean_error_m: sum(k => is_known(k) ? error(k) : 0) / sum(is_known),
    mean_error_true_m: mean(error_true),
    max_error_true_m: gather(error_true, 0, Math.max),
    violations: violations(error),
    violations_true: violations(error_true),
    overshoot_m: overshoot,
    rms_mu: rms("mu_hat", "mu"),
    rms_kappa: rms("kappa_hat", "kappa"),
    rms_yaw_rad: rms("theta_hat_rad", "theta_rad"),
  };
}
