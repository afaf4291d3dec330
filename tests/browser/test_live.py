"""The live page of the report, opened from the disk: its runs are Python's, and it keeps what the
reader chose.
"""

import base64
import random
from types import SimpleNamespace

import numpy as np
import pytest
from helpers import LIVE_PAGE, needs_live_page, wait_until

import rhec
from docs.live.page import FAULTS, SCENES, TURNS
from rhec import paper
from rhec.core import runner
from rhec.core._casadi import compiled
from rhec.explorer.controls import RULES
from rhec.simulation import closed_loop
from rhec.simulation.columns import COLUMNS, MEASUREMENTS
from rhec.simulation.parts import parts_of
from rhec.tracked_robot import tuning

pytestmark = needs_live_page

# What a reader does to answer the question of each step of the story.
ANSWERS = dict(
    encoders=("time", "18"),
    filter=("soil", "default"),
    window=("arrival", False),
    kalman=("bounds", False),
    row=("time", "61"),
    noise=("sigma", "-1.9958"),  # the power of ten
)
HELD_BY_A_BOUND_S = 65.0
BYTES = """array => {
    let text = ""
    for (const byte of new Uint8Array(array.slice().buffer)) text += String.fromCharCode(byte)
    return btoa(text)
}"""
PICTURES = "[...document.querySelectorAll('#pictures canvas')].map(c => c.toDataURL())"
RUNS = """() => {
    const bytes = BYTES
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
            soil_shape: page.world.soil_shape,
            metrics: Object.fromEntries(Object.entries(metrics).map(([of, x]) => [of, String(x)])),
        }
    })
}""".replace("BYTES", BYTES)
# Step 3 at a sample, and the estimates of step 4.
STORY = """k => {
    const bytes = BYTES
    const { loop, tools } = story.steps.window
    const { bounded, free } = take_sample(loop, tools, k, true)
    const piece = name => bytes(Float64Array.from(piece_of(tools, bounded.memory, name).flat()))
    const both = compare(story.steps.kalman.loop, tools, false)
    return {
        rows: bytes(loop.at_row.subarray(0, loop.samples * page.world.columns.length)),
        s: piece("s"), v: piece("v"), m: piece("m"), P: piece("P"),
        bounded: [...bounded.estimate],
        free: [...free.estimate],
        costs: costs_of(tools, bounded.memory, noises(loop).V),
        shortest: both.map(([one]) => one),
        kalman: both.map(([, other]) => other),
    }
}""".replace("BYTES", BYTES)


class Live:
    """What a reader does with the page, and finds on it."""

    def __init__(self, page):
        self.page = page

    def open(self, address=""):
        self.page.goto("about:blank")
        self.page.goto(LIVE_PAGE.as_uri() + address)
        self.settled()
        return self

    def settled(self):
        """Wait until the story and the sandbox have drawn all that was asked for."""
        done = "Object.keys(story.steps).length && page.busy && !asked && !story.wanted.size"
        wait_until(self.page, done)
        self.page.evaluate("Promise.all([story.busy, page.busy])")
        assert " runs of " in self.page.inner_text("#said"), self.page.inner_text("#said")

    def answer(self, step):
        return self.page.inner_text(f"#step-{step} .answer")

    def set(self, step, name, value):
        control = self.page.locator(f"#step-{step} [name={name}]")
        if isinstance(value, bool):
            control.set_checked(value)
        elif name == "soil":
            control.select_option(value)
        else:
            control.fill(value)
        self.settled()

    def change_at_random(self, chance):
        """Take other soil, seed, turns, rule and fault, add a patch, and move half of the sliders.

        A slider of noise that moves makes the noise the reader's own.
        """
        page = self.page
        page.select_option("#seed", "7")
        page.select_option("#soil", "soft")
        page.select_option("#turns", chance.choice([*TURNS.values()]))
        page.select_option("#noise", chance.choice(RULES))
        if page.is_visible("#fault"):
            page.select_option("#fault", [*FAULTS][3])
        page.click("#patch")
        self.settled()
        for slider in page.locator("#sliders input[type=range]:enabled").all():
            if chance.random() < 0.5:
                low, high = (float(slider.get_attribute(name)) for name in ("min", "max"))
                move = "(input, value) => { input.value = value }"
                slider.evaluate(move, low + chance.random() * (high - low))
                slider.dispatch_event("input")
        self.settled()

    def runs(self):
        """Line of Python, log, input, soil and metrics of each run."""
        found = self.page.evaluate(RUNS)
        for run in found:
            for name in ("rows", "noise", "slip"):
                run[name] = floats(run[name])
            run["rows"] = run["rows"].reshape(-1, len(COLUMNS))
            run["noise"] = run["noise"].reshape(len(run["rows"]), -1)
        return found


def floats(text):
    """The array behind a text."""
    return np.frombuffer(base64.b64decode(text))


def scenario_of(line):
    """The Scenario in a line of Python that simulates it."""
    names = dict(simulate=lambda scenario: scenario, Scenario=rhec.Scenario, Fault=rhec.Fault)
    return eval(line, dict(rhec=SimpleNamespace(**names)))


def same_run_in_python(run):
    """The Run of the page's scenario with the page's noise and soil."""
    scenario = scenario_of(run["line"])
    setup = closed_loop.set_up(scenario)
    settings = setup.settings | dict(slip=run["slip"], origin_m=np.array(run["origin_m"]))
    # The page's grid has room for the soil of every path.
    world = closed_loop.world_of(scenario)._replace(soil_shape=tuple(run["soil_shape"]))
    loop = tuple(part.block for part in parts_of(scenario, world))
    functions = compiled.load(closed_loop.build_sample, loop, tuple(settings))
    rows = runner.run_one(functions, setup.memory, run["noise"], settings)
    return closed_loop.finished(scenario, setup, rows)


@pytest.fixture
def live(page):
    return Live(page)


def test_the_page_opens_offline_is_light_and_fits_a_phone(live):
    page = live.page
    asked, said = [], []
    page.context.set_offline(True)
    page.on("request", lambda request: asked.append(request.url))
    page.on("console", lambda message: said.append(message.text))
    for scene in SCENES:
        live.open(f"#{scene}")
        for width in (1366, 390):
            page.set_viewport_size({"width": width, "height": 844})
            assert page.evaluate("document.documentElement.scrollWidth") <= width
    assert said == []
    assert {url.partition(":")[0] for url in asked} <= {"about", "data", "file"}
    sizes = {file.name: file.stat().st_size for file in (LIVE_PAGE.parent / "live").iterdir()}
    modules = sum(size for name, size in sizes.items() if not name.startswith("seed_"))
    assert modules < 1e6 and sizes["seed_0.js"] < 0.2e6 and sum(sizes.values()) < 2.9e6


def test_a_slider_changes_the_run_and_the_page_says_what_came_of_it(live):
    page = live.open().page

    def shown():
        label = page.get_attribute("#error", "aria-label")
        return [*page.evaluate(PICTURES), page.inner_text("#line"), label]

    before = shown()
    page.locator("#sliders [data-field=q]").first.focus()
    for _ in range(5):
        page.keyboard.press("ArrowRight")
    live.settled()
    assert all(now != then for now, then in zip(shown(), before))


def test_a_pointer_shows_values_zooms_and_a_click_hides_a_run(live):
    page = live.open("#b").page
    (rows, _) = (run["rows"] for run in live.runs())
    box = page.locator("#error").bounding_box()
    place = box["x"] + box["width"] / 2, box["y"] + box["height"] / 2
    page.mouse.move(*place)
    words = page.locator(".view-words:visible").all_inner_texts()
    assert len(words) == 5  # all but the robot's own picture
    (time_s,) = {text.split(" s", 1)[0] for text in words if " s · " in text}
    x_m = rows[round(float(time_s) / paper.DT_S)][COLUMNS.index("x_m")]
    assert f"RHE {float(f'{x_m:.3g}'):g}, " in words[0]
    whole = page.evaluate(PICTURES)
    page.keyboard.down("Control")
    page.mouse.wheel(0, -200)
    live.settled()
    zoomed = page.evaluate(PICTURES)
    same = [now == then for now, then in zip(zoomed, whole)]
    assert same == [True, True, False, False, False, False]
    page.mouse.wheel(0, 600)
    page.keyboard.up("Control")
    live.settled()
    assert page.evaluate(PICTURES) == whole
    page.locator("#metrics button", has_text="EKF").click()
    live.settled()
    page.mouse.move(*place)
    assert "EKF" not in " ".join(page.locator(".view-words:visible").all_inner_texts())


@pytest.mark.nightly(keep=1)
@pytest.mark.parametrize("scene", SCENES)
def test_given_its_noise_and_soil_a_run_equals_python(live, scene):
    live.open(f"#{scene}").change_at_random(random.Random(scene))
    for run in live.runs():
        native = same_run_in_python(run)
        expected = np.column_stack([native.columns[name] for name in COLUMNS]).astype(float)
        np.testing.assert_allclose(run["rows"], expected, rtol=1e-9, atol=1e-9, err_msg=run["line"])
        for name, value in run["metrics"].items():
            # Some 20 µm from where a bend begins, Python counts a sample as of the row.
            sample = 1 if name.startswith("violations") else 0
            np.testing.assert_allclose(
                float(value), native.metrics[name], rtol=1e-9, atol=sample, err_msg=name
            )


@pytest.mark.nightly(keep=1)
@pytest.mark.parametrize("rule, turns", list(zip(RULES, TURNS.values())))
def test_the_line_of_python_names_the_rule_and_the_turns_and_drives_by_them(live, rule, turns):
    page = live.open("#b").page
    for run in live.runs():
        native = rhec.simulate(scenario_of(run["line"]))
        for name in ("x_m", "y_m"):
            found = run["rows"][:, COLUMNS.index(name)]
            np.testing.assert_allclose(found, native.columns[name], atol=5e-3)
    page.select_option("#noise", rule)
    page.select_option("#turns", turns)
    live.settled()
    for run in live.runs():
        scenario = scenario_of(run["line"])
        assert (tuning.process_noise_of(scenario), scenario.turns) == (rule, turns)
        assert scenario.sigma_w is scenario.sigma_v is None
        native = rhec.simulate(scenario)
        found = run["rows"][:50, COLUMNS.index("y_m")]
        np.testing.assert_allclose(found, native.columns["y_m"][:50], atol=5e-3)
    for name, values in tuning.NOISES["rhe"][rule]._asdict().items():
        shown = page.locator(f"#sliders [data-field={name}] + output").all_inner_texts()
        np.testing.assert_allclose([*map(float, shown)], values, rtol=0.01)
    # The map shows the whole path, and fills the map one way or the other.
    path = rhec.Path.rows(paper.ROW_LENGTH_M, paper.HEADLAND_RADIUS_M, turns)
    x_min, x_max, y_min, y_max = map(float, path.box)
    place = "corners => corners.map(([x, y]) => [page.map.x(x), page.map.y(y)])"
    (left, bottom), (right, top) = page.evaluate(place, [[x_min, y_min], [x_max, y_max]])
    wide, high = page.evaluate("[$('map').clientWidth, $('map').clientHeight]")
    assert 0 < left < right < wide and 0 < top < bottom < high
    assert right - left > 0.6 * wide or bottom - top > 0.6 * high


def test_an_address_names_a_scene_or_a_step(live):
    page = live.open("#faults").page
    assert page.evaluate("page.scene") == "faults" and page.locator("#sandbox").is_visible()
    live.open("#step-row")
    assert page.evaluate("page.scene") == "a"
    assert page.evaluate("document.getElementById('step-row').getBoundingClientRect().y") < 400
    page.evaluate("location.hash = 'b'")
    live.settled()
    assert page.evaluate("page.scene") == "b"


# The story


@pytest.mark.nightly(keep=1)
@pytest.mark.parametrize("step", ANSWERS)
def test_a_question_is_open_until_the_reader_answers_it(live, step):
    assert live.open().answer(step).startswith("Not yet")
    live.set(step, *ANSWERS[step])
    assert live.answer(step).startswith("✓"), live.answer(step)


def test_window_costs_and_filter_of_the_story_are_those_of_python(live):
    """The public RHE and EKF on the page's measurements, and the cost of a fit by matrices."""
    last = round(HELD_BY_A_BOUND_S / paper.DT_S)
    seen = live.open().page.evaluate(STORY, last)
    rows = floats(seen["rows"]).reshape(-1, len(COLUMNS))
    z = rows[:, [COLUMNS.index(name) for name in MEASUREMENTS]]
    guess = (0.0, paper.START_OFFSET_M, 0.0, paper.SPEED_MPS, 1.0, 1.0)
    mhe = rhec.RHE(process_noise="prediction", guess=guess)
    noise = tuning.NOISES["rhe"]["prediction"]
    ekf = rhec.EKF(
        model=mhe.model,
        dt=paper.DT_S,
        **noise._asdict(),
        guess=guess,
        sigma_guess=paper.SIGMA_W_RHE,
    )
    for k, z_N in enumerate(z):
        estimate = ekf.feedback(z_N)
        np.testing.assert_allclose(seen["kalman"][k], [*estimate.x, *estimate.p], atol=1e-6)
    apart = np.subtract(seen["shortest"], seen["kalman"])[25:, :2]
    # With W by prediction a window of one interval is nearly the filter; it is linearised anew.
    assert 1e-6 < np.linalg.norm(apart, axis=1).max() < 1e-3
    for z_N in z[: last + 1]:
        mhe.prepare()
        estimate = mhe.feedback(z_N)
    s, v, m, P = (floats(seen[name]).reshape(-1, n) for name, n in dict(s=6, v=1, m=6, P=6).items())
    np.testing.assert_allclose(s[:, :3], mhe.x_window.T, atol=1e-6)
    np.testing.assert_allclose(v, mhe.u_window.T, atol=1e-6)
    np.testing.assert_allclose(seen["bounded"], estimate[:6], atol=1e-6)
    assert estimate.kappa == 1 and seen["free"][5] > 1.02
    window = z[last - 15 : last + 1]
    fitted = np.column_stack([s[:, :2], s[:, 3], np.append(window[0, 3], v)])
    half = (window - fitted) ** 2 / np.square(noise.sigma_v) / 2
    nodes = np.column_stack([half[:, 0] + half[:, 1], half[:, 2], half[:, 3]])
    np.testing.assert_allclose(seen["costs"]["nodes"], nodes, atol=1e-9)
    gap = s[0] - m[0]
    np.testing.assert_allclose(seen["costs"]["arrival"], gap @ np.linalg.inv(P) @ gap / 2, 1e-6)
