"""Experiments that are no closed-loop campaign: estimators on recorded measurements, one iteration
compared with many, exact properties of the problems.

Each returns a DataFrame, one row a case.
"""

import operator
import time
from functools import partial

import casadi as ca
import numpy as np
import pandas as pd
from scipy import optimize

import rhec
from notebooks.claims.live_robot import LiveRobot
from notebooks.rivals import RIVALS
from notebooks.studies import timing
from notebooks.studies.parallel import parallel_map
from rhec import paper
from rhec.core import runner
from rhec.core._casadi import compiled
from rhec.core._casadi.build import select_inputs, with_packed_memory
from rhec.core._casadi.packing import pack_array
from rhec.core.controller import rhc
from rhec.core.estimator import rhe
from rhec.core.model.robot_model import rk4
from rhec.core.solver.rti import PHASES
from rhec.simulation.closed_loop import set_up
from rhec.simulation.columns import ESTIMATE, MEASUREMENTS, POSE
from rhec.simulation.metrics import rms, settled_samples
from rhec.simulation.offline import SETTLED_S, run_estimator_on_all
from rhec.simulation.scenario import Scenario
from rhec.simulation.simulate import simulate
from rhec.tracked_robot import kinematics as model
from rhec.tracked_robot import paper_rhc, paper_rhe, path, tuning
from rhec.tracked_robot.estimators import Choice
from rhec.tracked_robot.references import PathTracker

# The arrival cost


def _window():
    # Without the check of positions, which changes no bit of these drives.
    return paper_rhe.window_of(Choice.of(Scenario()))._replace(judge=None)


def build_with_given_arrival():
    """Scan of an RHE step with a choice of the arrival cost's covariance.

    It is that of the smoothed EKF update, or P_given (6, 6) where `constant` is 1. The settings are
    V, W, P_0, P_given and constant; recorded are the estimate (6,) and that covariance (6, 6).
    """
    window = _window()
    phases = rhe.build_phases(window)
    kind = compiled.loop_symbols()
    shapes = dict(z_N=(4, 1), V=(4, 1), W=(6, 1), P_0=(6, 1), P_given=(6, 6), constant=(1, 1))

    @with_packed_memory("given_arrival", window.memory, kind, **shapes)
    def step(**known):
        for name in PHASES:
            known |= phases[name](**select_inputs(phases[name], known))
            if name == "shift":
                P = ca.if_else(known["constant"], known["P_given"], known["P"])
                known["P"] = P
        memory = {name: known[name] for name in window.memory}
        return dict(estimate=known["estimate"], arrival_covariance=P) | memory

    return runner.build_recorded(step, ["estimate", "arrival_covariance"])


def run_with_given_arrival(functions, log, scenario, P_given=None):
    """Estimates (n, 6) and arrival covariances (n, 6, 6) of the RHE over a log's measurements.

    `functions` is the scan of `build_with_given_arrival`. The arrival cost has the covariance
    P_given (6, 6) at all times, or the RHE's own; W and V are those of the Scenario.
    """
    settings = paper_rhe.ESTIMATORS["rhe"].settings(scenario) | dict(
        P_given=np.eye(6) if P_given is None else P_given, constant=float(P_given is not None)
    )
    guess = dict(zip(model.QUANTITIES, (*log.loc[0, POSE], log.loc[0, "nu_mps"], 1.0, 1.0)))
    memory = pack_array(paper_rhe.init(_window(), guess))
    recorded = runner.record(functions, memory, log[MEASUREMENTS].to_numpy(), settings)
    return recorded["estimate"], recorded["arrival_covariance"]


def _arrival_costs(process_noise, seeds):
    """DataFrame, one row of `_arrival_cost` a seed; the runs have the true state in the loop."""
    runs = simulate([Scenario(estimator="oracle", seed=seed) for seed in seeds])
    recorded = run_estimator_on_all(Scenario(process_noise=process_noise), runs, "covariance")
    return pd.DataFrame(
        [
            _arrival_cost(process_noise, run.log) | _sigma_left(of_run["covariance"])
            for run, of_run in zip(runs, recorded)
        ]
    )


def _arrival_cost(process_noise, log):
    """The RHE with its arrival cost as it is, and with constant ones, on the log of one run.

    A constant covariance is the run's mean one over 100 ("heavy": a large weight H_N), times 100
    ("light"), or times 10⁸ ("none").

    Returns:
        One row: for each arrival cost the RMS change of κ̂ from sample to sample, the time until
        |κ̂ - κ| first stays below 0.1 for 5 s, and whether the yaw was ever more than 0.5 rad off;
        `least`, the least eigenvalue of P - W over all samples in units of W; and `grown_with_w`
        and `grown_without_w`, see `_growth`.
    """
    steps = compiled.load(build_with_given_arrival)
    sigma = np.array(tuning.NOISES["rhe"][process_noise].sigma_w)
    scenario = Scenario(process_noise=process_noise)
    estimates, P = run_with_given_arrival(steps, log, scenario)
    # W^-1/2 (P - W) W^-1/2: the states have different units, and W makes them comparable.
    half = 1 / np.sqrt(sigma**2)
    row = dict(least=np.linalg.eigvalsh(half[:, None] * (P - np.diag(sigma**2)) * half).min())
    row |= dict(grown_with_w=_growth(P))
    without_w = Scenario(process_noise=process_noise, sigma_w=(0.0,) * 6)
    _, P_without_w = run_with_given_arrival(steps, log, without_w)
    row |= dict(grown_without_w=_growth(P_without_w))
    typical = P[paper.HORIZON + 1 :].mean(axis=0)  # from the first full window on
    for name, factor in {"adaptive": None, "heavy": 1e-2, "light": 1e2, "none": 1e8}.items():
        if factor is not None:
            estimates, _ = run_with_given_arrival(steps, log, scenario, factor * typical)
        error = estimates[:, 5] - log["kappa"].to_numpy()
        yaw = estimates[:, 2] - log["theta_rad"].to_numpy()
        row[f"step_{name}"] = rms(np.diff(estimates[:, 5]))
        row |= {f"reached_s_{name}": reached_s(error), f"lost_{name}": np.abs(yaw).max() > 0.5}
    return row


def _sigma_left(P):
    """The shares of their first standard deviations that μ and κ keep at the newest node.

    σ(t) is by the covariance P (n, 6, 6) of the newest estimates, which all measurements of the
    window have made smaller. The arrival cost's own is never below W (claim H3), and W is what it
    begins with, so that it could not show a reduction. The share is the mean of σ over the second
    half of the run, over σ at the first sample.
    """
    sigma = np.sqrt(np.diagonal(P, axis1=1, axis2=2)[:, 4:])
    left = sigma[len(P) // 2 :].mean(axis=0) / sigma[0]
    return dict(sigma_mu_left=left[0], sigma_kappa_left=left[1])


def _growth(P):
    """How much the largest eigenvalue of H_N = P⁻¹ grows over the second half of a run.

    The states are in units of their first standard deviations. A weight that sums up all past
    measurements without forgetting doubles; one that forgets stays as it is.
    """
    unit = np.sqrt(np.diag(P[0]))
    halfway, last = (
        np.linalg.eigvalsh(np.linalg.inv(P[place] / np.outer(unit, unit))).max()
        for place in (len(P) // 2, -1)
    )
    return last / halfway


def reached_s(error):
    """When an error first stays within 0.1 for 5 s; the run's length if it never does [s]."""
    settled = settled_samples(np.abs(error), 0.1)
    return paper.DT_S * (settled[0] if len(settled) else len(error))


# One iteration or many


def live(scenario, iterations):
    """Drive the closed loop in plain Python, with a fixed number of iterations a sample.

    Args:
        scenario: The Scenario.
        iterations: Gauss-Newton iterations of RHE and RHC; with 1, they run as in real time.

    Returns:
        distance_m: True distance to the path (n,) [m].
        taken_s: Time that RHE and RHC took (n,) [s].
        problems: Of each sample, the arguments of `RHC.feedback`.
        commands: Commanded yaw rates (n,) [rad/s].
    """
    robot = LiveRobot(scenario)
    taken_s = []
    problems = []
    commands = []
    positions = []
    estimator = rhec.RHE(process_noise=scenario.process_noise, guess=tuple(robot.world.guess))
    controller = rhec.RHC(q=scenario.q, r=scenario.r)
    tracker = PathTracker(robot.world.path, scenario.prediction_horizon)
    for z in robot:
        begin = time.perf_counter()
        estimator.prepare()
        estimate = estimator.feedback(z) if iterations == 1 else estimator.solve(z, iterations)
        estimated = time.perf_counter()
        problem = estimate.pose, estimate.p, *tracker.references(estimate, z[3])
        referenced = time.perf_counter()
        controller.prepare()
        if iterations == 1:
            command = controller.feedback(*problem)
        else:
            command = controller.solve(*problem, iterations)
        # The references belong to neither problem.
        taken_s.append(time.perf_counter() - referenced + estimated - begin)
        problems.append([np.copy(argument) for argument in problem])
        commands.append(command)
        positions.append(robot.pose[:2].copy())
        robot.drive(command)
    distance_m, _ = robot.world.path.project(positions)
    return distance_m, np.array(taken_s), problems, np.array(commands)


def _distances_from_converged(scenario, problems, commands):
    """How far the commands of the problems of `live` are from the converged ones, (n,) [rad/s].

    The second result is that of a cold RHC, which knows the previous estimate but has planned
    nothing.
    """
    # Two controllers, since each starts from its previous plan.
    exact = rhec.RHC(q=scenario.q, r=scenario.r)
    unprepared = rhec.RHC(q=scenario.q, r=scenario.r)
    stages = paper_rhc.problem_of_scenario(scenario).stages
    guess = set_up(scenario).guess
    cold = []
    converged = []
    previous = guess[:3], guess[3:]
    for problem in problems:
        exact.prepare()
        converged.append(exact.solve(*problem))
        unprepared.iteration.start(rhc.init(stages, *previous))
        cold.append(unprepared.feedback(*problem))
        previous = problem[:2]
    return commands - np.array(converged), np.array(cold) - np.array(converged)


def _iterations(process_noise, seed):
    """One iteration a sample compared with ten, in the closed loop on one field, once settled.

    Returns:
        One row: mean true errors [m], median times [µs], the RMS distance [rad/s] of the command
        after one iteration from the converged one, started warm and cold, and the largest warm one.
    """
    # Short rows, so that the robot turns to both sides.
    fields = dict(row_length_m=12.0, duration_s=160.0)
    scenario = Scenario(process_noise=process_noise, seed=seed, **fields)
    one_m, one_s, *solved = live(scenario, 1)
    many_m, many_s, *_ = live(scenario, 10)
    warm, cold = _distances_from_converged(scenario, *solved)
    settled = slice(round(SETTLED_S / paper.DT_S), None)
    row = dict(error_one_m=one_m[settled].mean(), error_many_m=many_m[settled].mean())
    row |= dict(one_us=1e6 * np.median(one_s), many_us=1e6 * np.median(many_s))
    row |= dict(rms_warm=rms(warm[settled]), rms_cold=rms(cold[settled]))
    return row | dict(max_warm=np.abs(warm[settled]).max())


def lowest_traction(process_noise, most=414):
    """Search for a traction estimate of the augmented EKF below zero.

    Differential evolution chooses start, first guess of the yaw, soil, bumps and field until an
    estimate is below zero, for at most so many runs. One row a run: its fields, and `lowest`, the
    lowest estimate of μ or κ.
    """
    rows = []
    ranges = dict(guess_yaw_rad=(-np.pi, np.pi), start_offset_m=(-3, 3), seed=(0, 999))
    ranges |= dict(kappa_mean=(0.5, 0.9), kappa_deviation=(0.0, 0.2), bump_sigma_radps=(0, 0.1))

    def lowest(values):
        fields = dict(zip(ranges, values)) | dict(seed=round(values[2]), duration_s=60.0)
        choice = dict(estimator=RIVALS["augmented_ekf"], process_noise=process_noise)
        columns = simulate(Scenario(**fields, **choice)).columns
        row = fields | dict(lowest=min(columns["mu_hat"].min(), columns["kappa_hat"].min()))
        rows.append(row)
        return row["lowest"]

    options = dict(popsize=3, polish=False, rng=np.random.default_rng(0), tol=0)
    optimize.differential_evolution(
        lowest,
        [*ranges.values()],
        maxiter=most // (3 * len(ranges)) - 1,  # beside the first generation
        callback=lambda _, convergence: min(row["lowest"] for row in rows) < 0,
        **options,
    )
    return pd.DataFrame(rows)


# Exact properties of the problems


def _straight_ahead(speed_mps, traction):
    """References of an RHC on the x axis, xi_ref (3, N+1) and omega_ref (N,), one sample apart."""
    xi_ref = np.zeros((3, paper.HORIZON + 1))
    xi_ref[0] = paper.DT_S * speed_mps * traction * np.arange(paper.HORIZON + 1)
    return xi_ref, np.zeros(paper.HORIZON)


def _draw_states(n):
    """n random speeds [m/s], tractions μ, κ and offsets to the left of a straight path [m]."""
    rng = np.random.default_rng(0)
    ranges = (0.2, 0.7), (0.6, 1.0), (0.5, 1.0), (-0.3, 0.3)
    return zip(*(rng.uniform(least, most, n) for least, most in ranges))


def kkt_tolerances(n=100):
    """KKT tolerances of a linear RHC problem, whose yaw alone has a weight, at n random states.

    "reported" is the tolerance as ACADO's code computes it, at the point where the iteration
    begins; "after_step" is computed again at the result.
    """
    rows = []
    controller = rhec.RHC(q=(0.0, 0.0, 1.0))
    for speed, mu, kappa, offset in _draw_states(n):
        problem = ((0.0, offset, offset), (speed, mu, kappa), *_straight_ahead(speed, mu))
        row = {}
        for column, count in {"linear_reported": 1, "linear_after_step": 2}.items():
            controller.restart()
            controller.solve(*problem, count)
            row[column] = controller.kkt
        rows.append(row)
    return pd.DataFrame(rows)


def gains(n=100):
    """How strongly the converged RHC answers a small offset from a straight path.

    Returns:
        DataFrame, one row a random state: |∂ω/∂y| [rad/s/m], with R = 10 and a hundredth of it.
    """
    rows = []
    controllers = {"large_r": rhec.RHC(), "small_r": rhec.RHC(r=paper.R / 100)}
    offset_m = 1e-4  # small enough that no input reaches its bound
    for speed, mu, kappa, _ in _draw_states(n):
        problem = (0.0, offset_m, 0.0), (speed, mu, kappa), *_straight_ahead(speed, mu)
        row = {}
        for name, controller in controllers.items():
            controller.restart()
            row[name] = abs(controller.solve(*problem)) / offset_m
        rows.append(row)
    return pd.DataFrame(rows)


def models(n=100):
    """The system model at n random states.

    Returns:
        DataFrame: at_rest_mps, |f(0, 0, p)|; off_unicycle_m, how far rk4 without slip is from the
        unicycle's circle; sideways_mps, the speed across the heading.
    """
    rng = np.random.default_rng(0)
    rows = []
    for speed, mu, kappa, _ in _draw_states(n):
        pose = rng.uniform(-3, 3, 3)
        omega = rng.uniform(-paper.OMEGA_MAX_RADPS, paper.OMEGA_MAX_RADPS)
        at_rest = np.array(ca.DM(model.f(ca.DM.zeros(3), 0, ca.DM([speed, mu, kappa])))).ravel()
        moved = rk4(model.f, ca.DM(pose), omega, ca.DM([speed, 1, 1]), paper.DT_S)
        circle = path.advance(*pose, omega / speed, speed * paper.DT_S, np)
        off = np.abs(np.array(ca.DM(moved)).ravel() - circle).max()
        x, y, _ = np.array(ca.DM(model.f(ca.DM(pose), omega, ca.DM([speed, mu, kappa])))).ravel()
        sideways = abs(y * np.cos(pose[2]) - x * np.sin(pose[2]))
        row = dict(at_rest_mps=np.linalg.norm(at_rest), off_unicycle_m=off, sideways_mps=sideways)
        rows.append(row)
    return pd.DataFrame(rows)


def steps_in_time(duration_s=60.0):
    """Times of every sample of a run on this machine.

    Returns:
        DataFrame: in_time, whether the whole step takes less than a sample; whole_us, and
        feedback_us, the part of it after the measurement.
    """
    scenario = Scenario(process_noise="prediction", duration_s=duration_s)
    taken = timing.phases(scenario)
    whole_us = taken.sum(axis=1)
    is_feedback = [phase == "feedback" for _, phase in timing.PHASES]
    return pd.DataFrame(
        dict(
            in_time=whole_us < 1e6 * paper.DT_S,
            whole_us=whole_us,
            feedback_us=taken[:, is_feedback].sum(axis=1),
        )
    )


def certainty_equivalence(duration_s=60.0):
    """Commands of the closed loop against those of a robot in the state that it estimates.

    The RHC gets the logged estimates as if they were the truth, sample by sample.

    Returns:
        DataFrame, one row a sample: off_radps, the difference of the two commands [rad/s].
    """
    (run,) = simulate([Scenario(process_noise="prediction", duration_s=duration_s)])
    controller = rhec.RHC(q=run.scenario.q, r=run.scenario.r)
    tracker = PathTracker(run.path, run.scenario.prediction_horizon)
    rows = []
    for sample in run.log.to_dict("records"):
        estimate = [sample[name] for name in ESTIMATE]
        controller.prepare()
        references = tracker.references(estimate, sample["omega_meas_radps"])
        command = controller.feedback(estimate[:3], estimate[3:], *references)
        rows.append(dict(off_radps=abs(command - sample["omega_cmd_radps"])))
    return pd.DataFrame(rows)


def convexity(n=1000):
    """Whether eq. (12) is convex, at n random states with two random input sequences u and v each.

    The feasible pairs of trajectory and inputs are a convex set only if the mean of two of them is
    feasible, that is, if the trajectory of (u + v) / 2 is the mean of the two trajectories. The
    cost J as a function of the inputs alone, see `_drive_and_cost`, is convex only if it bends
    upwards along every direction; here along that of a constant yaw rate e,

        (J(u + h e) - 2 J(u) + J(u - h e)) / h².

    Returns:
        DataFrame, one row a state: off_mean_m, how far the two trajectories lie apart; bending.
    """
    rng = np.random.default_rng(0)
    h = 1e-3
    rows = []
    for speed, mu, kappa, offset in _draw_states(n):
        state = 0.0, offset, rng.uniform(-np.pi, np.pi)
        shape = (2, paper.HORIZON)
        u, v = rng.uniform(-paper.OMEGA_MAX_RADPS, paper.OMEGA_MAX_RADPS, shape)
        drive = partial(_drive_and_cost, state, (speed, mu, kappa))
        of_u, cost = drive(u)
        of_v, _ = drive(v)
        of_mean, _ = drive((u + v) / 2)
        more, less = (drive(u + step)[1] for step in (h, -h))
        off_mean_m = np.abs(of_mean - (of_u + of_v) / 2).max()
        rows.append(dict(off_mean_m=off_mean_m, bending=(more - 2 * cost + less) / h**2))
    return pd.DataFrame(rows)


def _drive_and_cost(state, parameters, inputs):
    """Poses (N, 3) and J of eq. (12) for inputs (N,) on a straight path, with Q³, R and Q_N.

    The motion of each interval is the exact arc of eq. (2), so that nothing of the RHC is used.
    """
    speed, mu, kappa = parameters
    xi_ref, _ = _straight_ahead(speed, mu)
    weights = np.array(paper.Q3)
    poses = [state]
    for omega in inputs:
        curvature = kappa * omega / (mu * speed)
        poses.append(path.advance(*poses[-1], curvature, mu * speed * paper.DT_S, np))
    squares = np.square(np.array(poses[1:]) - xi_ref.T[1:]) @ weights
    squares[-1] *= paper.QN_FACTOR
    return np.array(poses[1:]), (squares.sum() + paper.R * inputs @ inputs) / 2


# All of them

EXACT = {  # experiments that no process noise affects
    "kkt": kkt_tolerances,
    "gains": gains,
    "models": models,
    "times": steps_in_time,
    "certainty": certainty_equivalence,
    "convexity": convexity,
}
_RUNS_AT_ONCE = 8  # as many as AVX-512 registers have lanes


def _tasks(process_noise, name, seeds):
    """The calls that make an experiment, one after the other."""
    if name in EXACT:
        return [EXACT[name]]
    if name == "search":
        return [partial(lowest_traction, process_noise)]
    if name == "arrival_cost":
        n = max(2, seeds * 64 // 1000)
        parts = [range(n)[first : first + _RUNS_AT_ONCE] for first in range(0, n, _RUNS_AT_ONCE)]
        return [partial(_arrival_costs, process_noise, part) for part in parts]
    return [partial(_iterations, process_noise, seed) for seed in range(max(2, seeds // 25))]


def make(tables, seeds):
    """Make experiments.

    Args:
        tables: (process noise, name) of each.
        seeds: The largest number of fields of a campaign; an experiment takes a part of them.

    Returns:
        {(process noise, name): DataFrame}.
    """
    # One that no process noise affects is made once.
    names = {table: (None if table[1] in EXACT else table[0], table[1]) for table in tables}
    tasks = {key: _tasks(*key, seeds) for key in dict.fromkeys(names.values())}
    found = iter(parallel_map(operator.call, [task for part in tasks.values() for task in part]))
    made = {}
    for key, part in tasks.items():
        results = [next(found) for _ in part]
        is_whole = isinstance(results[0], pd.DataFrame)
        made[key] = pd.concat(results, ignore_index=True) if is_whole else pd.DataFrame(results)
    return {table: made[key] for table, key in names.items()}
