"""The time from the start of a process to its first estimate and plan, at the paper's size.

`python -m benchmark.first NAME FOLDER` is one such process. "Cold" has an empty cache of compiled
code, "warm" that of the run before.
"""

import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
import pandas as pd

SAMPLES = 3
RHEC = "rhec, own loop"
SIMULATE = "rhec.simulate"


def solve_first(name, folder):
    """What a process does that has been told the data of some problems."""
    if name == SIMULATE:
        import rhec

        rhec.simulate(rhec.Scenario())
        return
    data = np.load(Path(folder, "problems.npz"))
    if name == RHEC:
        import rhec

        estimator, controller = rhec.RHE(), rhec.RHC()
        estimator.prepare()
        estimate = estimator.feedback(data["z"][0, :, -1])
        controller.feedback(estimate.pose, estimate.p, data["x_ref"][0], data["u_ref"][0, 0])
        return
    from benchmark import peers, problems

    case = problems.papers_case()
    first = problems.Problem(*(data[field][0] for field in problems.Problem._fields))
    for make in peers.PEERS[name]:
        make(case, first)(first)


def took(name, folder, cache):
    """(wall seconds, processor seconds) of the process and of all that it starts."""
    command = [sys.executable, "-W", "ignore", "-m", __name__, name, str(folder)]
    begin, before = time.perf_counter(), os.times()
    subprocess.run(command, check=True, env=os.environ | {"RHEC_CACHE": str(cache)})
    after = os.times()
    user = after.children_user - before.children_user
    return time.perf_counter() - begin, user + after.children_system - before.children_system


def measure(rounds=3):
    """Table of medians by contestant, with a cold and a warm cache."""
    from benchmark import peers, problems

    recorded = problems.record(problems.robot(problems.PAPERS_SIZE[0], SAMPLES))
    rows = []
    with tempfile.TemporaryDirectory() as folder:
        columns = zip(problems.Problem._fields, map(np.array, zip(*recorded)))
        np.savez(Path(folder, "problems.npz"), **dict(columns))
        for number in range(rounds):
            for name in (RHEC, SIMULATE, *peers.PEERS):
                cache = Path(folder, f"cache{number}")
                compiles = name in (RHEC, SIMULATE)
                for state in ("cold", "warm") if compiles else ("warm",):
                    wall, cpu = took(name, folder, cache / name.replace(" ", ""))
                    rows.append(dict(contestant=name, cache=state, wall_s=wall, cpu_s=cpu))
    return pd.DataFrame(rows).groupby(["contestant", "cache"], sort=False).median().reset_index()


if __name__ == "__main__":
    solve_first(*sys.argv[1:])
