"""Both nonlinear problems of a Case for other tools, each a function of a Problem that returns its
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

from benchmark import models
from notebooks.studies.ipopt import PlanProblem, Solver, WindowProblem
from rhec import paper

quiet = functools.partial(warnings.catch_warnings, action="ignore")
try:
    with quiet():  # it warns of what it could do if more were installed
        import do_mpc
except ImportError:
    do_mpc = None

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


def rhe_by(solver, case, first):
    window = WindowProblem(case.model, case.horizon, paper.DT_S, solver=solver)
    weights = window.weights(first.z.T, case.sigma_v).T
    window.begin(first.m, first.z.T)
    guess = window.opti.debug.value(window.opti.x, window.opti.initial())
    solve = warm(window, window.s[:, -1], guess)
    return lambda problem: solve(problem.m, problem.H, problem.z, weights)


def rhc_by(solver, case, first):
    bounds = {case.model.inputs[0]: (-case.u_max, case.u_max)}
    options = dict(model=case.model, dt=paper.DT_S, horizon=case.horizon, bounds=bounds)
    options |= dict(q=case.q, qn_factor=case.qn_factor, r=(case.r,))
    plan = PlanProblem(options, solver)
    states = first.x_ref.T
    guess = [np.append(x, u) for x, u in zip(states, first.u_ref.T)]
    solve = warm(plan, plan.u, np.concatenate([*guess, states[-1]]))
    n_x = len(case.model.states)

    def by_problem(problem):
        x, p = np.split(problem.estimate, [n_x])
        return solve(x, p, problem.x_ref, problem.u_ref)

    return by_problem


# do-mpc: a discrete-time model with states x, one input u and parameters p


def _do_mpc_model(case):
    """A model of do-mpc with its variables x, u and p, before its right-hand side is set."""
    model = do_mpc.model.Model("discrete")
    x = model.set_variable("_x", "x", (len(case.model.states), 1))
    u = model.set_variable("_u", "u")
    p = model.set_variable("_p", "p", (len(case.model.parameters), 1))
    return model, x, u, p


def _next(case, x, u, p):
    return models.runge_kutta(models.SYSTEMS[case.system], x, u, p, paper.DT_S)


def do_mpc_rhe(case, first):
    """Measurement k belongs to the state after interval k and to its input, as rhec's z_{k+1} does.
    At the oldest node do-mpc has no measurement: that one counts in the arrival cost, a function of
    parameters that are given.
    """
    model, x, u, p = _do_mpc_model(case)
    weights = 1 / np.square(case.sigma_v)
    n_s, n_y = len(first.m), len(case.measured)
    for name, shape in dict(m=(n_s, 1), H=(n_s**2, 1), z_0=(n_y, 1)).items():
        model.set_variable("_p", name, shape)
    model.set_rhs("x", _next(case, x, u, p))
    measured = list(case.measured)
    model.set_meas("z", ca.vertcat(ca.vertcat(x, p)[measured], u))
    model.setup()

    mhe = do_mpc.estimator.MHE(model, ["p"])
    mhe.settings.n_horizon, mhe.settings.t_step = case.horizon, paper.DT_S
    mhe.settings.supress_ipopt_output()
    x, (p, m, H, z_0) = model.x["x"], (model.p[name] for name in ("p", "m", "H", "z_0"))
    s = ca.vertcat(x, p)
    oldest = squared(s - m, ca.reshape(H, n_s, n_s))
    oldest += squared(s[measured] - z_0, np.diag(weights[:n_y]))
    mhe.set_objective(squared(model.v.cat, np.diag(weights)) / 2, oldest / 2)
    bounds = [bound or (-np.inf, np.inf) for bound in case.model.parameters.values()]
    mhe.bounds["lower", "_p_est", "p"], mhe.bounds["upper", "_p_est", "p"] = zip(*bounds)
    given, window = mhe.get_p_template(), mhe.get_y_template()
    mhe.set_p_fun(lambda t: given)
    mhe.set_y_fun(lambda t: window)
    with quiet():
        mhe.setup()
    mhe.x0["x"], mhe.p_est0["p"] = np.split(first.estimate, [len(case.model.states)])
    mhe.set_initial_guess()

    def solve(problem):
        oldest = [problem.m, problem.H.ravel(), problem.z[:n_y, 0]]
        given.master = ca.DM(np.concatenate(oldest))
        window.master = ca.DM(problem.z[:, 1:].ravel(order="F"))
        state = mhe.make_step(problem.z[:, -1])
        return np.append(state, mhe.p_est0["p"].full())

    return solve


def do_mpc_rhc(case, first):
    """The term of node 0, which is given, is a constant."""
    model, x, u, p = _do_mpc_model(case)
    model.set_variable("_tvp", "x_ref", x.shape)
    model.set_variable("_tvp", "u_ref")
    model.set_rhs("x", _next(case, x, u, p))
    model.setup()

    mpc = do_mpc.controller.MPC(model)
    mpc.settings.n_horizon, mpc.settings.t_step = case.horizon, paper.DT_S
    mpc.settings.supress_ipopt_output()
    error = model.x["x"] - model.tvp["x_ref"]
    Q = np.diag(case.q)
    mpc.set_objective(
        mterm=squared(error, case.qn_factor * Q) / 2,
        lterm=(squared(error, Q) + case.r * (model.u["u"] - model.tvp["u_ref"]) ** 2) / 2,
    )
    mpc.set_rterm(u=0.0)
    mpc.bounds["lower", "_u", "u"], mpc.bounds["upper", "_u", "u"] = -case.u_max, case.u_max
    given, varying = mpc.get_p_template(1), mpc.get_tvp_template()
    mpc.set_p_fun(lambda t: given)
    mpc.set_tvp_fun(lambda t: varying)
    with quiet():
        mpc.setup()
    n_x = len(case.model.states)
    mpc.x0["x"] = first.estimate[:n_x]
    mpc.set_initial_guess()
    plan = mpc.opt_x.f["_u"]  # where it is among the unknowns

    def solve(problem):
        state, given["_p", 0] = np.split(problem.estimate, [n_x])
        references = np.vstack([problem.x_ref, np.append(problem.u_ref, 0)])
        varying.master = ca.DM(references.ravel(order="F"))
        mpc.make_step(state)
        return mpc.opt_x_num.cat.full()[plan, 0]

    return solve


PEERS = {
    name: (functools.partial(rhe_by, solver), functools.partial(rhc_by, solver))
    for name, solver in {"Opti + IPOPT": IPOPT, "FATROP": FATROP}.items()
}
if do_mpc:
    PEERS["do-mpc"] = (do_mpc_rhe, do_mpc_rhc)
