"""What takes processes of its own to measure: the first run after a cold start."""

import os
import subprocess
import sys
import tempfile

import pandas as pd

START = """
from time import perf_counter
begin = perf_counter()
import rhec
scenario, simulate = rhec.Scenario, rhec.simulate
imported = perf_counter()
simulate(scenario())
print(imported - begin, perf_counter() - begin)
"""


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
