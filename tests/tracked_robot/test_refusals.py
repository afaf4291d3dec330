"""What paths, trackers, soils and the yaw drift refuse: one sentence that begins with the parameter
and what it was.
"""

import numpy as np
import pytest
from helpers import assert_refused, estimate_of

import rhec

PATH = rhec.Path.racetrack(30.0, 7.8)
NAMES = dict(position=("x_m", "y_m"), heading="yaw_rad")
ONES = np.ones((2, 2))


def references(of, *given):
    """References of a PathTracker with these options."""
    return rhec.PathTracker(PATH, **of).references(*given)


NAMED = NAMES | dict(speed=0.5)
FOUND = estimate_of(x_m=0, y_m=0, yaw_rad=0)
SIX = "estimate was …; it should be (x, y, θ, ν, μ, κ)"
PATHS = [
    (([],), "pieces was []; it "),
    (([(0.0, 0.1)],), "pieces[0][0] was 0.0; it "),
    (([(3.0, 0.0), (-1.0, 0.0)],), "pieces[1][0] was -1.0; it "),
]
TRACKERS = [
    ((NAMES, FOUND), "speed was not given; PathTracker needs position, head"),
    ((NAMED, estimate_of(x_m=0, y_m=0, theta=0)), "…the name 'yaw_rad'; this estimate has"),
    ((NAMED, np.zeros(6)), "estimate was …; it should be an Estimate"),
    ((NAMED, FOUND, 0.1), "omega_measured was 0.1; "),
    (({}, FOUND, 0.0), SIX),
    (({}, np.zeros(6)), "omega_measured was not given"),
]
SOILS = [
    (dict(mu=np.ones(4)), "mu had shape (4,); it must be"),
    (dict(mu=0 * ONES), "mu ranged from 0.0 to 0.0; traction must lie"),
    (dict(kappa=1.1 * ONES), "kappa ranged from 1.1 to 1.1; traction must lie"),
    (dict(kappa=np.nan * ONES), "kappa ranged from nan"),
    (dict(kappa=np.ones((2, 3))), "mu and kappa had shapes (2, 2) and (2, 3)"),
    (dict(cell_m=0.0), "cell_m "),
    (dict(origin_m=(0.0,)), "origin_m "),
    (dict(origin_m=(0.0, np.inf)), "origin_m "),
]
SOIL = dict(mu=ONES, kappa=ONES, origin_m=(0.0, 0.0), cell_m=1.0)
OF_SLIPPING = "speed_model was 'slipping'; with yaw_drift it should be one of"
DRIFTS = [
    (dict(speed_model="slipping"), OF_SLIPPING),
    (dict(estimator="ekf"), "yaw_drift was True; for the estimator 'ekf' it should"),
]
MADE = {
    "Path": (rhec.Path.from_segments, PATHS),
    "PathTracker": (references, TRACKERS),
    "Terrain": (lambda **bad: rhec.Terrain(**SOIL | bad), SOILS),
    "yaw drift": (lambda **bad: rhec.Scenario(yaw_drift=True, **bad), DRIFTS),
    "yaw drift of an RHE": (lambda **bad: rhec.RHE(yaw_drift=True, **bad), DRIFTS[:1]),
}


@pytest.mark.parametrize("what", MADE)
def test_a_bad_argument_is_refused_in_one_sentence(what):
    assert_refused(*MADE[what])
