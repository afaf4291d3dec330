// The engine of the live page. The closed loop, its start, errors and metrics are CasADi's own C as
// WebAssembly, noise and soil are world.c; this script fills and reads their arrays.
"use strict";
const live = { loading: {}, waiting: {}, arrived: (name, content) => live.waiting[name](content) };

const load = name => live.loading[name] ??= new Promise((resolve, reject) => {
  live.waiting[name] = resolve; // a page from the disk may not fetch: its data are scripts
  const script = Object.assign(document.createElement("script"), { src: `live/${name}.js` });
  script.onerror = () => reject(new Error(`live/${name}.js is not there`));
  document.head.append(script);
});
const unpack = async text => {
  const bytes = Uint8Array.from(atob(text), letter => letter.charCodeAt(0));
  const stream = new Blob([bytes]).stream().pipeThrough(new DecompressionStream("gzip"));
  return new Response(stream).arrayBuffer();
};
const compile = text => unpack(text).then(WebAssembly.compile);

class Module { // an instance of WebAssembly; each of its arrays has a property, as `at_noise`
  async open(module) {
    const nothing = {}; // a C library may ask for what is never called
    for (const { module: from, name } of WebAssembly.Module.imports(module))
      (nothing[from] ??= {})[name] = () => 0;
    this.wasm = (await WebAssembly.instantiate(module, nothing)).exports;
    for (const name of Object.keys(this.wasm).filter(name => name.startsWith("at_"))) {
      const Kind = name === "at_n" ? Int32Array : Float64Array; // up to the memory's end
      this[name] = new Kind(this.wasm.memory.buffer, this.wasm[name].value);
    }
    return this;
  }
}

class World extends Module { // noise and soil of a seed
  static async of(told) {
    const world = Object.assign(new World(), told, { kept: {}, kinds: Object.keys(told.soils) });
    return world.open(await compile(told.wasm));
  }
  keep(what, key, make) { // the newest of its kind
    if (this.kept[what]?.key !== key) this.kept[what] = { key, of: make() };
    return this.kept[what].of;
  }
  stream(seed, fault) { // of a run: noise, and beside it the sensors' faults
    return this.keep(`stream ${!fault}`, `${seed} ${fault}`, async () => {
      const { noise, most, at_stream } = this, wide = noise + (fault ? this.fault : 0);
      const faults = fault && new Float64Array(await unpack((await load("faults"))[fault][seed]));
      this.wasm.noise(seed, wide);
      const stream = at_stream.slice(0, most * wide);
      for (let k = 0; fault && k < most; k++)
        stream.set(faults.subarray(k * this.fault, (k + 1) * this.fault), k * wide + noise);
      return stream;
    });
  }
  soil(seed, kind, patches, start_offset_m) {
    return this.keep("soil", JSON.stringify([seed, kind, patches, start_offset_m]), () => {
      this.at_patches.set(patches.flat());
      this.wasm.soil(seed, this.kinds.indexOf(kind), start_offset_m, patches.length);
      return { slip: this.at_slip.slice(0, 2 * this.grid[0] * this.grid[1]),
        origin_m: this.at_origin_m.slice(0, 2), cell_m: [this.cell_m], n: this.at_n.slice(0, 2) };
    });
  }
}

class Loop extends Module { // a closed loop; `run` leaves the log of a whole run in its arrays
  static async of(name, world) {
    const told = await load(name), { columns, metrics } = world;
    const places = names => Object.fromEntries(names.map((each, i) => [each, i]));
    const loop = { name, told, wide: columns.length, column: places(columns), judged: metrics };
    return Object.assign(new Loop(), loop).open(await (told.module ??= compile(told.wasm)));
  }
  run(given, stream, soil, samples) {
    for (const name in this.told.given) this[`at_given_${name}`].set([given[name]].flat());
    for (const name of ["slip", "origin_m", "cell_m"]) this[`at_${name}`].set(soil[name]);
    this.at_noise.set(stream);
    if (this.wasm.run(samples)) throw new Error(`${this.name} failed`);
    this.samples = samples;
    this.metrics = Object.fromEntries(this.judged.map((name, i) => [name, this.at_metrics[i]]));
  }
  get(name) { // a column of the log, by sample
    const { at_row, wide, column: { [name]: i } } = this;
    return k => at_row[k * wide + i];
  }
  error() { // of the true position, by sample
    const { at_errors } = this;
    return k => at_errors[2 * k + 1];
  }
  sigma(name) { // the standard deviation of a state, by sample; null: it is not estimated
    const { at_covariance, told: { states } } = this, i = states.indexOf(name), n = states.length;
    return i < 0 ? null : k => Math.sqrt(at_covariance[(k * n + i) * n + i]);
  }
  piece(name, k) { // of the memory after sample k, by columns
    const { n, places } = this.told, [at, rows, columns] = places[name] ?? [0, 0, 0];
    return Array.from({ length: columns }, (_, i) => (k + 1) * n + at + i * rows).map(
      from => this.at_memory.subarray(from, from + rows));
  }
  desired(k) { // the poses of the path that the controller is asked for at sample k
    this.wasm.ask(k);
    return this.piece("controller.s", k).map((_, i) => this.at_xi_ref.slice(3 * i, 3 * i + 3));
  }
}
