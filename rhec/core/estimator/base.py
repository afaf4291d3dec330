"""What estimators of any Model share: first guess, noise, and the estimate they return."""

from typing import NamedTuple

import numpy as np

from rhec.core._casadi.validation import of_length
from rhec.core.model.base import SIGMA_UNMEASURED

__all__ = ["Estimate", "joint_estimate", "joint_guess", "noise_of"]


class Estimate(NamedTuple):
    """States x, inputs u of the last interval, parameters p, and the covariance of (x, p)."""

    x: np.ndarray
    u: np.ndarray
    p: np.ndarray
    covariance: np.ndarray


def noise_of(model, sigma_v, sigma_w):
    """Settings V, W and c of an estimator of this model, from standard deviations."""
    n_x = len(model.states)
    n_p = len(model.parameters)
    of_length("sigma_v", sigma_v, len(model.outputs), "output")
    of_length("sigma_w", sigma_w, n_x + n_p, "state, then each parameter")
    inputs = (0.0,) * (model.n_s - n_x - n_p)
    settings = dict(V=np.square(sigma_v), W=np.square([*sigma_w[:n_x], *inputs, *sigma_w[n_x:]]))
    if model.motion_noise:
        settings["c"] = np.array([*model.motion_noise.constants.values()])
    return settings


def joint_guess(model, guess, sigma):
    """First joint state (n_s,) and its standard deviations, from those of (x, p)."""
    n_x = len(model.states)
    n_p = len(model.parameters)
    of_length("guess", guess, n_x + n_p, "state, then each parameter")
    of_length("sigma_guess", sigma, n_x + n_p, "state, then each parameter")
    for name, value in zip(model.parameters, guess[n_x:]):
        bounds = model.parameters[name]
        if bounds and not bounds[0] <= value <= bounds[1]:
            raise ValueError(f"guess of {name!r} was {value}; it should be within {bounds}")
    inputs = model.n_s - n_x - n_p
    return tuple(
        np.array([*of[:n_x], *(fill,) * inputs, *of[n_x:]])
        for of, fill in ((guess, 0.0), (sigma, SIGMA_UNMEASURED))
    )


def joint_estimate(model, known, covariance):
    """The Estimate from (x, u, p) in one array and the joint state's covariance."""
    n_x = len(model.states)
    n_s = model.n_s
    n_p = len(model.parameters)
    end = len(known) - n_p
    if model.holds_inputs:
        kept = [*range(n_x), *range(n_s - n_p, n_s)]
        covariance = covariance[kept][:, kept]
    return Estimate(known[:n_x], known[n_x:end], known[end:], covariance)
