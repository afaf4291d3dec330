// The explorer's screen: words, pictures and metrics, as the kernel sends them.
const THEMES = ["data-jp-theme-name", "data-vscode-theme-kind"]; // of the page's body

function render({ model, el }) {
  const part = (name, tag = "div", within = el) => {
    const made = document.createElement(tag);
    made.className = `rhec-${name}`, within.append(made);
    return made;
  };
  const words = part("words"), status = part("status", "span", words);
  const line = part("line", "span", words), legend = part("legend");
  const pictures = part("pictures"), table = part("metrics"), canvases = {};
  status.role = "status", line.title = "click to copy";
  line.onclick = () => navigator.clipboard?.writeText(line.innerText);

  const say = () => {
    status.textContent = model.get("status"), status.dataset.how = model.get("how");
    line.textContent = model.get("line");
    if (table.of !== model.get("table")) table.innerHTML = table.of = model.get("table");
  };
  const arrange = ({ layout, panels, legend: marks }) => { // what seldom changes
    const areas = layout.map(row => JSON.stringify(row)).join(" ");
    if (pictures.style.gridTemplateAreas !== areas) {
      pictures.style.gridTemplateAreas = areas, pictures.replaceChildren();
      for (const name in panels) {
        const figure = part("panel", "figure", pictures);
        figure.style.gridArea = name, part("title", "figcaption", figure);
        canvases[name] = part("canvas", "canvas", figure), canvases[name].role = "img";
      }
    }
    for (const [name, { title }] of Object.entries(panels))
      canvases[name].ariaLabel = canvases[name].previousElementSibling.textContent = title;
    legend.replaceChildren(...marks.map(({ kind, colour, dash, full, label }) => {
      const sample = document.createElement("span");
      sample.textContent = kind === "dots" ? full ? "●" : "○" : dash.length ? "╍" : "━";
      sample.style.color = colour.startsWith("--") ? `var(${colour})` : colour;
      const entry = document.createElement("span");
      entry.append(sample, ` ${label}`);
      return entry;
    }));
  };
  const draw = () => {
    const { panels } = model.get("picture"), bytes = model.get("numbers");
    const end = bytes.byteOffset + bytes.byteLength; // a float's place is a multiple of four
    const numbers = new Float32Array(bytes.buffer.slice(bytes.byteOffset, end));
    const column = ([first, n]) => numbers.subarray(first, first + n);
    for (const [name, { xlim, ylim, scale, marks }] of Object.entries(panels)) {
      const plot = new Plot(canvases[name], xlim, ylim, { [scale]: true });
      for (const mark of marks) {
        const x = column(mark.x), y = column(mark.y);
        if (mark.kind === "soil") {
          const traction = column(mark.traction), high = y.length;
          plot.soil([x.length, high], [x[0], y[0]], x[1] - x[0], (i, j) => traction[i * high + j]);
        } else plot[mark.kind](x.length, k => x[k], k => y[k], mark.colour, mark);
      }
    }
    pictures.dispatchEvent(new Event("drawn", { bubbles: true }));
  };
  const show = () => { say(), arrange(model.get("picture")), draw(); };
  show();
  model.on("change", show);
  const resized = new ResizeObserver(draw); // while its theme changes, the page has no size
  const dressed = new MutationObserver(() => requestAnimationFrame(draw));
  resized.observe(pictures), dressed.observe(document.body, { attributeFilter: THEMES });
  return () => { model.off("change", show), resized.disconnect(), dressed.disconnect(); };
}
export default { render };
