"""The worst case: how long a phase takes at most in very many steps, with each QP solver; qpOASES
is the paper's.
"""

import numpy as np
import pandas as pd

from notebooks.studies import timing
from rhec import paper
from rhec.simulation.scenario import Scenario

PERCENTILES = 50, 99, 99.9, 99.99
SEEDS = range(10)
SOLVERS = "structured", "daqp", "qpoases"


def measure(steps):
    """Table of percentiles and maximum [µs] for each phase, from one run a seed, the solvers taking
    turns.
    """
    taken = {solver: [] for solver in SOLVERS}
    for seed in SEEDS:
        scenario = Scenario(
            process_noise="likelihood", seed=seed, duration_s=steps / len(SEEDS) * paper.DT_S
        )
        for solver in SOLVERS:
            taken[solver].append(timing.phases(scenario, timing.CONTROLLERS[solver]))
    rows = []
    for solver, runs in taken.items():
        times = np.concatenate(runs)
        for (problem, phase), column in [
            *zip(timing.PHASES, times.T),
            (("RHE + RHC", "overall"), times.sum(axis=1)),
        ]:
            quantiles = {
                f"p{percentile:g}_us": value
                for percentile, value in zip(PERCENTILES, np.percentile(column, PERCENTILES))
            }
            rows.append(
                dict(
                    qp=solver,
                    problem=problem,
                    phase=phase,
                    steps=len(column),
                    **quantiles,
                    maximum_us=column.max(),
                )
            )
    return pd.DataFrame(rows)
