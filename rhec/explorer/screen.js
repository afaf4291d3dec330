// The explorer's screen: status, pictures and metrics from the kernel.
const THEMES = ["data-jp-theme-name", "data-vscode-theme-kind"]; // of the page's body

function entry({ kind, colour, dash, full, label }, hidden, draw) { // of the legend: a click hides
  const [all, sample] = ["button", "span"].map(tag => document.createElement(tag));
  const press = () => all.ariaPressed = !hidden.has(label);
  all.onclick = () => (hidden.delete(label) || hidden.add(label), press(), draw());
  all.title = "a click hides or shows it", press();
  sample.textContent = kind === "dots" ? full ? "●" : "○" : dash.length ? "╍" : "━";
  sample.style.color = colour.startsWith("--") ? `var(${colour})` : colour;
  all.append(sample, ` ${label}`);
  return all;
}
// A mark with what its values are called, if they are told.
const said = mark =>
  ({ ...mark, label: mark.note === null ? "" : `${mark.label} ${mark.note}`.trim() });
function render({ model, el }) {
  const part = (name, tag = "div", within = el) => {
    const made = document.createElement(tag);
    made.className = `rhec-${name}`, within.append(made);
    return made;
  };
  const words = part("words"), status = part("status", "span", words);
  const line = part("line", "span", words), legend = part("legend");
  const pictures = part("pictures"), table = part("metrics"), canvases = {}, hidden = new Set();
  const views = new Views(() => draw());
  status.role = "status", line.title = "click to copy";
  line.onclick = () => navigator.clipboard?.writeText(line.innerText);

  // Unchanged content is not written again.
  const changes = (node, to) => node.of !== to && (node.of = to, true);
  const write = () => {
    status.textContent = model.get("status"), status.dataset.how = model.get("status_kind");
    if (changes(line, model.get("line"))) line.textContent = line.of;
    if (changes(table, model.get("table"))) table.innerHTML = table.of;
  };
  const arrange = ({ layout, panels, legend: marks }) => {
    if (changes(pictures, layout.map(row => JSON.stringify(row)).join(" "))) {
      pictures.style.gridTemplateAreas = pictures.of, pictures.replaceChildren(), views.all.clear();
      for (const name in panels) {
        const figure = part("panel", "figure", pictures);
        figure.style.gridArea = name, part("title", "figcaption", figure);
        canvases[name] = part("canvas", "canvas", figure), canvases[name].role = "img";
      }
    }
    for (const [name, { title }] of Object.entries(panels)) if (changes(canvases[name], title))
      canvases[name].ariaLabel = canvases[name].previousElementSibling.textContent = title;
    if (changes(legend, JSON.stringify(marks))) legend.replaceChildren(
      ...marks.map(mark => entry(mark, hidden, draw)));
  };
  const draw = () => {
    const { panels } = model.get("picture"), bytes = model.get("numbers");
    const end = bytes.byteOffset + bytes.byteLength; // slice() aligns the floats
    const numbers = new Float32Array(bytes.buffer.slice(bytes.byteOffset, end));
    const column = ([first, n]) => numbers.subarray(first, first + n);
    for (const [name, { xlim, ylim, scale, across, marks }] of Object.entries(panels)) {
      const plot = views.plot(canvases[name], xlim, ylim, { [scale]: true, across });
      for (const mark of marks) {
        if (hidden.has(mark.label)) continue;
        const x = column(mark.x), y = column(mark.y);
        if (mark.kind === "soil") {
          const traction = column(mark.traction), high = y.length;
          plot.soil([x.length, high], [x[0], y[0]], x[1] - x[0], (i, j) => traction[i * high + j]);
        } else plot[mark.kind](x.length, k => x[k], k => y[k], mark.colour, said(mark));
      }
    }
    views.point(views.k);
    pictures.dispatchEvent(new Event("drawn", { bubbles: true }));
  };
  const show = () => { write(), arrange(model.get("picture")), draw(); };
  show();
  model.on("change", show);
  const resized = new ResizeObserver(draw); // also reports the end of a theme change
  const dressed = new MutationObserver(() => requestAnimationFrame(draw));
  resized.observe(pictures), dressed.observe(document.body, { attributeFilter: THEMES });
  return () => { model.off("change", show), resized.disconnect(), dressed.disconnect(); };
}
export default { render };
