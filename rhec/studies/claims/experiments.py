"""Experiments that are no closed-loop campaign: estimators on recorded measurements, one iteration
against many, exact properties of the problems.

Each returns a DataFrame, one row a case.
"""

import time

import casadi as ca
import numpy as np
import pandas as pd

from rhec import paper, simulation
from rhec._casadi import compiled, scan
from rhec._casadi.build import (
    pack_array,
    packed_size,
    select_inputs,
    unpack_array,
    with_packed_memory,
)
from rhec.controller import rhc
from rhec.controller.rhc import RHC
from rhec.estimator import rhe
from rhec.estimator.rhe import RHE
from rhec.model import path, robot, terrain
from rhec.model import tracked_robot as model
from rhec.scenario import Scenario
from rhec.metrics import rms, settled_samples
from rhec.simulation import simulate
from rhec.studies import timing
from rhec.studies.calibration import SETTLED_S
from rhec.studies.claims.run_sets import PROCESS_NOISES

__all__ = ["all_of", "arrival_costs", "gains", "iterations", "kkt_tolerances", "models", "times"]

_RHE_MEMORY = ("s", "v", "z", "age", "m", "P")


# The arrival cost


def with_given_arrival():
    """One RHE step with a choice: the arrival cost's covariance from the smoothed EKF update, or
    P_0 (6, 6) at all times where `constant` is 1.

    (memory, z, V, W, P_0, constant) -> (memory, row); row: the estimate (6,) and the arrival
    covariance (36,) behind it.
    """
    phases = rhe.build_phases(paper.DT_S, paper.HORIZON)
    shift, linearise, feedback, expand = (
        phases[name] for name in ("shift", "linearise", "feedback", "expand")
    )

    def step(z_N, V, W, P_0, constant, **memory):
        memory = shift(**memory, V=V, W=W)
        memory["P"] = ca.if_else(constant, P_0, memory["P"])
        prepared = linearise(**select_inputs(linearise, memory), V=V)
        result = feedback(**select_inputs(feedback, prepared | memory), z_N=z_N, V=V)
        expanded = expand(**select_inputs(expand, memory | prepared | result | dict(z_N=z_N, V=V)))
        return dict(row=ca.vertcat(result["estimate"], ca.vec(memory["P"]))) | {
            name: expanded[name] for name in _RHE_MEMORY
        }

    memory = {name: shift.size_in(name) for name in _RHE_MEMORY}
    return with_packed_memory(
        "given_arrival",
        step,
        memory,
        dict(z_N=(4, 1), V=(4, 1), W=(6, 1), P_0=(6, 6), constant=(1, 1)),
        compiled.loop_symbols(),
    )


def _build_scan(serialized):
    """Scan of a step that is given as text: the text is part of the compiled library's name."""
    return scan.build_scan(ca.Function.deserialize(serialized))


def run_with_given_arrival(steps, log, process_noise, P_0=None):
    """Estimates (n, 6) and arrival covariances (n, 6, 6) on the measurements of a log."""
    guess = (*log.loc[0, ["x_m", "y_m", "theta_rad"]], log.loc[0, "nu_mps"], 1.0, 1.0)
    settings = dict(
        V=np.square(paper.SIGMA_V),
        W=np.square(rhe.SIGMA_W[process_noise]),
        P_0=np.eye(6) if P_0 is None else P_0,
        constant=float(P_0 is not None),
    )
    memory = pack_array(rhe.init(guess, paper.SIGMA_W_RHE, paper.HORIZON))
    _, rows = scan.scan(steps, memory, log[[*simulation.LOG["z"]]].to_numpy(), settings)
    return rows[:, :6], rows[:, 6:].reshape(-1, 6, 6)


def arrival_costs(process_noise, seeds):
    """The RHE with its arrival cost as it is, and with constant ones, on the same recorded runs
    (driven with the true state in the loop).

    A constant covariance is the run's mean one over 100 ("heavy": a large weight H_N), times 100
    ("light"), or times 10⁸ ("none"). For each: RMS change of κ̂ from sample to sample, time until
    |κ̂ - κ| first stays below 0.1 for 5 s, whether the yaw was ever more than 0.5 rad off; and the
    least eigenvalue of P - W over all samples, in units of W.
    """
    steps, rows = compiled.load(_build_scan, with_given_arrival().serialize()), []
    sigma = np.array(rhe.SIGMA_W[process_noise])
    for seed in range(seeds):
        run = simulate(Scenario(estimator="oracle", seed=seed))
        log, row = run.log, {}
        estimates, P = run_with_given_arrival(steps, log, process_noise)
        half = 1 / np.sqrt(sigma**2)  # P - W in units of W, where all eigenvalues compare
        row["least"] = np.linalg.eigvalsh(half[:, None] * (P - np.diag(sigma**2)) * half).min()
        typical = P[paper.HORIZON + 1 :].mean(axis=0)
        for name, factor in {"adaptive": None, "heavy": 1e-2, "light": 1e2, "none": 1e8}.items():
            if factor is not None:
                estimates, _ = run_with_given_arrival(steps, log, process_noise, factor * typical)
            error = estimates[:, 5] - log["kappa"].to_numpy()
            yaw = estimates[:, 2] - log["theta_rad"].to_numpy()
            row |= {
                f"step_{name}": rms(np.diff(estimates[:, 5])),
                f"reached_s_{name}": reached_s(error),
                f"lost_{name}": np.abs(yaw).max() > 0.5,
            }
        rows.append(row)
    return pd.DataFrame(rows)


def reached_s(error):
    """When an error first stays within 0.1 for 5 s; the run's length if it never does [s]."""
    settled = settled_samples(np.abs(error), 0.1)
    return paper.DT_S * (settled[0] if len(settled) else len(error))


# One iteration or many


def live(scenario, iterations):
    """The closed loop in plain Python: one Gauss-Newton iteration a sample (`iterations` = 1), or
    as many as told.

    Returns the true distance to the path (n,) [m], the time RHE and RHC took (n,) [s], and for the
    same estimates and references how far [rad/s] the command (n,) was from the converged one, and
    that of a cold RHC (n,), which knows the previous estimate but has planned nothing.
    """
    world, dt = simulation.set_up(scenario), paper.DT_S
    given = world.settings
    measure, drive, slip, references = (
        compiled.BufferedFunction(function)
        for function in (
            robot.measure(dt),
            robot.drive(dt),
            terrain.lookup(terrain.common_shape(world.terrain)),
            path.build_references(
                dt, scenario.prediction_horizon, len(world.path.segments), scenario.input_reference
            )["references"],
        )
    )
    for call in (measure, drive, slip, references):
        call.set(**select_inputs(call.function, given))
    estimator = RHE(process_noise=scenario.process_noise, guess=tuple(world.guess))
    controller, unprepared, exact = (RHC(q=scenario.q, r=scenario.r) for _ in range(3))
    previous, memory = (
        tuple(world.guess),
        unpack_array(world.memory[: packed_size(robot.MEMORY)], robot.MEMORY),
    )
    s, positions, taken, warm, cold = 0.0, [], [], [], []
    for noise in simulation.draw_noise(scenario.seed, round(scenario.duration_s / dt)):
        now = memory | unpack_array(noise, robot.NOISE)
        slip.set(xy=now["pose"][:2])
        slip.call()
        measure.set(**select_inputs(measure.function, now))
        measure.call()
        z = measure.results["z"].copy()

        begin = time.perf_counter()
        estimator.prepare()
        estimate = estimator.feedback(z) if iterations == 1 else estimator.solve(z, iterations)
        estimated = time.perf_counter()
        references.set(s=s, estimate=estimate[:6], omega_measured=z[3])
        references.call()
        s = references.results["s"][0]
        asked = (
            estimate[:3],
            estimate[3:6],
            references.results["xi_ref"].reshape((3, -1), order="F"),
            references.results["omega_ref"],
        )
        referenced = time.perf_counter()
        controller.prepare()
        command = (
            controller.feedback(*asked) if iterations == 1 else controller.solve(*asked, iterations)
        )
        taken.append(time.perf_counter() - referenced + estimated - begin)
        exact.prepare()
        converged = exact.solve(*asked)
        warm.append(command - converged)
        unprepared.iteration.start(
            rhc.init(previous[:3], previous[3:], scenario.prediction_horizon)
        )
        cold.append(unprepared.feedback(*asked) - converged)
        previous = estimate[:6]

        drive.set(
            **select_inputs(drive.function, now),
            traction=slip.results["traction"],
            omega_radps=command,
        )
        drive.call()
        positions.append(now["pose"][:2].ravel())
        memory = {
            name: value.copy()
            for name, value in (drive.results | dict(drift=measure.results["drift"])).items()
        }
    distance_m, _ = world.path.project(positions)
    return distance_m, np.array(taken), np.array(warm), np.array(cold)


def iterations(process_noise, seeds, duration_s=80.0, many=10):
    """One iteration a sample against `many`, in the closed loop at equal seeds, counted once
    settled: mean true errors [m], median times [µs]; and the RMS distance [rad/s] of the command
    after one iteration from the converged one, started warm and cold.
    """
    rows = []
    for seed in range(seeds):
        scenario = Scenario(process_noise=process_noise, seed=seed, duration_s=duration_s)
        one_m, one_s, warm, cold = live(scenario, 1)
        many_m, many_s, _, _ = live(scenario, many)
        settled = slice(round(SETTLED_S / paper.DT_S), None)
        rows.append(
            dict(
                error_one_m=one_m[settled].mean(),
                error_many_m=many_m[settled].mean(),
                one_us=1e6 * np.median(one_s),
                many_us=1e6 * np.median(many_s),
                rms_warm=rms(warm[settled]),
                rms_cold=rms(cold[settled]),
            )
        )
    return pd.DataFrame(rows)


# Exact properties of the problems


def _straight_ahead(speed_mps, traction, horizon=paper.HORIZON):
    """References of an RHC on the x axis: (xi_ref (3, N+1), omega_ref (N,)), desired points one
    sample apart.
    """
    xi_ref = np.zeros((3, horizon + 1))
    xi_ref[0] = paper.DT_S * speed_mps * traction * np.arange(horizon + 1)
    return xi_ref, np.zeros(horizon)


def _draw_states(n, seed=0):
    """n random speeds [m/s], tractions μ, κ and offsets to the left of a straight path [m]."""
    rng = np.random.default_rng(seed)
    return zip(
        rng.uniform(0.2, 0.7, n),
        rng.uniform(0.6, 1.0, n),
        rng.uniform(0.5, 1.0, n),
        rng.uniform(-0.3, 0.3, n),
    )


def kkt_tolerances(n=100):
    """KKT tolerances of two RHC problems: linear, where the yaw alone has a weight (θ̇ = κω), and
    the paper's Q³.

    "reported" is that of the sample as ACADO's code gives it, at the point where the iteration
    begins; "after the step" is taken again at the result.
    """
    rows = []
    for speed, mu, kappa, offset in _draw_states(n):
        state, references = (0.0, offset, offset), _straight_ahead(speed, mu)
        row = {}
        for name, q in {"linear": (0.0, 0.0, 1.0), "nonlinear": paper.Q3}.items():
            for place, count in {"reported": 1, "after the step": 2}.items():
                controller = RHC(q=q)
                controller.solve(state, (speed, mu, kappa), *references, count)
                row[f"{name}_{place}"] = controller.kkt
        rows.append(row)
    return pd.DataFrame(rows)


def gains(n=100, offset_m=1e-4):
    """How strongly the converged RHC answers a small offset from a straight path, |∂ω/∂y|
    [rad/s/m], with R = 10 and with a hundredth of it.
    """
    rows = []
    for speed, mu, kappa, _ in _draw_states(n):
        problem = (0.0, offset_m, 0.0), (speed, mu, kappa), *_straight_ahead(speed, mu)
        weights = {"large_r": paper.R, "small_r": paper.R / 100}
        rows.append({name: abs(RHC(r=r).solve(*problem)) / offset_m for name, r in weights.items()})
    return pd.DataFrame(rows)


def models(n=100):
    """The system model at random states: |f(0, 0, p)| [m/s], and how far rk4 without slip is from
    the unicycle's own motion [m].
    """
    rng, rows = np.random.default_rng(0), []
    for speed, mu, kappa, _ in _draw_states(n):
        pose = rng.uniform(-3, 3, 3)
        omega = rng.uniform(-paper.OMEGA_MAX_RADPS, paper.OMEGA_MAX_RADPS)
        still = np.array(ca.DM(model.f(ca.DM.zeros(3), 0, ca.DM([speed, mu, kappa])))).ravel()
        moved = model.rk4(model.f, ca.DM(pose), omega, ca.DM([speed, 1, 1]), paper.DT_S)
        circle = path.advance(*pose, omega / speed, speed * paper.DT_S, np)
        off = np.abs(np.array(ca.DM(moved)).ravel() - circle).max()
        rows.append(dict(at_rest_mps=np.linalg.norm(still), off_unicycle_m=off))
    return pd.DataFrame(rows)


def times(qp, duration_s=60.0):
    """Times [µs] of the four phases at every sample: on the condensed QP ("daqp"), as in the paper,
    or by its stages ("structured"), the default here.
    """
    columns = [f"{problem}_{phase}" for problem, phase in timing.COLUMNS]
    scenario = Scenario(process_noise="calibrated", duration_s=duration_s)
    return pd.DataFrame(timing.phases(scenario, qp), columns=columns)


def all_of(seeds):
    """Every experiment, {process noise: {name: table}}; what no process noise touches stands under
    both. `seeds` is the largest number of fields of a campaign.
    """
    independent = dict(kkt=kkt_tolerances(), gains=gains(), models=models())
    independent |= {f"times_{qp}": times(qp) for qp in ("daqp", "structured")}
    return {
        process_noise: independent
        | dict(
            arrival_cost=arrival_costs(process_noise, max(2, seeds // 10)),
            iterations=iterations(process_noise, max(2, seeds // 100)),
        )
        for process_noise in PROCESS_NOISES
    }
