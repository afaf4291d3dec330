"""Whether `rhec.suggest_window` suggests a window whose error is within 5 % of the best one's.

Four problems are simulated with the process noise that the estimator is told of. Estimators that
differ in their window alone see the same measurements.
"""

from typing import NamedTuple

import casadi as ca
import numpy as np
import pandas as pd

from rhec.core.estimator.rhe import RHE
from rhec.core.estimator.window_length import suggest_window
from rhec.core.model import base
from rhec.core.model.base import Model
from rhec.workbench.studies import gallery

__all__ = ["PROBLEMS", "Problem", "table"]

_SETTLED = 60  # samples after which errors count
_OFF = 0.3  # of the guess, in its standard deviations


class Problem(NamedTuple):
    """A drive: options of an RHE, in which `guess` is the truth, and inputs (n, n_u)."""

    options: dict
    u: np.ndarray


def _pendulum():
    """A pendulum on a cart that hangs and is shaken; position and angle are measured."""
    model = gallery.pendulum().options["model"]
    outputs = ("p_m", "theta_rad", "force_N")
    model = Model(
        states=model.states, inputs=model.inputs, parameters={}, outputs=outputs, f=model.f
    )
    options = dict(model=model, dt=0.025, sigma_v=(0.01, 0.02, 0.5))
    options |= dict(sigma_w=(0.001, 0.002, 0.02, 0.05), guess=(0.0, np.pi, 0.0, 0.0))
    options |= dict(sigma_guess=(0.1, 0.2, 0.5, 0.5))
    return Problem(options, 3 * np.sin(0.15 * np.arange(200))[:, None])


def _range_bearing():
    """The robot of `gallery.range_bearing`, with process noise."""
    given = gallery.range_bearing()
    noise = dict(guess=given.start, sigma_w=(0.005, 0.005, 0.01))
    return Problem(_without_window(given.options) | noise, given.inputs)


def _masses():
    """The masses of `gallery.masses`, with process noise; the inertia is a constant."""
    given = gallery.masses()
    noise = dict(guess=(*given.start, *given.p), sigma_w=(0.002,) * 3 + (0.02,) * 3 + (0.0,))
    noise |= dict(sigma_guess=(0.3,) * 3 + (1.0,) * 3 + (5e-5,))
    return Problem(_without_window(given.options) | noise, np.vstack([given.inputs] * 2))


def _skid_steered():
    """Two tracks, each with a slip of its own that changes at random."""

    def f(x, u, p):
        left = (1 - p[0]) * u[0]
        right = (1 - p[1]) * u[1]
        speed = (left + right) / 2
        return ca.vertcat(speed * ca.cos(x[2]), speed * ca.sin(x[2]), (right - left) / 0.6)

    inputs = ("v_left_mps", "v_right_mps")
    model = Model(
        states=("x_m", "y_m", "theta_rad"), inputs=inputs, f=f,
        parameters=dict(slip_left=(0.0, 1.0), slip_right=(0.0, 1.0)),
        outputs=("x_m", "y_m", *inputs),
    )  # fmt: skip
    k = np.arange(200)
    options = dict(model=model, dt=0.2, sigma_v=(0.03, 0.03, 0.02, 0.02))
    options |= dict(sigma_w=(0.005, 0.005, 0.005, 0.01, 0.01), guess=(0.0, 0.0, 0.0, 0.2, 0.2))
    options |= dict(sigma_guess=(0.3, 0.3, 0.2, 0.15, 0.15))
    left = 0.5 + 0.15 * np.sin(0.1 * k)
    return Problem(options, np.column_stack([left, 0.5 - 0.15 * np.sin(0.1 * k + 0.5)]))


def _without_window(options):
    return {name: options[name] for name in options if name not in ("horizon", "arrival_mean")}


PROBLEMS = {
    "pendulum": _pendulum,
    "range and bearing": _range_bearing,
    "masses": _masses,
    "skid-steered robot": _skid_steered,
}


def table(name, lengths, seeds, noise_in_window=False):
    """Errors of windows of several lengths, and of the suggested one.

    Args:
        name: One of PROBLEMS.
        lengths: Intervals of the other windows.
        seeds: Of the noise of each drive.
        noise_in_window: Whether the estimators have it.

    Returns:
        DataFrame, a row for each length: `suggested`, whether it is the suggested one, and
        `excess`, the RMSE of all states and parameters above the best of these windows, as a share.
    """
    problem = PROBLEMS[name]()
    problem.options["noise_in_window"] = noise_in_window
    suggested = suggest_window(**problem.options, u=problem.u)
    lengths = sorted({*lengths, suggested})
    squares = {length: [] for length in lengths}
    for seed in seeds:
        rng = np.random.default_rng(seed)
        true, z = _simulated(problem, rng)
        guess = _first_guess(problem, rng)
        for length in lengths:
            error = _estimated(problem, guess, length, z) - true
            squares[length].append(np.mean(error[_SETTLED:] ** 2, axis=0))
    rmse = np.sqrt([np.mean(squares[length], axis=0) for length in lengths])
    total = np.sqrt(np.mean((rmse / rmse.min(axis=0)) ** 2, axis=1))
    is_suggested = [length == suggested for length in lengths]
    excess = total / total.min() - 1
    return pd.DataFrame(dict(intervals=lengths, suggested=is_suggested, excess=excess))


def _limits(model):
    """Lowest and highest (n_x + n_p,) states and parameters."""
    none = (-np.inf, np.inf)
    bounds = [none] * len(model.states)
    bounds += [none if each is None else each for each in model.parameters.values()]
    return np.array(bounds).T


def _simulated(problem, rng):
    """True states and parameters (n, n_x + n_p), and measurements (n, n_z)."""
    options = problem.options
    model = options["model"]
    n_x = len(model.states)
    step = base.interval(model, measured=False).step
    s = np.array(options["guess"], float)
    true = []
    z = []
    for k in range(len(problem.u) + 1):
        u = problem.u[max(k - 1, 0)]
        if k:
            s = np.array(step(s, u, options["dt"])).ravel()
            s = np.clip(s + rng.normal(size=len(s)) * options["sigma_w"], *_limits(model))
        exact = np.array(model.measurement(s[:n_x], u, s[n_x:])).ravel()
        true.append(s)
        z.append(exact + rng.normal(size=len(exact)) * options["sigma_v"])
    return np.array(true), np.array(z)


def _first_guess(problem, rng):
    """A guess that is a little off."""
    sigma = np.array(problem.options["sigma_guess"])
    guess = problem.options["guess"] + _OFF * sigma * rng.normal(size=len(sigma))
    return np.clip(guess, *_limits(problem.options["model"]))


def _estimated(problem, guess, length, z):
    """Estimated states and parameters (n, n_x + n_p) by a window of this length."""
    rhe = RHE(**problem.options | dict(guess=tuple(guess)), horizon=length)
    rows = []
    for row in z:
        rhe.prepare()
        found = rhe.feedback(row)
        rows.append(np.append(found.x, found.p))
    return np.array(rows)
