"""The public face as a caller sees it: `make lint` checks the types of these calls, and that each
gives what its annotation says; run, they are what they say.
"""

import dataclasses
from pathlib import Path
from typing import Any, assert_type

import pandas as pd
import pytest
from numpy.typing import NDArray

import rhec
from rhec.simulation.metrics import Metrics

pytestmark = pytest.mark.usefixtures("virtual_machine")
Array = NDArray[Any]
SCENARIO = rhec.Scenario(process_noise="prediction", duration_s=2.0)


def test_one_run_and_many() -> None:
    run = assert_type(rhec.simulate(SCENARIO), rhec.Run)
    scenario = assert_type(run.scenario, rhec.Scenario)
    log = assert_type(run.log, pd.DataFrame)
    metrics = assert_type(run.metrics, Metrics)
    table = assert_type(rhec.campaign([scenario], workers=1), pd.DataFrame)
    assert isinstance(log, pd.DataFrame) and isinstance(table, pd.DataFrame) and len(table) == 1
    assert {type(value) for value in metrics.values()} <= {float, int, bool}


def test_a_recorded_log(tmp_path: Path) -> None:
    long = dataclasses.replace(SCENARIO, duration_s=60.0)  # after which the yaw is known
    rhec.simulate(long).log.to_csv(tmp_path / "log.csv", index=False)
    log = assert_type(rhec.logs.read(tmp_path / "log.csv"), pd.DataFrame)
    estimates = assert_type(rhec.replay(log, estimator="ekf"), pd.DataFrame)
    assert len(estimates) == len(log)


def test_the_world() -> None:
    path = assert_type(rhec.Path.racetrack(30.0, 7.8), rhec.Path)
    terrain = assert_type(rhec.Terrain.uniform(0.9, 0.8), rhec.Terrain)
    fault = assert_type(rhec.Fault(kind="missing", start_s=1.0), rhec.Fault)
    assert_type(path.length_m, float)
    mu = assert_type(terrain.mu, Array)
    assert mu.shape == (2, 2) and fault.start_s == 1.0


def test_a_loop_of_ones_own() -> None:
    path = rhec.Path.racetrack(30.0, 7.8)
    rhe, rhc, tracker = rhec.RHE(), rhec.RHC(), rhec.PathTracker(path)
    rhe.prepare()
    rhc.prepare()
    estimate = rhe.feedback((0.0, 0.0, 0.5, 0.0))
    xi_ref, omega_ref = assert_type(tracker.references(estimate, 0.0), tuple[Array, Array])
    omega = assert_type(rhc.feedback(estimate.pose, estimate.p, xi_ref, omega_ref), float)
    assert type(omega) is float and assert_type(rhc.ok, bool) and assert_type(rhe.ok, bool)
    assert_type(rhc.kkt, float)


def test_any_robot() -> None:
    model = rhec.Model(
        states=("x_m",),
        inputs=("v_mps",),
        parameters={"slip": (0, 1)},
        outputs=("x_m", "v_mps"),
        f=lambda x, u, p: u * (1 - p),
    )
    noise = dict(sigma_v=(0.1, 0.1), sigma_w=(0.0, 0.01), guess=(0, 0), sigma_guess=(1, 1))
    rhe = assert_type(rhec.RHE(model=model, dt=0.2, horizon=5, **noise), rhec.RHE)
    ekf = rhec.EKF(model=model, dt=0.2, **noise)
    for estimator in (rhe, ekf):
        estimator.prepare()
        assert estimator.feedback((0.0, 0.5)).x.shape == (1,)


def on_a_robot(folder: Path) -> None:
    """For the type checker alone: other tests run an export."""
    assert_type(rhec.export(SCENARIO, folder), Path)


def test_what_is_wrong_is_wrong_for_a_type_checker_too() -> None:
    """An ignore that nothing needs is an error, so each line below must be one for the checker."""
    with pytest.raises((TypeError, ValueError)):
        rhec.Scenario(duration=2.0)  # type: ignore[call-arg]
    with pytest.raises((TypeError, ValueError)):
        rhec.Scenario(duration_s="long")  # type: ignore[arg-type]
    with pytest.raises((TypeError, ValueError)):
        rhec.simulate("the field")  # type: ignore[arg-type]
