"""Linear time-varying MPC, against its problem written once more."""

import numpy as np
import pytest
from oracles import DT, flat, move
from scipy.optimize import lsq_linear

import rhec
from notebooks.further.rivals import ltv_mpc
from rhec import paper

pytestmark = pytest.mark.usefixtures("virtual_machine")
N = 6
P = np.array([0.5, 0.9, 0.8])  # ν, μ, κ
Q = np.array([1.0, 1.0, 0.3])
WEIGHTS = dict(Q=Q, QN=10 * Q, R=0.05)
CURVATURE = 0.1  # of the path [1/m]


def on_arc(s, c=CURVATURE):
    """Poses (3, n) on an arc through the origin."""
    return np.array([np.sin(c * s) / c, (1 - np.cos(c * s)) / c, c * s])


def command(pose, x_ref, bound=paper.OMEGA_MAX_RADPS):
    signals = dict(s_0=[*pose, *P], x_ref=x_ref, u_ref=np.zeros((1, N)), **WEIGHTS)
    step = ltv_mpc.controller(rhec.Scenario(prediction_horizon=N)).step
    result = step(**signals, lower=-bound, upper=bound)
    assert result["ok"] == 1
    return float(result["command"])


def by_least_squares(pose, x_ref, bound):
    """The QP about the path by finite differences of the robot's motion."""
    u_bar = np.clip(np.diff(x_ref[2]) / (P[2] * DT), -bound, bound)

    def after(x, u):
        return flat(move(x, *P, u))

    offset, slopes = np.array(pose) - x_ref[:, 0], np.zeros((3, N))
    rows, values = [], []
    h = 1e-6
    for i in range(N):
        x, u = x_ref[:, i], u_bar[i]
        A = np.array([after(x + h * e, u) - after(x - h * e, u) for e in np.eye(3)]).T / (2 * h)
        B = (after(x, u + h) - after(x, u - h)) / (2 * h)
        # The node's error to the path is offset + slopes (u - ū).
        offset = A @ offset + after(x, u) - x_ref[:, i + 1]
        slopes = A @ slopes
        slopes[:, i] += B
        weight = np.sqrt((10 if i == N - 1 else 1) * Q)
        rows.append(weight[:, None] * slopes)
        values.append(-weight * offset)
    # The reference of the yaw rate is 0.
    rows.append(np.sqrt(WEIGHTS["R"]) * np.eye(N))
    values.append(-np.sqrt(WEIGHTS["R"]) * u_bar)
    bounds = -bound - u_bar - 1e-12, bound - u_bar + 1e-12
    change = lsq_linear(np.vstack(rows), np.concatenate(values), bounds, tol=1e-14).x
    return (u_bar + change)[0]


@pytest.mark.parametrize("bound", [1.0, 0.1])
@pytest.mark.parametrize("pose", [(0, 0, 0), (0.02, 0.1, -0.05), (0, -0.2, 0.1)])
def test_it_is_the_qp_about_the_path(pose, bound):
    x_ref = on_arc(P[0] * P[1] * DT * np.arange(N + 1))
    expected = by_least_squares(pose, x_ref, bound)
    assert command(pose, x_ref, bound) == pytest.approx(expected, abs=1e-5)
