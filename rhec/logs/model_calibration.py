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

from rhec.core._casadi import compiled
from rhec.core._casadi.build import with_packed_memory
from rhec.core._casadi.packing import pack_array
from rhec.core.estimator import kalman, offline
from rhec.core.estimator.base import joint_guess, noise_of
from rhec.core.estimator.ekf import EKF
from rhec.core.estimator.innovation_gate import ROBUST
from rhec.core.model import base
from rhec.core.model.base import Model
from rhec.core.solver.gauss_newton import symmetric
from rhec.logs.calibration import Calibration, is_determined, posterior_covariance
from rhec.logs.recording import Recording, prepare_for, resample

_PRIOR = np.log(3.0)  # standard deviation of the logarithm of a standard deviation
_NEEDED = ("dt", "sigma_v", "sigma_w", "guess", "sigma_guess")
_PASSED_ON = ("horizon", "arrival_mean", "robust")
_LEAST_SAMPLES = 50  # with measurements


def _moved(interval, F, m, v, dt_s, z, ages_s, started):
    """The measurements z moved by what the model did since they were made.

    z_k + h_k(F) - h_k(state at dt - age_k) of each output k, with its age in ages_s (n_z,).
    """
    moved = ca.vertsplit(z)
    for output in interval.outputs:
        age_s = ages_s[output.row]
        then = interval.step(m, v, dt_s - age_s)
        since = started * (output.h(F) - output.h(then))
        moved[output.row] += ca.if_else(age_s > 0, since, 0)
    return ca.vertcat(*moved)


def _build_filter(model, dt_s):
    """The scan of a Kalman filter that counts outliers less.

    Its step takes the measurements z and, in the same vector, their ages [s]. It records the mean
    of the joint state, its variances, and the loss of the sample's outputs:
    c ρ(d/c) + log det S with d = y' S⁻¹ y, the limit c of d, and ρ(r) = r up to 1, then 1 + log r.
    """
    interval = base.interval(model)
    n_z = len(model.outputs)
    n_s = interval.n_s
    limit = float(chi2.isf(ROBUST, max(len(interval.outputs), 1)))
    memory = dict(m=(n_s, 1), P=(n_s, n_s), v=(interval.n_v, 1), started=(1, 1))
    noise = dict(V=(n_z, 1))
    if model.motion_noise:
        noise["c"] = (len(model.motion_noise.constants), 1)
    shapes = dict(z_N=(2 * n_z, 1), noise=noise, W=(n_s, 1))

    @with_packed_memory("calibrated_model", memory, ca.SX, **shapes)
    def step(m, P, v, started, z_N, noise, W):
        z = z_N[:n_z]
        v, R_v = interval.input_noise(z, v, **noise)
        F, D, B = interval.linearised(m, v, dt_s * started)
        A = interval.A_0 + D
        Q = symmetric(B @ ca.diag(R_v) @ B.T)
        Q += ca.diag(interval.process_noise(v, W, dt_s, noise.get("c")))
        z = _moved(interval, F, m, v, dt_s, z, z_N[n_z:], started)
        m = ca.if_else(started, F, m)
        P = ca.if_else(started, symmetric(A @ P @ A.T) + Q, P)
        V = noise["V"]
        plain = kalman.update(m, P, z, V, interval.outputs, m)
        far = plain.distance / limit
        loss = limit * ca.if_else(far < 1, far, 1 + ca.log(ca.fmax(far, 1)))
        loss += plain.deviance - plain.distance
        # This loss gives an outlier the weight of a measurement with a variance larger by d/c.
        updated = kalman.update(m, P, z, V * ca.fmax(far, 1), interval.outputs, m)
        recorded = dict(estimate=updated.m, variances=ca.diag(updated.P), loss=loss)
        return recorded | dict(m=updated.m, P=updated.P, v=v, started=1)

    return offline.build(step, ["estimate", "variances", "loss"])


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
            offline.run(self._functions, self._memory, stream, settings) for stream in self.segments
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
