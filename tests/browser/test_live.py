"""The live page of the report, opened from the disk: what it runs and what it shows."""

import base64
import random
import re
from types import SimpleNamespace

import numpy as np
import pytest
from helpers import LIVE_PAGE, needs_live_page

import rhec
from rhec.core._casadi import compiled, scan
from rhec.simulation import closed_loop
from rhec.simulation.columns import COLUMNS
from rhec.tracked_robot import tuning
from rhec.workbench.live.page import FAULTS, SCENES, SEEDS, SOILS

pytestmark = needs_live_page


class Live:
    """What a reader does with the page, and finds on it."""

    def __init__(self, page):
        self.page = page
        page.goto(LIVE_PAGE.as_uri())
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
        return self.page.locator("#sliders input[type=range]")

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
            "[...document.querySelectorAll('#pictures canvas')].map(canvas => canvas.toDataURL())"
        )

    def runs(self):
        """Line of Python, log, input, soil and metrics of each run."""
        found = self.page.evaluate(RUNS)
        for run in found:
            for name in ("rows", "noise", "slip"):
                run[name] = np.frombuffer(base64.b64decode(run[name]))
            run["rows"] = run["rows"].reshape(-1, len(COLUMNS))
            run["noise"] = run["noise"].reshape(len(run["rows"]), -1)
        return found

    def choose_at_random(self, scene, chance):
        """Take a seed, a soil, a noise and a fault at random, and move half of the sliders."""
        self.choose(
            seed=str(chance.choice(SEEDS)),
            soil=chance.choice([*SOILS]),
            noise=chance.choice(["printed", "calibrated"]),
        )
        if scene == "faults":
            self.choose(fault=chance.choice([*FAULTS]))
        if chance.random() < 0.5:
            self.page.click("#patch")
        for slider in self.sliders().all():
            if slider.is_enabled() and chance.random() < 0.5:
                self.move(slider, chance.random())
        self.settled()


RUNS = """() => {
    const bytes = array => {
        let text = ""
        for (const byte of new Uint8Array(array.slice().buffer)) text += String.fromCharCode(byte)
        return btoa(text)
    }
    const lines = document.getElementById("line").textContent.split("\\n")
    return page.loops.map((loop, i) => {
        const { samples, data, metrics } = loop
        const { noise, n_fault, columns: { length: wide } } = page.world
        const width = noise.n + (data.faulty ? n_fault : 0)
        return {
            line: lines[i],
            rows: bytes(loop.at_row.subarray(0, samples * wide)),
            noise: bytes(loop.at_noise.subarray(0, samples * width)),
            slip: bytes(page.soil.slip),
            origin_m: page.soil.origin_m,
            metrics: Object.fromEntries(Object.entries(metrics).map(([of, x]) => [of, String(x)])),
        }
    })
}"""


def scenario_of(line):
    """The Scenario in a line of Python that simulates it."""
    names = dict(simulate=lambda scenario: scenario, Scenario=rhec.Scenario, Fault=rhec.Fault)
    return eval(line, dict(rhec=SimpleNamespace(**names)))


def same_run_in_python(run):
    """The Run of the page's scenario with the page's noise and soil."""
    scenario = scenario_of(run["line"])
    setup = closed_loop.set_up(scenario)
    settings = setup.settings | dict(slip=run["slip"], origin_m=np.array(run["origin_m"]))
    functions = compiled.load(closed_loop.build_sample, *setup.structure)
    _, rows = scan.scan(functions, setup.memory, run["noise"], settings)
    return closed_loop.finish(scenario, setup, rows)


@pytest.fixture
def live(page):
    return Live(page)


@pytest.mark.parametrize("scene", SCENES)
def test_given_its_noise_and_soil_a_run_equals_python(live, scene):
    """Five scenarios of each scene, with all that can be moved at random."""
    live.choose(scene=scene)
    chance = random.Random(scene)
    for _ in range(5):
        live.choose_at_random(scene, chance)
        for run in live.runs():
            native = same_run_in_python(run)
            expected = np.column_stack([native.columns[name] for name in COLUMNS]).astype(float)
            np.testing.assert_allclose(
                run["rows"], expected, rtol=1e-9, atol=1e-9, err_msg=run["line"]
            )
            for name, value in run["metrics"].items():
                value = float(value)
                np.testing.assert_allclose(value, native.metrics[name], rtol=1e-9, err_msg=name)


@pytest.mark.parametrize("scene", SCENES)
def test_the_line_of_python_drives_within_millimetres_of_the_page(live, scene):
    """Apart from the failing sensors, where a robot that is lost may lose itself elsewhere."""
    live.choose(scene=scene)
    for run in live.runs():
        native = rhec.simulate(scenario_of(run["line"]))
        before_the_fault = slice(None, 195 if scene == "faults" else None)
        for column in ("x_m", "y_m"):
            found = run["rows"][before_the_fault, COLUMNS.index(column)]
            expected = native.columns[column][before_the_fault]
            np.testing.assert_allclose(found, expected, atol=5e-3)


@pytest.mark.parametrize("scene", SCENES)
def test_every_picture_has_lines_in_every_scene(live, scene):
    """More than a grid: the colours of the runs."""
    live.choose(scene=scene)
    inks = live.page.evaluate(
        """() => [...document.querySelectorAll("#pictures canvas")].map(canvas => {
            const probe = document.createElement("canvas").getContext("2d")
            const colours = ["--run0", "--run1", "--run2"].map(name => {
                probe.fillStyle = getComputedStyle(canvas).getPropertyValue(name)
                probe.fillRect(0, 0, 1, 1)
                return probe.getImageData(0, 0, 1, 1).data
            })
            const near = (data, i) => data[i + 3] > 60 && colours.some(colour =>
                [0, 1, 2].every(j => Math.abs(data[i + j] - colour[j]) < 40))
            const { data } = canvas.getContext("2d")
                .getImageData(0, 0, canvas.width, canvas.height)
            let found = 0
            for (let i = 0; i < data.length; i += 4)
                found += near(data, i)
            return found
        })"""
    )
    assert len(inks) == 6 and min(inks) > 20, inks


def test_sliders_of_w_show_the_w_in_use(live):
    """Printed, calibrated, of the EKF; touched, they go on from what they show."""
    live.choose(scene="b", noise="printed")

    def shown():
        return live.page.locator("#sliders input[data-field=sigma_w] + output").all_inner_texts()

    assert shown() == [f"{value:.3g}" for value in tuning.SIGMA_W["rhe"]["printed"]]
    live.page.locator("[name=run-b][value='1']").check()
    live.settled()
    assert shown() == [f"{value:.3g}" for value in tuning.SIGMA_W["ekf"]["printed"]] + ["–", "–"]
    live.page.locator("[name=run-b][value='0']").check()
    live.settled()
    live.move(live.page.locator("#sliders [data-field=sigma_w][data-place='5']"), 0.5)
    live.settled()
    assert live.page.locator("#noise").input_value() == "own"
    assert shown()[:5] == [f"{value:.3g}" for value in tuning.SIGMA_W["rhe"]["printed"][:5]]


def test_sliders_of_the_last_wet_patch_need_one(live):
    sliders = live.page.locator("#sliders input[data-field=patch]")
    assert not any(slider.is_enabled() for slider in sliders.all())
    live.page.click("#patch")
    live.settled()
    assert all(slider.is_enabled() for slider in sliders.all())
    live.page.click("#dry")
    live.settled()
    assert not any(slider.is_enabled() for slider in sliders.all())


def test_the_scene_of_faults_opens_while_the_fault_lasts(live):
    live.choose(scene="faults")
    (fault,) = scenario_of(live.runs()[0]["line"]).faults
    time_s = float(live.page.inner_text("#time").removesuffix(" s"))
    assert fault.kind == "dead" and fault.start_s < time_s < fault.end_s
    without, robust = (run["metrics"]["mean_error_true_m"] for run in live.runs())
    assert float(without) > 2 * float(robust)


@pytest.mark.parametrize("width, height", [(1400, 900), (390, 844)])
def test_pictures_are_in_view_while_a_slider_moves(live, width, height):
    live.page.set_viewport_size({"width": width, "height": height})
    last = live.page.locator("#sliders details[open] input[type=range]").last
    last.evaluate("slider => slider.scrollIntoView({block: 'end', behavior: 'instant'})")
    box = live.page.locator("#map").bounding_box()
    assert box["y"] >= -1 and box["y"] + box["height"] <= height
    assert box["height"] > 80 and last.bounding_box()["y"] < height


@pytest.mark.parametrize("scene", SCENES)
def test_each_control_changes_what_is_shown(live, scene):
    """Sliders, lists, and the button for a wet patch."""
    live.choose(scene=scene)
    if scene == "faults":
        live.choose(fault=[*FAULTS][3])
    live.page.click("#patch")
    lists = dict(seed="3", soil="soft", noise="printed")
    if scene in "ab":
        lists["window"] = "5"
    if scene == "faults":
        lists["fault"] = [*FAULTS][1]
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
    first = live.page.locator("#sliders [data-field=q]").first
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
    sizes = {file.name: file.stat().st_size for file in (LIVE_PAGE.parent / "live").iterdir()}
    modules = sum(size for name, size in sizes.items() if not name.startswith("seed_"))
    assert modules < 1.1e6 and sizes["seed_0.js"] < 0.2e6 and sum(sizes.values()) < 2.8e6
