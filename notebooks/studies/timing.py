"""Computation times of preparation and feedback (paper, Table "Computation times of the nonlinear
RHEC").

Timed from Python, one call a phase, NumPy arrays in and out, as in a user's loop; the arrival cost
belongs to the RHE's preparation.
"""

import os
import platform
import time
from pathlib import Path

import casadi as ca
import numpy as np
import pandas as pd

import rhec
from rhec import paper
from rhec.simulation.columns import MEASUREMENTS, POSE
from rhec.simulation.simulate import simulate
from rhec.tracked_robot import tuning
from rhec.tracked_robot.references import PathTracker

PHASES = tuple(key for key in paper.TABLE_1_MS if key[1] != "overall")  # (problem, phase), in order


def phases(scenario, controller=rhec.RHC):
    """Times of the four phases at every sample of a scenario's run.

    Args:
        scenario: The Scenario.
        controller: A function that makes the RHC of its weights.

    Returns:
        Times [µs], (samples, 4), in the order of PHASES.
    """
    (run,) = simulate([scenario])  # one run does not pay for compiling its loop
    guess = (*run.log.loc[0, POSE], scenario.speed_mps, 1.0, 1.0)
    noise = tuning.process_noise_of(scenario)
    estimator = rhec.RHE(process_noise=noise, guess=guess)
    controller = controller(q=scenario.q, r=scenario.r)
    tracker = PathTracker(run.path)
    measurements = run.log[MEASUREMENTS].to_numpy()
    clock = time.perf_counter_ns
    # References belong to neither RHE nor RHC, so they are left out of the times.
    taken = np.empty((len(measurements), 4))
    for k, z in enumerate(measurements):
        begin = clock()
        estimator.prepare()
        prepared = clock()
        estimate = estimator.feedback(z)
        estimated = clock()
        references = tracker.references(estimate, z[3])
        referenced = clock()
        controller.prepare()
        planned = clock()
        controller.feedback(estimate.pose, estimate.p, *references)
        taken[k] = prepared - begin, estimated - prepared, planned - referenced, clock() - planned
    return taken[1:] / 1e3  # the first sample has nothing to prepare


def table(taken):
    """Minimum, average, median and maximum [µs] by problem and phase, with the paper's numbers.

    Args:
        taken: Times of `phases`.
    """
    rows = []
    for problem, (preparation, feedback) in {"RHE": taken.T[:2], "RHC": taken.T[2:]}.items():
        times = dict(preparation=preparation, feedback=feedback, overall=preparation + feedback)
        for phase, values in times.items():
            ours = values.min(), values.mean(), np.median(values), values.max()
            papers = (1e3 * value for value in paper.TABLE_1_MS[problem, phase])
            rows.append((problem, phase, *ours, *papers))
    columns = "problem phase minimum_us average_us median_us maximum_us".split()
    papers_columns = "paper_minimum_us paper_average_us paper_maximum_us".split()
    return pd.DataFrame(rows, columns=columns + papers_columns)


def as_in_the_paper(times):
    """Table 1 as the paper prints it, in ms: minimum, average, maximum here beside the paper's.

    Args:
        times: Of `table`.

    Returns:
        DataFrame with an index of problem and phase, and columns of (whose, statistic).
    """
    statistics = ("minimum", "average", "maximum")
    rows = times.set_index(["problem", "phase"])
    columns = {
        (whose, statistic): rows[f"{prefix}{statistic}_us"] / 1e3
        for whose, prefix in (("here [ms]", ""), ("the paper, Raspberry Pi 3 [ms]", "paper_"))
        for statistic in statistics
    }
    return pd.DataFrame(columns)


def feedback_over_preparation(times):
    """Medians [µs] of both phases, and their ratio, by problem.

    Args:
        times: Of `table`.
    """
    medians = times.pivot(index="problem", columns="phase", values="median_us")
    return medians.assign(ratio=medians["feedback"] / medians["preparation"])


def machine():
    """The processor's name and number, and the versions that matter."""
    info = Path("/proc/cpuinfo")
    lines = info.read_text().splitlines() if info.exists() else []
    names = [line.split(":")[1].strip() for line in lines if line.startswith("model name")]
    processor = names[0] if names else platform.processor() or platform.machine()
    versions = f"Python {platform.python_version()}, CasADi {ca.__version__}"
    return f"{processor}, {os.cpu_count()} cores, {versions}"
