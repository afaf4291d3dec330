"""The public face as a caller sees it: `make lint` checks that each call gives what its annotation
says. Other tests run these calls.
"""

from pathlib import Path
from typing import Any, assert_type

import pandas as pd
from numpy.typing import NDArray

import rhec
from rhec.simulation.metrics import Metrics

Array = NDArray[Any]
SCENARIO = rhec.Scenario(process_noise="prediction", duration_s=2.0)


def runs(folder: Path) -> None:
    run = assert_type(rhec.simulate(SCENARIO), rhec.Run)
    scenario = assert_type(run.scenario, rhec.Scenario)
    assert_type(run.metrics, Metrics)
    assert_type(rhec.campaign([scenario], workers=1), pd.DataFrame)
    log = assert_type(run.log, pd.DataFrame)
    assert_type(rhec.logs.read(folder / "log.csv"), pd.DataFrame)
    assert_type(rhec.replay(log, estimator="ekf"), pd.DataFrame)
    assert_type(rhec.export(SCENARIO, folder), Path)


def the_world() -> None:
    path = assert_type(rhec.Path.racetrack(30.0, 7.8), rhec.Path)
    assert_type(path.length_m, float)
    terrain = assert_type(rhec.Terrain.uniform(0.9, 0.8), rhec.Terrain)
    assert_type(terrain.mu, Array)
    assert_type(rhec.Fault(kind="missing", start_s=1.0), rhec.Fault)


def a_loop_of_ones_own(path: rhec.Path) -> None:
    rhe = rhec.RHE()
    rhc = rhec.RHC()
    tracker = rhec.PathTracker(path)
    estimate = rhe.feedback((0.0, 0.0, 0.5, 0.0))
    xi_ref, omega_ref = assert_type(tracker.references(estimate, 0.0), tuple[Array, Array])
    assert_type(rhc.feedback(estimate.pose, estimate.p, xi_ref, omega_ref), float)
    assert_type(rhc.ok, bool)
    assert_type(rhe.ok, bool)
    assert_type(rhc.kkt, float)


def any_robot(model: rhec.Model) -> None:
    noise = dict(sigma_v=(0.1, 0.1), sigma_w=(0.0, 0.01), guess=(0, 0), sigma_guess=(1, 1))
    rhe = assert_type(rhec.RHE(model=model, dt=0.2, horizon=5, **noise), rhec.RHE)
    for estimator in (rhe, rhec.EKF(model=model, dt=0.2, **noise)):
        estimator.prepare()
        estimator.feedback((0.0, 0.5))


def mistakes() -> None:
    """An ignore that nothing needs is an error, so each line must be a mistake for the checker."""
    rhec.Scenario(duration=2.0)  # type: ignore[call-arg]
    rhec.Scenario(duration_s="long")  # type: ignore[arg-type]
    rhec.simulate("the field")  # type: ignore[arg-type]
