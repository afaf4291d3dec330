"""One step of estimation and control: who takes how long on the same problems, after all have shown
that they solve them.

All times are of one thread. Where a block of Python's takes longer than a process gets at once, it
is the processor's time that counts, so that others who use the machine do not.
"""

import functools
import itertools
import time

import numpy as np
import pandas as pd

from benchmark import acados_peer, instructions, native, peers, problems
from notebooks.studies.timing import PHASES
from rhec.core import runner
from rhec.core._casadi import compiled
from rhec.simulation import closed_loop
from rhec.tracked_robot import plant

# How far an answer may be from rhec's, in the state's and the input's units. An interior-point
# method ends beside an active bound, at its default tolerance up to 1e-5 from it.
TOLERANCE = 1e-6
TOLERANCE_OF_INTERIOR_POINTS = 1e-4
SAMPLES = 300  # problems at the paper's size
SHARE = 10  # problems that a peer solves in a block
LOOP = 1200  # samples of a closed loop in a block
WHOLE = "RHE + RHC", "closed loop"
FROM_PYTHON, CONVERGED = "rhec, one iteration", "rhec, to convergence"
REFERENCE = "do-mpc"
clock = time.perf_counter_ns


def difference(name, answers, recorded):
    """How far pairs of answers (RHE, RHC) are from rhec's at convergence: largest entry of each,
    median and maximum over all problems.
    """
    largest = np.array(
        [
            (np.abs(estimate - each.estimate).max(), np.abs(plan - each.plan).max())
            for (estimate, plan), each in zip(answers, recorded)
        ]
    )
    row = dict(contestant=name)
    for problem, errors in zip(("rhe", "rhc"), largest.T):
        row |= {f"{problem}_median": np.median(errors), f"{problem}_maximum": errors.max()}
    return row


def agreed(row):
    interior = row["contestant"] in peers.PEERS
    tolerance = TOLERANCE_OF_INTERIOR_POINTS if interior else TOLERANCE
    return max(row["rhe_maximum"], row["rhc_maximum"]) <= tolerance


def agreement(loop, recorded, acados=None):
    """The table of differences, and with how many iterations a sample rhec agrees with itself.

    One iteration a sample, as the paper has it, is in the table to show how near the optimum that
    stays. Who does not agree is not timed.
    """
    rows = []
    for name, makers in peers.PEERS.items():
        rhe, rhc = (make(loop.case, recorded[0]) for make in makers)
        rows.append(
            difference(name, [(rhe(problem), rhc(problem)) for problem in recorded], recorded)
        )
    for way in acados.ways if acados else ():
        rows.append(difference(acados_peer.NAMES[way], acados.answers(way), recorded))
    for iterations in itertools.count(1):
        again = problems.record(loop, iterations=iterations)
        answers = [(problem.estimate, problem.plan) for problem in again]
        name = f"rhec, {iterations} iteration{'s' * (iterations > 1)} a sample"
        rows.append(difference(name, answers, recorded))
        if agreed(rows[-1]):
            return pd.DataFrame(rows), iterations


# Contestants: functions of the block's number that run one block and return {(problem, phase): µs a
# step, of the block}.


def from_python(loop, recorded, iterations=None):
    """rhec's live objects, NumPy arrays in and out, the arrival cost updated: a block is the whole
    run, of which the median sample counts. One iteration a sample, or so many.
    """
    case = loop.case
    window, newest = np.split(loop.z, [case.horizon])

    def block(_):
        estimator, controller = case.live(loop.guess)
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
            begin = clock()
            estimator.prepare()
            prepared = clock()
            estimate(z)
            estimated = clock()
            controller.prepare()
            planned = clock()
            case.command(control, problem.estimate, problem.x_ref, problem.u_ref)
            taken[k] = np.diff([begin, prepared, estimated, planned, clock()])
        # On the first sample the controller has nothing to prepare.
        return dict(zip(PHASES, np.median(taken[1:], axis=0) / 1e3))

    return block


def fused(scenario):
    """The compiled closed loop: robot, sensors, estimator, path, controller and log."""
    world, noise = closed_loop.set_up(scenario), plant.draw_noise(scenario.seed, LOOP)
    functions = compiled.load(closed_loop.build_sample, *world.structure)

    def block(_):
        begin = time.process_time_ns()
        runner.run_one(functions, world.memory, noise, world.settings)
        taken = time.process_time_ns() - begin
        return {("closed loop", "overall"): taken / 1e3 / LOOP}

    return block


def peer(makers, case, recorded):
    rhe, rhc = (make(case, recorded[0]) for make in makers)

    def block(number):
        begin = SHARE * number % len(recorded)
        some = recorded[begin : begin + SHARE]
        times = []
        for solve in (rhe, rhc):
            started = time.process_time_ns()
            for problem in some:
                solve(problem)
            times.append((time.process_time_ns() - started) / 1e3 / len(some))
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


def acados_of(case, recorded):
    """acados, or None with a line that says why it is left out."""
    if not acados_peer.command():
        return None
    try:
        return acados_peer.Acados(case, recorded, TOLERANCE)
    except RuntimeError as error:
        print(f"acados is left out ({case.name}): {error}", flush=True)
        return None


def measure(loop, rounds=30):
    """Who agrees how well, and the table of times.

    `ratio` is the contestant's step over that of rhec from Python, one iteration, block beside
    block, median.

    Args:
        loop: A Loop.
        rounds: How often each contestant has its turn.
    """
    recorded = problems.record(loop)
    case = loop.case
    acados = acados_of(case, recorded)
    agreeing, iterations = agreement(loop, recorded, acados)
    good = {row["contestant"] for row in agreeing.to_dict("records") if agreed(row)}
    contestants = {
        instructions.IN_C: native.block(loop, recorded),
        FROM_PYTHON: from_python(loop, recorded),
        CONVERGED: from_python(loop, recorded, iterations),
    }
    if case.papers and case.horizon == problems.PAPERS_SIZE[0]:
        contestants[instructions.CLOSED_LOOP] = fused(problems.scenario_of(LOOP))
    others = {name: peer(makers, case, recorded) for name, makers in peers.PEERS.items()}
    for way in acados.ways if acados else ():
        others[acados_peer.NAMES[way]] = acados.block(way)
    for name in others.keys() - good:
        print(f"{name} is left out ({case.name}): its answers are too far off")
    contestants |= {name: block for name, block in others.items() if name in good}
    times = interleaved(contestants, rounds)
    table = spread(times, ["contestant", "problem", "phase"])
    whole = times[times["problem"].isin(WHOLE)].pivot(
        index="block", columns="contestant", values="us"
    )
    ratio = whole.div(whole[FROM_PYTHON], axis=0).median()
    table["ratio"] = table["contestant"].map(ratio).where(table["problem"].isin(WHOLE))
    if acados:
        acados.close()
    size = dict(system=case.system, states=len(case.model.states), intervals=case.horizon)
    return agreeing.assign(**size), table.assign(**size, iterations=iterations)
