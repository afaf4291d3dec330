// A picture on a canvas in the coordinates of its data, for the live page and the explorer.
class Plot { // a colour is CSS, or the name of a property of the canvas, as "--ink"
  constructor(canvas, [x0, x1], [low, high], { equal, log, across = "" } = {}) {
    const { clientWidth: w, clientHeight: h } = canvas, style = getComputedStyle(canvas);
    const [left, top] = [38, 6], c = canvas.getContext("2d");
    // A hidden canvas has no size, and a negative scale no circles.
    const [right, bottom] = [Math.max(w - 12, left + 1), Math.max(h - 20, top + 1)];
    const dots = devicePixelRatio, size = [w, h].map(side => Math.round(side * dots));
    if (`${size}` !== `${[canvas.width, canvas.height]}`) [canvas.width, canvas.height] = size;
    const of = log ? Math.log10 : y => y, back = log ? y => 10 ** y : y => y;
    let [y0, y1] = [of(low), of(high)];
    let [sx, sy] = [(right - left) / (x1 - x0), (bottom - top) / (y1 - y0)];
    if (equal) {
      sx = sy = Math.min(sx, sy);
      [x0, y0] = [(x0 + x1 - (right - left) / sx) / 2, (y0 + y1 - (bottom - top) / sy) / 2];
    }
    this.x = x => left + (x - x0) * sx, this.y = y => bottom - (of(y) - y0) * sy;
    this.data = ({ offsetX, offsetY }) =>
      [x0 + (offsetX - left) / sx, back(y0 + (bottom - offsetY) / sy)];
    // What a pointer needs to know: see view.js. Only lines with a label have values for readers.
    Object.assign(this, { box: [left, top, right, bottom], lines: [], over_time: Boolean(across) });
    this.colour = name => name.startsWith("--") ? style.getPropertyValue(name) : name;
    this.scale = sx, this.c = c, c.reset(), c.scale(dots, dots);
    Object.assign(c, { font: "11px system-ui, sans-serif", lineJoin: "bevel",
      fillStyle: this.colour("--soft"), strokeStyle: this.colour("--line") });
    const ticks = (low, pixels, per, apart, put) => {
      const ten = 10 ** Math.floor(Math.log10(apart / per));
      const step = ten * [1, 2, 5, 10].find(times => times * ten * per >= apart);
      for (let i = Math.ceil(low / step); (i * step - low) * per <= pixels + 0.1; i++)
        put(i * step, `${Number((i * step).toPrecision(6))}`.replace("-", "−"));
    };
    c.beginPath(), c.textAlign = "center";
    ticks(x0, right - left, sx, 60, (x, text) => {
      c.moveTo(this.x(x), top), c.lineTo(this.x(x), bottom), c.fillText(text, this.x(x), h - 5);
    });
    c.textAlign = "right", c.fillText(across, 30, h - 5);
    ticks(y0, bottom - top, sy, Math.max(Math.min(32, h / 5), log ? sy : 0), (value, text) => {
      const y = bottom - (value - y0) * sy; // log: of whole powers
      c.moveTo(left, y), c.lineTo(right, y), c.fillText(log ? `1e${text}` : text, 34, y + 4);
    });
    c.stroke(), c.beginPath(), c.rect(left, top, right - left, bottom - top), c.clip();
  }
  use(name, { width = 1.5, alpha = 1, dash = [] } = {}) {
    const colour = this.colour(name), look = { lineWidth: width, globalAlpha: alpha };
    this.c.setLineDash(dash);
    return Object.assign(this.c, { strokeStyle: colour, fillStyle: colour }, look);
  }
  path(n, x, y, first = 0) { // NaN leaves a gap
    this.c.beginPath();
    for (let k = first, pen = false; k < n; k++) {
      const across = this.x(x(k)), down = this.y(y(k)), there = isFinite(across + down);
      if (there) pen ? this.c.lineTo(across, down) : this.c.moveTo(across, down);
      pen = there;
    }
  }
  line(n, x, y, name, look = {}) { // in pieces, because long self-intersecting paths are slow
    if (look.label) this.lines.push({ n, x, y, label: look.label });
    const c = this.use(name, look), most = look.dash?.length ? n : 32;
    for (let k = 0; k < n; k += most) this.path(Math.min(k + most + 1, n), x, y, k), c.stroke();
  }
  area(n, x, y, name, look) { this.path(n, x, y), this.use(name, look).fill(); }
  band(n, x, middle, half, name) {
    const k = i => Math.min(i, 2 * n - 1 - i), side = i => i < n ? half(i) : -half(k(i));
    this.area(2 * n, i => x(k(i)), i => middle(k(i)) + side(i), name, { alpha: 0.15 });
  }
  dots(n, x, y, name, { radius, full = true, alpha = 1 }) {
    const c = this.use(name, { width: 1, alpha });
    for (let k = 0; k < n; k++)
      c.beginPath(), c.arc(this.x(x(k)), this.y(y(k)), radius, 0, 7), full ? c.fill() : c.stroke();
  }
  // Brown where it slips, a dot a cell. The root shows small differences on firm soil, too.
  soil([wide, high], [x, y], cell_m, traction) {
    const [red, green, blue] = this.colour("--wet").split(",").map(Number);
    const image = new ImageData(wide, high), { data } = image;
    for (let j = high - 1, at = 0; j >= 0; j--) for (let i = 0; i < wide; i++, at += 4) {
      data[at] = red, data[at + 1] = green, data[at + 2] = blue;
      data[at + 3] = 280 * Math.sqrt(1 - traction(i, j));
    }
    const picture = new OffscreenCanvas(wide, high);
    picture.getContext("2d").putImageData(image, 0, 0);
    const [left, right] = [-0.5, wide - 0.5].map(i => this.x(x + i * cell_m));
    const [bottom, top] = [-0.5, high - 0.5].map(j => this.y(y + j * cell_m));
    this.c.drawImage(picture, left, top, right - left, bottom - top);
  }
}
