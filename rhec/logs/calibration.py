"""Calibration: noise, side slip and lever arm of a recorded robot, from its log alone.

Found are the numbers under which the log's positions are likeliest, as a Kalman filter of the
slipping robot predicts each from the positions before and the encoders. Predicting 0.6 to 2 s
ahead, too, found no better numbers on four robots' logs and worse ones on one. The rest is Bayes:
broad priors stand in for what a log cannot tell, and the posterior is taken to be normal about its
maximum (Laplace). A position further off than OUTLIER standard deviations counts less (Huber).
"""

import sys
from typing import Any, NamedTuple

import casadi as ca
import numpy as np
import pandas as pd
from scipy.optimize import minimize, minimize_scalar

from rhec import paper
from rhec.core._casadi import compiled, scan
from rhec.core._casadi.build import pack_array, with_packed_memory
from rhec.core._casadi.validation import Flag, Positive, Real, checked
from rhec.core.estimator import kalman
from rhec.core.model import base
from rhec.core.solver.gauss_newton import symmetric
from rhec.extensions import slipping
from rhec.logs.log_checks import refuse_implausible
from rhec.logs.reader import read
from rhec.logs.recording import prepare, resample
from rhec.simulation.columns import AGE, MEASUREMENTS
from rhec.simulation.scenario import Scenario
from rhec.tracked_robot.estimators import estimator_of

__all__ = ["Calibration", "calibrate"]

OUTLIER = 3.0
# Errors of recorded positions are not white, so that each says less than a filter takes from it: a
# replay takes them to be larger than found.
_COLOURED = 1.75
_MODEL = slipping.SPEED_MODELS["slipping"].model
_ARM = _MODEL.joint_names.index("arm_forward_m")
# Before the first sample, of (x, y, θ, l_f, l_l, μ, κ); positions count once the first yaw is found
_SIGMA_FIRST = np.array([0.05, 0.05, 0.1, 0.3, 0.3, 0.25, 0.25])
_SETTLED_M = 3.0
# first yaws tried, over so much of the way
_N_HEADINGS = 32
_HEADING_M = 15.0
_HESSIAN_STEP = 0.1  # in prior deviations
_TOLD = 0.5  # a number is told by the log if its deviation is below this share of the prior's
_TOLD_ARM_M = 0.05
_LEAST_POSITIONS = 50


class _Unknown(NamedTuple):
    """A number to be found, with its prior: the logarithm of a scale, or the number, is normal."""

    name: str
    unit: str
    middle: float
    deviation: float
    is_scale: bool = True
    least: float = 0.0

    def at(self, x):
        """Its value x prior deviations from the middle."""
        value = x * self.deviation
        value = self.middle * np.exp(value) if self.is_scale else self.middle + value
        return np.maximum(value, self.least)


# a log hardly tells the walks
_BROAD = np.log(3.0)
_NARROW = np.log(2.0)
_KNOWN = np.log(1.3)
_UNKNOWNS = (
    # Smooth or interpolated positions seem better, until slip is found in what is wrong with them.
    _Unknown("noise of the position", "m", 0.05, _BROAD, least=0.02),
    _Unknown("noise of ν", "m/s", 0.03, _BROAD),
    _Unknown("noise of ω", "rad/s", 0.012, _BROAD),
    _Unknown("walk of μ", "1/√m", 0.004, _KNOWN),
    _Unknown("walk of κ", "1/√m", 0.007, _KNOWN),
    _Unknown("slip ahead, share of ν", "-", 0.1, _NARROW),
    _Unknown("slip in turning, share of ω", "-", 0.06, _NARROW),
    _Unknown("slip sideways, share of bω", "-", 0.06, _NARROW),
    _Unknown("bumps", "rad/√m", 0.02, _NARROW),
    _Unknown("side slip", "s", 0.05, 0.05, is_scale=False),
)


class Calibration(dict):
    """What `rhec.replay` takes of a log: sigma_v, sigma_w, slip, and lever_arm_m if the log tells.

    report   DataFrame, one row a number: its value, the bounds of its 95 % interval, low and high,
             its unit, and whether the log has told it; if not, it is little more than the prior
    """

    report: pd.DataFrame

    def __str__(self) -> str:
        untold = list(self.report.index[~self.report["told"]])
        told = f"The log cannot tell: {', '.join(untold)}." if untold else "The log tells all."
        return f"{self.report.to_string(float_format='%.3g')}\n{told}"


def _build_filter(outlier):
    """The filter as a Function (memory, z_N, V, c, W) -> (memory, row), to be scanned.

    z_N (5,) ends with the age of the position; a row is the loss of the position, the mean
    (x, y, θ, l_f, l_l, μ, κ) and its variances.
    """
    interval = base.interval(_MODEL)
    constants = _MODEL.motion_noise.constants
    n_s = interval.n_s
    n_v = interval.n_v
    shapes = dict(m=(n_s, 1), P=(n_s, n_s), v=(n_v, 1), started=(1, 1))
    given = dict(z_N=(5, 1), V=(4, 1), c=(len(constants), 1), W=(n_s, 1))

    @with_packed_memory("calibrated", shapes, ca.SX, **given)
    def step(m, P, v, started, z_N, V, c, W):
        v, R_v = interval.input_noise(z_N, v, V, c)
        F, D, B = interval.linearised(m, v, paper.DT_S)
        A = interval.A_0 + D
        W = interval.process_noise(v, W, paper.DT_S, c)
        predicted = symmetric(A @ P @ A.T + B @ ca.diag(R_v) @ B.T) + ca.diag(W)
        m_before = m
        m = ca.if_else(started, F, m)
        P = ca.if_else(started, predicted, P)
        since = started * (F - interval.step(m_before, v, paper.DT_S - z_N[4]))[:2]  # it was read
        z = ca.vertcat(z_N[:2] + ca.if_else(z_N[4] > 0, since, 0), z_N[2:])
        S = P[:2, :2] + ca.diag(V[:2])
        y = z[:2] - m[:2]
        used = interval.outputs[0].is_valid(z) * interval.outputs[1].is_valid(z)
        far = ca.if_else(used, ca.sqrt(ca.bilin(ca.inv_minor(S), y, y)) / outlier, 0)
        loss = outlier**2 * ca.if_else(far < 1, far**2, 2 * far - 1) + ca.log(ca.det(S))
        m, P, _, _, _ = kalman.update(m, P, z, V * ca.fmax(far, 1) ** 2, interval.outputs, m)
        row = ca.vertcat(ca.if_else(used, loss, 0), m, ca.diag(P))
        return dict(row=row, m=m, P=P, v=v, started=1)

    return scan.build_scan(step)


def _values(x):
    return [float(unknown.at(each)) for unknown, each in zip(_UNKNOWNS, x)]


def _fields(x):
    """Fields of a Scenario where the search is at x."""
    position, *rest = _values(x)
    return dict(
        sigma_v=(position, position, *rest[:2]), sigma_w=tuple(rest[2:4]), slip=tuple(rest[4:])
    )


def _filtered(z, x, yaw_rad, width_m):
    """Rows of the filter for one segment's z (n, 5), with the numbers at x."""
    choice = dict(speed_model="slipping", track_width_m=width_m)
    settings = estimator_of("rhe").settings(Scenario(**choice, **_fields(x)))
    first = z[np.isfinite(z[:, :2]).all(axis=1)][0]
    memory = dict(
        m=np.array([*first[:2], yaw_rad, 0.0, 0.0, 1.0, 1.0]), P=np.diag(_SIGMA_FIRST**2),
        v=np.zeros(len(_MODEL.inputs)), started=0.0,
    )  # fmt: skip
    return scan.scan(compiled.load(_build_filter, OUTLIER), pack_array(memory), z, settings)[1]


def _driven(z):
    """Way that the tracks ran until each sample [m]."""
    return paper.DT_S * np.nancumsum(np.abs(z[:, 2]))


def _first_yaw(z, x, width_m):
    """The likeliest yaw at the beginning of a segment [rad]."""
    begin = z[: np.searchsorted(_driven(z), _HEADING_M) + 1]

    def loss(yaw_rad):
        return np.nan_to_num(_filtered(begin, x, yaw_rad, width_m)[:, 0].sum(), nan=np.inf)

    apart = 2 * np.pi / _N_HEADINGS
    nearest = min(apart * np.arange(_N_HEADINGS), key=loss)
    about = (nearest - apart, nearest + apart)
    options = dict(maxiter=12)
    return float(minimize_scalar(loss, bounds=about, method="bounded", options=options).x)


def _objective(segments, yaws, width_m):
    """x -> minus the log posterior, up to a constant."""
    parts = [(z, yaw, _driven(z) > _SETTLED_M) for z, yaw in zip(segments, yaws)]

    def minus_log_posterior(x):
        losses = (_filtered(z, x, yaw, width_m)[settled, 0].sum() for z, yaw, settled in parts)
        value = sum(losses) / 2 + x @ x / 2
        return value if np.isfinite(value) else 1e12

    return minus_log_posterior


def _covariance(objective, x):
    """Inverse of the curvature of the objective at its minimum x."""
    n = len(x)
    h = _HESSIAN_STEP
    at = objective(x)
    axes = h * np.eye(n)
    ahead, behind = (np.array([objective(x + sign * e) for e in axes]) for sign in (1, -1))
    H = np.diag((ahead - 2 * at + behind) / h**2)
    for i, j in zip(*np.triu_indices(n, 1)):
        both = objective(x + axes[i] + axes[j])
        H[i, j] = H[j, i] = (both - ahead[i] - ahead[j] + at) / h**2
    values, vectors = np.linalg.eigh(H)
    return vectors / np.clip(values, 1.0, None) @ vectors.T  # never wider than the prior


@checked
def calibrate(
    log: Any,
    *,
    track_width_m: Positive | None = None,
    position_delay_s: Real = 0.0,
    trust_log: Flag = False,
) -> Calibration:
    """Noise, side slip and lever arm of a recorded robot, from its log alone, without truth.

    `rhec.replay(log, **rhec.calibrate(log))` replays a log with its own numbers. Found are, in the
    words of the report, the noise of positions and encoders, how μ and κ walk, the shares of slip,
    bumps, side slip, and where the antenna is. The antenna's place ahead is that from the centre of
    turning, which nobody can tell from a lever arm and a centre elsewhere.

    Args:
        log: DataFrame of a recording, as `rhec.replay` takes it; the truth in it is not looked at.
        track_width_m: As in `rhec.replay`, like the next two.
        position_delay_s: How late the positions were stamped [s].
        trust_log: Whether to take a log as it is in which something is surely wrong.

    Returns:
        A dict of arguments of `rhec.replay`, these three among them, with a `report`.

    Raises:
        ValueError: For a log that `rhec.replay` refuses, or one with less than 50 positions in a
            segment where the robot drives some metres.
    """
    given = dict(
        track_width_m=track_width_m, position_delay_s=position_delay_s, trust_log=trust_log
    )
    recording = prepare(log, track_width_m, position_delay_s)
    if not trust_log:
        refuse_implausible(recording)
    width_m = recording.track_width_m
    samples = (
        resample(rows, paper.DT_S, recording.averaged)
        for _, rows in recording.rows.groupby("segment")
    )
    segments = [
        z
        for z in (part[[*MEASUREMENTS, AGE[0]]].to_numpy() for part in samples)
        if np.isfinite(z[:, :2]).all(axis=1).sum() >= _LEAST_POSITIONS
        and _driven(z)[-1] > 2 * _SETTLED_M
    ]
    if not segments:
        raise ValueError(
            f"the log had no segment with {_LEAST_POSITIONS} positions over {2 * _SETTLED_M:g} m; "
            "a robot that hardly moves tells nothing"
        )
    x = np.zeros(len(_UNKNOWNS))
    for _ in range(2):  # the second time with better first yaws
        yaws = [_first_yaw(z, x, width_m) for z in segments]
        objective = _objective(segments, yaws, width_m)
        found = minimize(
            objective, x, method="L-BFGS-B", bounds=[(-4, 4)] * len(x), options=dict(maxiter=50)
        )
        x = found.x
    deviation = np.sqrt(np.diag(_covariance(objective, x)))
    low = _values(x - 1.96 * deviation)
    high = _values(x + 1.96 * deviation)
    rows = [*zip(_values(x), low, high, (u.unit for u in _UNKNOWNS), deviation < _TOLD)]
    arm, sigma = _lever_arm(segments, x, yaws, width_m)
    rows += [
        (*(arm[i] + side * sigma[i] for side in (0, -1.96, 1.96)), "m", sigma[i] < _TOLD_ARM_M)
        for i in range(2)
    ]
    result = Calibration(_fields(x))
    position, _, *encoders = result["sigma_v"]
    result["sigma_v"] = (_COLOURED * position,) * 2 + tuple(encoders)
    if (sigma < _TOLD_ARM_M).all():
        result["lever_arm_m"] = tuple(arm.tolist())
    result.update({name: value for name, value in given.items() if value})
    names = [*(unknown.name for unknown in _UNKNOWNS), "antenna ahead", "antenna left"]
    columns = ["value", "low", "high", "unit", "told"]
    result.report = pd.DataFrame(rows, index=names, columns=columns)
    return result


def _lever_arm(segments, x, yaws, width_m):
    """Place of the antenna (ahead, left) [m] and its deviations: of all segments together."""
    place = slice(1 + _ARM, 3 + _ARM)
    last = [_filtered(z, x, yaw, width_m)[-1] for z, yaw in zip(segments, yaws)]
    arms, variances = (np.array([row[part] for row in last])
                       for part in (place, slice(place.start + 7, place.stop + 7)))  # fmt: skip
    variance = 1 / (1 / variances).sum(axis=0)
    return variance * (arms / variances).sum(axis=0), np.sqrt(variance)


if __name__ == "__main__":
    try:
        found = calibrate(read(sys.argv[1]))
    except (ValueError, ImportError) as error:
        sys.exit(str(error))
    print(found, f"rhec.replay(log, **{dict(found)})", sep="\n")
