"""When a step cannot be solved: the shifted previous solution answers, `ok` says so, and the steps
after find back.
"""

import numpy as np
import pytest
from oracles import drive, move

import rhec
from rhec import paper

pytestmark = pytest.mark.usefixtures("virtual_machine")
GUESS = (0.0, 0.0, 0.0, 0.5, 1.0, 1.0)
WEAVE = 0.1 * np.sin(0.7 * np.arange(450)) + 0.05 * np.cos(0.31 * np.arange(450))
TRUTH, QUIET = drive((0.0, 0.0, 0.0, 0.5, 0.9, 0.8), WEAVE)
Z = QUIET + np.random.default_rng(0).normal(size=QUIET.shape) * (0.03, 0.03, 0.003, 0.003)
HIT = 100  # the sample at which something goes wrong
SOON = 220  # samples are enough for most

estimators = pytest.mark.parametrize(
    "given", [dict(), dict(horizon=7, speed_model="slipping")], ids=str
)


def estimated(rhe, z, upset=lambda rhe: None):
    """Estimates (n, 6) and whether each step was solved; `upset` reaches into the estimator after
    the sample HIT.
    """
    estimates, solved = [], []
    for k, reading in enumerate(z):
        rhe.prepare()
        estimates.append(rhe.feedback(reading)[:6])
        solved.append(rhe.ok)
        if k == HIT:
            upset(rhe)
    return np.array(estimates), np.array(solved)


def sound(estimates):
    return np.isfinite(estimates).all() and np.all(
        (estimates[:, 4:] >= 0) & (estimates[:, 4:] <= 1)
    )


def arrival_covariance(rhe):
    """P within the estimator, as it waits for the next sample; to be written to."""
    rhe.iteration.expand()
    return rhe.iteration.previous["P"].reshape(2 * (rhe.model.n_s,))


def fill_covariance(value):
    return lambda rhe: arrival_covariance(rhe).fill(value)


def no_covariance(rhe):
    """Correlations above 1: a measurement would make variances negative."""
    P = arrival_covariance(rhe)
    P[:] = 3 - 2 * np.eye(len(P))


def empty_memory(rhe):
    rhe.iteration.expand()
    for name in ("s", "v", "z", "m", "P"):
        rhe.iteration.previous[name].fill(np.nan)


# {what happens after the sample HIT: (how, at most so many steps that fail, error at the end [m])}
UPSETS = {
    "no prior at all": (fill_covariance(0.0), 1, 0.15),
    # Nothing but rounding is left within the window, so that the gate may reject a good sample.
    "a prior beyond all numbers": (fill_covariance(1e300), 1, 0.15),
    "a prior without numbers": (fill_covariance(np.nan), 1, 0.15),
    "a prior that is none": (no_covariance, 50, 0.5),
    "a memory without numbers": (empty_memory, 300, 1.0),
}


@estimators
@pytest.mark.parametrize("name", UPSETS)
def test_what_upsets_the_memory_is_solved_or_flagged_and_forgotten(given, name):
    upset, failures, error_m = UPSETS[name]
    z = Z if upset is empty_memory else Z[:SOON]
    rhe = rhec.RHE(guess=GUESS, sigma_v=paper.SIGMA_V, **given)
    estimates, solved = estimated(rhe, z, upset)
    begun = HIT + 3 if upset is empty_memory else 0
    assert sound(estimates[begun:]) and solved[: HIT + 1].all() and solved[-20:].all()
    assert np.sum(~solved) <= failures
    assert np.abs(estimates - TRUTH[: len(z)])[-20:, :2].max() < error_m
    P = arrival_covariance(rhe)
    np.testing.assert_array_equal(P, P.T)
    variances = np.linalg.eigvalsh(P)
    assert variances.min() > 0


@estimators
def test_a_step_that_fails_is_predicted_with_the_last_input(given):
    rhe = rhec.RHE(guess=GUESS, sigma_v=paper.SIGMA_V, **given)
    estimates, solved = estimated(rhe, Z[: HIT + 10], fill_covariance(np.nan))
    assert np.flatnonzero(~solved).tolist() == [HIT + 1]
    x, y, theta, nu, mu, kappa = estimates[HIT]
    predicted = move((x, y, theta), nu, mu, kappa, WEAVE[HIT - 1])
    np.testing.assert_allclose(estimates[HIT + 1, :3], predicted, atol=0.02)
    np.testing.assert_allclose(estimates[HIT + 1, 4:], estimates[HIT, 4:], atol=1e-12)


@pytest.mark.parametrize(
    "sigma",
    [
        dict(sigma_v=(1e-9,) * 4),
        dict(sigma_w=(1e6, 1e-6, 1e6, 1e-6, 1e6, 1e-6)),
        dict(sigma_w=(0.0,) * 6),
        dict(sigma_v=(1e100,) * 4),
        dict(sigma_w=(1e100,) * 6),
        dict(sigma_v=(1e-160,) * 4),
    ],
    ids=str,
)
def test_an_ill_conditioned_window_is_solved_or_flagged(sigma):
    with np.errstate(over="ignore"):
        rhe = rhec.RHE(guess=GUESS, **sigma)
    estimates, solved = estimated(rhe, Z[:SOON])
    assert sound(estimates)
    assert (
        np.all(np.abs(estimates - TRUTH[:SOON])[solved, :2] < 100)
        and np.isfinite(arrival_covariance(rhe)).all()
    )
