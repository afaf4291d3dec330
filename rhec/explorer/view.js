// What a pointer does with pictures of the same samples side by side: the values under it, zoom
// and pan. Lines and words that follow it are elements above the canvases: nothing is drawn again.
class Views {
  constructor(draw, { box = true } = {}) {
    Object.assign(this, { draw, box, all: new Map(), chosen: new Map(), k: null });
  }

  // A Plot with the limits that were chosen, else with these. Those over time share one x axis.
  plot(canvas, x, y, options = {}) {
    const view = this.all.get(canvas) ?? this.add(canvas);
    Object.assign(view, { whole: [x, y], along: options.across ? "time" : canvas });
    const limits = [this.chosen.get(view.along) ?? x, view.up ?? y];
    return view.plot = new Plot(canvas, ...limits, options);
  }

  add(canvas) {
    const view = { canvas };
    for (const name of ["cursor", "box", "words"]) {
      view[name] = document.createElement(name === "words" ? "output" : "div");
      view[name].className = `view-${name}`;
      view[name].hidden = true;
      canvas.after(view[name]);
    }
    canvas.title = `${this.box ? "drag: zoom · " : ""}shift and drag: move · Ctrl and wheel: zoom`
      + (this.box ? " · double click: all" : "");
    const on = (kind, act, options) => canvas.addEventListener(kind, act, options);
    on("pointermove", event => event.buttons || this.point(this.sample(view, event)));
    on("pointerleave", () => this.point(null));
    on("wheel", event => event.ctrlKey && this.wheel(view, event), { passive: false });
    on("pointerdown", event => this.grasp(view, event), { capture: true });
    if (this.box) on("dblclick", () => this.choose(view, ...view.whole));
    this.all.set(canvas, view);
    return view;
  }

  // Values under the pointer

  sample({ plot }, event) { // the sample of the nearest point of a line: along time, or on a map
    const [x, y] = plot.data(event);
    const far = ({ x: at, y: up }, k) => Math.hypot(at(k) - x, plot.over_time ? 0 : up(k) - y);
    let best = [Infinity, null];
    for (const line of plot.lines) for (let k = 0; k < line.n; k++)
      if (far(line, k) < best[0]) best = [far(line, k), k];
    return best[1];
  }

  point(k) { // show sample k in all pictures
    this.k = k;
    for (const { canvas, plot, cursor, words } of this.all.values()) {
      const known = plot.lines.filter(({ n, y }) => k !== null && k < n && isFinite(y(k)));
      const [{ x, y } = {}] = known.reverse(); // the topmost line first
      cursor.hidden = words.hidden = !x;
      if (!x) continue;
      const [left, top, right, bottom] = plot.box;
      const [across, down] = [plot.x(x(k)), plot.over_time ? top : plot.y(y(k))];
      cursor.hidden = across < left || across > right || down < top || down > bottom;
      cursor.className = `view-cursor ${plot.over_time ? "over-time" : ""}`;
      cursor.style.left = `${canvas.offsetLeft + across}px`;
      cursor.style.top = `${canvas.offsetTop + down}px`;
      cursor.style.height = plot.over_time ? `${bottom - top}px` : "";
      const number = value => `${Number(value.toPrecision(3))}`.replace("-", "−");
      const said = known.map(({ label, x, y }) =>
        `${label} ${plot.over_time ? "" : `${number(x(k))}, `}${number(y(k))}`);
      words.value = [...plot.over_time ? [`${x(k).toFixed(1)} s`] : [], ...said].join(" · ");
    }
  }

  // Zoom and pan

  choose(view, x, y) { // draw again with these limits, or with as much of them as there is
    const within = ([low, high], [least, most]) => [Math.max(low, least), Math.min(high, most)];
    const all = ([low, high], [least, most]) => low <= least && high >= most;
    const [whole_x, whole_y] = view.whole;
    if (all(x, whole_x)) this.chosen.delete(view.along);
    else this.chosen.set(view.along, within(x, whole_x));
    view.up = all(y, whole_y) ? null : within(y, whole_y);
    this.draw();
    this.point(this.k);
  }

  // The limits of a picture after its pixels were moved by a function, (px, axis) -> px.
  moved(view, by) {
    const { plot: { box: [left, top, right, bottom] }, plot } = view;
    const corner = (px, py) => plot.data({ offsetX: by(px, 0), offsetY: by(py, 1) });
    const [[x0, y0], [x1, y1]] = [corner(left, bottom), corner(right, top)];
    return [[x0, x1], [y0, y1]];
  }

  wheel(view, event) {
    event.preventDefault();
    const at = [event.offsetX, event.offsetY];
    const factor = Math.exp(0.002 * Math.max(-200, Math.min(200, event.deltaY)));
    this.choose(view, ...this.moved(view, (px, axis) => at[axis] + (px - at[axis]) * factor));
  }

  grasp(view, event) {
    const pans = event.shiftKey;
    if (event.button || event.pointerType === "touch" || !(pans || this.box)) return;
    event.stopImmediatePropagation();
    event.preventDefault();
    const { canvas, box } = view;
    const from = [event.offsetX, event.offsetY];
    const span = to => from.map((px, i) => [px, to[i]].sort((a, b) => a - b));
    let last = from;
    canvas.setPointerCapture(event.pointerId);
    const done = new AbortController();
    const on = (kind, act) => canvas.addEventListener(kind, act, { signal: done.signal });
    on("pointermove", ({ offsetX, offsetY }) => {
      const to = [offsetX, offsetY];
      if (pans) this.choose(view, ...this.moved(view, (px, i) => px + last[i] - to[i]));
      const [[left, right], [top, bottom]] = span(to);
      box.hidden = pans;
      Object.assign(box.style, {
        left: `${canvas.offsetLeft + left}px`, width: `${right - left}px`,
        top: `${canvas.offsetTop + top}px`, height: `${bottom - top}px`,
      });
      last = to;
    });
    on("pointercancel", () => done.abort());
    on("pointerup", () => {
      done.abort();
      box.hidden = true;
      const [[left, right], [top, bottom]] = span(last);
      if (pans || right - left < 5) return;
      const flat = bottom - top < 12; // a span of time alone
      const [, y_0, , y_1] = view.plot.box;
      const [x0, high] = view.plot.data({ offsetX: left, offsetY: flat ? y_0 : top });
      const [x1, low] = view.plot.data({ offsetX: right, offsetY: flat ? y_1 : bottom });
      this.choose(view, [x0, x1], [low, high]);
    });
  }
}
