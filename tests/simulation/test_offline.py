"""A scenario's estimator on the measurements of a run is the estimator that drove it."""

import dataclasses

import numpy as np
import pytest

import rhec
from rhec.simulation.columns import ESTIMATE
from rhec.simulation.offline import columns, run_estimator, sigma_of_traction

pytestmark = pytest.mark.usefixtures("virtual_machine")
CASES = [
    dict(estimator="ekf"),
    dict(estimator="oracle"),
    dict(sensors=()),
    dict(sensors=("gyro", "heading")),
    dict(backwards=True, guess_yaw_rad=0.5),
]


@pytest.mark.parametrize("case", CASES, ids=str)
def test_offline_it_estimates_what_it_did_in_the_loop(case):
    """It begins where the run did, wherever the scenario that names it begins."""
    run = rhec.simulate(rhec.Scenario(**case, duration_s=20.0))
    start = dict(start_offset_m=3.0, start_yaw_rad=1.0, guess_yaw_rad=-1.0)
    elsewhere = dataclasses.replace(run.scenario, **start)
    offline = run_estimator(elsewhere, run, "estimate")["estimate"]
    np.testing.assert_array_equal(offline, columns(run, ESTIMATE))


def test_a_heading_does_not_change_how_wide_the_band_of_the_traction_is():
    """A yaw that is known better makes no traction less sure; once the band was 4 times as wide."""
    alone, with_heading = (
        sigma_of_traction(rhec.simulate(rhec.Scenario(sensors=sensors, duration_s=20.0)))["mu"]
        for sensors in ((), ("heading",))
    )
    assert np.median(with_heading / alone) == pytest.approx(1.0, abs=0.1)
