"""Calibration of any Model: the noise of its outputs and of its process, from a log.

The likelihood of a log is that of a Kalman filter's innovations. Around the values that the user
passes, each standard deviation has a log-normal prior by a factor of 3; the posterior is
approximated by a normal distribution of the logarithms at its maximum (Laplace). Of a sample that
is further from its prediction than one in a thousand good ones, only the logarithm of its distance
counts, so that outliers do not pass for noise.
"""

from typing import Any

import casadi as ca
import numpy as np
import pandas as pd
from scipy.optimize import minimize
from scipy.stats import chi2

from rhec.core import runner
from rhec.core._casadi import compiled
from rhec.core._casadi.build import with_packed_memory
from rhec.core._casadi.packing import pack_array
from rhec.core.estimator import kalman
from rhec.core.estimator.base import joint_guess, noise_of, noise_shapes
from rhec.core.estimator.ekf import EKF
from rhec.core.estimator.filter import Filter, Noise
from rhec.core.model import base
from rhec.core.model.base import Model
from rhec.logs.calibrated import Calibration, is_determined, posterior_covariance
from rhec.logs.recording import Recording, prepare_for, resample

_PRIOR = np.log(3.0)  # standard deviation of the logarithm of a standard deviation
_NEEDED = ("dt", "sigma_v", "sigma_w", "guess", "sigma_guess")
_PASSED_ON = ("horizon", "arrival_mean")
_LEAST_SAMPLES = 50  # with measurements
_OUTLIERS = 1e-3  # share of good samples that count less


def _correct_robustly(m, P, z, V, outputs, s_bar):
    """`kalman.update` in which a sample may be an outlier, which counts less in its deviance.

    That is c ρ(d/c) + log det S with d = y' S⁻¹ y, the limit c of d, and ρ(r) = r up to 1, then
    1 + log r.
    """
    limit = float(chi2.isf(_OUTLIERS, max(len(outputs), 1)))
    plain = kalman.update(m, P, z, V, outputs, s_bar)
    far = plain.distance / limit
    loss = limit * ca.if_else(far < 1, far, 1 + ca.log(ca.fmax(far, 1)))
    loss += plain.deviance - plain.distance
    # This loss gives an outlier the weight of a measurement with a variance larger by d/c.
    updated = kalman.update(m, P, z, V * ca.fmax(far, 1), outputs, s_bar)
    return updated._replace(deviance=loss)


def _build_filter(model, dt_s):
    """The scan of a Kalman filter that counts outliers less.

    Its step takes the measurements z and, in the same vector, their ages [s]. It records the mean
    of the joint state, its variances, and the loss of the sample's outputs.
    """
    n_z = len(model.outputs)
    filtering = Filter(base.interval(model), dt_s, _correct_robustly)
    shapes = dict(z_N=(2 * n_z, 1), noise=noise_shapes(model), W=(model.n_s, 1))

    @with_packed_memory("calibrated_model", filtering.memory_shapes, ca.SX, **shapes)
    def step(z_N, noise, W, **memory):
        after = filtering.sample(z_N[:n_z], Noise(W=W, **noise), **memory, ages_s=z_N[n_z:])
        recorded = dict(estimate=after.m, variances=ca.diag(after.P), loss=after.deviance)
        return recorded | after.memory

    return runner.build_recorded(step, ["estimate", "variances", "loss"])


class _Search:
    """What is searched: the logarithms of the standard deviations that are not 0."""

    def __init__(self, model: Model, given: dict, segments: list) -> None:
        self.model = model
        self.given = given
        self.segments = segments
        self.middle = np.array([*given["sigma_v"], *given["sigma_w"]], dtype=float)
        self.is_searched = self.middle > 0
        self._functions = compiled.load(_build_filter, model, given["dt"])
        m, sigma = joint_guess(model, given["guess"], given["sigma_guess"])
        memory = dict(m=m, P=np.diag(np.square(sigma)), v=np.zeros(len(model.inputs)), started=0.0)
        self._memory = pack_array(memory)

    def sigmas(self, x: np.ndarray) -> tuple[tuple, tuple]:
        """(sigma_v, sigma_w) at x (n,), in standard deviations of the prior."""
        sigma = self.middle.copy()
        sigma[self.is_searched] *= np.exp(_PRIOR * x)
        n_z = len(self.model.outputs)
        return tuple(sigma[:n_z].tolist()), tuple(sigma[n_z:].tolist())

    def filtered(self, x: np.ndarray) -> list[dict]:
        """The records of the filter in each segment."""
        settings = noise_of(self.model, *self.sigmas(x))
        return [
            runner.record(self._functions, self._memory, stream, settings)
            for stream in self.segments
        ]

    def objective(self, x: np.ndarray) -> float:
        """-log posterior at x, up to a constant."""
        losses = [recorded["loss"].sum() for recorded in self.filtered(x)]
        value = sum(losses) / 2 + x @ x / 2
        return float(value) if np.isfinite(value) else 1e12


def _streams(model: Model, recording: Recording, dt_s: float) -> list:
    """(z, ages) (n, 2 n_z) of each segment."""
    inputs = [model.outputs[row] for row in model.input_outputs.values()]
    ages = [f"{name}_age_s" for name in model.outputs]
    streams = []
    for _, rows in recording.rows.groupby("segment"):
        part = resample(rows, dt_s, True, model.outputs, inputs, recording.timing)
        columns = part.reindex(columns=[*model.outputs, *ages]).to_numpy()
        columns[:, len(ages) :] = np.nan_to_num(columns[:, len(ages) :])
        # Before the first sample no motion is known by which to move its measurements.
        columns[0, : len(ages)][columns[0, len(ages) :] > 0] = np.nan
        streams.append(columns)
    return streams


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
    rows = {}
    for name, *values in zip(
        [name for name, searched in zip(names, search.is_searched) if searched],
        *(
            np.concatenate(search.sigmas(x + side * deviation))[search.is_searched]
            for side in (0, -1.96, 1.96)
        ),
        is_determined(deviation),
    ):
        rows[name] = dict(zip(("value", "low", "high", "determined"), values), unit="as given")
    last = search.filtered(x)
    means = np.array([recorded["estimate"][-1] for recorded in last])
    variances = np.array([recorded["variances"][-1] for recorded in last])
    variance = 1 / (1 / variances).sum(axis=0)
    mean = variance * (means / variances).sum(axis=0)
    first = dict(zip((*model.states, *model.parameters), search.given["sigma_guess"]))
    for name in model.parameters:
        place = model.joint_names.index(name)
        sigma = float(np.sqrt(variance[place]))
        low = mean[place] - 1.96 * sigma
        high = mean[place] + 1.96 * sigma
        determined = is_determined(sigma / first[name])
        rows[name] = dict(value=mean[place], low=low, high=high, determined=determined, unit="own")
    report = pd.DataFrame(rows).T[["value", "low", "high", "unit", "determined"]]
    return report.astype(dict(value=float, low=float, high=float, determined=bool))


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
    segments = _streams(model, recording, dt_s)
    _refuse_few(model, segments)
    search = _Search(model, arguments, segments)
    x = np.zeros(int(search.is_searched.sum()))
    bounds = [(-4, 4)] * len(x)
    found = minimize(
        search.objective, x, method="L-BFGS-B", bounds=bounds, options=dict(maxiter=50)
    )
    deviation = np.sqrt(np.diag(posterior_covariance(search.objective, found.x)))
    sigma_v, sigma_w = search.sigmas(found.x)
    result = Calibration(arguments | dict(model=model, sigma_v=sigma_v, sigma_w=sigma_w))
    if delays_s:
        result["delays_s"] = delays_s
    result.report = _report(search, found.x, deviation)
    result.terms = pd.DataFrame()
    result.yaml = ""
    result.remarks = []
    return result
