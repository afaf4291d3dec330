"""Any robot: one step of estimation and control of the bicycle and the skid-steered robot of
`robots`, beside do-mpc on the same problems, after both have shown that they solve them.

Model and Runge-Kutta step, horizon, weights, bounds and data are the same. The arrival cost belongs
to the data: its update costs do-mpc nothing.
"""

import functools
import itertools
from typing import NamedTuple

import casadi as ca
import numpy as np
import pandas as pd
from oracles import drive_robot, flat, limits, outputs, plant, reads_inputs, runge_kutta
from robots import BICYCLE, DT, SKID_STEERED, N

import rhec
from benchmark.peers import do_mpc, quiet, squared
from benchmark.step import PHASES, TOLERANCE, clock, interleaved, spread

ROBOTS = {"bicycle": BICYCLE, "skid-steered": SKID_STEERED}
TIGHT = {"ipopt.tol": 1e-11, "ipopt.bound_relax_factor": 0.0}
SAMPLES, SHARE = 300, 10  # problems; how many of them do-mpc solves in a block
REFERENCE, SPEEDUP = "do-mpc", "speedup_over_do-mpc"


class Problem(NamedTuple):
    """One sample of a closed loop, and the optimum of its two nonlinear problems."""

    z: np.ndarray  # (n_z, N+1) the window of measurements, the newest last
    m: np.ndarray  # (n_x + n_p,) mean of the arrival cost
    H: np.ndarray  # its weight
    estimate: np.ndarray  # (n_x + n_p,) answer at the newest node; the controller starts from it
    x_ref: np.ndarray  # (n_x, N+1)
    u_ref: np.ndarray  # (n_u, N)
    u_plan: np.ndarray  # (n_u, N) answer


@functools.cache
def model(robot):
    return rhec.Model(**robot.model)


def live(robot, guess):
    """rhec's estimator and controller as they begin."""
    common = dict(model=model(robot), dt=DT, horizon=N)
    settings = robot.estimator | dict(guess=tuple(guess), arrival_mean="filtered")
    return rhec.RHE(**common, **settings), rhec.RHC(**common, **robot.controller)


def reference(robot, samples):
    """A drive that can be followed: inputs (n, n_u) that weave, the states (n+1, n_x) that they
    lead to, and the parameters.
    """
    (low, high), t = np.array(robot.u_range), np.arange(samples + N)[:, None]
    inputs = (low + high) / 2 + 0.15 * (high - low) * np.sin(0.06 * t + np.arange(len(low)))
    p = np.clip(np.mean(robot.p_range, axis=0), *limits(robot))
    states, _ = drive_robot(robot, np.zeros(len(robot.states)), inputs, p)
    return inputs, states, p


def record(robot, samples=SAMPLES, iterations=20, seed=0, planned=None):
    """The first guess, all measurements (n, n_z) and the problems, from the first full window on.

    The robot is driven by the solutions, each iterated so often; or, with the plans of another
    recording as `planned`, measurements and starts of the controller are that recording's.
    """
    rng, step = np.random.default_rng(seed), plant(robot)
    inputs, states, p = reference(robot, N + samples)
    guess, n_x = np.append(states[0], p), len(robot.states)
    estimator, controller = live(robot, guess)
    x, true_p = states[0] + 0.1, p + 0.3 * (np.array(robot.p_range[1]) - p)
    true_p = np.clip(true_p, *limits(robot))
    measured, problems = flat(outputs(robot, *map(ca.DM, (x, 0 * inputs[0], true_p)))), []
    log = []
    for k in range(N + samples):
        log.append(measured + rng.normal(size=len(measured)) * robot.sigma_v)
        if planned:
            log[-1] = planned[0][k]
        x_ref, u_ref = states[k : k + N + 1].T, inputs[k : k + N].T
        estimator.prepare()
        found = estimator.solve(log[-1], iterations)
        estimate, given = np.append(found.x, found.p), np.append(found.x, found.p)
        if planned and k >= N:
            given = planned[1][k - N].estimate
        controller.prepare()
        u = controller.solve(given[:n_x], given[n_x:], x_ref, u_ref, iterations)
        if k >= N:
            arrival, size = estimator.iteration.current, len(guess)
            H = np.linalg.inv(arrival["P"].reshape(size, size))
            window = np.array(log[k - N :]).T
            m, plan = arrival["m"].copy(), controller.u_plan.copy()
            problems.append(Problem(window, m, H, estimate, x_ref, u_ref, plan))
        if not planned:
            x, measured = (flat(each) for each in step(x, u, true_p))
    return guess, np.array(log), problems


# do-mpc: a discrete-time model, used as its documentation has it (see `peers` for how its
# measurements and its missing arrival mean are matched)


def do_mpc_model(robot, given):
    """do-mpc's model of the robot with what else is `given` {name: (kind, length)}."""
    made = do_mpc.model.Model("discrete")
    x = made.set_variable("_x", "x", (len(robot.states), 1))
    u = made.set_variable("_u", "u", (len(robot.inputs), 1))
    p = made.set_variable("_p", "p", (len(robot.parameters), 1))
    for name, (kind, length) in given.items():
        made.set_variable(kind, name, (length, 1))
    made.set_rhs("x", runge_kutta(robot, x, u, p, DT))
    return made, x, u, p


def do_mpc_rhe(robot, first, options=()):
    n_s, own = len(first.m), ~reads_inputs(robot)
    given = dict(m=("_p", n_s), H=("_p", n_s**2), z_0=("_p", int(own.sum())))
    made, x, u, p = do_mpc_model(robot, given)
    made.set_meas("z", outputs(robot, x, u, p))
    made.setup()

    mhe = do_mpc.estimator.MHE(made, ["p"])
    mhe.settings.n_horizon, mhe.settings.t_step = N, DT
    mhe.settings.nlpsol_opts = dict(options)
    mhe.settings.supress_ipopt_output()
    x, (p, m, H, z_0) = made.x["x"], (made.p[name] for name in ("p", "m", "H", "z_0"))
    at_start = outputs(robot, x, ca.SX.zeros(len(robot.inputs)), p)[np.flatnonzero(own)]
    weights = np.diag(1 / np.square(robot.sigma_v))
    oldest = squared(ca.vertcat(x, p) - m, ca.reshape(H, n_s, n_s))
    oldest += squared(at_start - z_0, weights[np.ix_(own, own)])
    mhe.set_objective(squared(made.v.cat, weights) / 2, oldest / 2)
    mhe.bounds["lower", "_p_est", "p"], mhe.bounds["upper", "_p_est", "p"] = limits(robot)
    parameters, window = mhe.get_p_template(), mhe.get_y_template()
    mhe.set_p_fun(lambda t: parameters)
    mhe.set_y_fun(lambda t: window)
    with quiet():
        mhe.setup()
    n_x = len(robot.states)
    mhe.x0["x"], mhe.p_est0["p"] = first.estimate[:n_x], first.estimate[n_x:]
    mhe.set_initial_guess()

    def solve(problem):
        parameters.master = ca.DM(np.concatenate([problem.m, problem.H.ravel(), problem.z[own, 0]]))
        window.master = ca.DM(problem.z[:, 1:].ravel(order="F"))
        newest = mhe.make_step(problem.z[:, -1])
        return np.append(newest, mhe.p_est0["p"].full())

    return solve


def do_mpc_rhc(robot, first, options=()):
    """The term of node 0, which is given, is a constant."""
    n_x, n_u = len(robot.states), len(robot.inputs)
    made, _, _, _ = do_mpc_model(robot, dict(x_ref=("_tvp", n_x), u_ref=("_tvp", n_u)))
    made.setup()

    mpc = do_mpc.controller.MPC(made)
    mpc.settings.n_horizon, mpc.settings.t_step = N, DT
    mpc.settings.nlpsol_opts = dict(options)
    mpc.settings.supress_ipopt_output()
    error, effort = made.x["x"] - made.tvp["x_ref"], made.u["u"] - made.tvp["u_ref"]
    mpc.set_objective(
        mterm=squared(error, robot.qn_factor * np.diag(robot.q)) / 2,
        lterm=(squared(error, np.diag(robot.q)) + squared(effort, np.diag(robot.r))) / 2,
    )
    mpc.set_rterm(u=np.zeros(n_u))
    bounds = np.array([robot.bounds[name] for name in robot.inputs]).T
    mpc.bounds["lower", "_u", "u"], mpc.bounds["upper", "_u", "u"] = bounds
    parameters, varying = mpc.get_p_template(1), mpc.get_tvp_template()
    mpc.set_p_fun(lambda t: parameters)
    mpc.set_tvp_fun(lambda t: varying)
    with quiet():
        mpc.setup()
    mpc.x0["x"] = first.estimate[:n_x]
    mpc.set_initial_guess()
    plan = mpc.opt_x.f["_u"]  # where it is among the unknowns

    def solve(problem):
        parameters["_p", 0] = problem.estimate[n_x:]
        u_ref = np.column_stack([problem.u_ref, np.zeros(n_u)])
        varying.master = ca.DM(np.vstack([problem.x_ref, u_ref]).ravel(order="F"))
        mpc.make_step(problem.estimate[:n_x])
        return mpc.opt_x_num.cat.full()[plan, 0].reshape(N, n_u).T

    return solve


# Agreement first, then time


def difference(name, contestant, answers, problems):
    """How far pairs of answers (estimate, plan) are from rhec's at convergence: maxima over all
    problems.
    """
    rhe, rhc = np.max(
        [
            (np.abs(estimate - each.estimate).max(), np.abs(plan - each.u_plan).max())
            for (estimate, plan), each in zip(answers, problems)
        ],
        axis=0,
    )
    return dict(robot=name, contestant=contestant, rhe_maximum=rhe, rhc_maximum=rhc)


def agreement(name, robot, recorded):
    """Table of differences, and after how many iterations a sample rhec agrees with itself; raises
    if do-mpc does not agree with it at convergence. Where a bound is just active, IPOPT's default
    tolerance stops short of it; do-mpc is timed with that, and its accuracy is in the table.
    """
    guess, log, problems = recorded
    rows = []
    for contestant, options in {
        f"{REFERENCE}, IPOPT's tolerance 1e-11": TIGHT,
        REFERENCE: {},
    }.items():
        rhe, rhc = (make(robot, problems[0], options) for make in (do_mpc_rhe, do_mpc_rhc))
        answers = [(rhe(problem), rhc(problem)) for problem in problems]
        rows.append(difference(name, contestant, answers, problems))
    if max(rows[0]["rhe_maximum"], rows[0]["rhc_maximum"]) > TOLERANCE:
        raise SystemExit(f"Not all answers agree to {TOLERANCE:g}, so nothing was timed: {rows[0]}")
    for iterations in itertools.count(1):
        _, _, again = record(robot, len(problems), iterations, planned=(log, problems))
        contestant = f"rhec, {iterations} iteration{'s' * (iterations > 1)} a sample"
        answers = [(problem.estimate, problem.u_plan) for problem in again]
        rows.append(difference(name, contestant, answers, problems))
        if max(rows[-1]["rhe_maximum"], rows[-1]["rhc_maximum"]) <= TOLERANCE:
            return pd.DataFrame(rows), iterations


def from_python(robot, recorded, iterations=None):
    """rhec's live objects, NumPy arrays in and out, the arrival cost updated: a block is the whole
    run. One iteration a sample, or so many.
    """
    guess, log, problems = recorded
    n_x = len(robot.states)

    def block(_):
        estimator, controller = live(robot, guess)
        estimate, control = estimator.feedback, controller.feedback
        if iterations:
            estimate, control = (
                functools.partial(each.solve, iterations=iterations)
                for each in (estimator, controller)
            )
        for z in log[:N]:
            estimator.prepare()
            estimate(z)
        taken = np.empty((len(problems), 4))
        for k, (z, problem) in enumerate(zip(log[N:], problems)):
            x, p = problem.estimate[:n_x], problem.estimate[n_x:]
            begin = clock()
            estimator.prepare()
            prepared = clock()
            estimate(z)
            estimated = clock()
            controller.prepare()
            planned = clock()
            control(x, p, problem.x_ref, problem.u_ref)
            taken[k] = np.diff([begin, prepared, estimated, planned, clock()])
        return dict(zip(PHASES, taken[1:].mean(axis=0) / 1e3))

    return block


def from_do_mpc(robot, recorded):
    _, _, problems = recorded
    rhe, rhc = do_mpc_rhe(robot, problems[0]), do_mpc_rhc(robot, problems[0])

    def block(number):
        begin, times = SHARE * number % len(problems), []
        for solve in (rhe, rhc):
            started = clock()
            for problem in problems[begin : begin + SHARE]:
                solve(problem)
            times.append((clock() - started) / 1e3 / SHARE)
        return {("RHE", "overall"): times[0], ("RHC", "overall"): times[1]}

    return block


def measure(rounds=30, samples=SAMPLES):
    """Who agrees how well, and the table of times; speedup: do-mpc's RHE + RHC step over this one,
    block beside block, median.
    """
    agreeing, tables = [], []
    for name, robot in ROBOTS.items():
        recorded = record(robot, samples)
        table, iterations = agreement(name, robot, recorded)
        agreeing.append(table)
        times = interleaved(
            {
                "rhec, one iteration": from_python(robot, recorded),
                "rhec, to convergence": from_python(robot, recorded, iterations),
                REFERENCE: from_do_mpc(robot, recorded),
            },
            rounds,
        )
        table = spread(times, ["contestant", "problem", "phase"])
        whole = times.query("problem == 'RHE + RHC'")
        whole = whole.pivot(index="block", columns="contestant", values="us")
        speedup = whole.rtruediv(whole[REFERENCE], axis=0).median()
        table[SPEEDUP] = table["contestant"].map(speedup).where(table["problem"] == "RHE + RHC")
        table.insert(0, "robot", name)
        tables.append(table)
    return pd.concat(agreeing, ignore_index=True), pd.concat(tables, ignore_index=True)
