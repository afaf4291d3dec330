"""What a calibration returns, and how certain it is: of the paper's robot and of any Model."""

import numpy as np
import pandas as pd
from scipy.optimize import minimize

_HESSIAN_STEP = 0.1  # in prior standard deviations
# A log determines a parameter if it reduces the standard deviation below this share of the prior's.
_DETERMINED = 0.5
_LARGEST = 4.0  # prior standard deviations within which is searched
_UNUSABLE = 1e12  # the objective where a filter diverges


class Calibration(dict):
    """Arguments of `rhec.replay` that calibrate it for a log.

    They are sigma_v, sigma_w, slip, and lever_arm_m if the log determines it.

    Attributes:
        report: DataFrame, one row for each parameter: value, bounds `low` and `high` of the 95 %
            interval, unit, and `determined`, whether the log determines the parameter. Otherwise
            the value is close to the prior.
        terms: DataFrame, the same in the terms of ROS: multipliers of wheel separation and radius,
            effective track width, bias and scale of the gyro, place of the antenna, delay and noise
            of the positions, each with its 95 % interval (`rhec.logs.terms`).
        yaml: These for diff_drive_controller and robot_localization.
        remarks: Sentences, such as that the defaults of `rhec.replay` are kept.
    """

    report: pd.DataFrame
    terms: pd.DataFrame
    yaml: str
    remarks: list[str]

    def __str__(self) -> str:
        undetermined = list(self.report.index[~self.report["determined"]])
        summary = "The log determines all parameters."
        if undetermined:
            summary = f"The log does not determine: {', '.join(undetermined)}."
        report, in_terms = (
            table.to_string(float_format="{:.4g}".format) if len(table) else ""
            for table in (self.report, self.terms)
        )
        return "\n".join([report, summary, "", in_terms, *self.remarks]).rstrip("\n")


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


def most_likely(objective, x):
    """The x (n,) within ±_LARGEST where an objective is least, searched from x."""
    bounds = [(-_LARGEST, _LARGEST)] * len(x)
    return minimize(objective, x, method="L-BFGS-B", bounds=bounds, options=dict(maxiter=50)).x


def minus_log_posterior(losses, x):
    """-log posterior at x (n,), up to a constant, from the losses (array, …) of the segments."""
    value = sum(loss.sum() for loss in losses) / 2 + x @ x / 2
    return float(value) if np.isfinite(value) else _UNUSABLE


def report(names, units, values, low, high, determined):
    """The report of a Calibration, one row for each parameter."""
    columns = dict(value=values, low=low, high=high, unit=units, determined=determined)
    return pd.DataFrame(columns, index=names)


def is_determined(deviation):
    """Whether a log determines parameters with these deviations, in units of the prior's."""
    return deviation < _DETERMINED
