"""The explorer as its user has it: JupyterLab in a browser, a slider moved by the mouse, and what
the page then shows; and its screen without a kernel. The live page draws with the same scripts.
"""

import base64
import time

import numpy as np
import pytest
from drawn import NOTE, marks_on, place_on

from rhec.explorer.panels import Mark, Panel, Picture, packed
from rhec.explorer.screen import CSS, Screen


def shown(page):
    """Pictures, metrics and the line of Python."""
    pictures = "[...document.querySelectorAll('.rhec-canvas')].map(each => each.toDataURL())"
    metrics = page.locator(".rhec-table tr").all_inner_texts()[1:]
    return page.evaluate(pictures), metrics, page.inner_text(".rhec-line")


def wait_until_shown(page, is_so):
    """Wait until a function of what is shown is true."""
    end = time.monotonic() + 180
    while not is_so(*shown(page)):
        assert time.monotonic() < end, shown(page)[1:]
        page.wait_for_timeout(100)


def test_a_dragged_slider_drives_the_field_again_and_a_click_copies_the_setting(lab, page):
    lab.open(page, "00_start.ipynb")
    lab.run(page)
    page.wait_for_selector(".rhec-canvas")
    wait_until_shown(page, lambda pictures, metrics, _: len({*pictures}) == 6 and len(metrics) == 2)
    own, notebook = (
        page.locator(name).bounding_box() for name in (".rhec", ".jp-NotebookPanel-notebook")
    )
    assert own["width"] <= notebook["width"] and own["height"] <= notebook["height"]
    before = shown(page)
    page.locator(".rhec .lm-TabBar-tab", has_text="Drive").click()
    label = page.get_by_text("speed [m/s]", exact=True)
    slider = page.locator(".rhec .widget-slider:visible", has=label)
    slider.scroll_into_view_if_needed()
    box = slider.locator(".noUi-target").bounding_box()
    y = box["y"] + box["height"] / 2
    page.mouse.move(box["x"] + 0.3 * box["width"], y)
    page.mouse.down()
    for step in range(20):
        page.mouse.move(box["x"] + (0.3 + 0.02 * step) * box["width"], y)
        page.wait_for_timeout(16)
    page.mouse.up()
    speed_mps = float(slider.locator(".widget-readout").inner_text())
    assert "speed_mps" not in before[2]
    wait_until_shown(
        page,
        lambda pictures, metrics, line: (
            f"speed_mps={speed_mps!r}" in line
            and pictures != before[0]
            and all(now != then for now, then in zip(metrics, before[1]))
        ),
    )
    page.context.grant_permissions(["clipboard-read", "clipboard-write"])
    page.locator(".rhec-line").click()
    assert page.evaluate("navigator.clipboard.readText()") == shown(page)[2]
    page.locator(".rhec").get_by_role("button", name="reset", exact=True).click()
    wait_until_shown(page, lambda *now: now == before)
    for output in lab.outputs(page):  # the first compile says so on stderr
        assert output["output_type"] != "error"
        assert "Error" not in "".join(output.get("text", ""))
    lab.close(page)


# The screen without a kernel

RENDER = """([state, numbers]) => {
    const bytes = Uint8Array.from(atob(numbers), letter => letter.charCodeAt(0))
    state.numbers = new DataView(bytes.buffer, 3) // a message begins anywhere
    const listeners = new Set()
    window.told = () => listeners.forEach(each => each())
    const model = { get: name => state[name], on: (_, act) => listeners.add(act), off() {} }
    window.state = state
    screen_of({ model, el: document.querySelector(".rhec") })
}"""
# What the picture holds at places of its axes, and the numbers at its ticks with what stands there.
PIXELS = """([title, places]) => places.map(place => {
    const { plot } = seen[title]
    const [x, y, aside_px = 0] = place
    const at = [plot.x(x) + aside_px, plot.y(y)].map(Math.round)
    return [...plot.c.getImageData(...at, 1, 1).data]
})"""
TICKS = """title => {
    const { plot, ticks } = seen[title]
    const number = text => Number(text.replaceAll("−", "-"))
    const read = ([text, px, py]) =>
        [number(text), px, py - 4, ...plot.data({ offsetX: px, offsetY: py - 4 })]
    return [plot.box, ticks.filter(([text]) => /\\d/.test(text)).map(read)]
}"""
# What is seen above the pictures.
PLACES = """all => all.filter(each => each.checkVisibility()).map(each => {
    const { x, y, width, height } = each.getBoundingClientRect()
    return [x, y, width, height]
})"""
K = np.arange(11.0)
SOIL = np.linspace(0.5, 1, 12).reshape(4, 3)
SEEN = [
    Mark("soil", 0.3 + 2 * np.arange(4.0), 0.3 + 2 * np.arange(3.0), traction=SOIL),
    Mark("dots", K[:4], K[:4], colour="red", width=9, label="seen", note="by GNSS"),
    Mark("dots", 1 + K[:4], K[:4], colour="blue", width=9, label="worst", full=False),
]
ERRORS = [
    Mark("area", K[[2, 2, 8, 8]], np.array([0.5, 1, 1, 0.5]), "blue", alpha=0.5, label="band"),
    Mark("line", K, np.where(K == 5, np.nan, 0.2), dash=(6, 6), label="path"),
    Mark("line", K, 0.15 + K / 10, "red", width=3, label="RHE", note=""),
]
SPEEDS = [
    Mark("line", K, K / 10, label="up", note=""),
    Mark("line", K[:5], np.where(K == 2, np.nan, -0.0123 - K)[:5], label="down", note=""),
]
PANELS = dict(
    a=Panel("field", (0, 6), (0, 4), SEEN, "equal"),
    b=Panel("error", (0, 10), (0.1, 2), ERRORS, "log", "t [s]"),
    c=Panel("speed", (0, 10), (0, 1), SPEEDS, "", "t [s]"),
    d=Panel("map", (0, 10), (0, 10), [Mark("line", K, K, label="way", note="")]),
)


class Pictures:
    """The screen with PANELS, and what a pointer does on it."""

    def __init__(self, page):
        self.page = page

    def at(self, title, x, y):
        return place_on(self.page, title, x, y)

    def drawn(self):
        """{picture: [(kind, what a pointer calls it)]}."""
        return {
            title: [(kind, label) for kind, _, label, _ in marks.all]
            for title, marks in marks_on(self.page).items()
        }

    def limits(self, title):
        marks = marks_on(self.page)[title]
        return np.transpose([marks.low, marks.high])

    def wheel(self, title, x, y, by, key="Control"):
        self.page.mouse.move(*self.at(title, x, y))
        self.page.keyboard.down(key)
        self.page.mouse.wheel(0, by)
        self.page.keyboard.up(key)

    def drag(self, title, start, end, button="left"):
        """Returns the box that is seen meanwhile."""
        begin, to = (self.at(title, *place) for place in (start, end))
        self.page.mouse.move(*begin)
        self.page.mouse.down(button=button)
        self.page.mouse.move(*to, steps=3)
        boxes = self.page.eval_on_selector_all(".view-box", PLACES)
        self.page.mouse.up(button=button)
        return boxes


@pytest.fixture
def screen(page):
    content, numbers = packed(Picture(("a b", "d c"), PANELS))
    state = dict(status="ready", status_kind="good", line="rhec", picture=content)
    state |= dict(table="<table><tr><td>1</td></tr></table>")
    page.set_content("<body><div class=rhec style='width: 900px'></div></body>")
    page.add_style_tag(content=CSS)
    script = Screen._esm.replace("export default { render };", "window.screen_of = render;")
    page.add_script_tag(content=str(script))
    page.evaluate(NOTE)
    page.evaluate(RENDER, [state, base64.b64encode(b"---" + numbers).decode()])
    return Pictures(page)


def test_the_screen_draws_the_marks_of_a_picture_and_a_legend_hides_them(screen):
    page = screen.page
    for title, seen in marks_on(page).items():
        (panel,) = [panel for panel in PANELS.values() if panel.title == title]
        for mark, (kind, _, _, points) in zip(panel.marks, seen.all, strict=True):
            assert kind == mark.kind
            x = mark.x
            y = mark.y
            if mark.traction is not None:
                x, y = np.meshgrid(x, y, indexing="ij")
                np.testing.assert_array_equal(points[:, 2], np.float32(mark.traction).ravel())
            wanted = np.column_stack([np.ravel(x), np.ravel(y)])
            np.testing.assert_allclose(points[:, :2], wanted, atol=1e-6)
        if panel.scale != "equal":
            np.testing.assert_allclose(screen.limits(title), [panel.xlim, panel.ylim])
    # A mark whose values are not told has no label for the pointer.
    every = screen.drawn()
    assert [label for _, label in every["field"]] == ["", "seen by GNSS", ""]
    assert [label for _, label in every["error"]] == ["", "", "RHE"]
    entries = page.locator(".rhec-legend button")
    shown = ["○ worst", "● seen", "━ RHE", "╍ path", "━ band", "━ down", "━ up", "━ way"]
    assert entries.all_inner_texts() == shown
    colours = "all => all.map(sample => getComputedStyle(sample).color)"
    colours = page.eval_on_selector_all(".rhec-legend span", colours)
    assert colours[:3] == ["rgb(0, 0, 255)", "rgb(255, 0, 0)", "rgb(255, 0, 0)"]
    for marks, pressed in ((every["error"][:2], "false"), (every["error"], "true")):
        entries.nth(2).click()
        assert screen.drawn() == every | dict(error=marks)
        assert entries.nth(2).get_attribute("aria-pressed") == pressed


def test_what_is_new_is_shown_and_what_is_not_stays_as_it_is(screen):
    page = screen.page
    words = page.locator(".rhec-status, .rhec-line, .rhec-metrics")
    assert words.all_inner_texts() == ["ready", "rhec", "1"]
    page.locator("canvas").nth(1).hover()
    page.evaluate("state.picture.panels.b.marks[2].note = 'of two', told()")
    assert "RHE of two" in page.inner_text("canvas[aria-label=error] ~ .view-words")
    page.evaluate("canvas = document.querySelector('canvas')")
    page.evaluate("state.status = 'busy', state.line = 'new', state.table = 'no', told()")
    assert words.all_inner_texts() == ["busy", "new", "no"]
    page.evaluate("state.picture.panels.a.title = 'soil', told()")
    assert page.locator("figcaption").all_inner_texts() == ["soil", "error", "speed", "map"]
    assert page.evaluate("canvas.isConnected")
    page.evaluate("document.body.style.setProperty('--jp-ui-font-color1', 'lime')")
    page.evaluate("document.body.dataset.jpThemeName = 'of lime'")
    page.wait_for_function("""() => {
        const { plot } = seen.map
        return plot.c.getImageData(plot.x(3), plot.y(3), 1, 1).data[1] > 200
    }""")
    page.evaluate("state.picture.layout = ['a', 'b', 'c', 'd'], told()")
    places = [canvas.bounding_box() for canvas in page.locator("canvas").all()]
    assert places[0]["x"] == places[1]["x"] and places[0]["y"] < places[1]["y"]


def test_a_tick_stands_where_a_pointer_reads_its_number(screen):
    for _ in range(2):
        for title in ("field", "error", "speed", "map"):
            (left, top, right, bottom), ticks = screen.page.evaluate(TICKS, title)
            for axis, begin, end in ((0, left, right), (1, top, bottom)):
                own = [tick for tick in ticks if (tick[1] < left) == bool(axis)]
                read = [tick[3 + axis] for tick in own]
                np.testing.assert_allclose([tick[0] for tick in own], read, rtol=1e-4, atol=1e-6)
                steps = np.diff([begin, *sorted(tick[1 + axis] for tick in own), end])
                assert steps[1:-1].min() > (31, 60)[not axis] - 2 and steps.max() < 170
        low, high = screen.limits("field").T
        assert (high - low)[0] / (right - left) == pytest.approx((high - low)[1] / (bottom - top))
        screen.wheel("map", 4.3, 6.2, -200)
        screen.wheel("speed", 4.3, 0.62, -200)


def test_what_is_drawn_is_seen_where_it_is(screen):
    def pixels(title, *places):
        return np.array(screen.page.evaluate(PIXELS, [title, places]))

    red = 255, 0, 0, 255
    np.testing.assert_array_equal(pixels("field", (1, 1), (3, 3)), [red] * 2)
    ring = pixels("field", *[(2, 1, aside_px) for aside_px in (0, 3, 5, 6, 9)]).astype(int)
    is_blue = ring[:, 2] > ring[:, 0] + 20  # and the soil is brown
    assert not is_blue[[0, 1, 4]].any() and is_blue[2:4].any()
    cells = [(i, j) for i in (0, 1, 2) for j in (0, 1)]
    alpha = pixels("field", *[(0.3 + 2 * i, 0.3 + 2 * j) for i, j in cells])[:, 3]
    shown = [255 * np.sqrt(1 - SOIL[cell]) / 0.91 for cell in cells]  # as panels.py draws it
    np.testing.assert_allclose(alpha, np.minimum(shown, 255), atol=4)
    np.testing.assert_array_equal(pixels("error", (3, 0.45), (7, 0.85)), [red] * 2)
    band = pixels("error", (3.3, 0.7), (1.3, 0.7), (8.7, 0.7))
    np.testing.assert_allclose(band, [(0, 0, 255, 128), (0,) * 4, (0,) * 4], atol=2)
    path = pixels("error", *[(k, 0.2) for k in np.arange(0, 10, 0.013)])[:, 3] > 100
    known = np.abs(np.arange(0, 10, 0.013) - 5) > 1
    assert 0.4 < path[known].mean() < 0.6 and path[~known].mean() < 0.1
    assert pixels("speed", (0, -0.0123))[0, 3] == 0  # beyond its axes


def test_a_pointer_shows_the_values_of_its_sample(screen):
    page = screen.page
    words = page.locator(".view-words")
    assert not any(each.is_visible() for each in page.locator("[class^=view-]").all())
    speeds = {2: "up 0.2", 4: "down −4.01 · up 0.4", 5: "up 0.5", 7: "up 0.7"}
    for title, x, y, k in (
        ("speed", 4.1, 0.9, 4),
        ("error", 2.1, 1, 2),
        ("error", 4.6, 0.2, 5),
        ("map", 6.4, 7.6, 7),
    ):
        page.mouse.move(*screen.at(title, x, y))
        said = [f"{k}.0 s · RHE {0.15 + k / 10:.3g}", f"{k}.0 s · {speeds[k]}", f"way {k}, {k}"]
        assert words.all_inner_texts()[1:] == said
    # The cursor stands at the sample, in a picture over time from top to bottom.
    cursors = page.eval_on_selector_all(".view-cursor.over-time", PLACES)
    for (x, y, width, height), title, ends in zip(cursors, ("error", "speed"), ((0.1, 2), (0, 1))):
        low, high = (screen.at(title, 7, end) for end in ends)
        assert (x + width / 2, y, y + height) == pytest.approx((*high, low[1]), abs=1)
    page.mouse.move(600, 760)
    assert not any(each.is_visible() for each in words.all())


def test_a_pointer_zooms_and_moves_within_the_whole(screen):
    page = screen.page
    whole = dict(time=(0, 10), speed=(0, 1), map=[(0, 10), (0, 10)])

    def limits_are(**changes):
        time, speed, of_map = (whole | changes).values()
        np.testing.assert_allclose(screen.limits("speed"), [time, speed], atol=0.04)
        np.testing.assert_allclose(screen.limits("error"), [time, (0.1, 2)], atol=0.04)
        np.testing.assert_allclose(screen.limits("map"), of_map, atol=0.04)

    screen.wheel("speed", 4, 0.25, -100, key="Alt")
    limits_are()
    # Around the pointer, in time in all pictures over time.
    screen.wheel("speed", 4, 0.25, -100)
    share = np.exp(-0.2)
    time = np.array([4 - 4 * share, 4 + 6 * share])
    speed = np.array([1 - share, 1 + 3 * share]) / 4
    limits_are(time=time, speed=speed)
    page.keyboard.down("Shift")
    assert not screen.drag("speed", (5, 0.5), (4, 0.4))
    limits_are(time=time + 1, speed=speed + 0.1)
    screen.drag("speed", (4, 0.4), (7, 0.4))
    page.keyboard.up("Shift")
    limits_are(time=(0, time[1] - 2), speed=speed + 0.1)
    page.mouse.dblclick(*screen.at("speed", 5, 0.5))
    limits_are()
    assert not screen.drag("map", (6, 8), (2, 3), "right")
    limits_are()
    # A box is what is seen next; a flat one chooses times alone, and a narrow one is not meant.
    first = screen.at("map", 2, 8)
    last = screen.at("map", 6, 3)
    (box,) = screen.drag("map", (6, 8), (2, 3))
    np.testing.assert_allclose(box, [*first, *np.subtract(last, first)], atol=2)
    screen.drag("speed", (3, 0.52), (8, 0.5))
    screen.drag("map", (5, 7), (4.97, 4))
    limits_are(time=(3, 8), map=[(2, 6), (3, 8)])
    assert not page.eval_on_selector_all(".view-box", PLACES)
    for title, x, y in (("speed", 5, 0.5), ("map", 4, 5)) * 3:
        screen.wheel(title, x, y, 900)
    limits_are()
