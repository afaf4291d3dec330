"""How a step grows with the horizon: time to compute it, and to compile it from nothing."""

import os
import tempfile
import time
from unittest import mock

from benchmark import problems, step
from rhec import RHC, RHE
from rhec.core._casadi import compiled

HORIZONS = 15, 30, 60, 120  # intervals; 3 s to 24 s; compiling for 240 takes minutes with clang
SAMPLES = 50


def seconds(make, **arguments):
    begin = time.perf_counter()
    make(**arguments)
    return time.perf_counter() - begin


def contestants(horizons):
    """rhec on problems of each horizon, and the seconds that estimator and controller took to
    compile.
    """
    blocks, compiling = {}, {}
    for N in horizons:
        compiling[N, "RHE"], compiling[N, "RHC"] = (seconds(make, horizon=N) for make in (RHE, RHC))
        compiling[N, "RHE + RHC"] = compiling[N, "RHE"] + compiling[N, "RHC"]
        run = problems.drive(SAMPLES, N)
        blocks[N] = step.from_python(run, problems.record(run, N, iterations=1))
    return blocks, compiling


def measure(horizons=HORIZONS, rounds=15):
    """Table of RHE, RHC and both by horizon; growth: over the shortest horizon, block beside block,
    median.
    """
    with tempfile.TemporaryDirectory() as empty, mock.patch.dict(os.environ, RHEC_CACHE=empty):
        compiled.load.cache_clear()
        blocks, compiling = contestants(horizons)
        times = (
            step.interleaved(blocks, rounds)
            .query("phase == 'overall'")
            .rename(columns={"contestant": "intervals"})
        )
    by_block = times.pivot(index=["problem", "block"], columns="intervals", values="us")
    growth = by_block.div(by_block[horizons[0]], axis=0).groupby("problem").median()
    table = step.spread(times, ["intervals", "problem"])
    keys = list(zip(table["intervals"], table["problem"]))
    return table.assign(
        growth=[growth.loc[problem, N] for N, problem in keys],
        compile_s=[compiling[key] for key in keys],
    )
