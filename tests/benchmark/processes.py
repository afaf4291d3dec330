"""What takes processes of its own to measure: the first run after a cold start, and the throughput
of campaigns.
"""

import os
import subprocess
import sys
import tempfile
import time

import pandas as pd

from rhec import campaign, paper
from rhec.scenario import Scenario

START = """
from time import perf_counter
begin = perf_counter()
import rhec
scenario, simulate = rhec.Scenario, rhec.simulate
imported = perf_counter()
simulate(scenario())
print(imported - begin, perf_counter() - begin)
"""
SAMPLES = 1200


def start_times(cache):
    """Seconds from the beginning of `import rhec`: until its names are there, until the first
    closed-loop run is finished.
    """
    done = subprocess.run(
        [sys.executable, "-c", START],
        env=os.environ | dict(RHEC_CACHE=cache),
        check=True,
        capture_output=True,
        text=True,
    )
    return [float(seconds) for seconds in done.stdout.split()]


def starts(rounds=3):
    """Table of cold starts, nothing compiled yet, and of those that find everything compiled;
    least, median and most [s].
    """
    rows = []
    for _ in range(rounds):
        with tempfile.TemporaryDirectory() as cache:
            for state in ("nothing cached", "cached"):
                imported, finished = start_times(cache)
                rows += [
                    dict(start=state, until="imported", s=imported),
                    dict(start=state, until="first run finished", s=finished),
                ]
    return (
        pd.DataFrame(rows)
        .groupby(["start", "until"], sort=False)["s"]
        .agg(["min", "median", "max"])
        .add_suffix("_s")
        .reset_index()
    )


def seconds(runs, workers):
    scenarios = [
        Scenario(process_noise="calibrated", seed=seed, duration_s=SAMPLES * paper.DT_S)
        for seed in range(runs)
    ]
    begin = time.perf_counter()
    campaign(scenarios, workers=workers)
    return time.perf_counter() - begin


def throughput(few=128, many=512, rounds=3):
    """Table of closed-loop samples a second of campaigns of `many` runs, everything included, on
    one worker and on two that a few runs have started.
    """
    rows = []
    for workers in (1, 2):
        seconds(few, workers)
        rows += [
            dict(workers=workers, samples_per_s=many * SAMPLES / seconds(many, workers))
            for _ in range(rounds)
        ]
    table = (
        pd.DataFrame(rows)
        .groupby("workers")["samples_per_s"]
        .agg(["min", "median", "max"])
        .reset_index()
    )
    table["share_of_linear"] = table["median"] / table["workers"] / table["median"][0]
    return table
