"""Both nonlinear problems for other tools, each a function of a Problem that returns its
optimum.

Shared are the model and its Runge-Kutta step, horizon, weights and bounds, and the data, to which
the arrival cost belongs: its update costs the peers nothing. IPOPT begins at its previous solution
and iterates until its default tolerance is met. Opti tells it that this start is a good one, which
saves iterations; do-mpc is used as its documentation has it. FATROP is an interior-point method by
stages.
"""

import functools
import warnings

import casadi as ca
import numpy as np
from oracles import PAPER

from notebooks.studies.ipopt import PlanProblem, Solver, WindowProblem, next_state
from rhec import paper

quiet = functools.partial(warnings.catch_warnings, action="ignore")
try:
    with quiet():  # it warns of what it could do if more were installed
        import do_mpc
except ImportError:
    do_mpc = None

WEIGHTS = 1 / np.square(paper.SIGMA_V)
Q, QN = np.diag(paper.Q3), paper.QN_FACTOR * np.diag(paper.Q3)
IPOPT = Solver(
    "ipopt",
    {
        "print_level": 0,
        "sb": "yes",
        "warm_start_init_point": "yes",
        "mu_init": 1e-6,
        "warm_start_bound_push": 1e-9,
        "warm_start_mult_bound_push": 1e-9,
    },
)
FATROP = Solver("fatrop", {"print_level": 0}, by_stages=True)
ROBOT = PAPER["parameter"]
next_pose = next_state(ROBOT, paper.DT_S)


def squared(error, weight):
    return ca.bilin(weight, error, error)


# CasADi's Opti: multiple shooting


def warm(problem, answer, guess):
    """The function of the data alone that begins where it ended the last time."""
    opti = problem.opti
    data = [*problem.given, opti.x, opti.lam_g]
    function = opti.to_function("solve", data, [answer, opti.x, opti.lam_g])
    x, multipliers = guess, 0

    def solve(*data):
        nonlocal x, multipliers
        answer, x, multipliers = function(*data, x, multipliers)
        return answer.full().ravel()

    return solve


def rhe_by(solver, first):
    N = len(first.omega_ref)
    window = WindowProblem(ROBOT, N, paper.DT_S, solver=solver)
    weights = window.weights(first.z.T, paper.SIGMA_V).T
    window.begin(first.m, first.z.T)
    guess = window.opti.debug.value(window.opti.x, window.opti.initial())
    solve = warm(window, window.s[:, -1], guess)
    return lambda problem: solve(problem.m, problem.H, problem.z, weights)


def rhc_by(solver, first):
    N = len(first.omega_ref)
    bounds = {"omega_radps": (-paper.OMEGA_MAX_RADPS, paper.OMEGA_MAX_RADPS)}
    options = dict(model=ROBOT, dt=paper.DT_S, horizon=N, bounds=bounds)
    options |= dict(q=paper.Q3, qn_factor=paper.QN_FACTOR, r=(paper.R,))
    plan = PlanProblem(options, solver)
    poses = first.xi_ref.T
    guess = [np.append(pose, u) for pose, u in zip(poses, first.omega_ref)]
    solve = warm(plan, plan.u, np.concatenate([*guess, poses[-1]]))

    def by_problem(problem):
        pose, p = problem.estimate[:3], problem.estimate[3:]
        return solve(pose, p, problem.xi_ref, problem.omega_ref[None])

    return by_problem


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


PEERS = {
    name: (functools.partial(rhe_by, solver), functools.partial(rhc_by, solver))
    for name, solver in {"Opti + IPOPT": IPOPT, "FATROP": FATROP}.items()
}
if do_mpc:
    PEERS["do-mpc"] = (do_mpc_rhe, do_mpc_rhc)
