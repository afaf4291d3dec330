"""One step of estimation and control: who takes how long on the same problems, after all have shown
that they solve them.
"""

import functools
import itertools
import time

import numpy as np
import pandas as pd

from benchmark import acados_peer, instructions, native, peers, problems
from notebooks.studies.timing import PHASES
from rhec import paper
from rhec.core import runner
from rhec.core._casadi import compiled
from rhec.simulation import closed_loop
from rhec.tracked_robot import plant

TOLERANCE = 1e-6  # m, rad, m/s, 1, rad/s: how far an answer may be from rhec's
SAMPLES = 300  # problems
SHARE = 10  # problems that a peer solves in a block
LOOP = 1200  # samples of a closed loop in a block
WHOLE = "RHE + RHC", "closed loop"
REFERENCE = "do-mpc"
SPEEDUP = f"speedup_over_{REFERENCE}"
clock = time.perf_counter_ns


def difference(name, answers, recorded):
    """How far pairs of answers (RHE, RHC) are from rhec's at convergence: largest entry of each,
    median and maximum over all problems.
    """
    largest = np.array(
        [
            (np.abs(estimate - each.estimate).max(), np.abs(omega_plan - each.omega_plan).max())
            for (estimate, omega_plan), each in zip(answers, recorded)
        ]
    )
    row = dict(contestant=name)
    for problem, errors in zip(("rhe", "rhc"), largest.T):
        row |= {f"{problem}_median": np.median(errors), f"{problem}_maximum": errors.max()}
    return row


def agreed(row):
    return row["rhe_maximum"] <= TOLERANCE and row["rhc_maximum"] <= TOLERANCE


def agreement(run, recorded, acados=None):
    """The table of differences, and with how many iterations a sample rhec agrees with itself;
    raises if a peer does not agree.

    One iteration a sample, as the paper has it, is in the table to show how near the optimum that
    stays.
    """
    rows = []
    for name, makers in peers.PEERS.items():
        rhe, rhc = (make(recorded[0]) for make in makers)
        rows.append(
            difference(name, [(rhe(problem), rhc(problem)) for problem in recorded], recorded)
        )
    for way in acados.ways if acados else ():
        rows.append(difference(acados_peer.NAMES[way], acados.answers(way), recorded))
    if not all(map(agreed, rows)):
        raise SystemExit(
            f"Not all answers agree to {TOLERANCE:g}, so nothing was timed:\n"
            f"{pd.DataFrame(rows).to_string(index=False)}"
        )
    for iterations in itertools.count(1):
        answers = [
            (problem.estimate, problem.omega_plan)
            for problem in problems.record(run, iterations=iterations)
        ]
        rows.append(
            difference(
                f"rhec, {iterations} iteration{'s' * (iterations > 1)} a sample", answers, recorded
            )
        )
        if agreed(rows[-1]):
            return pd.DataFrame(rows), iterations


# Contestants: functions of the block's number that run one block and return {(problem, phase): µs a
# step, on average over the block}.


def from_python(run, recorded, iterations=None):
    """rhec's live objects, NumPy arrays in and out, the arrival cost updated: a block is the whole
    run. One iteration a sample, or so many.
    """
    window, newest = np.split(problems.measured(run), [paper.HORIZON])

    def block(_):
        estimator, controller = problems.live(run)
        estimate, control = estimator.feedback, controller.feedback
        if iterations:
            estimate, control = (
                functools.partial(each.solve, iterations=iterations)
                for each in (estimator, controller)
            )
        for z in window:
            estimator.prepare()
            estimate(z)
        taken = np.empty((len(recorded), 4))
        for k, (z, problem) in enumerate(zip(newest, recorded)):
            pose, p = problem.estimate[:3], problem.estimate[3:]
            begin = clock()
            estimator.prepare()
            prepared = clock()
            estimate(z)
            estimated = clock()
            controller.prepare()
            planned = clock()
            control(pose, p, problem.xi_ref, problem.omega_ref)
            taken[k] = np.diff([begin, prepared, estimated, planned, clock()])
        # On the first sample the controller has nothing to prepare.
        return dict(zip(PHASES, taken[1:].mean(axis=0) / 1e3))

    return block


def fused(scenario):
    """The compiled closed loop: robot, sensors, estimator, path, controller and log."""
    world, noise = closed_loop.set_up(scenario), plant.draw_noise(scenario.seed, LOOP)
    functions = compiled.load(closed_loop.build_sample, *world.structure)

    def block(_):
        begin = clock()
        runner.run_one(functions, world.memory, noise, world.settings)
        return {("closed loop", "overall"): (clock() - begin) / 1e3 / LOOP}

    return block


def peer(makers, recorded):
    rhe, rhc = (make(recorded[0]) for make in makers)

    def block(number):
        begin = SHARE * number % len(recorded)
        times = []
        for solve in (rhe, rhc):
            started = clock()
            for problem in recorded[begin : begin + SHARE]:
                solve(problem)
            times.append((clock() - started) / 1e3 / SHARE)
        return {("RHE", "overall"): times[0], ("RHC", "overall"): times[1]}

    return block


def interleaved(contestants, rounds):
    """A B C A B C …: one row a block and phase, with sums over phases and over both problems."""
    rows = []
    for number in range(-1, rounds):  # the first round warms up
        for name, block in contestants.items():
            times = problems.with_sums(block(max(number, 0)))
            rows += [
                dict(block=number, contestant=name, problem=problem, phase=phase, us=us)
                for (problem, phase), us in times.items()
            ]
    return pd.DataFrame(rows).query("block >= 0")


def spread(times, by):
    """Quartiles of `us` for each group, in the order of first appearance."""
    quartiles = times.groupby(by, sort=False)["us"].quantile([0.25, 0.5, 0.75]).unstack(sort=False)
    return quartiles.set_axis(
        ["lower_quartile_us", "median_us", "upper_quartile_us"], axis=1
    ).reset_index()


def measure(rounds=30, counted=True):
    """Who agrees how well, and the table of times, with instructions where valgrind is there;
    speedup: the reference's RHE + RHC step over this one, block beside block, median.
    """
    run = problems.drive(SAMPLES)
    recorded = problems.record(run)
    acados = acados_peer.Acados(recorded, TOLERANCE) if acados_peer.command() else None
    agreeing, iterations = agreement(run, recorded, acados)
    contestants = {
        instructions.CLOSED_LOOP: fused(run.scenario),
        instructions.IN_C: native.block(run, recorded),
        "rhec, one iteration": from_python(run, recorded),
        "rhec, to convergence": from_python(run, recorded, iterations),
    }
    contestants |= {name: peer(makers, recorded) for name, makers in peers.PEERS.items()}
    for way in acados.ways if acados else ():
        contestants[acados_peer.NAMES[way]] = acados.block(way)
    times = interleaved(contestants, rounds)
    table = spread(times, ["contestant", "problem", "phase"])
    whole = times[times["problem"].isin(WHOLE)].pivot(
        index="block", columns="contestant", values="us"
    )
    if REFERENCE in whole:
        speedup = whole.rtruediv(whole[REFERENCE], axis=0).median()
        table[SPEEDUP] = table["contestant"].map(speedup).where(table["problem"].isin(WHOLE))
    if counted and instructions.available():
        table = table.merge(instructions.measure(acados), how="left")
        table = table.astype({"instructions": "Int64"})
    if acados:
        acados.close()
    return agreeing, table
