"""Calibration of any Model: the noise of its outputs and of its process, from a log.

The likelihood of a log is that of a Kalman filter's innovations. Around the values that the user
passes, each standard deviation has a log-normal prior by a factor of 3; the posterior is
approximated by a normal distribution of the logarithms at its maximum (Laplace). Of a sample that
is further from its prediction than one in a thousand good ones, only the logarithm of its distance
counts, so that outliers do not pass for noise.
"""

from typing import Any

import numpy as np
import pandas as pd

from rhec.core.estimator.base import joint_guess, noise_of
from rhec.core.estimator.ekf import EKF
from rhec.core.model import base
from rhec.core.model.base import Model
from rhec.logs import filtering
from rhec.logs.calibrated import (
    Calibration,
    is_determined,
    minus_log_posterior,
    most_likely,
    posterior_covariance,
    report,
)
from rhec.logs.filtering import Loss
from rhec.logs.recording import prepare_for, resample, with_ages

_PRIOR = np.log(3.0)  # standard deviation of the logarithm of a standard deviation
_NEEDED = ("dt", "sigma_v", "sigma_w", "guess", "sigma_guess")
_PASSED_ON = ("horizon", "arrival_mean")
_LEAST_SAMPLES = 50  # with measurements


class _Search:
    """What is searched: the logarithms of the standard deviations that are not 0."""

    def __init__(self, model: Model, given: dict, segments: list) -> None:
        self.model = model
        self.given = given
        self.segments = segments
        self.middle = np.array([*given["sigma_v"], *given["sigma_w"]], dtype=float)
        self.is_searched = self.middle > 0

    def sigmas(self, x: np.ndarray) -> tuple[tuple, tuple]:
        """(sigma_v, sigma_w) at x (n,), in standard deviations of the prior."""
        sigma = self.middle.copy()
        sigma[self.is_searched] *= np.exp(_PRIOR * x)
        n_z = len(self.model.outputs)
        return tuple(sigma[:n_z].tolist()), tuple(sigma[n_z:].tolist())

    def filtered(self, x: np.ndarray) -> list[dict]:
        """The records of the filter in each segment."""
        model = self.model
        settings = noise_of(model, *self.sigmas(x))
        first = joint_guess(model, self.given["guess"], self.given["sigma_guess"])
        of_all = (model, self.given["dt"], Loss.LOGARITHM)
        return [filtering.run(*of_all, stream, first, settings) for stream in self.segments]

    def objective(self, x: np.ndarray) -> float:
        """-log posterior at x, up to a constant."""
        return minus_log_posterior((recorded["loss"] for recorded in self.filtered(x)), x)


def _checked_arguments(model, arguments):
    """Raise a ValueError for arguments that a replay with a model does not take."""
    unknown = [name for name in arguments if name not in (*_NEEDED, *_PASSED_ON)]
    if unknown:
        raise ValueError(
            f"calibrate has no parameter {unknown[0]!r}; with a model it takes "
            f"{', '.join((*_NEEDED, *_PASSED_ON))}"
        )
    EKF(model=model, **{name: arguments[name] for name in _NEEDED if name in arguments})


def _refuse_few(model, segments):
    outputs = [output.row for output in base.interval(model).outputs]
    n = sum(np.isfinite(stream[:, outputs]).any(axis=1).sum() for stream in segments)
    if n < _LEAST_SAMPLES:
        names = ", ".join(model.outputs[row] for row in outputs)
        raise ValueError(
            f"the log had {n} samples with a measurement of {names}; a calibration needs at least "
            f"{_LEAST_SAMPLES}: record a longer drive"
        )


def _report(search, x, deviation):
    """The report of a Calibration: the standard deviations, then the model's parameters."""
    model = search.model
    names = [f"noise of {name}" for name in model.outputs]
    names += [f"process noise of {name}" for name in (*model.states, *model.parameters)]
    searched = [name for name, is_searched in zip(names, search.is_searched) if is_searched]
    at = [
        np.concatenate(search.sigmas(x + side * deviation))[search.is_searched]
        for side in (0, -1.96, 1.96)
    ]
    noise = report(searched, "as given", *at, is_determined(deviation))
    last = filtering.last_estimates(model, search.filtered(x))
    first = dict(zip((*model.states, *model.parameters), search.given["sigma_guess"]))
    mean, sigma = np.array([last[name] for name in model.parameters]).reshape(-1, 2).T
    before = np.array([first[name] for name in model.parameters])
    interval = (mean - 1.96 * sigma, mean + 1.96 * sigma)
    own = report([*model.parameters], "own", mean, *interval, is_determined(sigma / before))
    return pd.concat([noise, own]) if len(own) else noise


def calibrate_model(
    log: Any, model: Model, delays_s: dict[str, float] | None, arguments: dict
) -> Calibration:
    """`rhec.calibrate` with a model.

    Args:
        log: DataFrame, as `rhec.replay` takes it with a model.
        model: The rhec.Model.
        delays_s: {output: delay of its time stamps [s]}.
        arguments: Those of rhec.RHE or rhec.EKF.

    Returns:
        Calibration: the arguments with the calibrated sigma_v and sigma_w.

    Raises:
        ValueError: For arguments or logs that a replay refuses, or a log with few measurements.
    """
    _checked_arguments(model, arguments)
    dt_s = arguments["dt"]
    recording = prepare_for(model, dt_s, log, delays_s)
    inputs = [model.outputs[row] for row in model.input_outputs.values()]
    parts = [
        resample(rows, dt_s, True, model.outputs, inputs, recording.timing)
        for _, rows in recording.rows.groupby("segment")
    ]
    segments = [with_ages(part, [*model.outputs]) for part in parts]
    _refuse_few(model, segments)
    search = _Search(model, arguments, segments)
    x = most_likely(search.objective, np.zeros(int(search.is_searched.sum())))
    deviation = np.sqrt(np.diag(posterior_covariance(search.objective, x)))
    sigma_v, sigma_w = search.sigmas(x)
    result = Calibration(arguments | dict(model=model, sigma_v=sigma_v, sigma_w=sigma_w))
    if delays_s:
        result["delays_s"] = delays_s
    result.report = _report(search, x, deviation)
    result.terms = pd.DataFrame()
    result.yaml = ""
    result.remarks = []
    return result
