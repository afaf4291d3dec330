"""The share of fields in which the promise is kept, beside the speed."""

import dataclasses

import numpy as np
import pandas as pd
import pytest

import rhec
from notebooks.further import tolerance

SHORT = dict(
    turns="figure_of_eight",
    row_length_m=6.0,
    headland_radius_m=6.0,
    start_offset_m=0.1,
    estimator="oracle",
)
DRIVE = rhec.Scenario(**SHORT, duration_s=150.0)


def driven(run):
    """The samples of the first lap that count, recounted."""
    after = run.log["t_s"] >= run.metrics["settling_time_s"] + 5 - 1e-9
    return run.log[after & (run.log["s_m"] < run.path.length_m)]


def test_a_lap_is_judged_from_settling_to_the_end_of_the_path():
    run = rhec.simulate(DRIVE)
    log, lap = driven(run), tolerance.lap(run)
    assert lap.error_m == pytest.approx(log["error_true_m"].max())
    assert lap.speed_mps == pytest.approx(log["nu_mps"].mean())
    assert lap.whole == (log["error_true_m"].max() <= 0.12)
    assert len(log) < len(run.log) - 100  # what came after the lap does not count


def test_who_has_not_driven_the_path_has_not_kept_the_promise():
    lap = tolerance.lap(rhec.simulate(dataclasses.replace(DRIVE, duration_s=60.0)))
    assert not (lap.whole or lap.rows or lap.corners) and np.isnan(lap.error_m)


@pytest.fixture(scope="module")
def table():
    """The study on a short path with two loops, one of which drives too fast on bumpy ground."""
    with pytest.MonkeyPatch.context() as patched:
        loops = {
            "slow": (SHORT | dict(speed_mps=0.4), 0.25),
            "fast": (SHORT | dict(speed_mps=0.7, bump_sigma_radps=0.3), 0.25),
        }
        patched.setattr(tolerance, "LOOPS", loops)
        patched.setattr(tolerance, "IN_WORLDS", ("default", "uncertain"))
        return tolerance.drive(12)


@pytest.mark.nightly
def test_fields_are_counted_and_the_verdict_needs_share_and_speed(table):
    whole = table[table["promise"] == tolerance.PROMISES["whole"]]
    whole = whole.set_index(["world", "loop", "speed"]).sort_index()
    slow, fast = (whole.loc[("default", loop, tolerance.CONSTANT)] for loop in ("slow", "fast"))
    slow_drive = dataclasses.replace(DRIVE, speed_mps=0.4)
    runs = rhec.simulate([dataclasses.replace(slow_drive, seed=k) for k in range(12)])
    kept = [tolerance.lap(run) for run in runs]
    assert slow["share"] == np.mean([lap.whole for lap in kept])
    assert slow["low"] < slow["share"] or slow["share"] == 0
    assert fast["share"] < slow["share"]
    assert slow["speed_mps"] == pytest.approx(0.4, abs=0.005)
    assert (whole["n"] == 12).all()

    def verdict(least_share, least_speed_mps):
        judged = tolerance.judged(pd.DataFrame([slow]), least_share, least_speed_mps)
        return judged["verdict"].item()

    assert verdict(0.3, 0.3) == "holds"
    assert verdict(0.999, 0.3) == "undecided"
    assert verdict(0.3, 0.45) == "does not hold"


def test_a_lap_is_that_of_the_longest_drive(monkeypatch):
    """The second robot starts so far away that it is late, and the third never comes back."""
    driven = []

    def map_runs(function, scenarios):
        driven.extend(scenarios)
        return [function(rhec.simulate(scenario)) for scenario in scenarios]

    monkeypatch.setattr(tolerance, "map_runs", map_runs)
    late = SHORT | dict(start_offset_m=0.6, kappa_mean=0.6, mu_deviation=0.0)
    changes = dict(speed_mps=0.4), dict(mu_mean=0.8, terrain=rhec.Terrain.uniform(0.7, 0.8)), {}
    scenarios = [rhec.Scenario(**late | change, seed=5) for change in changes]
    scenarios[2] = dataclasses.replace(scenarios[2], omega_max_radps=1e-9)
    found = tolerance.laps(scenarios)
    longest = [
        tolerance.lap(
            rhec.simulate(dataclasses.replace(each, duration_s=tolerance.longest_s(each)))
        )
        for each in scenarios
    ]
    pd.testing.assert_frame_equal(found, pd.DataFrame(longest))
    assert np.isnan(found["error_m"]).tolist() == [False, False, True]
    assert len(driven) == 3 + 2  # two were not back in the usual time
