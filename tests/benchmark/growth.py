"""How campaigns grow: closed-loop samples a second and memory with the number of runs and of
processes, and what a run costs as estimator, model and horizon change. Everything is included, from
a list of scenarios to a table; compiling is not.
"""

import os
import time
from concurrent.futures import ThreadPoolExecutor

import pandas as pd
import psutil

from rhec import campaign
from rhec.core.lanes import lanes
from rhec.simulation import closed_loop
from rhec.simulation.scenario import Scenario
from rhec.tracked_robot.estimators import NAMES

RUNS = 1, 10, 100, 1_000, 10_000, 100_000
KINDS = {"estimator": NAMES, "speed_model": ("parameter", "input", "slipping")}
KINDS |= dict.fromkeys(("estimation_horizon", "prediction_horizon"), (5, 15, 30, 60))


def scenarios(runs, **changes):
    """Four minutes each on fields of their own."""
    return [Scenario(process_noise="likelihood", seed=seed, **changes) for seed in range(runs)]


def samples(runs):
    """How many closed-loop samples these are."""
    return sum(round(run.duration_s / closed_loop.paper.DT_S) for run in runs)


def compile_lanes(scenario):
    """Compile a scenario's lanes, where there are some; how many runs they drive at once."""
    structure = closed_loop.set_up(scenario).structure
    block = lanes.load(closed_loop.build_sample, *structure)
    return block.lanes if block else 1


def seconds(runs, workers, clock=time.perf_counter):
    """What a campaign takes, and the memory [MB] that its processes have at the end."""
    begin = clock()
    table = campaign(runs, workers=workers)
    spent = clock() - begin
    assert (table["error"] == "").all()
    here = psutil.Process(os.getpid())
    processes = [here, *here.children(recursive=True)] if workers > 1 else [here]
    return spent, sum(process.memory_info().rss for process in processes) / 1e6


def by_runs(counts=RUNS, workers=(1, 2)):
    """Table of samples a second and memory by number of runs and of processes, which a few runs
    have warmed up. Small campaigns count the best of three.
    """
    rows = []
    compile_lanes(scenarios(1)[0])
    for n_workers in workers:
        seconds(scenarios(64), n_workers)
        for count in counts:
            runs = scenarios(count)
            spent, memory = min(seconds(runs, n_workers) for _ in range(3 if count <= 1_000 else 1))
            rows.append((n_workers, count, samples(runs) / spent, memory))
    table = pd.DataFrame(rows, columns=["workers", "runs", "samples_per_s", "memory_mb"])
    alone = table[table["workers"] == 1].set_index("runs")["samples_per_s"]
    per_worker = table["samples_per_s"] / table["workers"]
    return table.assign(share_of_linear=per_worker / table["runs"].map(alone))


def by_kind(kinds=KINDS, runs=64, rounds=3):
    """Table of what a run of 1,200 samples costs in one process [ms of its own time], kinds taking
    turns.
    """
    chosen = [(field, value) for field, values in kinds.items() for value in values]
    first = [scenarios(1, **dict([each]))[0] for each in chosen]
    with ThreadPoolExecutor(os.cpu_count()) as compilers:
        width = dict(zip(chosen, compilers.map(compile_lanes, first)))
    spent = {each: [] for each in chosen}
    for _ in range(rounds):
        for field, value in chosen:
            more = scenarios(runs, **{field: value})
            spent[field, value].append(seconds(more, 1, time.process_time)[0])
    rows = [(*each, width[each], 1e3 * min(times) / runs) for each, times in spent.items()]
    return pd.DataFrame(rows, columns=["field", "value", "lanes", "run_ms"]).astype({"value": str})
