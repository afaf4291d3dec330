"""What a campaign takes, by the number of its drives and of its workers."""

import os
import time

import pandas as pd
import psutil

import rhec
from rhec.core._casadi import compiled
from rhec.simulation import closed_loop
from rhec.simulation.campaigns import batch

RUNS = (1, 10, 100, 1000)


def _processor_s():
    """Seconds that the processor has given to this process and to its workers.

    Those of workers that have ended are among the process's own.
    """
    own = psutil.Process()
    living = own.children(recursive=True)
    return sum(own.cpu_times()[:4]) + sum(sum(each.cpu_times()[:2]) for each in living)


def measure(rounds=2, runs=RUNS):
    """Table of seconds: drives of 240 s of the default scenario, each with a seed of its own."""
    rows = []
    batch.compile_lanes(rhec.Scenario())
    for number in range(-1, rounds):  # the first round starts the workers
        for workers in range(1, (os.cpu_count() or 1) + 1):
            for n in runs if number >= 0 else runs[1:2]:
                seeds = range(1000 * (number + 1), 1000 * (number + 1) + n)
                scenarios = [rhec.Scenario(seed=seed) for seed in seeds]
                begin, before = time.perf_counter(), _processor_s()
                rhec.campaign(scenarios, workers=workers)
                wall, cpu = time.perf_counter() - begin, _processor_s() - before
                rows.append(dict(block=number, runs=n, workers=workers, wall_s=wall, cpu_s=cpu))
    times = pd.DataFrame(rows).query("block >= 0").drop(columns="block")
    found = times.groupby(["runs", "workers"])
    spread = {
        f"{name}_{part}": found[name].quantile(share)
        for name in ("wall_s", "cpu_s")
        for part, share in dict(low=0.0, median=0.5, high=1.0).items()
    }
    return pd.DataFrame(spread).reset_index()


def drive(rounds=10):
    """Table [ms] of one drive by rhec.simulate, with log and metrics, each by another seed."""
    # The first runs of a new loop would use code that is not optimised yet.
    compiled.load(closed_loop.build_sample, *closed_loop.set_up(rhec.Scenario()).structure)
    times = []
    for seed in range(-1, rounds):
        scenario = rhec.Scenario(seed=max(seed, 0))
        begin = time.process_time_ns()
        run = rhec.simulate(scenario)
        assert len(run.log), run.metrics
        times.append((time.process_time_ns() - begin) / 1e6)
    low, median, high = pd.Series(times[1:]).quantile([0.25, 0.5, 0.75])
    return pd.DataFrame(
        [dict(contestant="rhec.simulate", lower_quartile_ms=low, median_ms=median,
              upper_quartile_ms=high)]
    )  # fmt: skip
