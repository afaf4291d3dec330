"""The live page without a browser: what it is built from equals what `rhec.simulate` uses."""

import base64
import gzip

import numpy as np
import pytest

import rhec
from docs.live import functions, page, wasm, window
from rhec import paper
from rhec.simulation import closed_loop
from rhec.simulation.columns import COLUMNS, ESTIMATE, MEASUREMENTS
from rhec.tracked_robot import plant

START = dict(start_offset_m=-0.8, start_yaw_rad=0.5, guess_yaw_rad=0.1, speed_mps=0.6)
GAP = (rhec.Fault(kind="missing", start_s=30.0, duration_s=4.0),)


def unpack(text, kind):
    """An array that the page loads as text."""
    return np.frombuffer(gzip.decompress(base64.b64decode(text)), dtype=kind)


def test_noise_of_a_seed_is_rounded_to_a_step():
    expected = plant.draw_noise(3, functions.MAX_SAMPLES)
    noise = unpack(page.seed_data(3)["noise"], np.int16).reshape(expected.shape)
    np.testing.assert_allclose(page.NOISE_STEP * noise, expected, atol=page.NOISE_STEP / 2)


@pytest.mark.parametrize("kind", page.SOILS)
@pytest.mark.parametrize("seed, offset_m", [(0, -3.0), (4, 0.7), (9, 0.0)])
def test_soil_of_every_start_is_a_part_of_the_data(kind, seed, offset_m):
    soils = page.seed_data(seed)["soils"]
    widest = closed_loop.set_up(rhec.Scenario(start_offset_m=3.0)).terrain.mu.shape
    scenario = rhec.Scenario(seed=seed, start_offset_m=offset_m, **page.SOILS[kind])
    terrain = closed_loop.set_up(scenario).terrain
    fields = page.TRACTION_STEP * unpack(soils[kind], np.uint16).reshape(2, *widest)
    rows, columns = terrain.mu.shape
    expected = np.stack([terrain.mu, terrain.kappa])
    np.testing.assert_allclose(fields[:, :rows, :columns], expected, atol=page.TRACTION_STEP)


@pytest.mark.parametrize("name", page.STRUCTURES)
def test_the_first_memory_is_affine_in_the_start(name):
    own = page.STRUCTURES[name]
    memory, directions = page.affine_memory(own)
    for field, direction in directions.items():
        memory = memory + START[field] * direction
    expected = closed_loop.set_up(rhec.Scenario(**own, **START)).memory
    np.testing.assert_allclose(memory, expected, atol=1e-12)


@pytest.mark.nightly(keep=1)
@pytest.mark.parametrize("own", [START, dict(faults=GAP), dict(start_offset_m=2.9)])
def test_errors_are_those_of_the_run(own):
    run = rhec.simulate(rhec.Scenario(duration_s=120.0, **own))
    rows = np.column_stack([run.columns[name] for name in COLUMNS]).astype(float)
    errors = functions.build_functions(rhec.Scenario())["errors"]
    found = dict(zip(functions.ERRORS, errors.map(len(rows))(rows.T).full()))
    for name in ("error_m", "error_true_m", "on_straight"):
        np.testing.assert_allclose(found[name], run.columns[name], atol=1e-12, err_msg=name)
    assert {*found["on_straight"]} == {0, 1}
    np.testing.assert_allclose(np.abs(found["left_m"]), found["error_true_m"], atol=1e-12)


def test_left_of_the_racetrack_is_its_inside():
    x = paper.ROW_LENGTH_M / 2
    assert float(functions.left_of_racetrack(x, 1.0)) == pytest.approx(1.0)
    assert float(functions.left_of_racetrack(x, -1.0)) == pytest.approx(-1.0)


def test_every_scene_opens_with_controls_that_exist():
    world = page._world()
    for scene in world["scenes"].values():
        assert scene["fault"] in page.FAULTS and 0 < scene["time_s"] < scene["duration_s"]
        assert {module for _, module, _ in scene["runs"]} <= {*page.STRUCTURES}
        # A picture may ask for the value of every field that has a slider in some scene.
        assert "omega_max_radps" in scene["values"]


def test_without_a_compiler_the_page_is_left_out_and_says_so(monkeypatch, capsys, tmp_path):
    monkeypatch.setattr(wasm, "can_compile", lambda: False)
    monkeypatch.setattr("sys.argv", ["page", str(tmp_path)])
    page._main()
    assert not [*tmp_path.iterdir()]
    assert capsys.readouterr().out == "live page: left out, since ziglang is not installed\n"


@pytest.fixture(scope="module")
def taken_apart():
    """The story's Functions, a setup, its estimator's first memory and some of its measurements."""
    scenario = rhec.Scenario(process_noise="prediction", duration_s=20.0)
    setup = closed_loop.set_up(scenario)
    run = rhec.simulate(scenario)
    z = np.column_stack([run.columns[name] for name in MEASUREMENTS])
    pieces = setup.unpack(setup.memory)["estimator"].values()
    memory = np.concatenate([np.ravel(piece, order="F") for piece in pieces])
    tools = window.build_tools(scenario)
    # The memory of the check of positions follows.
    return tools, setup, memory[: tools["shift"].size1_in("memory")], z, run


def test_shift_and_solve_are_a_sample_of_the_rhe(taken_apart):
    """Their estimates are those of the run; without bounds they may leave 0 to 1."""
    tools, setup, memory, z, run = taken_apart
    V, W, P_0 = (setup.settings[name] for name in ("V", "W", "P_0"))
    beyond = 0
    for k, z_N in enumerate(z):
        shifted = tools["shift"](memory=memory, V=V, W=W)["memory"]
        found = tools["solve"](memory=shifted, z_N=z_N, V=V, P_0=P_0)
        free = tools["free"](memory=shifted, z_N=z_N, V=V, P_0=P_0)["estimate"].full().ravel()
        memory = found["memory"]
        estimate = found["estimate"].full().ravel()
        np.testing.assert_allclose(estimate, [run.columns[name][k] for name in ESTIMATE], atol=1e-9)
        beyond += free[5] > 1 + 1e-6
        if np.all((free[4:] > 0) & (free[4:] < 1)):
            np.testing.assert_allclose(free, estimate, atol=1e-12)
    assert 0 < beyond < len(z)


def test_dead_reckoning_takes_the_encoders_at_their_word(taken_apart):
    """A circle of one radius: speed over yaw rate."""
    pose = np.zeros(3)
    for _ in range(100):
        pose = taken_apart[0]["reckon"](pose=pose, z_N=[9.0, 9.0, 0.5, 0.25])["pose"]
    x, y, theta = pose.full().ravel()
    assert theta == pytest.approx(0.25 * 20)
    assert (x, y) == pytest.approx((2 * np.sin(theta), 2 - 2 * np.cos(theta)), abs=1e-6)


def test_the_words_of_the_story_name_controls_and_modules_that_exist():
    for step in page.STORY.values():
        assert step.get("controls", {}).get("soil", "default") in page.SOILS
        if "run" in step:
            assert step["run"]["module"] in page.STRUCTURES
