"""The live page of the report, opened from the disk: what it runs and what it shows."""

import base64
import random
import re
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pandas as pd
import pytest
from helpers import LIVE_PAGE, needs_live_page, wait_until

import rhec
from rhec import paper
from rhec.core._casadi import compiled, scan
from rhec.logs import recording, replay
from rhec.simulation import closed_loop
from rhec.simulation.columns import COLUMNS, MEASUREMENTS, POSE
from rhec.tracked_robot import tuning
from rhec.workbench.live.page import FAULTS, SCENES, SEEDS, SOILS, own_log_scenario

pytestmark = needs_live_page


class Live:
    """What a reader does with the page, and finds on it."""

    def __init__(self, page):
        self.page = page
        page.goto(LIVE_PAGE.as_uri())
        self.settled()

    def settled(self):
        wait_until(self.page, "page.busy && !asked")
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

    def fields(self):
        """Results on other fields, when all are there: noise, soil and the metrics of the runs."""
        wait_until(
            self.page, "fields.pairs.length && fields.results.length === fields.pairs.length"
        )
        self.settled()
        return self.page.evaluate(
            """fields.results.map(({noise, soil, runs}) => ({noise, soil, runs: runs.map(
                ({metrics, x_m}) => ({...metrics, x_m: [...x_m]}))}))"""
        )

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
                # Some 20 µm from where a bend begins, Python counts a sample as of the row.
                sample = 1 if name.startswith("violations") else 0
                np.testing.assert_allclose(
                    float(value), native.metrics[name], rtol=1e-9, atol=sample, err_msg=name
                )


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
    live.page.check("#many")
    live.fields()
    inks = live.page.evaluate(
        """() => [...document.querySelectorAll("#pictures canvas, #histogram")].map(canvas => {
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
    assert len(inks) == 7 and min(inks) > 20, inks


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
    if live.page.is_enabled("#window"):
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


def time_of(live):
    return float(live.page.inner_text("#time").removesuffix(" s"))


def test_the_run_plays_by_button_and_by_space_bar(live):
    live.page.select_option("#pace", "4")
    begun = time_of(live)
    live.page.click("#play")
    wait_until(live.page, f"parseFloat($('time').value) > {begun} + 1")
    live.page.click("#play")
    live.settled()
    stopped, pictures = time_of(live), live.pictures()
    live.page.wait_for_timeout(300)
    assert time_of(live) == stopped and live.pictures() == pictures
    live.page.locator("#moment").focus()
    live.page.keyboard.press("Space")
    wait_until(live.page, f"parseFloat($('time').value) > {stopped}")
    live.page.keyboard.press("Space")
    assert live.page.inner_text("#play") == "play"


def test_leaves_are_touched_where_the_robot_comes_nearer_than_half_the_free_space(live):
    """Against rectangles in NumPy, at three times of a run that begins beside its row."""
    live.choose(scene="b", seed="4")
    (run, _) = live.runs()
    x, y, theta = (run["rows"][:, COLUMNS.index(name)] for name in POSE)
    free = paper.ROBOT_WIDTH_M / 2 + paper.TOLERANCE_M
    along = np.arange(0, 30, 0.15)
    rows = [middle + side * free for middle in (0.0, 15.6) for side in (1, -1)]
    plants = np.array(live.page.evaluate("page.world.plants"))[:, :2]
    assert len(plants) == len(along) * len(rows) and {*plants[:, 1]} == {*np.round(rows, 3)}
    away = plants[:, None] - np.column_stack([x, y])
    ahead = away[..., 0] * np.cos(theta) + away[..., 1] * np.sin(theta)
    left = away[..., 1] * np.cos(theta) - away[..., 0] * np.sin(theta)
    inside = (abs(ahead) <= paper.ROBOT_LENGTH_M / 2) & (abs(left) <= paper.ROBOT_WIDTH_M / 2)
    for share in (0.01, 0.3, 0.999):
        live.page.evaluate(f"$('moment').value = {share}; ask(draw)")
        live.settled()
        now = round(time_of(live) / 0.2)
        wanted = inside[:, : now + 1].any(axis=1).sum()
        assert int(live.page.locator("#touched").inner_text()) == wanted
    assert 0 < wanted < len(plants)


def test_bends_tell_more_of_kappa_than_straight_rows(live):
    """The glow is the share of the variance of κ that the last 15 samples removed."""
    live.choose(scene="b")
    told, sigma, straight = np.array(
        live.page.evaluate("""() => {
            const [loop] = page.loops
            const all = [telling_of(loop), loop.sigma("kappa"), loop.get("on_straight")]
            return all.map(of => Array.from({length: loop.samples}, (_, k) => of(k)))
        }""")
    )
    grown = sigma[:-15] ** 2 + 15 * tuning.SIGMA_W["rhe"]["calibrated"][5] ** 2
    np.testing.assert_allclose(told[15:], np.maximum(1 - sigma[15:] ** 2 / grown, 0), atol=1e-9)
    settled = np.arange(len(told)) > 100
    on_rows, on_bends = (told[settled & (straight == of)] for of in (1, 0))
    assert np.median(on_bends) > 3 * np.median(on_rows)


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


# Other fields, and challenges


def test_workers_drive_each_seed_as_the_page_does(live):
    """Ten fields of a challenge: the same runs as those of the list of seeds, to the last bit."""
    live.page.select_option("#challenge", "patch")
    live.settled()
    live.page.click("#patch")
    found = {field["noise"]: field["runs"] for field in live.fields()}
    assert [*sorted(found)] == [*SEEDS]
    for seed in ("0", "7"):
        live.choose(seed=seed)
        for run, field in zip(live.runs(), found[int(seed)]):
            x_m = run["rows"][::4, COLUMNS.index("x_m")].astype(np.float32)
            np.testing.assert_array_equal(np.array(field["x_m"], np.float32), x_m)
            assert field["mean_error_true_m"] == float(run["metrics"]["mean_error_true_m"])


def test_a_hundred_fields_are_all_pairs_of_noise_and_soil(live):
    live.choose(scene="a")
    plain = live.pictures()
    live.page.check("#many")
    found = live.fields()
    assert {(field["noise"], field["soil"]) for field in found} == {
        (noise, soil) for noise in SEEDS for soil in SEEDS
    }
    assert len({tuple(field["runs"][0]["x_m"]) for field in found}) == 100
    assert live.pictures()[0] != plain[0]
    words = live.page.inner_text("#violations_said")
    for i, (name, *_) in enumerate(SCENES["a"]["runs"]):
        counts = [field["runs"][i]["violations"] for field in found]
        said = f"{name}: none on {counts.count(0)} of 100 fields, median {sorted(counts)[50]}, "
        assert f"{said}most {max(counts)}" in words
    live.page.uncheck("#many")
    live.settled()
    assert live.pictures()[:6] == plain[:6]


@pytest.mark.parametrize("challenge", ["settle", "patch", "cautious"])
def test_a_challenge_is_scored_by_its_rule_and_refuses_other_means(live, challenge):
    page = live.page
    page.select_option("#challenge", challenge)
    live.settled()
    assert len(page.inner_text("#task")) > 50
    if challenge == "patch":
        assert page.inner_text("#score") == "There must be one wet patch."
        page.evaluate("page.patches = [[37.8, 7.8, 3, 0.9, 0.55]]; ask(drive)")
    if challenge == "cautious":
        live.choose(soil="soft")
    if challenge == "settle":
        page.locator("[name=run-a][value='1']").check()
        page.evaluate("page.values.r = 1; page.values.look_ahead_m = 0.3; ask(drive)")
    live.settled()
    rule = dict(
        settle=lambda q1, q2, q3: (q2["settling_time_s"] or 99) < 15 and q2["overshoot_m"] < 0.1,
        patch=lambda rhe, ekf: rhe["max_error_true_m"] <= 0.25 < ekf["max_error_true_m"],
        cautious=lambda rhe, drift, cautious: cautious["violations_true"] > 0,
    )[challenge]
    won = [rule(*field["runs"]) for field in sorted(live.fields(), key=lambda each: each["noise"])]
    marks = " ".join("✓" if each else "✗" for each in won)
    assert page.inner_text("#score") == f"{sum(won)} of 10 fields: {marks}"
    assert sum(won) > 0
    live.move(page.locator("#sliders input[data-field=gnss_sigma_m]"), 0.9)
    live.settled()
    assert "A slider has moved" in page.inner_text("#score")


# A reader's own log

EXAMPLE = Path(__file__).parents[2] / "data/example_log.csv"
ESTIMATED = """own_log.found.map(({t_s, stream, yaw_rad, rows}) => {
    const numbers = of => [...of].map(x => isFinite(x) ? x : null)
    return {t_s: [...t_s], stream: numbers(stream), yaw_rad, rows: numbers(rows)}
})"""


def rough(log):
    """The log with rows lost, gaps of 1 and 5 s, times that jitter, and numbers that are absurd."""
    chance = np.random.default_rng(3)
    log = log.copy()
    log["t_s"] += chance.uniform(0, 0.05, len(log)).round(4)
    log.loc[chance.random(len(log)) < 0.05, "speed_mps"] = np.nan
    log.loc[chance.random(len(log)) < 0.02, "x_m"] = 1e12
    keep = chance.random(len(log)) > 0.1
    for begin, long_s in ((20.0, 1.0), (40.0, 5.0)):
        keep &= ~log["t_s"].between(begin, begin + long_s)
    return log[keep]


def estimated_in_python(log, found):
    """Samples of `rhec.replay` for each segment, with the page's choice of the first yaw."""
    yaw_rad = tuple(part["yaw_rad"] for part in found)
    first = replay.InitialGuess(yaw_rad=yaw_rad, sigma_yaw_rad=np.pi / replay.N_HEADINGS)
    samples = replay.estimate_samples(recording.prepare(log), own_log_scenario(), first)
    return [part for _, part in samples.groupby("segment")]


@pytest.mark.parametrize("make", [lambda log: log, rough], ids=["example", "rough"])
def test_an_own_log_is_estimated_as_in_python(live, tmp_path, make):
    log = make(pd.read_csv(EXAMPLE))
    log.to_csv(tmp_path / "log.csv", index=False)
    live.page.set_input_files("#own_file", tmp_path / "log.csv")
    wait_until(live.page, "own_log.found.length")
    found = live.page.evaluate(ESTIMATED)
    parts = estimated_in_python(pd.read_csv(tmp_path / "log.csv"), found)
    assert len(parts) == len(found) == 2
    for part, page in zip(parts, found):
        n = len(page["t_s"])
        assert n > 400
        np.testing.assert_allclose(page["t_s"], part["t_s"])
        z = np.array(page["stream"], float).reshape(n, 5)[:, :4]
        np.testing.assert_allclose(z, part[MEASUREMENTS], rtol=1e-9, atol=1e-12)
        rows = np.array(page["rows"], float).reshape(n, -1)
        hats = replay.hats_of()
        np.testing.assert_allclose(rows[:, : len(hats)], part[hats], rtol=1e-6, atol=1e-6)
        true_yaw = part["theta_rad"].iloc[-1]
        off = rows[-1, 2] - true_yaw
        assert abs(np.angle(np.exp(1j * off))) < 0.3


def test_columns_of_an_own_log_are_found_or_matched_by_hand(live, tmp_path):
    names = dict(t_s="Time [s]", x_m="east", y_m="north", speed_mps="speed", yaw_rate_radps="my w")
    log = pd.read_csv(EXAMPLE)[[*names, "segment", "pos_ok"]].rename(columns=names)
    log.to_csv(tmp_path / "log.csv", index=False, sep=";")
    live.page.set_input_files("#own_file", tmp_path / "log.csv")
    said = "Which column is yaw_rate_radps?"
    wait_until(live.page, f"$('own_said').textContent === '{said}'")
    live.page.select_option("#own_yaw_rate_radps", "my w")
    wait_until(live.page, "own_log.found.length")
    assert f"{len(log)} rows" in live.page.inner_text("#own_said")
