"""The explorer as its user has it: JupyterLab in a browser, sliders moved by mouse and keyboard,
and what the page then shows.
"""

import numpy as np
import pytest

import rhec
from rhec.explorer.explorer import metrics_table
from rhec.explorer.screen import CSS

# From here on the page notes when each picture that follows a change was painted, when a pointer
# was last pressed and let go [ms], and which messages the kernel has not yet dealt with.
WATCH = """() => {
    window.seen = {painted: [], pressed: 0, released: 0}
    window.unanswered = new Set()
    const kernel = jupyterapp.shell.currentWidget.context.sessionContext.session.kernel
    kernel.anyMessage.connect((_, { msg, direction }) => {
        if (direction == 'send' && msg.channel == 'shell') unanswered.add(msg.header.msg_id)
    })
    kernel.iopubMessage.connect((_, msg) => {
        if (msg.content.execution_state == 'idle') unanswered.delete(msg.parent_header.msg_id)
    })
    const note = () => seen.painted.push(performance.now())
    document.addEventListener('drawn', () => requestAnimationFrame(() => setTimeout(note)))
    document.addEventListener('pointerdown', () => { seen.pressed = performance.now() }, true)
    document.addEventListener('pointerup', () => { seen.released = performance.now() }, true)
}"""
QUIET_MS = 400


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

    @property
    def status(self):
        return self.page.inner_text(".rhec-status")

    def tab(self, name):
        self.page.locator(".rhec .lm-TabBar-tab", has_text=name).click()

    def press(self, name):
        self.page.locator(".rhec").get_by_role("button", name=name, exact=True).click()

    def slider(self, label):
        """The box of the slider with this label, which is in the open tab."""
        return self.page.locator(
            ".rhec .widget-slider:visible", has=self.page.get_by_text(label, exact=True)
        )

    def keys(self, label, key, times=1):
        self.slider(label).locator(".noUi-handle").focus()
        for _ in range(times):
            self.page.keyboard.press(key)

    def settled(self):
        """Wait until a picture has come and no more do. Returns when each was painted since the
        last time, and when the pointer was pressed and let go [ms].
        """
        self.page.wait_for_function("seen.painted.length")
        self.quiet()
        seen = self.page.evaluate("() => ({...seen})")
        self.page.evaluate("seen.painted = []")
        return seen

    def quiet(self):
        """Wait until the kernel has dealt with all that the page sent, and no more comes for a
        while: a slider sends its next value after the reply to the last one.
        """
        self.page.evaluate(
            """async quiet_ms => {
            let since = performance.now()
            while (performance.now() - since < quiet_ms) {
                if (unanswered.size) since = performance.now()
                await new Promise(done => setTimeout(done, 20))
            }
        }""",
            QUIET_MS,
        )

    def no_error(self, lab):
        for output in lab.outputs(self.page):  # the first compile says so on stderr
            assert output["output_type"] != "error" and "Error" not in "".join(
                output.get("text", "")
            )


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
    opened.press("unpin") if opened.page.get_by_role("button", name="unpin").is_enabled() else None
    opened.press("reset")
    opened.quiet()
    opened.page.evaluate("seen.painted = []")
    yield opened
    opened.no_error(lab)


def test_a_moved_slider_drives_the_field_again(explorer):
    picture, metrics, line = explorer.picture, explorer.metrics, explorer.line
    assert len(metrics) == 2 and len(picture) == len({*picture}) == 6
    explorer.tab("Controller")
    explorer.keys("R", "ArrowRight", 5)
    explorer.settled()
    assert explorer.picture != picture
    assert all(now != before for now, before in zip(explorer.metrics, metrics))
    assert "r=" in explorer.line and "r=" not in line
    explorer.press("reset")
    explorer.settled()
    assert (explorer.picture, explorer.metrics, explorer.line) == (picture, metrics, line)


def test_the_setting_is_copied_by_a_click(explorer):
    explorer.tab("Controller")
    explorer.press("Q²")
    explorer.settled()
    explorer.page.context.grant_permissions(["clipboard-read", "clipboard-write"])
    explorer.page.locator(".rhec-line").click()
    assert (
        explorer.page.evaluate("navigator.clipboard.readText()")
        == explorer.line
        == "rhec.Scenario(q=(1.0, 1.0, 0.0))"
    )


@pytest.mark.timed
def test_dragging_follows_drops_pictures_and_ends_at_the_last_value(explorer, capsys):
    explorer.tab("Drive")
    box = explorer.slider("speed [m/s]").locator(".noUi-target").bounding_box()
    steps, mouse = 60, explorer.page.mouse
    mouse.move(box["x"] + 0.3 * box["width"], box["y"] + box["height"] / 2)
    mouse.down()
    for step in range(steps):
        mouse.move(
            box["x"] + (0.3 + 0.4 * step / steps) * box["width"], box["y"] + box["height"] / 2
        )
        explorer.page.wait_for_timeout(16)
    mouse.up()
    seen = explorer.settled()
    while_dragging = sum(painted < seen["released"] for painted in seen["painted"])
    last = seen["painted"][-1] - seen["released"]
    with capsys.disabled():
        print(
            f"\ndragging: {while_dragging} pictures in "
            f"{(seen['released'] - seen['pressed']) / 1000:.1f} s, "
            f"the last one {last:.0f} ms after the release"
        )
    assert 2 <= while_dragging < steps
    readout = float(explorer.slider("speed [m/s]").locator(".widget-readout").inner_text())
    assert f"speed_mps={readout!r}" in explorer.line


def test_the_pictures_tell_what_they_are_and_are_readable_in_both_themes(explorer):
    before, page = explorer.picture, explorer.page
    labels = page.evaluate(
        "[...document.querySelectorAll('.rhec-canvas')]"
        ".map(canvas => canvas.role == 'img' && canvas.ariaLabel)"
    )
    assert len(labels) == 6 and all(labels)
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


def middle(page, place):
    """The middle of the picture at this place, in pixels of the page, and its box."""
    box = page.locator(".rhec-canvas").nth(place).bounding_box()
    return box["x"] + box["width"] / 2, box["y"] + box["height"] / 2, box


def test_a_pointer_shows_the_values_of_one_sample_in_every_picture(explorer):
    page = explorer.page
    run = rhec.simulate(rhec.Scenario())
    for place in range(6):
        x, y, box = middle(page, place)
        page.mouse.move(x, y)
        words = page.locator(".view-words:visible").all_inner_texts()
        assert len(words) == 6
        map_, *over_time = words
        (time_s,) = {float(text.split(" s", 1)[0]) for text in over_time}
        k = round(time_s / 0.2)
        row = run.log.iloc[k]
        x_m, y_m, error_m = (float(f"{row[name]:.3g}") for name in ("x_m", "y_m", "error_true_m"))
        assert f"RHE {x_m:g}, {y_m:g}" in map_
        assert any(f"RHE {error_m:g}" in text for text in over_time)
    page.mouse.move(1, 1)
    assert not page.locator(".view-words:visible").count()


def test_a_box_zooms_a_drag_moves_and_a_double_click_shows_all(explorer):
    page = explorer.page
    whole = explorer.picture
    for place, others in ((0, [0]), (1, [1, 2, 3, 4, 5])):
        x, y, box = middle(page, place)
        page.mouse.move(x - 60, y - 30)
        page.mouse.down()
        page.mouse.move(x + 60, y + 30, steps=3)
        page.mouse.up()
        page.mouse.move(1, 1)
        zoomed = explorer.picture
        # Pictures over time have one axis along x; the map has its own.
        assert [i for i in range(6) if zoomed[i] != whole[i]] == others
        page.keyboard.down("Shift")
        page.mouse.move(x, y)
        page.mouse.down()
        page.mouse.move(x + 20, y, steps=2)
        page.mouse.up()
        page.keyboard.up("Shift")
        page.mouse.move(1, 1)
        assert explorer.picture[place] != zoomed[place]
        page.mouse.dblclick(x, y)
        page.mouse.move(1, 1)
        assert explorer.picture == whole
        page.mouse.move(x, y)
        page.keyboard.down("Control")
        page.mouse.wheel(0, -200)
        page.keyboard.up("Control")
        page.wait_for_function(
            "([place, before]) => document.querySelectorAll('.rhec-canvas')[place].toDataURL()"
            " != before",
            arg=[place, whole[place]],
        )
        page.mouse.dblclick(x, y)
        page.mouse.move(1, 1)
        assert explorer.picture == whole


def test_a_click_on_the_legend_hides_and_shows(explorer):
    page = explorer.page
    whole = explorer.picture
    button = page.locator(".rhec-legend").get_by_role("button", name="EKF")
    button.click()
    assert button.get_attribute("aria-pressed") == "false"
    assert all(now != before for now, before in zip(explorer.picture, whole))
    x, y, _ = middle(page, 1)
    page.mouse.move(x, y)
    assert "EKF" not in " ".join(page.locator(".view-words:visible").all_inner_texts()[1:2])
    button.click()
    page.mouse.move(1, 1)
    assert explorer.picture == whole


# The last size is the one that the page was opened with.
@pytest.mark.parametrize("width, height", [(2560, 1440), (1366, 768)])
def test_it_fits_the_screen(explorer, width, height):
    page = explorer.page
    page.set_viewport_size({"width": width, "height": height})
    explorer.press("pin")
    explorer.settled()
    box = page.locator(".rhec").bounding_box()
    panel = page.locator(".jp-NotebookPanel-notebook").bounding_box()
    assert 0.85 * width < box["width"] <= panel["width"] and box["height"] <= panel["height"]
    assert page.locator(".rhec-pictures").bounding_box()["width"] > 0.5 * box["width"]
    assert page.evaluate(
        "[...document.querySelectorAll("
        "'.rhec, .rhec-metrics, .rhec-table, .rhec-pictures, .rhec-title')]"
        ".every(each => each.scrollWidth <= each.clientWidth + 1)"
    )


@pytest.mark.parametrize("width", [420, 560, 660, 1000])
def test_the_table_of_metrics_is_never_cut(page, width):
    run = rhec.simulate(rhec.Scenario(duration_s=10.0, estimator="bounded_ekf"))
    table = metrics_table((run, run), (run, run))
    page.set_viewport_size({"width": width, "height": 600})
    page.set_content(
        f'<style>{CSS} body {{ margin: 0; font-family: sans-serif }}</style><div class="rhec">'
        f'<div class="rhec-metrics">{table}</div></div>'
    )
    frame = page.locator(".rhec-metrics").bounding_box()
    for cell in page.locator("th, td").all():
        box = cell.bounding_box()
        assert box["x"] >= frame["x"] and box["x"] + box["width"] <= frame["width"] + 0.5
    assert page.evaluate("document.documentElement.scrollWidth") <= width


def contrast(one, other):
    """WCAG's contrast ratio of two colours as CSS computes them."""

    def luminance(colour):
        rgb = (
            np.array([float(part) for part in colour.partition("(")[2].rstrip(")").split(",")[:3]])
            / 255
        )
        return np.where(rgb <= 0.04045, rgb / 12.92, ((rgb + 0.055) / 1.055) ** 2.4) @ (
            0.2126,
            0.7152,
            0.0722,
        )

    low, high = sorted([luminance(one), luminance(other)])
    return (high + 0.05) / (low + 0.05)
