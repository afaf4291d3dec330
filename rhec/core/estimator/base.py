"""What estimators of any Model share: first guess, noise, and the estimate they return."""

from typing import NamedTuple

import numpy as np

from rhec.core._casadi.validation import of_length, shown
from rhec.core.model.base import SIGMA_UNMEASURED
from rhec.core.model.limits import MAX_PLAUSIBLE_STATE

__all__ = ["Estimate", "joint_estimate", "joint_guess", "noise_of"]


class _Arrays(NamedTuple):
    x: np.ndarray
    u: np.ndarray
    p: np.ndarray
    covariance: np.ndarray


class Estimate(_Arrays):
    """An estimate of a Model: states x, inputs u of the last interval, parameters p.

    `covariance` (n_x + n_p, n_x + n_p) is that of (x, p).
    """

    names: tuple[str, ...] = ()  # of states, inputs and parameters

    def __repr__(self) -> str:
        n_x = len(self.x)
        variances = np.diag(self.covariance)
        nothing = [np.nan] * len(self.u)  # inputs have no covariance
        sigma = [*np.sqrt(variances[:n_x]), *nothing, *np.sqrt(variances[n_x:])]
        values = [*self.x, *self.u, *self.p]
        lines = (
            f"    {name}: {value:.4g}" + ("" if np.isnan(deviation) else f" ± {deviation:.2g}")
            for name, value, deviation in zip(self.names, values, sigma)
        )
        return "\n".join(("Estimate", *lines))


def noise_of(model, sigma_v, sigma_w):
    """Settings V, W and c of an estimator.

    Args:
        model: The Model.
        sigma_v: (n_z,) standard deviations of the measurements.
        sigma_w: (n_x + n_p,) standard deviations of the process noise per sample.

    Returns:
        {name: array}: variances V (n_z,) and W (n_s,), and constants c of noise by motion, if any.
    """
    n_x = len(model.states)
    n_p = len(model.parameters)
    of_length("sigma_v", sigma_v, len(model.outputs), "output")
    of_length("sigma_w", sigma_w, n_x + n_p, "state, then each parameter")
    # Each interval replaces the last inputs in the joint state: they have no process noise.
    inputs = (0.0,) * (model.n_s - n_x - n_p)
    W = np.square([*sigma_w[:n_x], *inputs, *sigma_w[n_x:]])
    settings = dict(V=np.square(sigma_v), W=W)
    if model.motion_noise:
        settings["c"] = np.array([*model.motion_noise.constants.values()])
    return settings


def joint_guess(model, guess, sigma):
    """First joint state (n_s,) and its standard deviations (n_s,), from those of (x, p)."""
    n_x = len(model.states)
    n_p = len(model.parameters)
    of_length("guess", guess, n_x + n_p, "state, then each parameter")
    of_length("sigma_guess", sigma, n_x + n_p, "state, then each parameter")
    if max(np.square(sigma)) >= MAX_PLAUSIBLE_STATE:
        limit = MAX_PLAUSIBLE_STATE**0.5
        raise ValueError(f"sigma_guess was {shown(sigma)}; each should be below {limit:g}")
    for name, value in zip(model.parameters, guess[n_x:]):
        bounds = model.parameters[name]
        if bounds and not bounds[0] <= value <= bounds[1]:
            raise ValueError(f"guess of {name!r} was {value}; it should be within {bounds}")
    n_inputs = model.n_s - n_x - n_p
    mean = np.array([*guess[:n_x], *[0.0] * n_inputs, *guess[n_x:]])
    return mean, np.array([*sigma[:n_x], *[SIGMA_UNMEASURED] * n_inputs, *sigma[n_x:]])


def joint_estimate(model, values, covariance):
    """The Estimate from (x, u, p) in one array and the joint state's covariance."""
    n_x = len(model.states)
    n_s = model.n_s
    n_p = len(model.parameters)
    first_p = len(values) - n_p
    if model.holds_inputs:
        places = [*range(n_x), *range(n_s - n_p, n_s)]
        covariance = covariance[places][:, places]
    estimate = Estimate(values[:n_x], values[n_x:first_p], values[first_p:], covariance)
    estimate.names = model.names
    return estimate
