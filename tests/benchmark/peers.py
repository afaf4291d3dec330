"""Both nonlinear problems for other tools, each a function of a Problem that returns its
optimum.

Shared are the model and its Runge-Kutta step, horizon, weights and bounds, and the data, to which
the arrival cost belongs: its update costs the peers nothing. IPOPT begins at its previous solution
and iterates until its default tolerance is met. Opti tells it that this start is a good one, which
saves iterations; do-mpc is used as its documentation has it.
"""

import functools
import warnings

import casadi as ca
import numpy as np

from rhec import paper
from rhec.core.model import base
from rhec.tracked_robot import kinematics as model

quiet = functools.partial(warnings.catch_warnings, action="ignore")
try:
    with quiet():  # it warns of what it could do if more were installed
        import do_mpc
except ImportError:
    do_mpc = None

WEIGHTS = 1 / np.square(paper.SIGMA_V)
Q, QN = np.diag(paper.Q3), paper.QN_FACTOR * np.diag(paper.Q3)
WARM = {
    "warm_start_init_point": "yes",
    "mu_init": 1e-6,
    "warm_start_bound_push": 1e-9,
    "warm_start_mult_bound_push": 1e-9,
}
OPTIONS = {"print_time": False, "expand": True, "ipopt": {"print_level": 0, "sb": "yes", **WARM}}


def next_pose(xi, omega, p):
    return base.rk4(model.f, xi, omega, p, paper.DT_S)


def squared(error, weight):
    return ca.bilin(weight, error, error)


# CasADi's Opti: multiple shooting, written as in its documentation


def every_interval(horizon):
    xi, omega, p = ca.MX.sym("xi", 3), ca.MX.sym("omega"), ca.MX.sym("p", 3)
    return ca.Function("interval", [xi, omega, p], [next_pose(xi, omega, p)]).map(horizon)


def warm(function, guess):
    """The function (data …, x, λ) -> (answer, x, λ) as one of the data alone, which begins where it
    ended the last time.
    """
    x, multipliers = guess, 0

    def solve(*data):
        nonlocal x, multipliers
        answer, x, multipliers = function(*data, x, multipliers)
        return answer.full().ravel()

    return solve


def solver(opti, data, answer):
    opti.solver("ipopt", OPTIONS)
    return opti.to_function("solve", [*data, opti.x, opti.lam_g], [answer, opti.x, opti.lam_g])


def opti_rhe(first):
    N = len(first.omega_ref)
    opti = ca.Opti()
    xi, omega, p = opti.variable(3, N + 1), opti.variable(1, N), opti.variable(3)
    z, m, H = opti.parameter(4, N + 1), opti.parameter(6), opti.parameter(6, 6)
    nodes, inputs = ca.vertcat(xi[:2, :], ca.repmat(p[0], 1, N + 1)) - z[:3, :], omega - z[3, 1:]
    opti.minimize(
        (
            squared(ca.vertcat(xi[:, 0], p) - m, H)
            + ca.sumsqr(np.sqrt(WEIGHTS[:3, None]) * nodes)
            + WEIGHTS[3] * ca.sumsqr(inputs)
        )
        / 2
    )
    opti.subject_to(xi[:, 1:] == every_interval(N)(xi[:, :-1], omega, p))
    opti.subject_to(opti.bounded(0, p[1:], 1))
    solve = warm(
        solver(opti, [z, m, H], ca.vertcat(xi[:, -1], p)),
        np.concatenate([np.tile(first.estimate[:3], N + 1), first.z[3, 1:], first.estimate[3:]]),
    )
    return lambda problem: solve(problem.z, problem.m, problem.H)


def opti_rhc(first):
    N = len(first.omega_ref)
    opti = ca.Opti()
    xi, omega = opti.variable(3, N + 1), opti.variable(1, N)
    pose, p, xi_ref, omega_ref = (
        opti.parameter(3),
        opti.parameter(3),
        opti.parameter(3, N + 1),
        opti.parameter(1, N),
    )
    errors = ca.horzsplit(xi_ref - xi)
    opti.minimize(
        (
            sum(squared(error, Q) for error in errors[1:-1])
            + squared(errors[-1], QN)
            + paper.R * ca.sumsqr(omega_ref - omega)
        )
        / 2
    )
    opti.subject_to(xi[:, 0] == pose)
    opti.subject_to(xi[:, 1:] == every_interval(N)(xi[:, :-1], omega, p))
    opti.subject_to(opti.bounded(-paper.OMEGA_MAX_RADPS, omega, paper.OMEGA_MAX_RADPS))
    solve = warm(
        solver(opti, [pose, p, xi_ref, omega_ref], omega),
        np.concatenate([first.xi_ref.ravel(order="F"), first.omega_ref]),
    )
    return lambda problem: solve(
        problem.estimate[:3], problem.estimate[3:], problem.xi_ref, problem.omega_ref
    )


# FATROP, an interior-point method by stages: what is unknown stands in the order of the stages, the
# parameters are states that stay

FATROP = {"expand": True, "print_time": False, "structure_detection": "auto"}
FATROP["fatrop"] = {"print_level": 0}


def stages(N):
    """Opti, joint states s_0 … s_N, inputs, and the Function of an interval."""
    opti, s, omega = ca.Opti(), [], []
    for _ in range(N):
        s.append(opti.variable(6))
        omega.append(opti.variable())
    s.append(opti.variable(6))
    joint, u = ca.SX.sym("s", 6), ca.SX.sym("u")
    after = ca.vertcat(next_pose(joint[:3], u, joint[3:]), joint[3:])
    return opti, s, omega, ca.Function("interval", [joint, u], [after])


def by_fatrop(opti, data, answer, guess):
    opti.solver("fatrop", FATROP)
    names = [*data, opti.x, opti.lam_g], [answer, opti.x, opti.lam_g]
    return warm(opti.to_function("solve", *names), guess)


def fatrop_rhe(first):
    N = len(first.omega_ref)
    opti, s, omega, interval = stages(N)
    z, m, H = opti.parameter(4, N + 1), opti.parameter(6), opti.parameter(6, 6)
    cost = squared(s[0] - m, H)
    for i, node in enumerate(s):
        residual = ca.vertcat(node[:2], node[3]) - z[:3, i]
        cost += squared(residual, np.diag(WEIGHTS[:3]))
    cost += sum(WEIGHTS[3] * (u - z[3, i + 1]) ** 2 for i, u in enumerate(omega))
    opti.minimize(cost / 2)
    for i, u in enumerate(omega):
        opti.subject_to(s[i + 1] == interval(s[i], u))
    opti.subject_to(opti.bounded(0, s[N][4:], 1))
    guess = [np.append(first.estimate, u) for u in first.z[3, 1:]]
    solve = by_fatrop(opti, [z, m, H], s[N], np.concatenate([*guess, first.estimate]))
    return lambda problem: solve(problem.z, problem.m, problem.H)


def fatrop_rhc(first):
    N = len(first.omega_ref)
    opti, s, omega, interval = stages(N)
    estimate, xi_ref, omega_ref = opti.parameter(6), opti.parameter(3, N + 1), opti.parameter(1, N)
    errors = [node[:3] - xi_ref[:, i] for i, node in enumerate(s)]
    cost = sum(squared(error, Q) for error in errors[1:-1]) + squared(errors[-1], QN)
    cost += paper.R * sum((u - omega_ref[i]) ** 2 for i, u in enumerate(omega))
    opti.minimize(cost / 2)
    for i, u in enumerate(omega):
        opti.subject_to(s[i + 1] == interval(s[i], u))
        if i == 0:
            opti.subject_to(s[0] == estimate)
        opti.subject_to(opti.bounded(-paper.OMEGA_MAX_RADPS, u, paper.OMEGA_MAX_RADPS))
    p, poses = first.estimate[3:], first.xi_ref.T
    guess = [np.concatenate([pose, p, [u]]) for pose, u in zip(poses, first.omega_ref)]
    guess = np.concatenate([*guess, poses[-1], p])
    solve = by_fatrop(opti, [estimate, xi_ref, omega_ref], ca.horzcat(*omega), guess)
    return lambda problem: solve(problem.estimate, problem.xi_ref, problem.omega_ref)


# do-mpc: a discrete-time model with states (x, y, θ), input ω and parameters ν, μ, κ


def do_mpc_rhe(first):
    """Measurement k belongs to the state after interval k and to its input, as rhec's z_{k+1} does.
    At the oldest node do-mpc has no measurement: that one counts in the arrival cost, a function of
    parameters that are given.
    """
    robot, N = do_mpc.model.Model("discrete"), len(first.omega_ref)
    xi, omega = robot.set_variable("_x", "xi", (3, 1)), robot.set_variable("_u", "omega")
    p = robot.set_variable("_p", "p", (3, 1))
    for name, shape in dict(m=(6, 1), H=(36, 1), z_0=(3, 1)).items():
        robot.set_variable("_p", name, shape)
    robot.set_rhs("xi", next_pose(xi, omega, p))
    robot.set_meas("z", ca.vertcat(xi[:2], p[0], omega))
    robot.setup()

    mhe = do_mpc.estimator.MHE(robot, ["p"])
    mhe.settings.n_horizon, mhe.settings.t_step = N, paper.DT_S
    mhe.settings.supress_ipopt_output()
    xi, (p, m, H, z_0) = robot.x["xi"], (robot.p[name] for name in ("p", "m", "H", "z_0"))
    oldest = squared(ca.vertcat(xi, p) - m, ca.reshape(H, 6, 6)) + squared(
        ca.vertcat(xi[:2], p[0]) - z_0, np.diag(WEIGHTS[:3])
    )
    mhe.set_objective(squared(robot.v.cat, np.diag(WEIGHTS)) / 2, oldest / 2)
    mhe.bounds["lower", "_p_est", "p"], mhe.bounds["upper", "_p_est", "p"] = (
        (-np.inf, 0, 0),
        (np.inf, 1, 1),
    )
    given, window = mhe.get_p_template(), mhe.get_y_template()
    mhe.set_p_fun(lambda t: given)
    mhe.set_y_fun(lambda t: window)
    with quiet():
        mhe.setup()
    mhe.x0["xi"], mhe.p_est0["p"] = first.estimate[:3], first.estimate[3:]
    mhe.set_initial_guess()

    def solve(problem):
        given.master = ca.DM(np.concatenate([problem.m, problem.H.ravel(), problem.z[:3, 0]]))
        window.master = ca.DM(problem.z[:, 1:].ravel(order="F"))
        pose = mhe.make_step(problem.z[:, -1])
        return np.append(pose, mhe.p_est0["p"].full())

    return solve


def do_mpc_rhc(first):
    """The term of node 0, which is given, is a constant."""
    robot, N = do_mpc.model.Model("discrete"), len(first.omega_ref)
    xi, omega, p = (
        robot.set_variable("_x", "xi", (3, 1)),
        robot.set_variable("_u", "omega"),
        robot.set_variable("_p", "p", (3, 1)),
    )
    robot.set_variable("_tvp", "xi_ref", (3, 1))
    robot.set_variable("_tvp", "omega_ref")
    robot.set_rhs("xi", next_pose(xi, omega, p))
    robot.setup()

    mpc = do_mpc.controller.MPC(robot)
    mpc.settings.n_horizon, mpc.settings.t_step = N, paper.DT_S
    mpc.settings.supress_ipopt_output()
    error = robot.x["xi"] - robot.tvp["xi_ref"]
    mpc.set_objective(
        mterm=squared(error, QN) / 2,
        lterm=(squared(error, Q) + paper.R * (robot.u["omega"] - robot.tvp["omega_ref"]) ** 2) / 2,
    )
    mpc.set_rterm(omega=0.0)
    mpc.bounds["lower", "_u", "omega"], mpc.bounds["upper", "_u", "omega"] = (
        -paper.OMEGA_MAX_RADPS,
        paper.OMEGA_MAX_RADPS,
    )
    given, varying = mpc.get_p_template(1), mpc.get_tvp_template()
    mpc.set_p_fun(lambda t: given)
    mpc.set_tvp_fun(lambda t: varying)
    with quiet():
        mpc.setup()
    mpc.x0["xi"] = first.estimate[:3]
    mpc.set_initial_guess()
    plan = mpc.opt_x.f["_u"]  # where it is among the unknowns

    def solve(problem):
        given["_p", 0] = problem.estimate[3:]
        varying.master = ca.DM(
            np.vstack([problem.xi_ref, np.append(problem.omega_ref, 0)]).ravel(order="F")
        )
        mpc.make_step(problem.estimate[:3])
        return mpc.opt_x_num.cat.full()[plan, 0]

    return solve


PEERS = {"Opti + IPOPT": (opti_rhe, opti_rhc), "FATROP": (fatrop_rhe, fatrop_rhc)}
if do_mpc:
    PEERS["do-mpc"] = (do_mpc_rhe, do_mpc_rhc)
