"""What takes processes of its own to measure: the first run after a cold start, and the throughput of campaigns."""

import os
import subprocess
import sys
import tempfile
import time
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context

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
    """Seconds from the beginning of `import rhec`: until its names are there, until the first closed-loop run is finished."""
    done = subprocess.run([sys.executable, "-c", START], env=os.environ | dict(RHEC_CACHE=cache), check=True, capture_output=True, text=True)
    return [float(seconds) for seconds in done.stdout.split()]


def starts(rounds=3):
    """Table of cold starts, nothing compiled yet, and of those that find everything compiled; least, median and most [s]."""
    rows = []
    for _ in range(rounds):
        with tempfile.TemporaryDirectory() as cache:
            for state in ("nothing cached", "cached"):
                imported, finished = start_times(cache)
                rows += [dict(start=state, until="imported", s=imported), dict(start=state, until="first run finished", s=finished)]
    return pd.DataFrame(rows).groupby(["start", "until"], sort=False)["s"].agg(["min", "median", "max"]).add_suffix("_s").reset_index()


def drive(seeds):
    return len(campaign([Scenario(reading="calibrated", seed=seed, duration_s=SAMPLES * paper.DT_S) for seed in seeds]))


def throughput(runs=50, rounds=5):
    """Table of closed-loop samples a second in 1 and in 2 processes, each of which drives a campaign of so many runs at a time."""
    rows, seeds = [], range(runs)
    with ProcessPoolExecutor(2, get_context("spawn")) as pool:
        list(pool.map(drive, [seeds] * 4))   # both have imported and loaded everything
        for _ in range(rounds):
            for processes in (1, 2):
                begin = time.perf_counter()
                done = sum(pool.map(drive, [seeds] * processes))
                rows.append(dict(processes=processes, samples_per_s=done * SAMPLES / (time.perf_counter() - begin)))
    table = pd.DataFrame(rows).groupby("processes")["samples_per_s"].agg(["min", "median", "max"]).reset_index()
    table["share_of_linear"] = table["median"] / table["processes"] / table["median"][0]
    return table
