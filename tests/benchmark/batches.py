"""Batches: what a run of a batch costs, beside single objects that do the same with the same bits.

CPU time of one process, since other work on the machine changes that least. Pendulums swing up from
random places; skid-steered robots drive with the estimator and the controller.
"""

import time
from typing import NamedTuple

import numpy as np
import pandas as pd
from oracles import plant
from robots import DT, SKID_STEERED, N

import rhec
from benchmark.any_robot import live
from notebooks.further import gallery
from notebooks.studies.ipopt import next_state

RUNS, SINGLE = 4096, 64


class Work(NamedTuple):
    """One kind of object, and the arguments of all runs at each sample."""

    make: object  # () -> the object
    samples: list  # of arguments, each (runs, …) or the same for all runs


def swing_up(runs=RUNS, samples=80, seed=0):
    """Work of a pendulum's RHC in closed loop, hanging at first, more or less."""
    problem = gallery.pendulum()
    rng = np.random.default_rng(seed)
    x = np.array(problem.start) + rng.uniform(-0.5, 0.5, (runs, 4))
    options = problem.options | dict(dt=0.05)
    step = next_state(options["model"], 0.05).map(runs)
    x_ref = np.zeros((4, options["horizon"] + 1))
    u_ref = np.zeros((1, options["horizon"]))
    batch = rhec.batch(rhec.RHC(**options), runs)
    given = []
    for _ in range(samples):
        given.append((x, np.zeros(0), x_ref, u_ref))
        x = step(x.T, batch.feedback(*given[-1]).T, np.zeros((0, runs))).full().T
    return Work(lambda: rhec.RHC(**options), given)


def skid_steered(runs=RUNS, samples=40, seed=0):
    """Works of RHE and RHC of skid-steered robots that follow a line."""
    rng = np.random.default_rng(seed)
    truth = rng.uniform(*SKID_STEERED.x_range, (runs, 3))
    slips = rng.uniform(0.0, 0.35, (runs, 2))
    guess = np.zeros(5)
    step = plant(SKID_STEERED).map(runs)
    estimators, controllers = (rhec.batch(each, runs) for each in live(SKID_STEERED, guess))
    ahead = 0.5 * DT * np.arange(samples + N + 1)
    readings, wishes = [], []
    u = np.zeros((runs, 2))
    for k in range(samples):
        z = np.hstack([truth[:, :2], u]) + rng.normal(size=(runs, 4)) * SKID_STEERED.sigma_v
        readings.append((z,))
        found = estimators.feedback(z)
        x_ref = np.array([ahead[k : k + N + 1], np.zeros(N + 1), np.zeros(N + 1)])
        wishes.append((found.x, found.p, x_ref, np.full((2, N), 0.5)))
        u = controllers.feedback(*wishes[-1])
        truth = step(truth.T, u.T, slips.T)[0].full().T
    rhe, rhc = (lambda: live(SKID_STEERED, guess)[0]), (lambda: live(SKID_STEERED, guess)[1])
    return Work(rhe, readings), Work(rhc, wishes)


def works():
    """{name: Work}."""
    estimators, controllers = skid_steered()
    return {
        "pendulum's RHC": swing_up(),
        "skid-steered robot's RHE": estimators,
        "skid-steered robot's RHC": controllers,
    }


def _together(work):
    """Time a sample of a run [µs], (samples,), and the results of the first SINGLE runs."""
    batch = rhec.batch(work.make(), len(work.samples[0][0]))
    times, results = [], []
    for given in work.samples:
        begin = time.process_time()
        batch.prepare()
        found = batch.feedback(*given)
        times.append(time.process_time() - begin)
        results.append(np.array(getattr(found, "x", found))[:SINGLE])
    return 1e6 * np.array(times) / batch.n, np.array(results)


def _one_by_one(work):
    """The same of SINGLE objects, in a loop in Python."""
    objects = [work.make() for _ in range(SINGLE)]
    ndim = (2, 2, 3, 3)[: len(work.samples[0])]  # of what differs between the runs
    times, results = [], []
    for given in work.samples:
        rows = [
            [each[run] if np.ndim(each) == n else each for each, n in zip(given, ndim)]
            for run in range(SINGLE)
        ]
        found = []
        begin = time.process_time()
        for single, row in zip(objects, rows):
            single.prepare()
            found.append(single.feedback(*row))
        times.append(time.process_time() - begin)
        results.append([getattr(each, "x", each) for each in found])
    return 1e6 * np.array(times) / SINGLE, np.array(results)


def measure(rounds=3, kinds=works):
    """Table of CPU time a sample of a run [µs], least of some rounds, which take turns.

    The first sample, which sets up the memory, does not count. Raises SystemExit if a run of a
    batch has other bits than its single object.
    """
    rows = []
    for name, work in kinds().items():
        together, single = [], []
        for _ in range(rounds):
            spent, found = _together(work)
            together.append(spent[1:])
            spent, expected = _one_by_one(work)
            single.append(spent[1:])
            if not np.array_equal(found, expected, equal_nan=True):
                raise SystemExit(f"{name}: a batch has other bits than single objects")
        batch_us, single_us = np.min(together, axis=0), np.min(single, axis=0)
        row = dict(work=name, runs=len(work.samples[0][0]), samples=len(batch_us))
        row |= dict(single_us=single_us.mean(), batch_us=batch_us.mean())
        row |= dict(speedup=single_us.mean() / batch_us.mean())
        rows.append(row | dict(median_speedup=np.median(single_us / batch_us)))
    return pd.DataFrame(rows)
