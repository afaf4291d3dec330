"""Many runs, on all cores."""

import multiprocessing
import os
from concurrent.futures import ProcessPoolExecutor
from dataclasses import fields

from rhec.closed_loop import simulate

CHUNK = 32    # scenarios a worker takes at a time
FEW = 200     # so many take less time than workers need to start


def row(scenario):
    """A run's fields and metrics. The log stays where it was made."""
    return {field.name: getattr(scenario, field.name) for field in fields(scenario)} | simulate(scenario).metrics


def campaign(scenarios, workers=None):
    """One row a scenario, in the order given: its fields and its metrics, as a DataFrame. The same on any number of workers.

    workers: processes; unless told, one a core, or none for a few scenarios. A script that starts workers needs `if __name__ == "__main__":`.
    """
    import pandas as pd   # as in `closed_loop`
    scenarios = list(scenarios)
    if workers is None:
        workers = 0 if len(scenarios) <= FEW else os.cpu_count()
    if workers < 2:
        return pd.DataFrame(map(row, scenarios))
    # workers of their own, not forked: a notebook's kernel has threads, which a fork may leave in the middle of something
    with ProcessPoolExecutor(workers, multiprocessing.get_context("spawn")) as pool:
        return pd.DataFrame(pool.map(row, scenarios, chunksize=CHUNK))
