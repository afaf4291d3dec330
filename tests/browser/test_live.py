"""The live page of the report, opened from the disk: its runs are Python's, its pictures show them,
and it keeps what the reader chose.
"""

import itertools
import random
from types import SimpleNamespace

import numpy as np
import pytest
from drawn import NOTE, floats, marks_on, place_on
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
# Each picture has the size of its place.
DRAWN = "[...document.querySelectorAll('canvas')].every(c => c.width === c.clientWidth)"
PICTURES = "[...document.querySelectorAll('#pictures canvas')].map(c => c.toDataURL())"


class Live:
    """What a reader does with the page, and finds on it."""

    def __init__(self, page):
        self.page = page

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

    def to_moment(self, share):
        self.move(self.page.locator("#moment"), share)
        self.settled()

    def set(self, step, name, value):
        control = self.page.locator(f"#step-{step} [name={name}]")
        if isinstance(value, bool):
            control.set_checked(value)
        elif name == "soil":
            control.select_option(value)
        else:
            self.move(control, value)
        self.settled()

    def change(self, rule, turns, chance, share):
        """Choose what is not there at first, add a patch, and move a share of the sliders.

        A slider of noise that moves makes the noise the reader's own.
        """
        page = self.page
        page.select_option("#seed", "7")
        page.select_option("#soil", "soft")
        page.select_option("#turns", turns)
        page.select_option("#noise", rule)
        if page.is_visible("#fault"):
            page.select_option("#fault", [*FAULTS][3])
        else:
            page.select_option("#window", "5 intervals")
        page.click("#patch")
        self.settled()
        before = self.sliders()
        moved = set()
        for i, slider in enumerate(page.locator("#sliders input[data-field]:enabled").all()):
            if chance.random() < share:
                low, high = (float(slider.get_attribute(name)) for name in ("min", "max"))
                away = float(slider.input_value()) - low + (high - low) * chance.uniform(0.2, 0.8)
                self.move(slider, low + away % (high - low))
                moved.add(i)
        self.settled()
        changes = {i for i, both in enumerate(zip(before, self.sliders())) if both[0] != both[1]}
        assert changes == moved

    def sliders(self):
        """[what is moved, its place, kind, where the slider stands, what is said of it]."""
        read = """all => all.map(({ dataset: { field, place, kind }, value, nextSibling }) =>
            [field, place, kind, value, nextSibling.value])"""
        return self.page.eval_on_selector_all("#sliders input:enabled[data-field]", read)

    def scenarios(self):
        """Those of the lines of Python."""
        return [scenario_of(line) for line in self.page.inner_text("#line").split("\n")]

    def floats(self, array):
        return floats(self.page.evaluate(f"bytes({array})"))

    def log(self, loop):
        """Columns of a loop's log."""
        n = len(COLUMNS)
        rows = self.floats(f"{loop}.at_row.subarray(0, {loop}.samples * {n})").reshape(-1, n)
        c = dict(zip(COLUMNS, rows.T), time=paper.DT_S * np.arange(len(rows)))
        return c | dict(xy=np.column_stack([c["x_m"], c["y_m"]]))

    def noise(self, loop):
        """A run's input, a row a sample."""
        n = f"{loop}.samples"
        width = f"(page.world.noise.n + ({loop}.data.faulty ? page.world.n_fault : 0))"
        noise = self.floats(f"{loop}.at_noise.subarray(0, {n} * {width})")
        return noise.reshape(self.page.evaluate(n), -1)

    def marks(self):
        return marks_on(self.page)


def seen_from(pose):
    """A function from places (n, 2) to what is ahead and to the left of a pose (x, y, θ)."""
    x, y, theta = pose
    turn = np.array([[np.cos(theta), -np.sin(theta)], [np.sin(theta), np.cos(theta)]])
    return lambda places: (np.asarray(places)[..., :2] - [x, y]) @ turn


def scenario_of(line):
    """The Scenario in a line of Python that simulates it."""
    names = dict(simulate=lambda scenario: scenario, Scenario=rhec.Scenario, Fault=rhec.Fault)
    return eval(line, dict(rhec=SimpleNamespace(**names)))


def same_run_in_python(live, scenario, loop):
    """The Run of the page's scenario with the page's noise and soil."""
    setup = closed_loop.set_up(scenario)
    origin_m = np.array(live.page.evaluate("page.soil.origin_m"))
    settings = setup.settings | dict(slip=live.floats("page.soil.slip"), origin_m=origin_m)
    # The page's grid has room for the soil of every path.
    shape = tuple(live.page.evaluate("page.world.soil_shape"))
    world = closed_loop.world_of(scenario)._replace(soil_shape=shape)
    blocks = tuple(part.block for part in parts_of(scenario, world))
    functions = compiled.load(closed_loop.build_sample, blocks, tuple(settings))
    rows = runner.run_one(functions, setup.memory, live.noise(loop), settings)
    return closed_loop.finished(scenario, setup, rows)


@pytest.fixture(scope="module")
def opened(open_page):
    """The page, opened once, and what it asked for and said on the console."""
    with open_page() as page:
        asked, said = [], []
        page.context.set_offline(True)
        page.on("request", lambda request: asked.append(request.url))
        page.on("console", lambda message: said.append(message.text))
        page.goto(LIVE_PAGE.as_uri() + "#faults")
        live = Live(page)
        live.settled()
        page.evaluate(NOTE)
        yield live, asked, said


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
        shown = page.locator("section[data-scene]:visible")
        assert shown.evaluate_all("all => all.map(each => each.dataset.scene)") == [scene]
        assert page.is_visible("#fault") == page.is_disabled("#window") == (scene == "faults")
        for width in (1366, 390, 1366):
            page.set_viewport_size({"width": width, "height": 768})
            assert page.evaluate("document.documentElement.scrollWidth") <= width
            wait_until(page, DRAWN, patience_s=30)
        shades = [{*shade[:, 0]} for shade in live.marks()["error"].of("area", "--measured")]
        assert shades == ([{40, 50}] if scene == "faults" else [])  # when positions are 2 m off
    assert said == []
    assert {url.partition(":")[0] for url in asked} <= {"about", "data", "file"}
    sizes = {file.name: file.stat().st_size for file in (LIVE_PAGE.parent / "live").iterdir()}
    assert sizes["seed_0.js"] < 0.2e6 and sum(sizes.values()) < 2.9e6


# All that is seen


CHANGES = [("a", 0.5), ("b", 0.0), ("faults", 0.5), ("b", 0.5), ("a", 0.0)]


@pytest.mark.nightly(keep=2)
@pytest.mark.parametrize(
    "scene, share, rule, turns",
    [(*change, *of) for change, of in zip(CHANGES, itertools.cycle(zip(RULES, TURNS.values())))],
)
def test_all_that_is_seen_is_the_run_of_the_line_of_python(live, scene, share, rule, turns):
    """Given the page's noise and soil, which are Python's in 16 bits."""
    page = live.scene(scene).page
    before = page.evaluate(PICTURES)
    live.change(rule, turns, random.Random(f"{scene} {rule}"), share)
    assert not {*before} & {*page.evaluate(PICTURES)}
    scenarios = live.scenarios()
    marks = live.marks()
    chosen = dict(seed=7, turns=turns, estimation_horizon=5, faults=())
    if scene == "faults":
        chosen |= dict(estimation_horizon=15, faults=[*FAULTS.values()][3])
    assert {name: getattr(scenarios[0], name) for name in chosen} == chosen
    assert (scenarios[0].process_noise or tuning.DEFAULT_RULE) == rule or share
    assert_soil_shown(marks["map"], scenarios[0])
    for i, row in enumerate(page.locator("#metrics tr:has(td)").all()):
        loop = f"page.loops[{i}]"
        native = same_run_in_python(live, scenarios[i], loop)
        c = live.log(loop)
        noise = live.noise(loop)
        drawn = plant.draw_noise(7, len(noise))
        np.testing.assert_allclose(noise[:, : drawn.shape[1]], drawn, atol=8 / 2**15 / 2)
        for name in COLUMNS:
            expected = native.columns[name].astype(float)
            np.testing.assert_allclose(c[name], expected, rtol=1e-9, atol=1e-9, err_msg=name)
        assert_metrics_shown(row.locator("td").all_inner_texts(), native.metrics)
        name = row.locator("button").inner_text()[2:]
        largest = f"{name}: largest true error {native.metrics['max_error_true_m']:.2f} m"
        assert largest in page.get_attribute("#error", "aria-label")
        c["error"] = native.columns["error_true_m"]
        lines = dict(omega="omega_cmd_radps", mu="mu_hat", kappa="kappa_hat", error="error")
        for picture, column in lines.items():
            expected = np.column_stack([c["time"], c[column]])
            np.testing.assert_allclose(marks[picture].labelled(name), expected, atol=1e-9)
        for picture in ("mu", "kappa"):
            truth = np.column_stack([c["time"], c[picture]])
            np.testing.assert_array_equal(marks[picture].labelled(f"truth of {name}"), truth)
        np.testing.assert_array_equal(marks["map"].labelled(name), c["xy"])
        page.check(f"[name=run-{scene}][value='{i}']")
        assert_sliders_show(live, scenarios[i])
        live.settled()
    assert i + 1 == len(scenarios)


def assert_sliders_show(live, scenario):
    """What the followed run has: its own values, those of its rule, and the last patch."""
    shown = live.sliders()
    assert len(shown) > 20
    assumed = tuning.noise_of(scenario.estimator, scenario)._asdict()
    for field, place, kind, stands, text in shown:
        values = scenario.patches[-1] if field == "patch" else getattr(scenario, field)
        value = np.ravel(assumed[field] if values is None else values)[int(place or 0)]
        assert float(text) == pytest.approx(value, rel=0.01), field
        value = np.log10(value) if kind == "log" else value
        assert float(stands) == pytest.approx(value, abs=0.03, rel=0.01), field


def assert_metrics_shown(cells, metrics):
    for (name, _, _, digits), cell in zip(METRICS, cells, strict=True):
        if np.isfinite(metrics[name]):
            # Some 20 µm from where a bend begins, Python counts a sample as of the row.
            atol = 0.51 * 10.0**-digits + name.startswith("violations")
            assert float(cell) == pytest.approx(metrics[name], abs=atol), name
            assert len(cell.partition(".")[2]) == digits
        else:
            assert cell == "never"


def assert_soil_shown(marks, scenario):
    """κ of Python's soil, in 16 bits, where it is."""
    terrain = closed_loop.set_up(scenario).terrain
    ((*places, kappa),) = [soil.T for soil in marks.of("soil", "")]
    i, j = np.indices(terrain.kappa.shape).reshape(2, -1)
    corner = np.reshape(terrain.origin_m, (2, 1))
    np.testing.assert_allclose(places, corner + terrain.cell_m * np.array([i, j]), atol=1e-9)
    np.testing.assert_allclose(kappa, terrain.kappa.ravel(), atol=8e-6)


# Pictures of one drive, at a moment

NEAR_M = 0.015  # the page takes the path as a line with steps of half a metre
MOMENTS = (8, 330)  # while the robot comes to its row and the window fills; and in a turn


@pytest.fixture(scope="module")
def drive(opened):
    """Two runs, and what the pictures show of them at each of MOMENTS; the RHE is followed."""
    live = opened[0].scene("b")
    marks = {}
    for k in MOMENTS:
        live.to_moment((k + 0.5) / 1200)
        marks[k] = live.marks()
    touched = int(live.page.inner_text("#touched"))
    c = live.log("page.loops[0]")
    P = covariances(c, process_noise=tuning.DEFAULT_RULE)
    touches = live.page.evaluate("[...touches_of(page.loops[0])]")
    soil = closed_loop.set_up(live.scenarios()[0]).terrain
    return SimpleNamespace(c=c, marks=marks, touched=touched, touches=touches, P=P, soil=soil)


def covariances(c, **noise):
    """Of the public RHE on the measurements of a log, by sample."""
    rhe = rhec.RHE(**noise, guess=GUESS)
    found = []
    for z_N in np.column_stack([c[name] for name in MEASUREMENTS]):
        rhe.prepare()
        found.append(rhe.feedback(z_N).covariance)
    return np.array(found)


def test_bands_limits_and_the_moment_are_shown(drive):
    k = MOMENTS[-1]
    c = drive.c
    marks = drive.marks[k]
    for i, name in ((4, "mu"), (5, "kappa")):
        (band,) = marks[name].of("area", "--run0")
        estimate = c[f"{name}_hat"]
        half = 2 * np.sqrt(drive.P[:, i, i])
        up, down = (np.column_stack([c["time"], estimate + side * half]) for side in (1, -1))
        np.testing.assert_allclose(band, [*up, *down[::-1]], atol=1e-6)
    bounds = paper.OMEGA_MAX_RADPS, -paper.OMEGA_MAX_RADPS
    for name, expected in dict(error=[paper.TOLERANCE_M], omega=bounds, mu=[], kappa=[]).items():
        levels = np.reshape(marks[name].of("line", "--ink"), (-1, 2, 2))
        wanted = np.reshape([[(0, y), (240, y)] for y in expected], (-1, 2, 2))
        np.testing.assert_allclose(levels, wanted)
        (now,) = marks[name].of("line", "--soft")
        np.testing.assert_allclose(now[:, 0], k * paper.DT_S)
        for run in ("RHE", "EKF"):  # not for how far off it begins
            assert marks[name].has_room_for(marks[name].labelled(run)[200:])
        assert (marks[name].low[0], marks[name].high[0]) == pytest.approx((0, 240))
    path, heading = marks["map"].of("line", "--ink")
    assert PATH.project(path)[0].max() < 2e-3 and marks["map"].has_room_for(path)
    np.testing.assert_allclose(heading, [(0, paper.START_OFFSET_M), (3, paper.START_OFFSET_M)])
    (outline,) = marks["map"].of("area", "--run0")
    ahead_and_left = seen_from([c[of][k] for of in POSE])(outline)
    np.testing.assert_allclose(ahead_and_left, box(), atol=1e-9)


def box(width=paper.ROBOT_WIDTH_M, left=0.0):
    """Corners of a box as long as the robot, ahead along x, moved to the left."""
    half = paper.ROBOT_LENGTH_M / 2, width / 2
    return np.multiply([(1, 1), (-1, 1), (-1, -1), (1, -1)], half) + (0, left)


def assert_ellipse(points, mean, P):
    """Two standard deviations of a Gaussian."""
    middle = points[1:].mean(axis=0)
    np.testing.assert_allclose(middle, mean, atol=NEAR_M)
    away = points - middle
    within = np.linalg.solve(P, away.T).T
    np.testing.assert_allclose(np.sum(away * within, axis=1), 4, rtol=0.02)


@pytest.mark.parametrize("k", MOMENTS)
def test_the_robot_in_its_row_is_seen_along_the_path(drive, k):
    near = drive.marks[k]["near"]
    c = drive.c
    P = drive.P[k]
    pose, estimate = ([c[name][k] for name in names] for names in (POSE, ESTIMATE))
    x, y, theta = PATH.poses([c["s_m"][k]])[0][0]
    left = seen_from([x, y, theta])(pose)[1]
    aside = left - np.clip(left, -0.25, 0.25)  # the picture moves with a robot that is far off
    eye = x - aside * np.sin(theta), y + aside * np.cos(theta), theta
    see = seen_from(eye)
    turn = seen_from([0, 0, theta])(np.eye(2))
    reach_m = 3.2 * paper.SPEED_MPS + 0.7
    assert (near.low + near.high == pytest.approx((0, 0))) and near.high[0] >= reach_m

    def placed(at, points):  # [ahead, left] of a pose, as they are seen
        ways = seen_from([0, 0, at[2]])(np.eye(2)).T
        return see(np.asarray(points) @ ways + at[:2])

    half = paper.TRACK_WIDTH_M / 2
    turned = c["omega_cmd_radps"][k - 1], c["kappa"][k] * c["omega_radps"][k]
    ahead = paper.SPEED_MPS, c["mu"][k] * c["nu_mps"][k]
    # Of each track where it would be after a second as commanded, and over ground.
    slips = [
        [(v - left * omega, left) for v, omega in zip(ahead, turned)] for left in (half, -half)
    ]
    past = slice(max(k - 59, 0), k + 1)
    z = np.column_stack([c["x_meas_m"], c["y_meas_m"]])
    window, outline, ellipse = near.of("line", "--run0")
    plan = near.of("line", "--plan")[0]
    pace_m = c["mu_hat"][k] * c["nu_hat_mps"][k] * paper.DT_S
    aims_m = c["s_m"][k] + rhec.Scenario().look_ahead_m + pace_m * np.arange(len(plan))
    tracks = [box(paper.ROBOT_WIDTH_M - 2 * half, left) for left in (half, -half)]
    corridor, robot = near.of("area", "--soft")
    arrows = near.of("line", "--ink")[1:]  # the first one is the path
    yaws = np.linspace(-2, 2, 5) * np.sqrt(P[2, 2])
    fan = paper.ROBOT_LENGTH_M * np.column_stack([np.cos(yaws), np.sin(yaws)])
    for found, expected in (
        (near.of("line", "--soft")[0], see(c["xy"][past])),
        (np.concatenate(near.of("dots", "--measured")), see(z[past][-25:])),
        (near.of("dots", "--ink")[:2], [placed(pose, slip[:1]) for slip in slips]),
        (near.of("dots", "--ink")[2], see(PATH.poses(aims_m)[0])),
        (plan[:1], see([estimate[:2]])),
        (window[-1:], see([estimate[:2]])),
        (outline[:4], placed(estimate, box())),
        (near.of("area", "--run0")[0], placed(estimate, [(0, 0), *fan])),
        (robot, placed(pose, box())),
        (near.of("area", "--ink"), [placed(pose, track) for track in tracks]),
        (near.of("line", "--touched"), [placed(pose, slip) for slip in slips]),
        (arrows[::2], [placed(pose, [(0, slip[1][1]), slip[1]]) for slip in slips]),
        ([head[1] for head in arrows[1::2]], [placed(pose, slip[1]) for slip in slips]),
    ):
        np.testing.assert_allclose(found, expected, atol=NEAR_M)
    rings = np.concatenate(near.of("dots", "--ink")[:2])
    commanded = np.hypot(*(rings - np.mean(near.of("area", "--ink"), axis=1)).T)
    np.testing.assert_allclose(commanded, [slip[0][0] for slip in slips])
    assert len(window) == min(k + 1, 16)
    assert_ellipse(ellipse, see(estimate), turn.T @ P[:2, :2] @ turn)
    edges = corridor @ turn.T + eye[:2]
    np.testing.assert_allclose(PATH.project(edges)[0], paper.TOLERANCE_M, atol=NEAR_M)
    middles = see(PLANTS[:, 2:])
    middles = middles[(np.abs(middles) < 1.2 * reach_m).all(axis=1)]
    plants = np.concatenate([*near.of("dots", "--plants"), *near.of("dots", "--touched")])
    far = np.linalg.norm(plants[:, None] - middles, axis=2)  # in any order
    assert len(plants) == len(middles) and far.min(axis=0).max() < NEAR_M
    # Soil as the nearest point of the grid has it.
    (soil,) = near.of("soil", "")
    cells = (soil[:, :2] @ turn.T + eye[:2] - drive.soil.origin_m) / drive.soil.cell_m
    i, j = np.clip(np.round(cells).astype(int).T, 0, np.reshape(drive.soil.kappa.shape, (2, 1)) - 1)
    assert np.isclose(soil[:, 2], drive.soil.kappa[i, j], atol=8e-6).mean() > 0.95


def test_a_leaf_is_touched_once_the_robot_has_covered_its_tip(drive):
    c = drive.c
    first = np.full(len(PLANTS), 1200)
    for k in range(1200):
        tips = np.abs(seen_from([c[name][k] for name in POSE])(PLANTS[:, :2]))
        covered = (tips <= (paper.ROBOT_LENGTH_M / 2, paper.ROBOT_WIDTH_M / 2)).all(axis=1)
        first[covered & (first == 1200)] = k
    np.testing.assert_array_equal(drive.touches, first)
    assert 0 < drive.touched == np.sum(first <= MOMENTS[-1])


# What a reader does


def test_a_pointer_on_a_picture_moves_what_it_holds(live):
    page = live.scene("a").page

    def px(place, picture="map"):
        return place_on(page, picture, *place)

    def drag(start, end):
        begin = px(start)
        to = px(end)
        page.mouse.move(*begin)
        page.mouse.down()
        page.mouse.move(*to, steps=2)
        page.mouse.up()
        live.settled()
        return live.scenarios()[0]

    def seconds():
        return float(page.inner_text("#time").split()[0])

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
    assert live.scenarios()[0].patches == (patch, NEW_PATCH)
    page.keyboard.down("Shift")
    assert drag((0, -0.8), (5, 5)).start_offset_m == turned.start_offset_m  # the picture moves
    page.keyboard.up("Shift")
    page.evaluate("page.views.chosen.clear(), page.views.all.get($('map')).up = null, ask(draw)")
    live.settled()
    # Elsewhere a pointer chooses when the robot is nearest; over time, the time.
    drag((25, 0.3), (20, 0.3))
    away = live.log("page.loops[0]")["xy"] - [20, 0.3]
    assert seconds() == pytest.approx(np.argmin(np.hypot(*away.T)) * paper.DT_S, abs=0.5)
    page.mouse.click(*px((30, 0.1), "error"))
    live.settled()
    assert seconds() == pytest.approx(30, abs=0.4)
    page.click("#dry")
    live.settled()
    assert live.scenarios()[0].patches == () and page.is_disabled("#dry")


def test_a_click_on_a_run_hides_it(live):
    page = live.scene("b").page
    button = page.locator("#metrics button", has_text="EKF")
    for pressed in ("false", "true"):
        button.click()
        live.settled()
        assert button.get_attribute("aria-pressed") == pressed
        labels = [label for *_, label, _ in live.marks()["error"].all]
        assert ("EKF" in labels) == (pressed == "true") and "RHE" in labels


def test_play_goes_on_at_its_pace_until_the_end(live):
    page = live.scene("a").page
    moment = "Number(document.getElementById('moment').value)"
    took = page.evaluate(f"""async () => {{
        const [begin, from] = [performance.now(), {moment}]
        document.getElementById("play").click()
        await new Promise(done => setTimeout(done, 800))
        document.getElementById("play").click()
        return [(performance.now() - begin) / 1000, 120 * ({moment} - from)]
    }}""")
    live.settled()
    assert 2 * took[0] < took[1] < 4 * took[0] + 0.5  # at 4 times the pace, but for a frame
    page.evaluate("document.activeElement.blur()")
    for said in ("pause", "play"):
        page.keyboard.press(" ")
        assert page.inner_text("#play") == said
    live.to_moment(0.998)
    page.keyboard.press(" ")
    wait_until(page, "document.getElementById('play').textContent === 'play'")
    live.settled()
    assert page.inner_text("#time") == "119.8 s"
    page.click("#play")
    wait_until(page, f"{moment} < 0.1")
    page.click("#play")
    live.settled()


def test_the_page_says_what_failed(live):
    page = live.page
    page.evaluate("ask(() => { throw Error('of all things') })")
    wait_until(page, "$('said').textContent === 'of all things'")
    page.evaluate("want({ id: 'no step', form: { elements: [] } })")
    wait_until(page, "$('said').textContent.includes('not a function')")
    live.scene("a")


# The story

LATE = slice(25, None)  # an estimator has forgotten its first guess after 5 s
SIGMA = "Array.from({{ length: {loop}.samples }}, (_, k) => {loop}.sigma({name!r})(k))"


def rms(values):
    return np.sqrt(np.mean(np.square(values)))


def log_of_step(live, step):
    """Its columns, and the measurements."""
    c = live.log(f"story.steps.{step}.loop")
    return c | dict(z=np.column_stack([c[name] for name in MEASUREMENTS]))


def sigma_of(live, step, name):
    return live.floats(SIGMA.format(loop=f"story.steps.{step}.loop", name=name))


def ekf():
    """The public one with the six states of the page's."""
    model = rhec.RHE(process_noise="prediction", guess=GUESS).model
    noise = tuning.NOISES["rhe"]["prediction"]._asdict()
    start = dict(guess=GUESS, sigma_guess=paper.SIGMA_W_RHE)
    return rhec.EKF(model=model, dt=paper.DT_S, **noise, **start)


def assert_says(live, step, verdict, numbers):
    """numbers: {name: text, or (value, decimals)}."""
    words = {
        name: of if isinstance(of, str) else f"{of[0]:.{of[1]}f}" for name, of in numbers.items()
    }
    told, answer = (live.page.inner_text(f"#step-{step} .{part}") for part in ("told", "answer"))
    assert told == STORY[step]["told"].format(**words)
    expected = STORY[step][verdict].format(**words)
    assert answer == (f"✓ {expected}" if verdict == "right" else expected)


# What a step says, as numbers and their decimals, and the lines that it draws.


def shown_by_encoders(live, c, time):
    k = round(time / paper.DT_S)
    poses = [np.array([c[name][0] for name in POSE])]
    for _, _, nu, omega in c["z"][1:]:
        turn = omega * paper.DT_S
        way = nu * paper.DT_S * np.sinc(turn / 2 / np.pi)  # along the chord of an arc
        middle = poses[-1][2] + turn / 2
        poses.append(poses[-1] + [way * np.cos(middle), way * np.sin(middle), turn])
    reckoned = np.array(poses)[: k + 1, :2]
    driven = c["xy"][: k + 1]
    error = np.hypot(*(reckoned - driven)[-1])
    way = np.hypot(*np.diff(driven, axis=0).T).sum()
    numbers = dict(time=(time, 1), error=(error, 2), way=(way, 1))
    return numbers, {("encoders-0", "--run0"): driven, ("encoders-0", "--run1"): reckoned}


def shown_by_filter(live, c, soil):
    error = c["theta_hat_rad"] - c["theta_rad"]
    sigma = sigma_of(live, "filter", "theta_rad")
    outside = 100 * np.mean((np.abs(error) > 2 * sigma)[LATE])
    numbers = dict(outside=(outside, 0), kappa=(c["kappa"][LATE].mean(), 2))
    return numbers, {("filter-0", "--run1"): np.column_stack([c["time"], error])}


def shown_by_kalman(live, c, bounds):
    script = "bounds => compare(story.steps.kalman.loop, story.steps.kalman.tools, bounds)"
    shortest = np.array(live.page.evaluate(script, bounds))[:, 0]
    filtered = ekf()
    kalman = np.array([[*step.x, *step.p] for step in map(filtered.feedback, c["z"])])
    gaps = np.hypot(*(shortest - kalman)[:, :2].T)
    gnss = np.hypot(*(c["xy"] - c["z"][:, :2]).T)
    kappa = np.abs((shortest - kalman)[LATE, 5]).max()
    numbers = dict(largest=(1e3 * gaps[LATE].max(), 2), kappa=(kappa, 3))
    numbers |= dict(rms=(1e3 * rms(gaps[LATE]), 2), gnss=(1e3 * rms(gnss), 0))
    # With W by prediction a window of one interval is nearly the filter; it is linearised anew.
    assert bounds or 1e-6 < gaps[LATE].max() < 1e-3
    return numbers, {("kalman-0", "--run0"): np.column_stack([c["time"], gaps])}


def shown_by_row(live, c, time):
    sigma = sigma_of(live, "row", "kappa")
    k = round(time / paper.DT_S)
    best = 50 + np.argmax(sigma[50:])
    numbers = dict(time=(time, 1), sigma=(sigma[k], 3), x=(c["x_m"][k], 1))
    numbers |= dict(largest=(sigma[best], 3), after=(sigma[best + 50], 3), later="10")
    lines = {("row-0", "--run0"): np.column_stack([c["time"], sigma])}
    return numbers, lines | {("row-1", "--run0"): c["xy"][: k + 1]}


def shown_by_noise(live, c, sigma):
    estimate = c["kappa_hat"]
    jumps = np.sum(np.abs(np.diff(estimate)) > 0.2)
    bound = 100 * np.mean((estimate <= 0) | (estimate >= 1))
    error = rms((estimate - c["kappa"])[LATE])
    numbers = dict(sigma=(sigma, 3), jumps=(jumps, 0), rms=(error, 2))
    numbers |= dict(bound=(np.floor(bound + 0.5), 0))
    lines = {("noise-0", "--run0"): np.column_stack([c["time"], estimate])}
    return numbers, lines | {("noise-0", "--ink"): np.column_stack([c["time"], c["kappa"]])}


# Of each step but the third: what it says and draws, its control, its first value and the answer.
STEPS = dict(
    encoders=(shown_by_encoders, "time", 60.0, 18.0),
    filter=(shown_by_filter, "soil", "soft", "default"),
    kalman=(shown_by_kalman, "bounds", True, False),
    row=(shown_by_row, "time", 20.0, 61.0),
    noise=(shown_by_noise, "sigma", 0.25, 0.0101),
)


@pytest.mark.parametrize("step", STEPS)
def test_a_step_says_and_draws_what_its_run_shows_and_is_open_until_answered(live, step):
    shown_by, control, first, answer = STEPS[step]
    assert_says(live, step, "wrong", shown_by(live, log_of_step(live, step), first)[0])
    live.set(step, control, np.log10(answer) if step == "noise" else answer)
    numbers, lines = shown_by(live, log_of_step(live, step), answer)
    assert_says(live, step, "right", numbers)
    marks = live.marks()
    for (canvas, colour), points in lines.items():
        (found, *_) = marks[canvas].of("line", colour)
        np.testing.assert_allclose(found, points, atol=2e-6, err_msg=canvas)
        assert marks[canvas].has_room_for(found[LATE])


# Step 3 at a sample: what is not public of its window.
WINDOW = """([k, arrival]) => {
    const { loop, tools } = story.steps.window
    const { bounded, free } = take_sample(loop, tools, k, arrival)
    return {
        m: piece_of(tools, bounded.memory, "m")[0], P: piece_of(tools, bounded.memory, "P"),
        kappa: bounded.estimate[5], sigma: Math.sqrt(bounded.covariance[35]),
        free: [...free.estimate],
        costs: costs_of(tools, bounded.memory, noises(loop).V),
    }
}"""


def said_of_window(time_s, seen, known):
    """What the third step says after feedback."""
    gnss, speed, yaw_rate = np.sum(seen["costs"]["nodes"], axis=0)
    arrival = seen["costs"]["arrival"]
    costs = dict(gnss=gnss, speed=speed, input=yaw_rate, arrival=arrival)
    costs |= dict(cost=gnss + speed + yaw_rate + arrival)
    numbers = {name: (of, 1) for name, of in costs.items()} | dict(time=(time_s, 1))
    numbers |= dict(kappa=(seen["kappa"], 3), free=(seen["free"][5], 3), sigma=(seen["sigma"], 3))
    return numbers | dict(phase="Feedback", known=(known, 3), factor=(seen["sigma"] / known, 0))


def test_the_third_step_shows_the_window_of_the_public_rhe(live):
    """At 65 s, when a bound holds κ; and the costs of a fit by matrices."""
    k = 325
    live.set("window", "time", k * paper.DT_S)
    c = log_of_step(live, "window")
    marks = live.marks()
    seen = live.page.evaluate(WINDOW, [k, True])
    rhe = rhec.RHE(process_noise="prediction", guess=GUESS)
    for z_N in c["z"][: k + 1]:
        rhe.prepare()
        estimate = rhe.feedback(z_N)
    assert estimate.kappa == 1 and seen["free"][5] > 1.02
    last = slice(k - 15, k + 1)
    z = c["z"][last]
    fits = rhe.x_window.T
    v = [z[0, 3], *rhe.u_window.ravel()]  # that of the interval before the window has no cost
    fitted = np.column_stack([fits[:, :2], np.full(16, estimate.nu), v])
    half = ((z - fitted) / tuning.NOISES["rhe"]["prediction"].sigma_v) ** 2 / 2
    nodes = np.column_stack([half[:, 0] + half[:, 1], half[:, 2], half[:, 3]])
    gap = [*fits[0], *estimate[3:6]] - np.array(seen["m"])
    P = np.array(seen["P"])
    costs = dict(nodes=nodes, arrival=gap @ np.linalg.solve(P, gap) / 2)
    sigma = np.sqrt(estimate.covariance[5, 5])
    seen |= dict(kappa=estimate.kappa, sigma=sigma, costs=costs)
    assert_says(live, "window", "wrong", said_of_window(65, seen, sigma))
    # Fits and positions in the frame of the middle pose, and bars as high as the costs.
    for colour, places in (("--run0", fits), ("--measured", z)):
        found = marks["window-0"].of("dots", colour)[0]
        np.testing.assert_allclose(found, seen_from(fits[8])(places), atol=1e-6)
    bars = [marks["window-1"].of("area", of) for of in ("--measured", "--run1", "--run2", "--plan")]
    heights = [[bar[:, 1].max() for bar in of] for of in bars]
    np.testing.assert_allclose(np.transpose(heights[:3]), nodes, atol=1e-4)
    assert heights[3] == pytest.approx([costs["arrival"]], rel=1e-4)
    places = [bar[:, 0].mean() for bar in bars[1] + bars[3]]
    np.testing.assert_allclose(places, [*np.arange(16), -1], atol=0.1)
    # κ and μ without bounds and with them, and as the arrival cost has them.
    both = [5, 4]
    points = np.concatenate(marks["window-2"].of("dots", "--run0"))
    expected = [np.take(of, both) for of in (seen["free"], estimate[:6])]
    np.testing.assert_allclose(points, expected, atol=1e-6)
    (prior,) = marks["window-2"].of("line", "--plan")
    assert_ellipse(prior, np.take(seen["m"], both), P[np.ix_(both, both)])


def test_the_third_step_without_its_arrival_cost_and_phase_by_phase(live):
    page = live.page
    k = 250
    live.set("window", "time", k * paper.DT_S)
    live.set("window", "arrival", False)
    seen = page.evaluate(WINDOW, [k, False])
    seen["costs"]["arrival"] = 0
    known = sigma_of(live, "window", "kappa")[k]
    assert_says(live, "window", "right", said_of_window(50, seen, known))
    for phase, following in (("Preparation", "feedback"), ("Feedback", "preparation")):
        page.click("#step-window [name=next]")
        live.settled()
        told = page.inner_text("#step-window .told")
        assert told.startswith(phase) and " at 50.2 s: " in told
        assert page.inner_text("#step-window [name=next]") == f"next: {following}"


def test_the_last_step_compares_the_runs_of_the_field(live):
    page = live.scene("a").page
    assert page.inner_text("#step-sandbox .answer") == STORY["sandbox"]["idle"]
    live.scene("b")
    for soil in ("default", "soft"):
        page.select_option("#soil", soil)
        live.settled()
        loops = "page.loops.map(loop => loop.metrics.max_error_true_m)"
        rhe, ekf_ = page.evaluate(loops)
        numbers = dict(rhe=(rhe, 2), ekf=(ekf_, 2), ratio=(ekf_ / rhe, 1))
        assert_says(live, "sandbox", "right" if ekf_ > 2 * rhe else "wrong", numbers)
