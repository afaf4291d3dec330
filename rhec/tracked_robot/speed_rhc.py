"""A receding horizon controller that also chooses its speed. Not in the paper.

The commanded inputs are the yaw rate ω of the tracks and a speed w. The model is the paper's in
path coordinates: e is the distance to the left of the path and ψ the yaw relative to it. The speed
v follows w, so that a bound of w is one of v, too, and v changes by (w - v)/T at most:

    ė = μ v sin ψ
    ψ̇ = κ ω - μ v c cos ψ / (1 - c e)
    v̇ = (w - v) / T

The path's curvature c along the horizon is an input that is known. Where the soil gives less yaw
rate than the curve takes, μ v c > κ ω_max, a slower plan has the smaller e and ψ: the cost of eq.
(12) on e, ψ, ω and ν_set - w makes the robot slow down there, and in time. All constraints are
bounds of inputs, so that the solver is that of the paper's controller.

ν, w and v are positive here: in reverse, too, the robot follows the path in its direction, and ψ is
the yaw relative to the path's turned by π.
"""

import casadi as ca

from rhec import paper
from rhec.core._casadi.build import casadi_function, packed_size, unpack
from rhec.core.controller import rhc
from rhec.core.controller.horizon import Horizon
from rhec.core.model.base import Model
from rhec.tracked_robot.path import ahead_and_left
from rhec.tracked_robot.references import LEAST_KAPPA, nearest_turn, pose_at

SPEED_LAG_S = 0.5  # T
SLOWEST_MPS = 0.15
_LEAST_SLOPE = 0.2  # of 1 - c e, which is 0 at the centre of an arc
_STATES = ("left_m", "yaw_error_rad", "speed_mps")


def f(x, u, p):
    """The model above: dx/dt of x = (e, ψ, v) [m, rad, m/s].

    Args:
        x: (3,) as above.
        u: (3,) yaw rate ω [rad/s], speed w [m/s], curvature c of the path [1/m].
        p: (2,) traction coefficients (μ, κ).

    Returns:
        (3,) dx/dt.
    """
    e, psi, v = (x[i] for i in range(3))
    omega, w, c = (u[i] for i in range(3))
    mu, kappa = (p[i] for i in range(2))
    along = mu * v * ca.cos(psi) / ca.fmax(1 - c * e, _LEAST_SLOPE)
    return ca.vertcat(mu * v * ca.sin(psi), kappa * omega - c * along, (w - v) / SPEED_LAG_S)


MODEL = Model(
    states=_STATES,
    inputs=("omega_radps", "set_mps", "curvature_pm"),
    parameters=dict(mu=None, kappa=None),
    outputs=_STATES,
    f=f,
)


def horizon_of(N, dt_s=paper.DT_S):
    """The Horizon of N intervals of dt_s [s]: yaw rate and speed are commanded."""
    return Horizon(MODEL, (0, 1), dt_s, N)


def init(horizon, speed_mps):
    """Memory before the first sample: on the path, at the set speed."""
    return rhc.init(horizon, [0.0, 0.0, abs(speed_mps)], [1.0, 1.0])


def build_step(horizon, n_segments):
    """The controller as a Function (memory, estimate, s, …) -> (memory, kkt, command, ok, speed).

    Its memory is the plan, as that of the RHC. `Q` and `QN` are weights of (x, y, θ), of which e
    gets that of y and ψ that of θ; `r_speed` weighs ν_set - w.
    """
    step = rhc.build_phases(horizon)["step"]
    problem = _build_problem(horizon, n_segments)
    shapes = {name: problem.size_in(name) for name in problem.name_in()}
    del shapes["speeds"]

    @casadi_function("speed_rhc_step", ca.MX, memory=(packed_size(horizon.memory), 1), **shapes)
    def speed_rhc_step(memory, **signals):
        # The speeds of the last plan, from where that had the robot now.
        speeds = unpack(memory, horizon.memory)["s"][2, 1:]
        result = step(memory=memory, **problem(speeds=speeds, **signals))
        planned = unpack(result["memory"], horizon.memory)["s"][2, 1]
        speed = ca.if_else(signals["speed_mps"] < 0, -planned, planned)
        results = {name: result[name] for name in ("memory", "kkt", "ok")}
        return results | dict(command=result["command"][0], speed_mps=speed)

    return speed_rhc_step


def _build_problem(horizon, n_segments):
    """Weights, references, bounds and the first state of the RHC's problem, as a Function."""
    one = (1, 1)
    three = (3, 1)
    inputs = dict.fromkeys(("s", "period_m", "backwards", "speed_mps"), one)
    inputs |= dict.fromkeys(("R", "r_speed", "lower", "upper"), one)

    @casadi_function(
        "speed_rhc_problem",
        speeds=(1, horizon.N),
        estimate=(6, 1),
        segments=(5, n_segments),
        Q=three,
        QN=three,
        **inputs,
    )
    def problem(
        speeds, estimate, segments, Q, QN, s, period_m, backwards, speed_mps, R, r_speed, lower,
        upper,
    ):  # fmt: skip
        mu, kappa = ca.vertsplit(estimate[4:])
        set_mps = ca.fabs(speed_mps)
        e, psi = _path_coordinates(estimate, s, segments, period_m, backwards)
        c = _curvatures(mu * speeds, s, segments, period_m, horizon.dt_s)
        omega = c * mu * speeds / ca.fmax(kappa, LEAST_KAPPA)
        omega = ca.fmax(ca.fmin(omega, upper), lower)
        u_ref = ca.vertcat(omega, ca.repmat(set_mps, 1, horizon.N), c)
        x_ref = ca.repmat(ca.vertcat(0, 0, set_mps), 1, horizon.N + 1)
        weights = dict(Q=ca.vertcat(Q[1:], 0), QN=ca.vertcat(QN[1:], 0), R=ca.vertcat(R, r_speed))
        bounds = dict(
            lower=ca.vertcat(lower, ca.fmin(SLOWEST_MPS, set_mps)), upper=ca.vertcat(upper, set_mps)
        )
        s_0 = ca.vertcat(e, psi, speeds[0], mu, kappa)
        return weights | bounds | dict(s_0=s_0, x_ref=x_ref, u_ref=u_ref)

    return problem


def _path_coordinates(estimate, s, segments, period_m, backwards):
    """(e, ψ) [m, rad] of an estimated pose, for the arc length s [m] of the closest point."""
    pose, _ = pose_at(s, segments, period_m)
    offset = estimate[:2] - pose[:2]
    _, left = ahead_and_left(offset[0], offset[1], pose[2], ca)
    return left, nearest_turn(estimate[2] - pose[2] - backwards * ca.pi, 0)


def _curvatures(speeds, s, segments, period_m, dt_s):
    """The path's curvatures (1, N) [1/m] in the middle of each interval of the plan.

    `speeds` (1, N) are those over ground [m/s].
    """
    curvatures = []
    for way in ca.horzsplit(dt_s * speeds):
        curvatures.append(pose_at(s + way / 2, segments, period_m)[1])
        s = s + way
    return ca.horzcat(*curvatures)
