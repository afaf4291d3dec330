"""The live page of the report, opened from the disk: its runs are Python's, its pictures show them,
and it keeps what the reader chose.
"""

import base64
import random
from types import SimpleNamespace

import numpy as np
import pytest
from helpers import LIVE_PAGE, needs_live_page, wait_until

import rhec
from docs.live.page import FAULTS, SCENES, STORY, TURNS
from docs.live.plants import plants_of
from rhec import paper
from rhec.core import runner
from rhec.core._casadi import compiled
from rhec.explorer.controls import NEW_PATCH, RULES
from rhec.explorer.explorer import METRICS
from rhec.simulation import closed_loop
from rhec.simulation.columns import COLUMNS, ESTIMATE, MEASUREMENTS, POSE
from rhec.simulation.parts import parts_of
from rhec.tracked_robot import plant, tuning

pytestmark = needs_live_page

GUESS = (0.0, paper.START_OFFSET_M, 0.0, paper.SPEED_MPS, 1.0, 1.0)
PATH = rhec.Path.rows(paper.ROW_LENGTH_M, paper.HEADLAND_RADIUS_M)
PLANTS = plants_of(PATH).round(3)

# What the page computed, as text, and what its pictures show, noted while they are drawn.
PREPARE = """() => {
    window.bytes = array => {
        let text = ""
        for (const byte of new Uint8Array(array.slice().buffer)) text += String.fromCharCode(byte)
        return btoa(text)
    }
    window.marks = {}
    const reset = CanvasRenderingContext2D.prototype.reset
    CanvasRenderingContext2D.prototype.reset = function () {
        marks[this.canvas.id] = { all: [] }
        reset.call(this)
    }
    for (const kind of ["line", "area", "dots"]) {
        const draw = Plot.prototype[kind]
        Plot.prototype[kind] = function (n, x, y, colour, look = {}) {
            const points = Float64Array.from({ length: 2 * n }, (_, i) => (i % 2 ? y : x)(i >> 1))
            const [left, top, right, bottom] = this.box
            const picture = marks[this.c.canvas.id]
            picture.limits = [[left, bottom], [right, top]].map(
                ([offsetX, offsetY]) => this.data({ offsetX, offsetY }))
            picture.all.push({ kind, colour, points, label: look.label ?? "" })
            draw.call(this, n, x, y, colour, look)
        }
    }
}"""
# Each picture has the size of its place.
DRAWN = "[...document.querySelectorAll('canvas')].every(c => c.width === c.clientWidth)"
PICTURES = "[...document.querySelectorAll('#pictures canvas')].map(c => c.toDataURL())"
MARKS = """() => Object.fromEntries(Object.entries(marks).map(([canvas, { all, limits }]) =>
    [canvas, { limits, all: all.map(mark => ({ ...mark, points: bytes(mark.points) })) }]))"""
# The logs, inputs, soils and metrics of the runs, and of a step of the story.
RUNS = """() => {
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
}"""
STEP = """id => {
    const { loop } = story.steps[id]
    const sigma = name => bytes(Float64Array.from({ length: loop.samples }, (_, k) =>
        loop.sigma(name)?.(k) ?? NaN))
    return {
        rows: bytes(loop.at_row.subarray(0, loop.samples * page.world.columns.length)),
        sigma_theta: sigma("theta_rad"), sigma_kappa: sigma("kappa"),
    }
}"""


class Live:
    """What a reader does with the page, and finds on it."""

    def __init__(self, page):
        self.page = page

    def open(self, address=""):
        self.page.goto(LIVE_PAGE.as_uri() + address)
        self.settled()
        self.page.evaluate(PREPARE)
        return self

    def settled(self):
        """Wait until the story and the sandbox have drawn all that was asked for."""
        done = "Object.keys(story.steps).length && page.busy && !asked && !story.wanted.size"
        wait_until(self.page, done)
        self.page.evaluate("Promise.all([story.busy, page.busy])")
        assert " runs of " in self.page.inner_text("#said"), self.page.inner_text("#said")

    def scene(self, name):
        """A scene as it begins."""
        self.page.click("button[type=reset]")
        self.page.check(f"[name=scene][value={name}]")
        self.settled()
        return self

    def move(self, slider, value):
        """Move a slider, which then says so."""
        slider.evaluate("(input, value) => { input.value = value }", value)
        slider.dispatch_event("input")

    def answer(self, step):
        return self.page.inner_text(f"#step-{step} .answer")

    def set(self, step, name, value):
        control = self.page.locator(f"#step-{step} [name={name}]")
        if isinstance(value, bool):
            control.set_checked(value)
        elif name == "soil":
            control.select_option(value)
        else:
            self.move(control, value)
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
        else:
            page.select_option("#window", "5 intervals")
        page.click("#patch")
        self.settled()
        for slider in page.locator("#sliders input[type=range]:enabled").all():
            if chance.random() < 0.5:
                low, high = (float(slider.get_attribute(name)) for name in ("min", "max"))
                self.move(slider, low + chance.random() * (high - low))
        self.settled()

    def step(self, name):
        """Columns of the log of a step of the story, and its standard deviations."""
        seen = self.page.evaluate(STEP, name)
        c = dict(zip(COLUMNS, floats(seen["rows"]).reshape(-1, len(COLUMNS)).T))
        c |= dict(xy=np.column_stack([c["x_m"], c["y_m"]]))
        c |= dict(time=paper.DT_S * np.arange(len(c["x_m"])))
        return c | {of: floats(seen[of]) for of in ("sigma_theta", "sigma_kappa")}

    def runs(self):
        """Line of Python, log, input, soil and metrics of each run."""
        found = self.page.evaluate(RUNS)
        for run in found:
            for name in ("rows", "noise", "slip"):
                run[name] = floats(run[name])
            run["rows"] = run["rows"].reshape(-1, len(COLUMNS))
            run["noise"] = run["noise"].reshape(len(run["rows"]), -1)
        return found

    def marks(self):
        """{canvas: what it shows}."""
        return {canvas: Marks(**marks) for canvas, marks in self.page.evaluate(MARKS).items()}


class Marks:
    """What a picture shows, in the units of its axes, and where these begin and end."""

    def __init__(self, all, limits):
        names = ("kind", "colour", "label")
        self.all = [([mark[name] for name in names], floats(mark["points"])) for mark in all]
        self.low, self.high = np.array(limits)

    def has_room_for(self, points):
        return ((self.low - 1e-9 <= points) & (points <= self.high + 1e-9)).all()

    def of(self, kind, colour, label=""):
        """The points (n, 2) of each mark of this kind, colour and label."""
        return [points.reshape(-1, 2) for what, points in self.all if what == [kind, colour, label]]


def seen_from(pose):
    """A function from places (n, 2) to what is ahead and to the left of a pose (x, y, θ)."""
    x, y, theta = pose
    turn = np.array([[np.cos(theta), -np.sin(theta)], [np.sin(theta), np.cos(theta)]])
    return lambda places: (np.asarray(places)[..., :2] - [x, y]) @ turn


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


@pytest.fixture(scope="module")
def opened(open_page):
    """The page, opened once, and what it asked for and said on the console."""
    with open_page() as page:
        asked, said = [], []
        page.context.set_offline(True)
        page.on("request", lambda request: asked.append(request.url))
        page.on("console", lambda message: said.append(message.text))
        yield Live(page).open("#faults"), asked, said


@pytest.fixture
def live(opened):
    return opened[0]


def test_it_opens_offline_at_the_scene_of_an_address_is_light_and_fits_a_phone(opened):
    live, asked, said = opened
    page = live.page
    assert page.evaluate("page.scene") == "faults"
    assert page.locator("#sandbox").bounding_box()["y"] < 200
    for scene in SCENES:
        page.evaluate("scene => { location.hash = scene }", scene)
        live.settled()
        assert page.evaluate("page.scene") == scene
        assert page.locator("section[data-scene]:visible").all_inner_texts() == (
            page.locator(f"section[data-scene={scene}]").all_inner_texts()
        )
        assert page.is_visible("#fault") == page.is_disabled("#window") == (scene == "faults")
        for width in (1366, 390, 1366):
            page.set_viewport_size({"width": width, "height": 768})
            assert page.evaluate("document.documentElement.scrollWidth") <= width
            wait_until(page, DRAWN, patience_s=30)
        (*_, shade) = live.marks()["error"].of("area", "--measured") or [None]
        assert (shade is not None) == (scene == "faults")
    assert {*shade[:, 0]} == {40, 50}  # when positions are 2 m off
    assert said == []
    assert {url.partition(":")[0] for url in asked} <= {"about", "data", "file"}
    sizes = {file.name: file.stat().st_size for file in (LIVE_PAGE.parent / "live").iterdir()}
    modules = sum(size for name, size in sizes.items() if not name.startswith("seed_"))
    assert modules < 1e6 and sizes["seed_0.js"] < 0.2e6 and sum(sizes.values()) < 2.9e6


@pytest.mark.nightly(keep=1)
@pytest.mark.parametrize("scene", SCENES)
def test_given_its_noise_and_soil_a_run_equals_python(live, scene):
    page = live.scene(scene).page
    before = page.evaluate(PICTURES)
    live.change_at_random(random.Random(scene))
    assert not {*before} & {*page.evaluate(PICTURES)}
    assert_sliders_show(page, scenario_of(live.runs()[0]["line"]))
    rows = page.locator("#metrics tr:has(td)").all()
    for run, row in zip(live.runs(), rows, strict=True):
        native = same_run_in_python(run)
        expected = np.column_stack([native.columns[name] for name in COLUMNS]).astype(float)
        np.testing.assert_allclose(run["rows"], expected, rtol=1e-9, atol=1e-9, err_msg=run["line"])
        for name, value in run["metrics"].items():
            # Some 20 µm from where a bend begins, Python counts a sample as of the row.
            sample = 1 if name.startswith("violations") else 0
            np.testing.assert_allclose(
                float(value), native.metrics[name], rtol=1e-9, atol=sample, err_msg=name
            )
        values = [(float(run["metrics"][name]), digits) for name, _, _, digits in METRICS]
        cells = [f"{x:.{digits}f}" if np.isfinite(x) else "never" for x, digits in values]
        assert row.locator("td").all_inner_texts() == cells
        error = f"largest true error {float(run['metrics']['max_error_true_m']):.2f} m"
        assert f"{row.locator('button').inner_text()[2:]}: {error}" in page.get_attribute(
            "#error", "aria-label"
        )


def assert_sliders_show(page, scenario):
    """What the followed run has: its own values, those of the page, and the last patch."""
    read = (
        "all => all.map(each => [each.dataset.field, each.dataset.place, each.nextSibling.value])"
    )
    shown = page.eval_on_selector_all("#sliders input:enabled[data-field]", read)
    assert len(shown) > 20
    for field, place, text in shown:
        values = scenario.patches[-1] if field == "patch" else getattr(scenario, field)
        assert float(text) == pytest.approx(np.ravel(values)[int(place or 0)], rel=0.01)


@pytest.mark.nightly(keep=1)
@pytest.mark.parametrize("rule, turns", list(zip(RULES, TURNS.values())))
def test_the_line_of_python_names_the_rule_and_the_turns_and_drives_by_them(live, rule, turns):
    page = live.scene("b").page
    for run in live.runs():
        native = rhec.simulate(scenario_of(run["line"]))
        for name in ("x_m", "y_m"):
            found = run["rows"][:, COLUMNS.index(name)]
            np.testing.assert_allclose(found, native.columns[name], atol=5e-3)
        noise = plant.draw_noise(native.scenario.seed, len(run["noise"]))
        np.testing.assert_allclose(run["noise"], noise, atol=8 / 2**15 / 2)
        settled_s = float(run["metrics"]["settling_time_s"])
        assert settled_s == pytest.approx(native.metrics["settling_time_s"], abs=0.2)
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
    for followed, estimator in enumerate(("rhe", "ekf")):
        page.check(f"[name=run-b][value='{followed}']")
        for name, values in tuning.NOISES[estimator][rule]._asdict().items():
            shown = page.locator(f"#sliders [data-field={name}] + output").all_inner_texts()
            np.testing.assert_allclose([float(x) for x in shown if x != "–"], values, rtol=0.01)
    # The map shows the whole path, and fills the map one way or the other.
    path = rhec.Path.rows(paper.ROW_LENGTH_M, paper.HEADLAND_RADIUS_M, turns)
    x_min, x_max, y_min, y_max = map(float, path.box)
    place = "corners => corners.map(([x, y]) => [page.map.x(x), page.map.y(y)])"
    (left, bottom), (right, top) = page.evaluate(place, [[x_min, y_min], [x_max, y_max]])
    wide, high = page.evaluate("[$('map').clientWidth, $('map').clientHeight]")
    assert 0 < left < right < wide and 0 < top < bottom < high
    assert right - left > 0.6 * wide or bottom - top > 0.6 * high


# Pictures

NEAR_M = 0.015  # the page takes the path as a line with steps of half a metre
MOMENTS = (8, 330)  # while the robot comes to its row and the window fills; and in a turn


@pytest.fixture(scope="module")
def shown(opened):
    """Two runs, and what the pictures show of them at each of MOMENTS; the RHE is followed."""
    live = opened[0].scene("b")
    marks = {}
    for k in MOMENTS:
        live.move(live.page.locator("#moment"), (k + 0.5) / 1200)
        live.settled()
        marks[k] = live.marks()
    touched = int(live.page.inner_text("#touched"))
    runs = [dict(zip(COLUMNS, run["rows"].T)) for run in live.runs()]
    for run in runs:
        run["xy"] = np.column_stack([run["x_m"], run["y_m"]])
    P = covariances(runs[0], process_noise=tuning.DEFAULT_RULE)
    touches = live.page.evaluate("[...touches_of(page.loops[0])]")
    return SimpleNamespace(runs=runs, marks=marks, touched=touched, touches=touches, P=P)


def covariances(c, **noise):
    """Of the public RHE on the measurements of a log, by sample."""
    rhe = rhec.RHE(**noise, guess=GUESS)
    found = []
    for z_N in np.column_stack([c[name] for name in MEASUREMENTS]):
        rhe.prepare()
        found.append(rhe.feedback(z_N).covariance)
    return np.array(found)


def test_pictures_show_the_columns_of_the_runs(shown):
    k = MOMENTS[-1]
    marks = shown.marks[k]
    time = paper.DT_S * np.arange(1200)
    lines = dict(omega="omega_cmd_radps", mu="mu_hat", kappa="kappa_hat")
    for run, name, colour in zip(shown.runs, ("RHE", "EKF"), ("--run0", "--run1")):
        error, _ = PATH.project(run["xy"])
        expected = {of: (time, run[column]) for of, column in lines.items()}
        expected |= dict(error=(time, error), map=run["xy"].T)
        for picture, line in expected.items():
            (found,) = marks[picture].of("line", colour, name)
            np.testing.assert_allclose(found, np.column_stack(line), atol=1e-9, err_msg=picture)
            assert marks[picture].has_room_for(found[200:])  # not for how far off it begins
        for of in ("mu", "kappa"):
            (found,) = marks[of].of("line", "--ink", f"truth of {name}")
            np.testing.assert_array_equal(found, np.column_stack([time, run[of]]))
        (outline,) = marks["map"].of("area", colour)
        assert_outline(seen_from([run[of][k] for of in POSE])(outline))
    for i, name in ((4, "mu"), (5, "kappa")):
        (band,) = marks[name].of("area", "--run0")
        up = shown.runs[0][f"{name}_hat"] + 2 * np.sqrt(shown.P[:, i, i])
        np.testing.assert_allclose(band[:1200], np.column_stack([time, up]), atol=1e-6)
        middle = (band[:1200] + band[:1199:-1]) / 2
        np.testing.assert_allclose(middle[:, 1], shown.runs[0][f"{name}_hat"], atol=1e-9)
    for name in ("error", "omega", "mu", "kappa"):
        assert (marks[name].low[0], marks[name].high[0]) == pytest.approx((0, 240))
    assert marks["error"].low[1] == 0 and marks["kappa"].high[1] == marks["mu"].high[1] < 1.05
    assert marks["omega"].high[1] < 1.5 * paper.OMEGA_MAX_RADPS
    levels = {name: [level[0, 1] for level in marks[name].of("line", "--ink")] for name in marks}
    assert marks["omega"].of("line", "--ink")[0][:, 0] == pytest.approx((0, 240))
    assert levels["error"] == [paper.TOLERANCE_M]
    assert levels["omega"] == [paper.OMEGA_MAX_RADPS, -paper.OMEGA_MAX_RADPS]
    for name in ("error", "omega", "mu", "kappa"):
        (now,) = marks[name].of("line", "--soft")
        np.testing.assert_allclose(now[:, 0], k * paper.DT_S)
    path, heading = marks["map"].of("line", "--ink")
    assert PATH.project(path)[0].max() < 2e-3
    np.testing.assert_allclose(heading, [(0, paper.START_OFFSET_M), (3, paper.START_OFFSET_M)])


def assert_outline(corners, width=paper.ROBOT_WIDTH_M, left=0.0):
    """Corners of a box as long as the robot, ahead along x, moved to the left."""
    half = paper.ROBOT_LENGTH_M / 2, width / 2
    expected = np.multiply([(1, 1), (-1, 1), (-1, -1), (1, -1)], half) + (0, left)
    np.testing.assert_allclose(corners[:4], expected, atol=NEAR_M)


def assert_ellipse(points, mean, P):
    """Two standard deviations of a Gaussian."""
    middle = points[1:].mean(axis=0)
    np.testing.assert_allclose(middle, mean, atol=NEAR_M)
    away = points - middle
    within = np.linalg.solve(P, away.T).T
    np.testing.assert_allclose(np.sum(away * within, axis=1), 4, rtol=0.02)


@pytest.mark.parametrize("k", MOMENTS)
def test_the_robot_in_its_row_is_seen_along_the_path(shown, k):
    near, c, P = shown.marks[k]["near"], shown.runs[0], shown.P[k]
    pose, estimate = ([c[name][k] for name in names] for names in (POSE, ESTIMATE))
    x, y, theta = PATH.poses([c["s_m"][k]])[0][0]
    left = seen_from([x, y, theta])(pose)[1]
    aside = left - np.clip(left, -0.25, 0.25)  # the picture moves with a robot that is far off
    eye = x - aside * np.sin(theta), y + aside * np.cos(theta), theta
    see = seen_from(eye)
    reach_m = 3.2 * paper.SPEED_MPS + 0.7
    assert (near.low + near.high == pytest.approx((0, 0))) and near.high[0] >= reach_m
    robot, estimated = (seen_from([*see(at), at[2] - theta]) for at in (pose, estimate))
    past = slice(max(k - 59, 0), k + 1)

    def is_near(found, places):
        np.testing.assert_allclose(np.concatenate(found), places, atol=NEAR_M)

    driven, *_ = near.of("line", "--soft")
    is_near([driven], see(c["xy"][past]))
    z = np.column_stack([c[name] for name in MEASUREMENTS])
    is_near(near.of("dots", "--measured"), see(z[past][-25:]))
    left_ring, right_ring, aims = near.of("dots", "--ink")
    (plan,) = near.of("line", "--plan")
    pace_m = c["mu_hat"][k] * c["nu_hat_mps"][k] * paper.DT_S
    ahead_m = rhec.Scenario().look_ahead_m + pace_m * np.arange(len(plan))
    is_near([aims], see(PATH.poses(c["s_m"][k] + ahead_m)[0]))
    is_near([plan[:1]], see([estimate[:2]]))
    # The estimate: its window, outline, ellipse and fan.
    window, outline, ellipse = near.of("line", "--run0")
    assert len(window) == min(k + 1, 16)
    is_near([window[-1:]], see([estimate[:2]]))
    assert_outline(estimated(outline))
    turn = seen_from([0, 0, theta])(np.eye(2))
    assert_ellipse(ellipse, see(estimate), turn.T @ P[:2, :2] @ turn)
    fan = estimated(near.of("area", "--run0")[0])
    np.testing.assert_allclose(np.hypot(*fan[1:].T), paper.ROBOT_LENGTH_M, atol=NEAR_M)
    yaws = np.arctan2(*fan[1:, ::-1].T)
    np.testing.assert_allclose(yaws, np.linspace(-2, 2, 5) * np.sqrt(P[2, 2]), atol=NEAR_M)
    # The robot on its tracks: what was commanded, and its way over ground in a second.
    half = paper.TRACK_WIDTH_M / 2
    corridor, outline = near.of("area", "--soft")
    assert_outline(robot(outline))
    turned = c["omega_cmd_radps"][k - 1], c["kappa"][k] * c["omega_radps"][k]
    ahead = paper.SPEED_MPS, c["mu"][k] * c["nu_mps"][k]
    boxes, slips = near.of("area", "--ink"), near.of("line", "--touched")
    for side, box, slip, ring in zip((1, -1), boxes, slips, (left_ring, right_ring)):
        assert_outline(robot(box), paper.ROBOT_WIDTH_M - paper.TRACK_WIDTH_M, side * half)
        tips = [(v - side * half * omega, side * half) for v, omega in zip(ahead, turned)]
        is_near([robot(slip)], tips)
        is_near([robot(ring)], tips[:1])
    arrows = [robot(line) for line in near.of("line", "--ink")[1:]]  # the first one is the path
    for arrow, head, slip in zip(arrows[::2], arrows[1::2], slips):
        is_near([arrow[1:], head[1:2]], robot(slip)[[1, 1]])
        assert arrow[0, 0] == pytest.approx(0, abs=NEAR_M)
        assert abs(head[0, 0] - head[2, 0]) < 0.01 < head[1, 0] - head[0, 0]
    edges = corridor @ turn.T + eye[:2]
    np.testing.assert_allclose(PATH.project(edges)[0], paper.TOLERANCE_M, atol=NEAR_M)
    middles = see(PLANTS[:, 2:])
    middles = middles[(np.abs(middles) < 1.2 * reach_m).all(axis=1)]
    plants = np.concatenate([*near.of("dots", "--plants"), *near.of("dots", "--touched")])
    assert_same_places(plants, middles)


def assert_same_places(found, places):
    """In any order."""
    far = np.linalg.norm(found[:, None] - places, axis=2)
    assert len(found) == len(places) and far.min(axis=0).max() < NEAR_M


def test_a_leaf_is_touched_once_the_robot_has_covered_its_tip(shown):
    c = shown.runs[0]
    first = np.full(len(PLANTS), 1200)
    for k in range(1200):
        tips = np.abs(seen_from([c[name][k] for name in POSE])(PLANTS[:, :2]))
        covered = (tips <= (paper.ROBOT_LENGTH_M / 2, paper.ROBOT_WIDTH_M / 2)).all(axis=1)
        first[covered & (first == 1200)] = k
    np.testing.assert_array_equal(shown.touches, first)
    assert 0 < shown.touched == np.sum(first <= MOMENTS[-1])


# What a reader does


def test_a_pointer_on_a_picture_moves_what_it_holds(live):
    page = live.scene("a").page

    def px(place, canvas="map"):
        box = page.locator(f"#{canvas}").bounding_box()
        plot = f"page.views.all.get(document.getElementById('{canvas}')).plot"
        x, y = page.evaluate(f"([x, y]) => [{plot}.x(x), {plot}.y(y)]", place)
        return box["x"] + x, box["y"] + y

    def drag(start, end):
        page.mouse.move(*px(start))
        page.mouse.down()
        page.mouse.move(*px(end), steps=2)
        page.mouse.up()
        live.settled()
        return scenario_of(live.runs()[0]["line"])

    page.locator("#map").scroll_into_view_if_needed()
    # A pixel is nearly a decimetre.
    assert drag((0, 1), (0.4, -0.8)).start_offset_m == pytest.approx(-0.8, abs=0.1)
    turned = drag((3, -0.8), (3 * np.cos(0.5), -0.8 + 3 * np.sin(0.5)))
    assert turned.start_yaw_rad == pytest.approx(0.5, abs=0.05)
    assert page.is_disabled("#dry")
    page.mouse.dblclick(*px((12, 4)))
    live.settled()
    (patch,) = drag((12.5, 4.5), (15, 2)).patches
    assert patch == pytest.approx((15, 2, *NEW_PATCH[2:]), abs=0.1)
    page.click("#patch")
    live.settled()
    assert scenario_of(live.runs()[0]["line"]).patches == (patch, NEW_PATCH)
    page.keyboard.down("Shift")
    moved = drag((0, -0.8), (5, 5))
    page.keyboard.up("Shift")
    assert moved.start_offset_m == turned.start_offset_m  # the picture is moved, not the start
    page.evaluate("page.views.chosen.clear(), page.views.all.get($('map')).up = null, ask(draw)")
    live.settled()
    # Elsewhere a pointer chooses when the robot is nearest; over time, the time.
    drag((25, 0.3), (20, 0.3))
    away = live.runs()[0]["rows"][:, :2] - [20, 0.3]
    nearest = np.argmin(np.hypot(*away.T)) * paper.DT_S
    assert float(page.inner_text("#time").split()[0]) == pytest.approx(nearest, abs=0.5)
    page.mouse.click(*px((30, 0.1), "error"))
    live.settled()
    assert float(page.inner_text("#time").split()[0]) == pytest.approx(30, abs=0.4)
    page.click("#dry")
    live.settled()
    assert scenario_of(live.runs()[0]["line"]).patches == () and page.is_disabled("#dry")


def test_a_wet_patch_is_seen_where_it_is(live):
    """On the map, and ahead of a robot that has not come to it."""
    page = live.scene("a").page
    live.move(page.locator("#moment"), 100.5 / 600)
    live.settled()
    brown = """([canvas, ...place]) => {
        const [across, down] = place.map(Math.round)
        return $(canvas).getContext("2d").getImageData(across, down, 1, 1).data[3]
    }"""
    near = live.marks()["near"].high[0]
    robot_m = live.runs()[0]["rows"][100, 0]
    radius = NEW_PATCH[2]
    x, y = robot_m + 0.8 + radius, 0.5

    def on_map(along, across):
        place = [x + radius * along, y + radius * across]
        at = page.evaluate("([x, y]) => [page.map.x(x), page.map.y(y)]", place)
        return page.evaluate(brown, ["map", *at])

    def ahead(ahead_m):
        wide, high = page.evaluate("[$('near').clientWidth, $('near').clientHeight]")
        scale = (wide - 50) / 2 / near
        beside_m = 0.25  # between the corridor and the leaves
        at = 38 + (near + ahead_m) * scale, (high - 14) / 2 - beside_m * scale
        return page.evaluate(brown, ["near", *at])

    def seen():
        shares = [(0, 0.4), (0.7, 0.4), (0, -0.8), (1.2, 0.5), (0, 1.3)]
        return np.array([*(on_map(*share) for share in shares), ahead(1.5), ahead(-1.5)])

    before = seen()
    page.evaluate("place => add_patch(...place)", [x, y])
    live.settled()
    wetter = seen() - before
    assert min(wetter[[0, 1, 2, 5]]) > 30
    np.testing.assert_array_equal(wetter[[3, 4, 6]], 0)


def test_a_click_on_a_run_hides_it(live):
    page = live.scene("b").page
    button = page.locator("#metrics button", has_text="EKF")
    for pressed in ("false", "true"):
        button.click()
        live.settled()
        assert button.get_attribute("aria-pressed") == pressed
        shown = [bool(marks.of("line", "--run1", "EKF")) for marks in live.marks().values()]
        assert any(shown) == (pressed == "true")


def test_play_goes_on_at_its_pace_until_the_end(live):
    page = live.scene("a").page

    def seconds():
        return float(page.inner_text("#time").split()[0])

    begin = seconds()
    took = page.evaluate("""async () => {
        const begin = performance.now()
        document.getElementById("play").click()
        await new Promise(done => setTimeout(done, 800))
        document.getElementById("play").click()
        return (performance.now() - begin) / 1000
    }""")
    live.settled()
    assert 2 * took < seconds() - begin < 4 * took + 0.5  # at 4 times the pace, but for a frame
    page.evaluate("document.activeElement.blur()")
    for said in ("pause", "play"):
        page.keyboard.press(" ")
        assert page.inner_text("#play") == said
    live.move(page.locator("#moment"), 0.998)
    live.settled()
    page.keyboard.press(" ")
    wait_until(page, "document.getElementById('play').textContent === 'play'")
    live.settled()
    assert seconds() == pytest.approx(119.8)
    page.click("#play")
    wait_until(page, "Number(document.getElementById('moment').value) < 0.1")
    live.move(page.locator("#moment"), 0.5)  # while it plays
    wait_until(page, "Number(document.getElementById('moment').value) > 0.501")
    page.click("#play")
    live.settled()
    assert 60 < seconds() < 70


# One picture of its own, beside what is drawn

PLOT = """([x, y, options]) => {
    const canvas = document.createElement("canvas")
    document.body.prepend(canvas)
    canvas.style.cssText = "display: block; width: 400px; height: 120px"
    const ticks = []
    const fillText = CanvasRenderingContext2D.prototype.fillText
    CanvasRenderingContext2D.prototype.fillText = (...tick) => ticks.push(tick)
    const plot = new Plot(canvas, x, y, options)
    CanvasRenderingContext2D.prototype.fillText = fillText
    const [left, top, right, bottom] = plot.box
    const corners = [[left, bottom], [right, top]].map(
        ([offsetX, offsetY]) => plot.data({ offsetX, offsetY }))
    const there = corners.map(([x, y]) => [plot.x(x), plot.y(y)])
    canvas.remove()
    return { ticks, corners, box: plot.box, there }
}"""
INK = """() => {
    const canvas = document.createElement("canvas")
    document.body.prepend(canvas)
    canvas.style.cssText = "display: block; width: 450px; height: 226px; --wet: 255, 0, 0"
    const plot = new Plot(canvas, [0, 40], [0, 20])
    const red = (x, y) => { // how much of a pixel is red
        const at = [plot.x(x), plot.y(y)].map(Math.round)
        const [r, g, , alpha] = plot.c.getImageData(...at, 1, 1).data
        return r > 245 && g < 99 ? alpha / 255 : 0
    }
    const row = (y, from, to) => // along a line
        Array.from({ length: 10 * (to - from) }, (_, i) => red(from + i / 10, y))
    plot.soil([5, 4], [2.3, 12.3], 2, (i, j) => i === 3 && j === 1 ? 0.75 : 1)
    plot.line(100, k => k === 50 ? NaN : 0.41 * k - 0.1, () => 1.3, "red", { width: 3, alpha: 0.8 })
    plot.area(4, i => [36, 36, 38, 38][i], i => [-5, 25, 25, -5][i], "red")
    plot.line(2, k => 2.1 + 36 * k, () => 3.3, "red", { width: 3, dash: [5, 5] })
    plot.area(4, i => [2, 2, 8, 8][i], i => [6, 9, 9, 6][i], "red", { alpha: 0.5 })
    plot.dots(2, k => 12.3 + 6 * k, () => 7.3, "red", { radius: 8 })
    plot.dots(1, () => 25.3, () => 7.3, "red", { radius: 8, full: false, alpha: 0.9 })
    plot.band(3, k => 30 + 4 * k, k => 7, k => 2, "red")
    const seen = {
        line: row(1.3, -2, 35), dashes: row(3.3, 2, 38), area: row(7.3, 1, 9),
        edges: [-0.6, 0.6, 19.4, 20.4].map(y => red(37, y)),
        dots: [12.3, 18.3, 15.3].map(x => red(x, 7.3)), ring: [25.3, 26.1].map(x => red(x, 7.3)),
        band: [4.4, 5.4, 8.6, 9.4].map(y => red(34.3, y)),
        soil: [0, 1, 2, 3].map(j => [0, 1, 2, 3, 4].map(i => red(2.3 + 2 * i, 12.3 + 2 * j))),
    }
    canvas.remove()
    return seen
}"""


@pytest.mark.parametrize("options", [{}, dict(equal=True), dict(log=True)])
def test_a_tick_stands_where_a_pointer_reads_its_number(live, options):
    for (x0, x1), (low, high) in (((-1, 9), (0.02, 3)), ((40, 40.7), (1e-7, 1e-2))):
        seen = live.page.evaluate(PLOT, [[x0, x1], [low, high], options])
        left, top, right, bottom = seen["box"]
        (x_0, y_0), (x_1, y_1) = seen["corners"]
        np.testing.assert_allclose(seen["there"], [(left, bottom), (right, top)], atol=1e-9)
        if options.get("equal"):
            scale = min((right - left) / (x1 - x0), (bottom - top) / (high - low))
            np.testing.assert_allclose(
                [x_1 - x_0, y_1 - y_0], [(right - left) / scale, (bottom - top) / scale]
            )
            np.testing.assert_allclose([x_0 + x_1, y_0 + y_1], [x0 + x1, low + high])
        else:
            np.testing.assert_allclose([x_0, x_1, y_0, y_1], [x0, x1, low, high])
        of = np.log10 if options.get("log") else np.asarray
        ticks = [(float(text.replace("−", "-")), px, py) for text, px, py in seen["ticks"] if text]
        across = np.array([(number, px) for number, px, py in ticks if py > bottom + 5])
        up = np.array([(of(number), py - 4) for number, px, py in ticks if px < left])
        decade = (bottom - top) / np.diff(of([y_0, y_1]))[0] if options.get("log") else 0
        for found, (px_0, px_1), (first, last), apart in (
            (across, (left, right), (x_0, x_1), 60),
            (up, (bottom, top), of([y_0, y_1]), max(120 / 5, decade)),
        ):
            places = px_0 + (found[:, 0] - first) / (last - first) * (px_1 - px_0)
            np.testing.assert_allclose(places, found[:, 1], atol=0.1)
            steps = np.abs(np.diff([px_0, *places, px_1]))
            assert (steps[1:-1] > apart - 0.1).all() and steps.max() < 2.6 * apart


def test_what_is_drawn_is_seen_where_it_is(live):
    seen = {name: np.array(pixels) for name, pixels in live.page.evaluate(INK).items()}
    x = np.arange(-20, 350) / 10
    expected = 0.8 * ((x > 0) & ((x < 20) | (x > 20.8)))  # where a value is not known is a gap
    edges = np.abs(x[:, None] - [0, 10, 20, 20.8, 30]).min(axis=1) < 0.25  # and lines of the grid
    joints = np.abs(x[:, None] - (0.41 * np.arange(0, 100, 32) - 0.1)).min(axis=1) < 0.5
    np.testing.assert_allclose(
        seen["line"][~edges & ~joints], expected[~edges & ~joints], atol=0.01
    )
    assert seen["line"][joints & (x > 1)].min() > 0.3
    np.testing.assert_array_equal(seen["edges"], [0, 1, 1, 0])
    assert 0.4 < (seen["dashes"] > 0.5).mean() < 0.6
    np.testing.assert_allclose(seen["area"][15:65], 0.5, atol=0.01)
    assert not seen["area"][:8].any() and not seen["area"][72:].any()
    np.testing.assert_array_equal(seen["dots"], [1, 1, 0])
    assert seen["ring"][0] == 0 < seen["ring"][1]
    np.testing.assert_allclose(seen["band"], [0, 0.15, 0.15, 0], atol=0.01)
    soil = np.zeros((4, 5))
    soil[1, 3] = np.sqrt(1 - 0.75) / 0.91  # as in rhec/explorer/panels.py
    np.testing.assert_allclose(seen["soil"], soil, atol=0.02)


VIEWS = """() => {
    const holder = document.createElement("div")
    holder.style.cssText = "position: fixed; inset: 0; z-index: 9; background: white"
    const canvases = ["one", "two", "map"].map(id => {
        const figure = document.createElement("figure")
        const canvas = document.createElement("canvas")
        canvas.id = `view-${id}`
        canvas.style.cssText = "flex: none; width: 350px; height: 226px"
        figure.append(canvas)
        holder.append(figure)
        return canvas
    })
    document.body.append(holder)
    window.views = new Views(() => {
        for (const canvas of canvases) {
            const [up, across] = canvas.id === "view-map" ? [10, ""] : [1, "t [s]"]
            const plot = views.plot(canvas, [0, 10], [0, up], { across })
            plot.line(11, k => k, k => up * k / 10, "red", { label: "up" })
            plot.line(5, k => k, k => k === 2 ? NaN : -0.0123 - k, "red", { label: "down" })
            plot.line(11, k => k, k => 0.5, "red")
        }
    })
    views.draw()
}"""
LIMITS = """() => ["one", "two", "map"].map(id => {
    const { plot, box } = views.all.get(document.getElementById(`view-${id}`))
    const [left, top, right, bottom] = plot.box
    const [[x0, y0], [x1, y1]] = [[left, bottom], [right, top]].map(
        ([offsetX, offsetY]) => plot.data({ offsetX, offsetY }))
    return [x0, x1, y0, y1]
})"""


def test_a_pointer_shows_values_and_zooms_and_moves(live):
    """Two pictures over time and a map, whose axes have 300 and 200 pixels."""
    page = live.page
    page.evaluate(VIEWS)
    whole = [0, 10, 0, 1]
    whole_map = [0, 10, 0, 10]

    def px(canvas, x, share):
        box = page.locator(f"#view-{canvas}").bounding_box()
        return box["x"] + 38 + 30 * x, box["y"] + 206 - 200 * share

    def limits_are(*expected):
        np.testing.assert_allclose(page.evaluate(LIMITS), expected, atol=0.02)

    def drag(canvas, start, end, button="left"):
        page.mouse.move(*px(canvas, *start))
        page.mouse.down(button=button)
        page.mouse.move(*px(canvas, *end), steps=3)
        boxes = page.eval_on_selector_all(
            f"#view-{canvas} ~ .view-box:not([hidden])",
            """all => all.map(({ style, parentElement: { firstChild: canvas } }) => [
                parseFloat(style.left) - canvas.offsetLeft,
                parseFloat(style.top) - canvas.offsetTop,
                parseFloat(style.width), parseFloat(style.height)])""",
        )
        page.mouse.up(button=button)
        return np.round(boxes).ravel().tolist()

    assert (
        page.locator("[id^=view-] ~ div:not([hidden]), [id^=view-] ~ output:visible").count() == 0
    )
    words = page.locator("[id^=view-] ~ .view-words")
    for canvas, place, k in (
        ("one", (4.1, 0.9), 4),
        ("two", (2.1, 0.9), 2),
        ("two", (4.6, 0), 5),
        ("map", (6.4, 0.76), 7),
    ):
        page.mouse.move(*px(canvas, *place))
        said = [f"up {k / 10:g}", f"up {k}, {k}"]
        if k == 4:
            said = [f"down −{k + 0.0123:.3g} · {said[0]}", f"down 4, −4.01 · {said[1]}"]
        said = [f"{k}.0 s · {said[0]}"] * 2 + [said[1]]
        assert words.all_inner_texts() == said
    # The cursor stands at the sample, in a picture over time from top to bottom.
    rectangle = "all => all.map(e => [e.offsetLeft, e.offsetTop, e.offsetHeight])"
    cursors = page.eval_on_selector_all("[id^=view-] ~ .view-cursor.over-time", rectangle)
    one = page.evaluate("(c => [c.offsetLeft, c.offsetTop])(document.getElementById('view-one'))")
    assert cursors[0] == [one[0] + 38 + 30 * 7, one[1] + 6, 200]
    # Ctrl and wheel zoom around the pointer, in time in all pictures over time.
    page.mouse.move(*px("one", 4, 0.25))
    page.mouse.wheel(0, -100)
    limits_are(whole, whole, whole_map)
    page.keyboard.down("Control")
    page.mouse.wheel(0, -100)
    page.keyboard.up("Control")
    share = np.exp(-0.2)
    x = [4 - 4 * share, 4 + 6 * share]
    limits_are([*x, 0.25 - 0.25 * share, 0.25 + 0.75 * share], [*x, 0, 1], whole_map)
    page.keyboard.down("Shift")
    assert not drag("one", (5, 0.5), (4, 0.6))  # a second's pixels to the left, a tenth's up
    page.keyboard.up("Shift")
    (cursor, _) = page.eval_on_selector_all("[id^=view-] ~ .view-cursor.over-time", rectangle)
    x = [each + share for each in x]
    expected = one[0] + 38 + 30 * (5 - x[0]) / share  # where sample 5 is now
    assert cursor[0] == pytest.approx(expected, abs=1)
    up = [0.15 - 0.25 * share, 0.15 + 0.75 * share]
    limits_are([*x, max(up[0], 0), up[1]], [*x, 0, 1], whole_map)
    drag("one", (0, 0.5), (10, 0.52))
    limits_are([*x, max(up[0], 0), up[1]], [*x, 0, 1], whole_map)
    page.mouse.dblclick(*px("one", 5, 0.5))
    limits_are(whole, whole, whole_map)
    assert not drag("map", (6, 0.8), (2, 0.3), "right")
    limits_are(whole, whole, whole_map)
    # A box is what is seen next; a flat one chooses times alone.
    assert drag("map", (6, 0.8), (2, 0.3)) == [38 + 60, 6 + 40, 30 * 4, 200 * 0.5]
    limits_are(whole, whole, [2, 6, 3, 8])
    assert drag("two", (3, 0.52), (8, 0.5)) == [38 + 90, 6 + 96, 30 * 5, 200 * 0.02]
    limits_are([3, 8, 0, 1], [3, 8, 0, 1], [2, 6, 3, 8])
    assert page.locator("[id^=view-] ~ .view-box:visible").count() == 0
    drag("map", (6, 0.8), (5.9, 0.3))  # too narrow to be meant
    limits_are([3, 8, 0, 1], [3, 8, 0, 1], [2, 6, 3, 8])
    # Nothing is seen beyond the whole.
    page.keyboard.down("Control")
    for canvas in ("two", "map"):
        page.mouse.move(*px(canvas, 5, 0.5))
        page.mouse.wheel(0, 900)
        page.mouse.wheel(0, 900)
        page.mouse.wheel(0, 900)
    page.keyboard.up("Control")
    limits_are(whole, whole, whole_map)
    page.mouse.move(600, 600)
    assert not any(word.is_visible() for word in words.all())
    page.evaluate("document.getElementById('view-one').closest('div').remove()")


def test_the_page_says_what_failed(live):
    page = live.page
    page.evaluate("ask(() => { throw Error('of all things') })")
    wait_until(page, "$('said').textContent === 'of all things'")
    page.evaluate("want({ id: 'no step', form: { elements: [] } })")
    wait_until(page, "$('said').textContent.includes('not a function')")
    live.scene("a")


# The story

# What a reader does to answer the question of each step of the story.
ANSWERS = dict(
    encoders=("time", 18),
    filter=("soil", "default"),
    window=("arrival", False),
    kalman=("bounds", False),
    row=("time", 61),
    noise=("sigma", -1.9958),  # the power of ten
)
HELD_BY_A_BOUND_S = 65.0
# Step 3 at a sample, and the estimates of step 4.
COMPARED = "bounds => compare(story.steps.kalman.loop, story.steps.kalman.tools, bounds)"
WINDOW = """([k, arrival]) => {
    const { loop, tools } = story.steps.window
    const { bounded, free } = take_sample(loop, tools, k, arrival)
    const piece = name => bytes(Float64Array.from(piece_of(tools, bounded.memory, name).flat()))
    const both = compare(story.steps.kalman.loop, tools, false)
    return {
        rows: bytes(loop.at_row.subarray(0, loop.samples * page.world.columns.length)),
        s: piece("s"), v: piece("v"), m: piece("m"), P: piece("P"),
        bounded: [...bounded.estimate],
        free: [...free.estimate],
        P_bounded: bytes(bounded.covariance),
        P_free: bytes(free.covariance),
        costs: costs_of(tools, bounded.memory, noises(loop).V),
        shortest: both.map(([one]) => one),
        kalman: both.map(([, other]) => other),
    }
}"""


def after_the_guess(values):
    """Without the first 5 s, in which an estimator forgets its first guess."""
    return values[25:]


def rms(values):
    return np.sqrt(np.mean(np.square(values)))


def shown_by_encoders(live, c, time):
    k = round(time / paper.DT_S)
    poses = [np.array([c[name][0] for name in POSE])]
    for nu, omega in zip(c["nu_meas_mps"][1:], c["omega_meas_radps"][1:]):
        turn = omega * paper.DT_S
        way = nu * paper.DT_S * np.sinc(turn / 2 / np.pi)  # along the chord of an arc
        middle = poses[-1][2] + turn / 2
        poses.append(poses[-1] + [way * np.cos(middle), way * np.sin(middle), turn])
    reckoned = np.array(poses)[: k + 1, :2]
    driven = c["xy"][: k + 1]
    error = np.hypot(*(reckoned - driven)[-1])
    way = np.hypot(*np.diff(driven, axis=0).T).sum()
    numbers = dict(time=f"{time:.1f}", error=f"{error:.2f}", way=f"{way:.1f}")
    return numbers, {("encoders-0", "--run0"): driven, ("encoders-0", "--run1"): reckoned}


def shown_by_filter(live, c, soil):
    error = c["theta_hat_rad"] - c["theta_rad"]
    outside = 100 * np.mean(after_the_guess(np.abs(error) > 2 * c["sigma_theta"]))
    numbers = dict(outside=f"{outside:.0f}", kappa=f"{after_the_guess(c['kappa']).mean():.2f}")
    return numbers, {("filter-0", "--run1"): np.column_stack([c["time"], error])}


def shown_by_kalman(live, c, bounds):
    """The estimates are those of the test after the next."""
    shortest, kalman = np.moveaxis(live.page.evaluate(COMPARED, bounds), 1, 0)
    gaps = np.linalg.norm((shortest - kalman)[:, :2], axis=1)
    gnss = np.linalg.norm(c["xy"] - np.column_stack([c["x_meas_m"], c["y_meas_m"]]), axis=1)
    kappa = np.abs(after_the_guess(shortest - kalman)[:, 5]).max()
    numbers = dict(largest=f"{1e3 * after_the_guess(gaps).max():.2f}", kappa=f"{kappa:.3f}")
    numbers |= dict(rms=f"{1e3 * rms(after_the_guess(gaps)):.2f}", gnss=f"{1e3 * rms(gnss):.0f}")
    return numbers, {("kalman-0", "--run0"): np.column_stack([c["time"], gaps])}


def shown_by_row(live, c, time):
    """With the covariances of the public RHE."""
    noise = tuning.NOISES["rhe"]["prediction"]
    sigma_w = (*noise.sigma_w[:5], 0.014)
    sigma = np.sqrt(covariances(c, sigma_w=sigma_w, sigma_v=noise.sigma_v)[:, 5, 5])
    k = round(time / paper.DT_S)
    best = 50 + np.argmax(sigma[50:])
    numbers = dict(time=f"{time:.1f}", sigma=f"{sigma[k]:.3f}", x=f"{c['x_m'][k]:.1f}")
    numbers |= dict(largest=f"{sigma[best]:.3f}", after=f"{sigma[best + 50]:.3f}", later="10")
    lines = {("row-0", "--run0"): np.column_stack([c["time"], sigma])}
    return numbers, lines | {("row-1", "--run0"): c["xy"][: k + 1]}


def shown_by_noise(live, c, sigma):
    estimate = c["kappa_hat"]
    jumps = np.sum(np.abs(np.diff(estimate)) > 0.2)
    bound = 100 * np.mean((estimate <= 0) | (estimate >= 1))
    error = rms(after_the_guess(estimate - c["kappa"]))
    numbers = dict(
        sigma=f"{sigma:.3f}",
        jumps=f"{jumps}",
        bound=f"{np.floor(bound + 0.5):.0f}",
        rms=f"{error:.2f}",
    )
    lines = {("noise-0", "--run0"): np.column_stack([c["time"], estimate])}
    return numbers, lines | {("noise-0", "--ink"): np.column_stack([c["time"], c["kappa"]])}


# Of each step but the third: its first value, the answer, and what it says and draws.
STEPS = dict(
    encoders=(60.0, 18.0, shown_by_encoders),
    filter=("soft", "default", shown_by_filter),
    kalman=(True, False, shown_by_kalman),
    row=(20.0, 61.0, shown_by_row),
    noise=(0.25, 0.0101, shown_by_noise),
)


@pytest.mark.parametrize("step", STEPS)
def test_a_step_says_and_draws_what_its_run_shows_and_is_open_until_answered(live, step):
    *values, shown_by = STEPS[step]
    for value, verdict in zip(values, ("wrong", "right")):
        if verdict == "right":
            live.set(step, *ANSWERS[step])
        c = live.step(step)
        numbers, lines = shown_by(live, c, value)
        told, answer = (live.page.inner_text(f"#step-{step} .{of}") for of in ("told", "answer"))
        assert told == STORY[step]["told"].format(**numbers)
        assert answer.removeprefix("✓ ") == STORY[step][verdict].format(**numbers)
        assert answer.startswith("✓") == (verdict == "right")
    marks = live.marks()
    for (canvas, colour), points in lines.items():
        (found, *_) = marks[canvas].of("line", colour)
        np.testing.assert_allclose(found, points, atol=2e-6, err_msg=canvas)
        assert marks[canvas].has_room_for(after_the_guess(found))


def test_window_costs_and_filter_of_the_story_are_those_of_python(live):
    """The public RHE and EKF on the page's measurements, and the cost of a fit by matrices."""
    last = round(HELD_BY_A_BOUND_S / paper.DT_S)
    seen = live.page.evaluate(WINDOW, [last, True])
    rows = floats(seen["rows"]).reshape(-1, len(COLUMNS))
    z = rows[:, [COLUMNS.index(name) for name in MEASUREMENTS]]
    mhe = rhec.RHE(process_noise="prediction", guess=GUESS)
    noise = tuning.NOISES["rhe"]["prediction"]
    ekf = rhec.EKF(
        model=mhe.model,
        dt=paper.DT_S,
        **noise._asdict(),
        guess=GUESS,
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


def test_the_third_step_draws_and_says_what_its_window_is(live):
    live.set("window", "time", HELD_BY_A_BOUND_S)
    k = round(HELD_BY_A_BOUND_S / paper.DT_S)
    c, seen, marks = live.step("window"), live.page.evaluate(WINDOW, [k, True]), live.marks()
    s, m, P, P_bounded, P_free = (
        floats(seen[name]).reshape(-1, 6) for name in ("s", "m", "P", "P_bounded", "P_free")
    )
    costs = np.array(seen["costs"]["nodes"])
    arrival = seen["costs"]["arrival"]
    # In the frame of its middle pose: fits, positions, truth and two ellipses.
    see = seen_from(s[8, :3])
    turn = seen_from([0, 0, s[8, 2]])(np.eye(2))
    z = np.column_stack([c["x_meas_m"], c["y_meas_m"]])
    last = slice(k - 15, k + 1)
    for kind, colour, places in (
        ("dots", "--run0", s),
        ("dots", "--measured", z[last]),
        ("line", "--soft", c["xy"][last]),
    ):
        found = marks["window-0"].of(kind, colour)[0]
        np.testing.assert_allclose(found, see(places), atol=1e-9)
    for colour, mean, covariance in (("--plan", m[0], P), ("--ink", s[-1], P_bounded)):
        (ellipse,) = marks["window-0"].of("line", colour)
        assert_ellipse(ellipse, see(mean), turn.T @ covariance[:2, :2] @ turn)
    # Bars as high as the costs, and the arrival cost before them.
    for of, colour in enumerate(("--measured", "--run1", "--run2")):
        bars = np.array(marks["window-1"].of("area", colour))
        np.testing.assert_allclose(bars[:, :, 1].max(axis=1), costs[:, of], atol=1e-12)
        assert (np.round(bars[:, :, 0].mean(axis=1)) == np.arange(16)).all()
    (bar,) = marks["window-1"].of("area", "--plan")
    assert bar[:, 0].mean() == pytest.approx(-1) and bar[:, 1].max() == pytest.approx(arrival)
    # κ and μ with bounds and without, and as the arrival cost has them.
    traction = [5, 4]
    ring, dot = marks["window-2"].of("dots", "--run0")
    np.testing.assert_allclose(
        [*ring, *dot], [np.take(seen[of], traction) for of in ("free", "bounded")]
    )
    (prior,) = marks["window-2"].of("line", "--plan")
    assert_ellipse(prior, m[0, traction], P[np.ix_(traction, traction)])
    (around,) = marks["window-2"].of("line", "--run0")
    assert_ellipse(around, ring[0], P_free[np.ix_(traction, traction)])


def test_the_third_step_without_its_arrival_cost_and_phase_by_phase(live):
    page = live.page
    live.set("window", "time", 50)
    assert live.answer("window").startswith("Not yet")
    live.set("window", *ANSWERS["window"])
    seen = page.evaluate(WINDOW, [250, False])
    known = live.step("window")["sigma_kappa"][250]
    sigma = np.sqrt(floats(seen["P_bounded"])[-1])
    gnss, speed, yaw_rate = np.sum(seen["costs"]["nodes"], axis=0)
    numbers = dict(kappa=seen["bounded"][5], free=seen["free"][5], sigma=sigma, known=known)
    numbers = {name: f"{number:.3f}" for name, number in numbers.items()}
    costs = dict(cost=gnss + speed + yaw_rate, gnss=gnss, speed=speed, input=yaw_rate, arrival=0)
    numbers |= {name: f"{number:.1f}" for name, number in costs.items()}
    told = STORY["window"]["told"].format(phase="Feedback", time="50.0", **numbers)
    assert page.inner_text("#step-window .told") == told
    right = STORY["window"]["right"].format(factor=f"{sigma / known:.0f}")
    assert live.answer("window") == f"✓ {right}"
    live.set("window", "bounds", False)
    live.set("window", "arrival", True)
    for phase, following in (("Preparation", "feedback"), ("Feedback", "preparation")):
        page.click("#step-window [name=next]")
        live.settled()
        assert page.inner_text("#step-window .told").startswith(phase)
        assert " at 50.2 s: " in page.inner_text("#step-window .told")
        assert page.inner_text("#step-window [name=next]") == f"next: {following}"
        assert live.answer("window").startswith("Not yet")


def test_the_last_step_compares_the_runs_of_the_field(live):
    page = live.scene("a").page
    assert live.answer("sandbox") == STORY["sandbox"]["idle"]
    live.scene("b")
    for soil in ("default", "soft"):
        page.select_option("#soil", soil)
        live.settled()
        rhe, ekf = (float(run["metrics"]["max_error_true_m"]) for run in live.runs())
        told = STORY["sandbox"]["told"].format(rhe=f"{rhe:.2f}", ekf=f"{ekf:.2f}")
        assert page.inner_text("#step-sandbox .told") == told
        verdict = "right" if ekf > 2 * rhe else "wrong"
        expected = STORY["sandbox"][verdict].format(ratio=f"{ekf / rhe:.1f}")
        assert live.answer("sandbox").removeprefix("✓ ") == expected
        assert live.answer("sandbox").startswith("✓") == (verdict == "right")
