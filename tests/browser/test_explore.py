"""The explorer as its user has it: JupyterLab in a browser, sliders moved by mouse and keyboard,
and what the page then shows. `test_live.py` tests the values that a pointer shows.
"""

import numpy as np
import pytest

from benchmark import latency

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


def test_a_box_zooms_a_drag_moves_a_double_click_shows_all_and_the_legend_hides(explorer):
    page = explorer.page
    whole = explorer.picture

    def drag(by_x, by_y):
        page.mouse.move(x, y)
        page.mouse.down()
        page.mouse.move(x + by_x, y + by_y, steps=3)
        page.mouse.up()
        page.mouse.move(1, 1)
        return explorer.picture

    # Pictures over time have one axis along x; the map has its own.
    for place, others in ((0, [0]), (1, [1, 2, 3, 4, 5])):
        box = page.locator(".rhec-canvas").nth(place).bounding_box()
        x, y = box["x"] + box["width"] / 2, box["y"] + box["height"] / 2
        zoomed = drag(60, 30)
        assert [i for i in range(6) if zoomed[i] != whole[i]] == others
        page.keyboard.down("Shift")
        assert drag(20, 0)[place] != zoomed[place]
        page.keyboard.up("Shift")
        page.mouse.dblclick(x, y)
        page.mouse.move(1, 1)
        assert explorer.picture == whole
    button = page.locator(".rhec-legend").get_by_role("button", name="EKF")
    button.click()
    assert button.get_attribute("aria-pressed") == "false"
    assert all(now != before for now, before in zip(explorer.picture, whole))
    button.click()
    page.mouse.move(1, 1)
    assert explorer.picture == whole


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
