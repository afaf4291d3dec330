"""The live page of the report, opened from the disk: what it runs and what it shows."""

import random
import re
from pathlib import Path

import numpy as np
import pytest

import rhec
from rhec.simulation.columns import COLUMNS
from rhec.workbench.live.functions import METRICS
from rhec.workbench.live.page import FAULTS, SCENES
from rhec.workbench.live.texts import SEEDS, SOILS

PAGE = Path(__file__).parents[2] / "build/report/live.html"
pytestmark = pytest.mark.skipif(
    not PAGE.exists(), reason="build/report has no live page: nothing compiled C to WebAssembly"
)


class Live:
    """What a reader does with the page, and finds on it."""

    def __init__(self, page):
        self.page = page
        page.goto(PAGE.as_uri())
        self.settled()

    def settled(self):
        self.page.wait_for_function("page.busy && !asked")
        self.page.evaluate("page.busy")
        assert re.match(r"\d runs of", self.page.inner_text("#said")), self.page.inner_text("#said")

    def choose(self, **values):
        """Take these values of the lists, and of the choices between buttons."""
        for name, value in values.items():
            if name == "scene":
                self.page.locator(f"input[name=scene][value={value}]").check()
            else:
                self.page.select_option(f"#{name}", value)
        self.settled()

    def sliders(self):
        return self.page.locator("[data-scene]:not([hidden]) input[type=range]")

    def move(self, slider, share):
        """Move a slider to so much of its way."""
        slider.evaluate(
            """(input, share) => {
                const [min, max] = [Number(input.min), Number(input.max)]
                input.value = min + share * (max - min)
                input.dispatchEvent(new Event('input', {bubbles: true}))
            }""",
            share,
        )

    def pictures(self):
        return self.page.evaluate(
            "[...document.querySelectorAll('canvas')].map(canvas => canvas.toDataURL())"
        )

    def runs(self):
        """The line of Python, the log's bits, errors and metrics of each run."""
        found = self.page.evaluate(
            """() => page.loops.map((loop, i) => ({
                line: document.getElementById('line').textContent.split('\\n')[i],
                bits: [...new Uint8Array(loop.at_row.slice(0, loop.samples * loop.wide).buffer)],
                errors: [...loop.at_errors.slice(0, 2 * loop.samples)].map(String),
                metrics: Object.values(loop.metrics).map(String)}))"""
        )
        for run in found:
            run["rows"] = np.frombuffer(bytes(run["bits"])).reshape(-1, len(COLUMNS))
        return found


@pytest.fixture
def live(page):
    return Live(page)


@pytest.mark.parametrize("scene", SCENES)
def test_a_run_has_the_bits_of_the_line_of_python_beside_it(live, scene):
    """Twenty scenarios: five of each scene, with all that can be moved at random."""
    live.choose(scene=scene)
    chance = random.Random(scene)
    for number in range(5):
        live.choose(
            seed=str(chance.choice(SEEDS)), soil=chance.choice([*SOILS]),
            noise=chance.choice(["printed", "calibrated"]),
        )  # fmt: skip
        if scene == "faults":
            live.choose(fault=chance.choice([*FAULTS]))
        if number % 2:
            live.page.click("#patch")
        for slider in live.sliders().all():
            if chance.random() < 0.5:
                live.move(slider, chance.random())
        live.settled()
        for run in live.runs():
            native = eval(run["line"], dict(rhec=rhec))
            expected = np.column_stack([native.columns[name] for name in COLUMNS]).astype(float)
            assert np.array_equal(run["rows"], expected, equal_nan=True), run["line"]
            errors = np.array(run["errors"], dtype=float).reshape(-1, 2)
            known = np.column_stack([native.columns["error_m"], native.columns["error_true_m"]])
            np.testing.assert_allclose(errors, known, atol=1e-12)
            found = dict(zip(METRICS, map(float, run["metrics"])))
            for name, value in found.items():
                np.testing.assert_allclose(value, native.metrics[name], rtol=1e-9, err_msg=name)


@pytest.mark.parametrize("scene", SCENES)
def test_each_control_changes_what_is_shown(live, scene):
    """A slider, each list, and the button for a wet patch; W's sliders make W one's own."""
    live.choose(scene=scene)
    if scene == "faults":
        live.choose(fault=[*FAULTS][3])
    live.page.click("#patch")
    lists = dict(seed="3", soil="soft", noise="printed")
    lists |= dict(window="5") if scene in "ab" else {}
    lists |= dict(fault=[*FAULTS][1]) if scene == "faults" else {}
    for name, value in lists.items():
        before = live.pictures()
        live.choose(**{name: value})
        assert live.pictures() != before, name
    on_the_way = {"0": 0.5, "1": 0.28}  # where the robot comes through the patch
    for slider in live.sliders().all():
        field, place = (slider.get_attribute(f"data-{of}") for of in ("field", "place"))
        if (field, place) == ("patch", "0"):  # what was moved before may keep the robot away
            live.page.click("button[type=reset]")
            live.page.click("#patch")
            live.settled()
        before = live.pictures()
        live.move(slider, on_the_way.get(place, 0.9) if field == "patch" else 0.9)
        live.settled()
        assert live.pictures() != before, (field, place)
    before = live.pictures()
    live.page.click("#dry")
    live.settled()
    assert live.pictures() != before


def test_the_keyboard_moves_all_and_the_page_says_what_came_of_it(live):
    first = live.sliders().first
    said, label = live.page.inner_text("#line"), live.page.get_attribute("#error", "aria-label")
    first.focus()
    for _ in range(5):
        live.page.keyboard.press("ArrowRight")
    live.settled()
    assert live.page.inner_text("#line") != said
    assert live.page.get_attribute("#error", "aria-label") != label
    names = live.page.evaluate(
        "[...document.querySelectorAll('#live input, #live select')].map(it => it.labels.length)"
    )
    assert all(names)


def test_the_robot_the_start_and_a_wet_patch_are_dragged(live):
    live.choose(scene="b")
    box = live.page.locator("#map").bounding_box()

    def drag(places):
        (x, y), *others = live.page.evaluate(
            "places => places.map(([x, y]) => [page.map.x(x), page.map.y(y)])", places
        )
        live.page.mouse.move(box["x"] + x, box["y"] + y)
        live.page.mouse.down()
        for x, y in others:
            live.page.mouse.move(box["x"] + x, box["y"] + y)
        live.page.mouse.up()
        live.settled()

    live.page.locator("#map").scroll_into_view_if_needed()
    box = live.page.locator("#map").bounding_box()
    drag([(0, 1), (0, 2), (0, -1.5)])
    assert "start_offset_m=-1.5" in live.page.inner_text("#line")
    time = live.page.inner_text("#time")
    drag([(20, 8), (37.8, 8)])
    assert live.page.inner_text("#time") != time
    live.page.click("#patch")
    live.settled()
    drag([(15, 0), (18, 3)])
    (patch,) = live.page.evaluate("page.patches")
    assert np.hypot(patch[0] - 18, patch[1] - 3) < 0.3
    assert "patches=((1" in live.page.inner_text("#line")


def test_the_page_is_light_asks_nothing_of_a_network_and_fits_a_phone(page):
    asked = []
    page.context.set_offline(True)
    page.on("request", lambda request: asked.append(request.url))
    live = Live(page)
    for scene in SCENES:
        live.choose(scene=scene)
        for width in (1366, 390):
            page.set_viewport_size({"width": width, "height": 844})
            assert page.evaluate("document.documentElement.scrollWidth") <= width
    assert {url.partition(":")[0] for url in asked} <= {"file", "data"}
    folder = PAGE.parent / "live"
    files = [PAGE, PAGE.with_name("report.css"), *folder.iterdir()]
    assert sum(file.stat().st_size for file in files) < 1.5e6
