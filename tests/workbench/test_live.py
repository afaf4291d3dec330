"""The live page without a browser: its C makes the same world, its Functions the same run."""

import ctypes
import subprocess
import sys
from pathlib import Path

import casadi as ca
import numpy as np
import pytest

import rhec
from rhec.core._casadi import compiled
from rhec.simulation import closed_loop
from rhec.simulation.columns import COLUMNS
from rhec.tracked_robot import plant, tuning
from rhec.workbench import report
from rhec.workbench.live import functions, page, texts, wasm

SCRIPTS = sorted(Path(page.__file__).parent.glob("*.js"))


@pytest.fixture(scope="module")
def world(tmp_path_factory):
    """The page's noise and soil as a library of this machine."""
    if not compiled.compiler():
        pytest.skip("there is no C compiler")
    folder = tmp_path_factory.mktemp("world")
    (folder / "world.c").write_text(texts.world_text())
    command = [compiled.compiler(), *compiled.FLAGS, "world.c", "-o", "world.so", "-lm"]
    subprocess.run(command, cwd=folder, check=True)
    return ctypes.CDLL(str(folder / "world.so"))


def array(library, name, n):
    """An array of the library, as NumPy's."""
    return np.frombuffer((ctypes.c_double * n).in_dll(library, f"at_{name}"))


@pytest.mark.parametrize("seed", texts.SEEDS)
def test_noise_is_that_of_the_seed_in_every_bit(world, seed):
    expected = plant.draw_noise(seed, texts.MOST)
    wide = expected.shape[1] + 3
    world.noise(seed, wide)
    found = array(world, "stream", texts.MOST * wide).reshape(texts.MOST, wide)
    assert np.array_equal(found[:, :-3], expected)


@pytest.mark.parametrize("kind", texts.SOILS)
@pytest.mark.parametrize("seed, offset_m", [(0, -3.0), (4, 0.7), (7, 3.0), (9, 0.0)])
def test_soil_is_that_of_the_scenario_in_every_bit(world, kind, seed, offset_m):
    patches = ((15.0, 0.0, 2.5, 0.7, 0.55), (15.5, 1.0, 1.0, 0.5, 0.5))[: seed % 3]
    scenario = rhec.Scenario(
        seed=seed, start_offset_m=offset_m, patches=patches, **texts.SOILS[kind]
    )
    settings = closed_loop.set_up(scenario).settings
    array(world, "patches", 5 * len(patches))[:] = np.ravel(patches)
    world.soil(seed, [*texts.SOILS].index(kind), ctypes.c_double(offset_m), len(patches))
    assert np.array_equal(array(world, "slip", len(settings["slip"])), settings["slip"])
    assert np.array_equal(array(world, "origin_m", 2), settings["origin_m"])


OWN = dict(q=(1.0, 2.0, 3.0), r=4.0, speed_mps=0.6, start_offset_m=-0.8, start_yaw_rad=0.5)
GAP = (rhec.Fault(kind="missing", start_s=30.0, duration_s=4.0),)


@pytest.mark.parametrize("name", ["rhe", "ekf", "dual", "dual_cautious", "rhe_robust"])
def test_start_is_the_set_up_of_the_scenario_in_every_bit(name):
    own = page.STRUCTURES[name]
    start = functions.build_live(own)["start"]
    n_w = start.nnz_in("sigma_w")
    scenario = rhec.Scenario(**own, **OWN, guess_yaw_rad=0.1, sigma_w=(0.02,) * n_w)
    given = vars(scenario) | dict(sigma_v=tuning.sigma_v_of(scenario))
    made = start(**{of: ca.DM(given[of]) for of in start.name_in()})
    setup = closed_loop.set_up(scenario)
    for of in {*made} - {"tally"}:
        expected = setup.memory if of == "memory" else setup.settings[of]
        expected = np.ravel(expected, order="F").astype(float)
        assert np.array_equal(made[of].full().ravel(), expected, equal_nan=True), of


@pytest.mark.parametrize("own", [OWN, OWN | dict(duration_s=14.0), dict(OWN, faults=GAP), {}])
def test_the_judge_reports_the_metrics_of_the_run(own):
    """It settles, does not in 14 s, has no position for a while, is one second long."""
    run = rhec.simulate(rhec.Scenario(**{"duration_s": 60.0 if own else 1.0} | own))
    made = functions.build_live({})
    judge, tally = made["judge"], made["start"](**dict.fromkeys(made["start"].name_in(), 1))
    tally, errors = tally["tally"], []
    for row in np.column_stack([run.columns[name] for name in COLUMNS]).astype(float):
        tally, error, metrics = judge(tally, row)
        errors.append(error.full().ravel())
    expected = np.column_stack([run.columns["error_m"], run.columns["error_true_m"]])
    np.testing.assert_allclose(errors, expected, atol=1e-12)
    for name, value in zip(functions.METRICS, metrics.full().ravel()):
        np.testing.assert_allclose(value, run.metrics[name], rtol=1e-9, err_msg=name)


def test_the_script_is_short_and_asks_nothing_of_a_network():
    lines = [line for script in SCRIPTS for line in script.read_text("utf-8").splitlines()]
    assert len(lines) <= 400 and max(map(len, lines)) <= 100
    assert not [line for line in lines if "fetch(" in line or "://" in line or "import(" in line]


def test_without_a_compiler_the_report_says_that_it_has_pictures_alone(monkeypatch, capsys):
    asked = []
    monkeypatch.setattr(wasm, "_compiler", lambda: None)
    monkeypatch.setattr(report, "build", lambda notebooks, live: asked.append(live))
    monkeypatch.setattr(sys, "argv", ["report", "one.ipynb"])
    report._main()
    assert asked == [False]
    assert capsys.readouterr().out.splitlines()[0] == (
        "report: with pictures alone, since nothing here compiles C to WebAssembly"
    )
