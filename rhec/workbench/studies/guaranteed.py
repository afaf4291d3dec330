"""Which errors may there be if 0.12 m is to be *guaranteed*: l1 gains of the loop on a row.

On a row, near the path, estimator and controller are linear. With the distance e from the path, the
relative yaw ψ, the commanded yaw rate u and samples of Δt, and with w = μ v Δt:

    ψ⁺ = ψ + κ Δt u + w δ + Δt b,    e⁺ = e + w ψ + ½ w (κ Δt u + w δ + Δt b),    y = e + g

g is the error of the GNSS across the row [m], δ the yaw drift by a difference of slip [rad/m], and
b the yaw rate of bumps [rad/s]. The estimator is the steady-state Kalman filter of (e, ψ), or of
(e, ψ, δ), with its V and W. The controller is the QP of the RHC without active bounds.

For an output, the response h_k to an impulse of one signal k samples ago gives the l1 gain Σ |h_k|.
No signal that is bounded by 1 makes the output larger, and the signal sign(h_k) attains it (Dahleh
and Pearson, "l1-optimal feedback controllers for MIMO discrete-time systems", 1987). Therefore

    |e| ≤ a sup|g| + d sup|δ| + c sup|b|

holds for all signals, and a smaller bound for none. Curves, saturation, and what lies between
samples are not in this.
"""

from typing import NamedTuple

import numpy as np
import pandas as pd
from scipy.linalg import solve_discrete_are

from rhec import paper
from rhec.simulation.scenario import Scenario
from rhec.tracked_robot.estimators import estimator_of
from rhec.tracked_robot.tuned_loops import OWN_SPEED, TUNED
from rhec.tracked_robot.tuning import variances_of

__all__ = [
    "LOOPS",
    "OUTPUTS",
    "SIGNALS",
    "RowLoop",
    "gains",
    "guaranteed",
    "impulse_response",
    "row_loop",
    "worst",
]

SIGNALS = ("gnss_m", "yaw_drift_radpm", "bump_radps")
_NOSE_M = paper.ROBOT_LENGTH_M / 2
# Of (e, ψ): the centre, and both ends of the robot, whose corners they are.
OUTPUTS = dict(centre=np.array([[1, 0]]), corner=np.array([[1, _NOSE_M], [1, -_NOSE_M]]))
_SAMPLES = 4000  # of an impulse response
_OF_SIGMA = 3.0  # standard deviations of a world's signals, in place of a bound

_RTK = dict(gnss_sigma_m=0.008, sigma_v=(0.008, 0.008, 0.05, 0.0175))
# {name: fields of Scenario}, in the default world.
LOOPS = {
    "paper's RHC, R = 10, bounded EKF": dict(estimator="bounded_ekf", process_noise="calibrated"),
    "tuned RHC, yaw-drift EKF": TUNED["default"]["yaw_drift_ekf"],
    "speed RHC, 0.5 m/s": OWN_SPEED,
    "speed RHC, 0.4 m/s": OWN_SPEED | dict(speed_mps=0.4),
    "speed RHC, 0.3 m/s": OWN_SPEED | dict(speed_mps=0.3),
    "speed RHC, 0.5 m/s, GNSS of 8 mm": OWN_SPEED | _RTK,
}


class RowLoop(NamedTuple):
    """The linear closed loop on a row: x⁺ = A x + B w, (e, ψ) = C x, with w of SIGNALS."""

    A: np.ndarray
    B: np.ndarray
    C: np.ndarray


def row_loop(scenario):
    """The RowLoop of a scenario at its set speed, with the means of its soil.

    Args:
        scenario: A Scenario with the estimator "bounded_ekf" or "yaw_drift_ekf", and the controller
            "rhc" or "speed_rhc".

    Raises:
        ValueError: If it has another estimator or controller.
    """
    _check(scenario)
    has_drift = estimator_of(scenario.estimator).has_yaw_drift
    way = scenario.mu_mean * scenario.speed_mps * paper.DT_S
    turn = scenario.kappa_mean * paper.DT_S
    move = np.array([[1.0, way], [0.0, 1.0]])
    by_yaw = np.array([way / 2, 1.0])
    n = 3 if has_drift else 2
    model = np.eye(n)
    model[:2, :2] = move
    if has_drift:
        model[:2, 2] = way * by_yaw
    gain = _kalman_gain(model, scenario)
    of_state, of_last = _control_gain(move, turn * by_yaw, scenario)
    # ω + d is planned and ω commanded, with d = w δ / (κ Δt).
    cancel = way / turn if has_drift else 0.0
    feedback = np.append(-of_state, -cancel * (1 - of_last))[:n]
    # x = (e, ψ, the prediction of the estimator, the last command).
    measure = np.zeros(n + 3)
    measure[0] = 1.0
    corrected = np.zeros((n, n + 3))
    corrected[:, 2:-1] = np.eye(n) - np.outer(gain, np.eye(n)[0])
    corrected += np.outer(gain, measure)
    command = feedback @ corrected
    command[-1] += of_last
    truth = np.zeros((2, n + 3))
    truth[:, :2] = move
    by_command = np.append(turn * by_yaw, np.zeros(n - 2))
    A = np.vstack(
        [
            truth + np.outer(turn * by_yaw, command),
            model @ corrected + np.outer(by_command, command),
            command,
        ]
    )
    commanded = feedback @ gain
    by_gnss = [turn * by_yaw * commanded, model @ gain + by_command * commanded, commanded]
    B = np.zeros((n + 3, len(SIGNALS)))
    B[:, 0] = np.hstack(by_gnss)
    B[:2, 1] = way * by_yaw
    B[:2, 2] = paper.DT_S * by_yaw
    return RowLoop(A, B, np.eye(2, n + 3))


def _check(scenario):
    """Refuse a scenario whose loop is not written down here."""
    for name, choices in (
        ("estimator", ("bounded_ekf", "yaw_drift_ekf")),
        ("controller", ("rhc", "speed_rhc")),
    ):
        value = getattr(scenario, name)
        if not isinstance(value, str) or value not in choices:
            raise ValueError(f"{name} was {value!r}; it should be one of {choices}")


def _kalman_gain(model, scenario):
    """Steady-state gain L of the filter of (e, ψ[, δ]): x̂ = x̂⁻ + L (y - ê⁻).

    Of the estimator's W, (y, θ) and the yaw drift count: μ, κ and ν have no effect on a row.
    """
    variances = variances_of(scenario.estimator, scenario)
    W = variances["W"][[1, 2, *range(6, 4 + len(model))]]
    V = variances["V"][1]
    H = np.eye(1, len(model))
    P = solve_discrete_are(model.T, H.T, np.diag(W), np.array([[V]]))
    return P[:, 0] / (P[0, 0] + V)


def _control_gain(move, by_command, scenario):
    """(K, k) of the RHC's first command u = -K (e, ψ) + k u_ref, by its condensed QP.

    The paper's reference u_ref is the measured yaw rate, here the last command; on a row that of
    "speed_rhc" is 0.
    """
    N = scenario.prediction_horizon
    Q = np.diag(scenario.q[1:])
    free = [np.linalg.matrix_power(move, i) for i in range(1, N + 1)]
    forced = np.zeros((N, 2, N))
    for i in range(N):
        for j in range(i + 1):
            forced[i, :, j] = np.linalg.matrix_power(move, i - j) @ by_command
    weights = [Q] * (N - 1) + [scenario.qn_factor * Q]
    H = scenario.r * np.eye(N) + sum(S.T @ W @ S for S, W in zip(forced, weights))
    F = sum(S.T @ W @ Phi for S, W, Phi in zip(forced, weights, free))
    first = np.linalg.inv(H)[0]
    is_measured = scenario.controller == "rhc" and scenario.input_reference == "measured"
    return first @ F, scenario.r * first.sum() * is_measured


def impulse_response(loop, output, samples=_SAMPLES):
    """h (samples, rows of output, signals): the output k + 1 samples after an impulse.

    Args:
        loop: A RowLoop.
        output: Rows by which (e, ψ) count, of OUTPUTS.
        samples: Length of the response.
    """
    h = np.empty((samples, len(output), len(SIGNALS)))
    state = loop.B
    for k in range(samples):
        h[k] = output @ loop.C @ state
        state = loop.A @ state
    return h


def gains(scenario):
    """The l1 gains of each signal: {output: (3,) in the order of SIGNALS}."""
    loop = row_loop(scenario)
    return {
        name: np.abs(impulse_response(loop, output)).sum(axis=0).max(axis=0)
        for name, output in OUTPUTS.items()
    }


def worst(scenario, signal, samples):
    """The signal, bounded by 1, that moves the centre farthest from the path.

    Args:
        scenario: As of `row_loop`.
        signal: Its place in SIGNALS.
        samples: Its length. The largest distance comes one sample after its end.

    Returns:
        (samples,) values of 1 and -1.
    """
    h = impulse_response(row_loop(scenario), OUTPUTS["centre"], samples)[:, 0, signal]
    return np.where(h[::-1] < 0, -1.0, 1.0)


def guaranteed(loops=LOOPS, tolerance_m=paper.TOLERANCE_M):
    """What may act on each loop if its robot is to stay within the tolerance on a row.

    Args:
        loops: {name: fields of Scenario}.
        tolerance_m: The tolerance [m].

    Returns:
        DataFrame, one row a loop and output: the l1 gains; the largest bound of each signal if it
        acts alone, slip also as a share; and `at_three_sigma_m`, the bound of the distance where
        GNSS and bumps are bounded by three of the scenario's standard deviations, and the tracks
        slip as differently as it says.
    """
    rows = []
    for name, fields in loops.items():
        scenario = Scenario(**fields)
        drift = abs(scenario.slip_difference) / scenario.track_width_m
        largest = _OF_SIGMA * np.array([scenario.gnss_sigma_m, 0, scenario.bump_sigma_radps])
        largest[1] = drift
        for output, gain in gains(scenario).items():
            alone = tolerance_m / gain
            row = dict(loop=name, speed_mps=scenario.speed_mps, output=output)
            row |= dict(zip(("per_gnss", "per_yaw_drift_m2", "per_bump_ms"), gain))
            row |= dict(zip(("gnss_m", "yaw_drift_radpm", "bump_radps"), alone))
            row |= dict(slip_difference=alone[1] * scenario.track_width_m)
            rows.append(row | dict(at_three_sigma_m=gain @ largest))
    return pd.DataFrame(rows)
