"""The likelihood of a log by a Kalman filter's innovations, over a table of unknown noise.

Broad priors supply what a log does not determine. The posterior is approximated by a normal
distribution at its maximum (Laplace).
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
from scipy.optimize import minimize

from rhec.core.model.robot_model import Model
from rhec.logs import filtering
from rhec.logs.filtering import Loss

Z_95 = 1.96  # standard deviations that hold 95 %
_HESSIAN_STEP = 0.1  # in prior standard deviations
# The same, of the slopes of a search. The shorter step of SciPy's default is lost in the rounding
# of a sum of thousands of losses, and the search ends up to 8 nats too early.
_SLOPE_STEP = 1e-5
# A log determines a parameter if it reduces the standard deviation below this share of the prior's.
_DETERMINED = 0.5
_LARGEST = 4.0  # prior standard deviations within which is searched
_UNUSABLE = 1e12  # the objective where a filter diverges


class Unknown(NamedTuple):
    """A parameter to calibrate, with its prior."""

    name: str
    unit: str
    middle: float  # mean of the prior
    deviation: float  # standard deviation of the prior, of the logarithm if is_scale
    is_scale: bool = True  # whether the logarithm is normally distributed
    least: float = 0.0  # lower bound

    def at(self, x):
        """The value that is x prior standard deviations from the mean."""
        value = x * self.deviation
        value = self.middle * np.exp(value) if self.is_scale else self.middle + value
        return float(np.maximum(value, self.least))


class Likelihood(NamedTuple):
    """What a log says of unknowns, which are searched in standard deviations x of their priors."""

    model: Model
    dt_s: float  # length of a sample [s]
    loss: Loss
    unknowns: tuple  # (Unknown, …)
    settings_of: Callable  # from the values of the unknowns to the settings of the filter
    segments: list  # streams (n, 2 n_z), as of `recording.with_ages`
    firsts: list  # mean and standard deviations of the joint state before each segment
    counts: list | None = None  # whether each sample counts (n,), for each segment

    def values(self, x):
        """The values of the unknowns at x."""
        return [unknown.at(entry) for unknown, entry in zip(self.unknowns, x)]

    def filtered(self, x):
        """What the filter records in each segment at x."""
        settings = self.settings_of(self.values(x))
        return [
            filtering.run(self.model, self.dt_s, self.loss, stream, first, settings)
            for stream, first in zip(self.segments, self.firsts)
        ]

    def losses(self, x):
        """The losses (n,) of the samples of each segment at x."""
        losses = [recorded["loss"] for recorded in self.filtered(x)]
        if self.counts:
            # Not a product: what does not count may be no number.
            losses = [np.where(counts, loss, 0.0) for counts, loss in zip(self.counts, losses)]
        return losses

    def objective(self, x):
        """-log posterior at x, up to a constant."""
        value = sum(loss.sum() for loss in self.losses(x)) / 2 + x @ x / 2
        return float(value) if np.isfinite(value) else _UNUSABLE

    def most_likely(self):
        """The x where the objective is least, searched from the middle of the priors."""
        x = np.zeros(len(self.unknowns))
        bounds = [(-_LARGEST, _LARGEST)] * len(x)
        options = dict(maxiter=200, eps=_SLOPE_STEP)
        return minimize(self.objective, x, method="L-BFGS-B", bounds=bounds, options=options).x

    def report(self, x):
        """The report of a Calibration on the unknowns, at the most likely x."""
        deviation = np.sqrt(np.diag(posterior_covariance(self.objective, x)))
        value, low, high = (self.values(x + side * deviation) for side in (0, -Z_95, Z_95))
        columns = dict(value=value, low=low, high=high, unit=[each.unit for each in self.unknowns])
        columns |= dict(determined=deviation < _DETERMINED)
        return pd.DataFrame(columns, index=[unknown.name for unknown in self.unknowns])


def posterior_covariance(objective, x):
    """H⁻¹ of the objective's Hessian H at its minimum x, by finite differences, at most the prior.

    The Hessian of the prior is the identity, so eigenvalues of H below 1 are numerical errors.
    """
    n = len(x)
    h = _HESSIAN_STEP
    steps = h * np.eye(n)
    center = objective(x)
    ahead = np.array([objective(x + step) for step in steps])
    behind = np.array([objective(x - step) for step in steps])
    H = np.diag((ahead - 2 * center + behind) / h**2)
    for i, j in zip(*np.triu_indices(n, 1)):
        both = objective(x + steps[i] + steps[j])
        H[i, j] = (both - ahead[i] - ahead[j] + center) / h**2
        H[j, i] = H[i, j]
    values, vectors = np.linalg.eigh(H)
    return vectors / np.clip(values, 1.0, None) @ vectors.T


def normal_interval(mean, sigma):
    """The mean, and the limits of its 95 % interval."""
    return mean, mean - Z_95 * sigma, mean + Z_95 * sigma


def normal_report(name, unit, mean, sigma, is_determined):
    """The report of a Calibration on one parameter, by its mean and standard deviation."""
    row = dict(zip(("value", "low", "high"), normal_interval(mean, sigma)))
    return pd.DataFrame(row | dict(unit=unit, determined=bool(is_determined)), index=[name])


class Calibration(dict):
    """Arguments of `rhec.replay` that calibrate it for a log.

    They are sigma_v, sigma_w, slip, and lever_arm_m if the log determines it.

    Attributes:
        report: DataFrame, one row for each parameter: value, bounds `low` and `high` of the 95 %
            interval, unit, and `determined`, whether the log determines the parameter. Otherwise
            the value is close to the prior, or the least that is assumed.
        remarks: Sentences, such as that the defaults of `rhec.replay` are kept.
    """

    report: pd.DataFrame
    remarks: list[str]

    def __init__(self, arguments: dict[str, Any], report: pd.DataFrame) -> None:
        super().__init__(arguments)
        self.report = report
        self.remarks = []

    def __str__(self) -> str:
        undetermined = list(self.report.index[~self.report["determined"]])
        summary = "The log determines all parameters."
        if undetermined:
            summary = f"The log does not determine: {', '.join(undetermined)}."
        report = self.report.to_string(float_format="{:.4g}".format)
        return "\n".join([report, summary, *self.remarks])
