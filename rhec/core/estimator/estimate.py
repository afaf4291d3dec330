"""What estimators of any Model share: first guess, noise, and the estimate they return."""

from collections import namedtuple

import numpy as np

from rhec.core._casadi.validation import of_length, refuse, shown
from rhec.core.model.limits import MAX_PLAUSIBLE_STATE
from rhec.core.model.robot_model import SIGMA_HELD, SIGMA_UNMEASURED


class Estimate(namedtuple("Estimate", "x u p covariance")):
    """An estimate of a Model: states x, inputs u of the last interval, parameters p.

    `covariance` (n_x + n_p, n_x + n_p) is that of (x, p).
    """

    names: tuple[str, ...] = ()  # of states, inputs and parameters

    def __repr__(self) -> str:
        n_x = len(self.x)
        sigma = np.sqrt(np.diag(self.covariance))
        sigma = [*sigma[:n_x], *[np.nan] * len(self.u), *sigma[n_x:]]  # inputs have no covariance
        return with_deviations(self.names, [*self.x, *self.u, *self.p], sigma)


def with_deviations(names, values, sigma):
    """An estimate as text, a line for each quantity; NaN among `sigma` is none."""
    text = "Estimate"
    for name, value, deviation in zip(names, values, sigma):
        tolerance = "" if np.isnan(deviation) else f" ± {deviation:.2g}"
        text += f"\n    {name}: {value:.4g}{tolerance}"
    return text


def _by_name(model, parameter, values):
    """The values of each state, then of each parameter, by name."""
    names = (*model.states, *model.parameters)
    of_length(parameter, values, len(names), "state, then each parameter")
    return dict(zip(names, values))


def noise_of(model, sigma_v, sigma_w):
    """Variances V (n_z,) and W (n_s,), and constants c of noise by motion, if any, by name.

    sigma_v (n_z,) are standard deviations of the measurements, sigma_w (n_x + n_p,) those of the
    process noise per sample.
    """
    if not model.outputs:
        raise ValueError("outputs of the model was (); an estimator needs at least one")
    of_length("sigma_v", sigma_v, len(model.outputs), "output")
    settings = dict(V=np.square(sigma_v), W=variances_w(model, sigma_w))
    if model.motion_noise:
        settings["c"] = np.array([*model.motion_noise.constants.values()])
    return settings


def noise_shapes(model):
    """Shapes of V and c, by name, in the settings of an estimator."""
    shapes = dict(V=(len(model.outputs), 1))
    if model.motion_noise:
        shapes["c"] = (len(model.motion_noise.constants), 1)
    return shapes


def variances_w(model, sigma_w):
    """Variances W (n_s,) of the process noise of the joint state, or (n, n_s) of n runs.

    sigma_w (n_x + n_p,) or (n, n_x + n_p) are the standard deviations.
    """
    n_x = len(model.states)
    n_p = len(model.parameters)
    try:
        sigma = np.asarray(sigma_w, float)
        is_valid = sigma.shape[-1:] == (n_x + n_p,) and bool(np.all((sigma >= 0) & (sigma < 1e100)))
    except (TypeError, ValueError):
        is_valid = False
    if not is_valid:
        wanted = f"it should have {n_x + n_p} entries, one for each state, then each parameter"
        refuse("sigma_w was", sigma_w, f"{wanted}, and none below 0")
    # Each interval replaces the last inputs in the joint state: they have no process noise.
    held = np.zeros((*sigma.shape[:-1], model.n_s - n_x - n_p))
    return np.square(np.concatenate([sigma[..., :n_x], held, sigma[..., n_x:]], axis=-1))


def joint_guess(model, guess, sigma):
    """First joint state (n_s,) and its standard deviations (n_s,), from those of (x, p)."""
    guess = _by_name(model, "guess", guess)
    sigma = _by_name(model, "sigma_guess", sigma)
    if max(np.square([*sigma.values()])) >= MAX_PLAUSIBLE_STATE:
        limit = MAX_PLAUSIBLE_STATE**0.5
        values = tuple(sigma.values())
        expected = f"each should be below {limit:g}, if need be in larger units"
        raise ValueError(f"sigma_guess was {shown(values)}; {expected}")
    every = (model.state_bounds or {}) | dict(model.parameters)
    for name, bounds in every.items():
        if bounds and not bounds[0] <= guess[name] <= bounds[1]:
            raise ValueError(f"guess of {name!r} was {guess[name]}; it should be within {bounds}")
    names = model.joint_names
    mean = np.array([guess.get(name, 0.0) for name in names])
    unknown = {name: SIGMA_UNMEASURED * model.sigma_held.get(name, SIGMA_HELD) for name in names}
    return mean, np.array([(unknown | sigma)[name] for name in names])


def joint_estimate(model, values, covariance):
    """The Estimate from (x, u, p) in one array and the joint state's covariance."""
    n_x = len(model.states)
    n_p = len(model.parameters)
    if model.held_inputs:
        places = [*range(n_x), *range(model.n_s - n_p, model.n_s)]
        covariance = covariance[places][:, places]
    first_p = len(values) - n_p
    estimate = Estimate(values[:n_x], values[n_x:first_p], values[first_p:], covariance)
    estimate.names = model.names
    return estimate
