"""The explorer as its user has it: JupyterLab in a browser, sliders moved by mouse and keyboard,
and what the page then shows. `test_live.py` tests the values that a pointer shows.
"""

import base64

import numpy as np
import pytest

from benchmark import latency
from rhec.explorer.panels import Mark, Panel, Picture, packed
from rhec.explorer.screen import CSS, Screen

# From here on the page counts the pictures that follow a change, and notes which messages the
# kernel has not yet dealt with.
WATCH = """() => {
    window.painted = 0
    window.unanswered = new Set()
    const kernel = jupyterapp.shell.currentWidget.context.sessionContext.session.kernel
    kernel.anyMessage.connect((_, { msg, direction }) => {
        if (direction == 'send' && msg.channel == 'shell') unanswered.add(msg.header.msg_id)
    })
    kernel.iopubMessage.connect((_, msg) => {
        if (msg.content.execution_state == 'idle') unanswered.delete(msg.parent_header.msg_id)
    })
    const note = () => setTimeout(() => painted++)
    document.addEventListener('drawn', () => requestAnimationFrame(note))
}"""
# The kernel has dealt with all that the page sent, and no more comes for a while: a slider sends
# its next value after the reply to the last one.
QUIET = """async () => {
    let since = performance.now()
    while (performance.now() - since < 400) {
        if (unanswered.size) since = performance.now()
        await new Promise(done => setTimeout(done, 20))
    }
}"""


# The screen without a kernel: what its pictures draw is noted, by their titles.
RENDER = """([state, numbers]) => {
    window.drawn = {}
    const reset = CanvasRenderingContext2D.prototype.reset
    CanvasRenderingContext2D.prototype.reset = function () {
        drawn[this.canvas.ariaLabel] = []
        reset.call(this)
    }
    const note = (kind, what) => {
        const draw = Plot.prototype[kind]
        Plot.prototype[kind] = function (...given) {
            drawn[this.c.canvas.ariaLabel].push({ kind, ...what(...given) })
            draw.apply(this, given)
        }
    }
    const list = (length, of) => Array.from({ length }, (_, k) => of(k))
    for (const kind of ["line", "area", "dots"])
        note(kind, (n, x, y, colour, { label }) => ({ x: list(n, x), y: list(n, y), label }))
    note("soil", ([wide, high], [x, y], cell_m, traction) => ({
        x: list(wide, i => x + i * cell_m),
        y: list(high, j => y + j * cell_m),
        traction: list(wide * high, at => traction(Math.floor(at / high), at % high)),
    }))
    const bytes = Uint8Array.from(atob(numbers), letter => letter.charCodeAt(0))
    state.numbers = new DataView(bytes.buffer, 3) // a message begins anywhere
    const listeners = new Set()
    window.told = () => listeners.forEach(each => each())
    const model = { get: name => state[name], on: (_, act) => listeners.add(act), off() {} }
    window.state = state
    screen_of({ model, el: document.querySelector(".rhec") })
}"""


class Explorer:
    """What a user does with the page, and sees on it."""

    def __init__(self, page):
        self.page = page
        page.evaluate("document.querySelector('.rhec').scrollIntoView()")
        page.evaluate(WATCH)

    @property
    def picture(self):
        return self.page.evaluate(
            "[...document.querySelectorAll('.rhec-canvas')].map(canvas => canvas.toDataURL())"
        )

    @property
    def metrics(self):
        return self.page.locator(".rhec-table tr").all_inner_texts()[1:]

    @property
    def line(self):
        return self.page.inner_text(".rhec-line")

    def tab(self, name):
        self.page.locator(".rhec .lm-TabBar-tab", has_text=name).click()

    def press(self, name):
        self.page.locator(".rhec").get_by_role("button", name=name, exact=True).click()

    def slider(self, label):
        """The box of the slider with this label, which is in the open tab."""
        return self.page.locator(
            ".rhec .widget-slider:visible", has=self.page.get_by_text(label, exact=True)
        )

    def settled(self):
        """Wait until a picture has come and no more do."""
        self.page.wait_for_function("painted")
        self.page.evaluate(QUIET)
        self.page.evaluate("painted = 0")


@pytest.fixture(scope="module")
def opened(lab, open_page):
    with open_page() as page:
        lab.open(page, "00_start.ipynb")
        lab.run(page)
        page.wait_for_selector(".rhec-canvas")
        yield Explorer(page)
        lab.close(page)


@pytest.fixture
def explorer(opened, lab):
    """The explorer as it begins."""
    opened.press("reset")
    opened.page.evaluate(QUIET)
    opened.page.evaluate("painted = 0")
    yield opened
    for output in lab.outputs(opened.page):  # the first compile says so on stderr
        assert output["output_type"] != "error"
        assert "Error" not in "".join(output.get("text", ""))


def test_a_moved_slider_drives_the_field_again_and_a_click_copies_the_setting(explorer):
    page = explorer.page
    picture, metrics, line = explorer.picture, explorer.metrics, explorer.line
    assert len(metrics) == 2 and len(picture) == len({*picture}) == 6
    explorer.tab("Controller")
    explorer.slider("R").locator(".noUi-handle").focus()
    for _ in range(5):
        page.keyboard.press("ArrowRight")
    explorer.settled()
    assert explorer.picture != picture
    assert all(now != before for now, before in zip(explorer.metrics, metrics))
    assert "r=" in explorer.line and "r=" not in line
    page.context.grant_permissions(["clipboard-read", "clipboard-write"])
    page.locator(".rhec-line").click()
    assert page.evaluate("navigator.clipboard.readText()") == explorer.line
    explorer.press("reset")
    explorer.settled()
    assert (explorer.picture, explorer.metrics, explorer.line) == (picture, metrics, line)


def test_the_screen_draws_the_marks_of_a_picture_and_a_legend_hides_them(page):
    x, y = np.arange(5.0), np.linspace(0.25, 1, 5)
    traction = np.linspace(0.5, 1, 12).reshape(4, 3)
    soil = Mark("soil", 2 * np.arange(4.0), 2 * np.arange(3.0), traction=traction)
    dots = Mark("dots", x, y, colour="red", label="seen", note="by GNSS")
    ring = Mark("dots", x, y, colour="blue", label="worst", note=None, full=False)
    line = Mark("line", x, 2 * y, label="RHE", note="")
    dashed = Mark("line", x, np.where(y > 0.5, y, np.nan), dash=(2, 2), label="path")
    area = Mark("area", x, y, label="band")
    panels = dict(
        a=Panel("field", (0, 6), (0, 4), [soil, dots, ring], "equal"),
        b=Panel("error", (0, 5), (0.1, 2), [area, dashed, line], "log", "t [s]"),
    )
    picture = Picture(("a b",), panels)
    content, numbers = packed(picture)
    state = dict(status="ready", status_kind="good", line="rhec", picture=content)
    state |= dict(table="<table><tr><td>1</td></tr></table>")
    page.set_content("<body><div class=rhec style='width: 900px'></div></body>")
    page.add_style_tag(content=CSS)
    script = Screen._esm.replace("export default { render };", "window.screen_of = render;")
    page.add_script_tag(content=str(script))
    page.evaluate(RENDER, [state, base64.b64encode(b"---" + numbers).decode()])

    def drawn():
        return {
            title: [(mark["kind"], mark.get("label")) for mark in marks]
            for title, marks in page.evaluate("drawn").items()
        }

    for panel in panels.values():
        found = page.evaluate("drawn")[panel.title]
        for mark, seen in zip(panel.marks, found, strict=True):
            assert seen["kind"] == mark.kind
            for name in ("x", "y") if mark.traction is None else ("x", "y", "traction"):
                wanted = np.ravel(getattr(mark, name)).astype(np.float32)
                np.testing.assert_array_equal(np.array(seen[name], dtype=float), wanted)
    # A mark whose values are not told has no label for the pointer.
    assert [label for _, label in drawn()["field"]] == [None, "seen by GNSS", ""]
    assert [label for _, label in drawn()["error"]] == ["", "", "RHE"]
    entries = page.locator(".rhec-legend button")
    assert entries.all_inner_texts() == ["○ worst", "● seen", "━ RHE", "╍ path", "━ band"]
    colours = "all => all.map(sample => getComputedStyle(sample).color)"
    colours = page.eval_on_selector_all(".rhec-legend span", colours)
    assert colours[:2] == ["rgb(0, 0, 255)", "rgb(255, 0, 0)"] and len({*colours}) == 3
    every = drawn()
    entries.nth(2).click()
    assert drawn() == every | dict(error=every["error"][:2])
    assert entries.nth(2).get_attribute("aria-pressed") == "false"
    entries.nth(2).click()
    assert drawn() == every and entries.nth(2).get_attribute("aria-pressed") == "true"
    words = ".rhec-status, .rhec-line, .rhec-metrics"
    assert page.locator(words).all_inner_texts() == ["ready", "rhec", "1"]
    page.locator("canvas").nth(1).hover()
    page.evaluate("state.picture.panels.b.marks[2].note = 'of two', told()")
    assert "RHE of two" in page.inner_text("canvas[aria-label=error] ~ .view-words")
    # What is new is shown, and what is not stays as it is.
    page.evaluate("canvas = document.querySelector('canvas')")
    page.evaluate("state.status = 'busy', state.line = 'new', state.table = 'no', told()")
    assert page.locator(words).all_inner_texts() == ["busy", "new", "no"]
    assert page.evaluate("canvas.isConnected")
    page.evaluate(
        "state.picture.layout = ['a', 'b'], state.picture.panels.a.title = 'soil', told()"
    )
    assert page.locator("figcaption").all_inner_texts() == ["soil", "error"]
    places = [canvas.bounding_box() for canvas in page.locator("canvas").all()]
    assert places[0]["x"] == places[1]["x"] and places[0]["y"] < places[1]["y"]


def test_a_dragged_slider_ends_at_its_last_value(explorer):
    explorer.tab("Drive")
    box = explorer.slider("speed [m/s]").locator(".noUi-target").bounding_box()
    mouse, y = explorer.page.mouse, box["y"] + box["height"] / 2
    mouse.move(box["x"] + 0.3 * box["width"], y)
    mouse.down()
    for step in range(20):
        mouse.move(box["x"] + (0.3 + 0.02 * step) * box["width"], y)
        explorer.page.wait_for_timeout(16)
    mouse.up()
    explorer.settled()
    readout = float(explorer.slider("speed [m/s]").locator(".widget-readout").inner_text())
    assert f"speed_mps={readout!r}" in explorer.line


def test_it_fits_the_screen_and_is_readable_in_both_themes(explorer):
    before, page = explorer.picture, explorer.page
    box = page.locator(".rhec").bounding_box()
    panel = page.locator(".jp-NotebookPanel-notebook").bounding_box()
    assert box["width"] <= panel["width"] and box["height"] <= panel["height"]
    for theme, same in (("Dark", False), ("Light", True)):
        page.evaluate(
            "theme => jupyterapp.commands.execute('apputils:change-theme', {theme})",
            f"JupyterLab {theme}",
        )
        page.wait_for_selector("#jupyterlab-splash", state="detached")
        page.wait_for_function(
            """([before, same]) => {
                const all = [...document.querySelectorAll('.rhec-canvas')]
                return all.every(({ clientWidth }) => clientWidth) &&
                    all.every((canvas, i) => (canvas.toDataURL() == before[i]) == same)
            }""",
            arg=[before, same],
        )
        ink, paper = page.evaluate("""() => [
            getComputedStyle(document.querySelector('.rhec-pictures')).color,
            getComputedStyle(document.querySelector('.jp-Notebook')).backgroundColor,
        ]""")
        assert contrast(ink, paper) > 7


def contrast(one, other):
    """WCAG's contrast ratio of two colours as CSS computes them."""

    def luminance(colour):
        parts = colour.partition("(")[2].rstrip(")").split(",")[:3]
        rgb = np.array([*map(float, parts)]) / 255
        linear = np.where(rgb <= 0.04045, rgb / 12.92, ((rgb + 0.055) / 1.055) ** 2.4)
        return linear @ (0.2126, 0.7152, 0.0722)

    low, high = sorted([luminance(one), luminance(other)])
    return (high + 0.05) / (low + 0.05)


@pytest.mark.nightly
def test_the_benchmark_times_moves_of_a_slider(lab, page):
    table = latency.measure(lab, page, moves=2)
    assert list(table["drives"]) == [2, 1]
    assert (table["kernel_s_median"] < table["picture_s_median"]).all()
