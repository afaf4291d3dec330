"""An estimate may leave the region where its model has slopes; it has to find back."""

import casadi as ca
import numpy as np
import pytest

import rhec

SEEDS = range(4)
EMPTY = 60  # the sample from which the tank is filled again
SAMPLES = 160
SIGMA = (0.1, 0.02)
DT_S = 0.2

MODEL = rhec.Model(
    states=("level_m",),
    inputs=("inflow",),
    parameters={"outflow": (0.2, 3.0)},
    outputs=("level_m", "inflow"),
    f=lambda x, u, p: [u[0] - p[0] * ca.sqrt(x[0])],  # no number below an empty tank
)


def settings_of(estimator):
    settings = dict(model=MODEL, dt=DT_S, sigma_v=SIGMA, sigma_w=(0.05, 0.02))
    settings |= dict(guess=(1.0, 1.0), sigma_guess=(0.5, 0.5))
    return settings | (dict(horizon=10) if estimator is rhec.RHE else {})


def drained_and_filled(seed):
    """Levels (n,) of a tank that runs empty and is filled again, and what is measured (n, 2)."""
    rng = np.random.default_rng(seed)
    levels = np.empty(SAMPLES)
    inflows = np.where(np.arange(SAMPLES) < EMPTY, 0.0, 0.6)
    level = 1.0
    for k, inflow in enumerate(inflows):
        for _ in range(20):
            level = max(level + DT_S / 20 * (inflow - np.sqrt(level)), 0.0)
        levels[k] = level
    exact = np.column_stack([levels, inflows])
    return levels, exact + SIGMA * rng.normal(size=exact.shape)


@pytest.mark.parametrize("estimator", [rhec.RHE, rhec.EKF])
def test_the_estimate_stays_finite_and_finds_back(virtual_machine, estimator):
    for seed in SEEDS:
        levels, measured = drained_and_filled(seed)
        live = estimator(**settings_of(estimator))
        errors = np.empty(SAMPLES)
        oks = []
        for k, z in enumerate(measured):
            live.prepare()
            estimate = live.feedback(z)
            assert np.isfinite([*estimate.x, *estimate.p]).all()
            errors[k] = estimate.x[0] - levels[k]
            oks.append(estimator is rhec.EKF or live.ok)
        assert np.sqrt(np.mean(np.square(errors[-20:]))) < SIGMA[0]
        assert all(oks[-40:])
        # The drive is one where the window has to restart.
        assert estimator is rhec.EKF or not all(oks)


def test_where_the_model_has_no_slopes_only_the_process_noise_adds_to_the_variance():
    """Not that of the measured inflow, whose effect is unknown there."""
    settings = settings_of(rhec.EKF) | dict(guess=(-1.0, 1.0))
    ekf = rhec.EKF(**settings)
    variances = [np.diag(ekf.feedback((np.nan, 0.3)).covariance).copy() for _ in range(4)]
    added = np.square(settings["sigma_w"])
    np.testing.assert_allclose(np.diff(variances, axis=0), [added] * 3, rtol=1e-9)
