"""What takes processes of its own to measure: first run and first view after a cold start."""

import os
import subprocess
import sys
import tempfile

import pandas as pd

RUN = """
from time import perf_counter
begin = perf_counter()
import rhec
scenario, simulate = rhec.Scenario, rhec.simulate
imported = perf_counter()
simulate(scenario())
print(imported - begin, perf_counter() - begin)
"""
VIEW = """
from time import perf_counter
begin = perf_counter()
import rhec
explorer = rhec.Explorer()
explorer._repr_mimebundle_()
print(perf_counter() - begin)
"""
# A script, and what each of the times that it prints is until.
_SCRIPTS = {RUN: ("imported", "first run finished"), VIEW: ("first view of the explorer",)}


def start_times(script, cache):
    """The times that a script prints in a fresh process [s]."""
    done = subprocess.run(
        [sys.executable, "-c", script],
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
    for script, ends in [*_SCRIPTS.items()] * rounds:
        with tempfile.TemporaryDirectory() as cache:
            for state in ("nothing cached", "cached"):
                times = zip(ends, start_times(script, cache))
                rows += [dict(start=state, until=end, s=seconds) for end, seconds in times]
    return (
        pd.DataFrame(rows)
        .groupby(["start", "until"], sort=False)["s"]
        .agg(["min", "median", "max"])
        .add_suffix("_s")
        .reset_index()
    )
