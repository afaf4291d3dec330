"""Whether robust handling loses anything on recorded robots: a grid of noise, rate and faults.

Each log is made noisier, its positions rarer, and its sensors fail; then it is replayed with and
without robust handling. Robust handling loses a cell where its yaw error (RMS) or its worst
position error is larger than 1.1 times that of the plain replay, plus 0.01 rad or 0.1 m. The errors
are means over noise seeds, which both replays share.

    python -m rhec.workbench.studies.robustness_grid LOG… [--seeds 5] [--first-seed 0] [--told]
        [--without-gyro]

prints the cells that are lost and writes the means of all cells to data/robustness_grid.csv. With
`--told` both replays are told a noise of 0.03 m, which is wrong in most cells.
"""

import argparse
import itertools
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pandas as pd

from rhec import paper
from rhec.logs import scores
from rhec.logs.reader import read
from rhec.logs.recording import prepare
from rhec.logs.replay import InitialGuess, estimate_samples, replay_scenario
from rhec.simulation.columns import MEASUREMENTS
from rhec.simulation.faults import Fault

__all__ = ["FAULTS", "NOISES_M", "RATES_HZ", "Cell", "grid", "lost_cells", "replays_of"]

NOISES_M = (0.02, 0.03, 0.05, 0.1, 0.3)
RATES_HZ = (5.0, 2.5, 1.0)
_START_S = 60.0
_DEAD_S = 30.0
FAULTS = {
    "no fault": None,
    "dead left": dict(kind="dead", channel="left", duration_s=_DEAD_S),
    "dead right": dict(kind="dead", channel="right", duration_s=_DEAD_S),
    "both dead": dict(kind="dead", channel="encoders", duration_s=_DEAD_S),
    "outliers": dict(kind="outliers", size_m=2.0, duration_s=_DEAD_S),
    "outage": dict(kind="missing", duration_s=20.0),
}
TOLERANCE = dict(yaw_rms_rad=(1.1, 0.01), worst_position_m=(1.1, 0.1))
_YAW_ERROR_RAD = 0.3  # of the first yaw
_ROUNDING_S = 1e-6


class Cell(NamedTuple):
    """What is made worse in a log."""

    noise_m: float  # standard deviation of the white noise on positions [m]
    rate_hz: float  # rate of the positions [Hz]
    fault: str  # one of FAULTS


def _rarer(rows, rate_hz):
    """Rows of a log with only so many positions a second."""
    due = np.floor((rows["t_s"] - rows["t_s"].iloc[0]) * rate_hz + _ROUNDING_S)
    rows.loc[due.diff() < 1, MEASUREMENTS[:2]] = np.nan
    return rows


def _noisy(recording, cell, seed):
    """A Recording with the noise and the rate of a cell."""
    rows = recording.rows.copy()
    noise = np.random.default_rng(seed).standard_normal((len(rows), 2))
    rows[MEASUREMENTS[:2]] += cell.noise_m * noise
    return recording._replace(rows=_rarer(rows, cell.rate_hz))


def replays_of(recording, cell, seed, start_s, **fields):
    """Samples of a cell's two replays, {robust: DataFrame}.

    Args:
        recording: The Recording, with the true yaw.
        cell: The Cell.
        seed: Seed of the noise and of the outliers.
        start_s: When the fault begins [s].
        **fields: Those of `rhec.replay`, such as sigma_v.
    """
    noisy = _noisy(recording, cell, seed)
    first = noisy.rows.groupby("segment")["theta_rad"].first()
    guess = InitialGuess(tuple(first + _YAW_ERROR_RAD))
    fault = FAULTS[cell.fault]
    faults = (Fault(start_s=start_s, **fault),) if fault else ()
    replays = {}
    for robust in (False, True):
        scenario = replay_scenario("rhe", noisy, fields | dict(robust=robust))
        replays[robust] = estimate_samples(noisy, scenario, guess, faults, seed)
    return replays


def _errors(samples):
    """The errors of TOLERANCE, from 8 m on in each segment."""
    counted = samples[scores.distance_driven(samples) >= scores.FROM_M]
    x, y = (counted[f"{name}_hat_m"] - counted[f"{name}_m"] for name in "xy")
    error = np.hypot(x, y)
    return dict(
        yaw_rms_rad=scores.rms(scores.yaw_error(counted)),
        worst_position_m=float(error.max()),
        last_position_m=float(error.iloc[-1]),
    )


def grid(logs, seeds, noises_m=NOISES_M, rates_hz=RATES_HZ, faults=tuple(FAULTS), **fields):
    """Errors of all replays.

    Args:
        logs: {name: DataFrame of a recording with the true pose}.
        seeds: Seeds of the noise.
        noises_m: Standard deviations of the noise [m].
        rates_hz: Rates of the positions [Hz].
        faults: Names among FAULTS.
        **fields: Those of `rhec.replay`.

    Returns:
        DataFrame, one row for each log, noise_m, rate_hz, fault, seed and robust, with the errors
        yaw_rms_rad, worst_position_m and last_position_m.
    """
    rows = []
    for name, log in logs.items():
        recording = prepare(log)
        scenario = replay_scenario("rhe", recording, {})
        start_s = scores.while_moving(estimate_samples(recording, scenario), _START_S, _DEAD_S)
        for *what, seed in itertools.product(noises_m, rates_hz, faults, seeds):
            cell = Cell(*what)
            for robust, samples in replays_of(recording, cell, seed, start_s, **fields).items():
                about = dict(log=name, **cell._asdict(), seed=seed, robust=robust)
                rows.append(about | _errors(samples))
    return pd.DataFrame(rows)


def lost_cells(table):
    """The cells that robust handling loses.

    Args:
        table: DataFrame, as `grid` returns it.

    Returns:
        DataFrame, one row for each log and Cell: the mean errors over seeds of the plain and the
        robust replay, and for each error whether it `is_lost`.
    """
    cell = ["log", *Cell._fields]
    means = table.groupby([*cell, "robust"], sort=False)[[*TOLERANCE]].mean().unstack("robust")
    columns = {}
    for error, (factor, more) in TOLERANCE.items():
        plain = means[error, False]
        robust = means[error, True]
        columns |= {
            f"{error}, plain": plain,
            f"{error}, robust": robust,
            f"{error}, is_lost": ~(robust <= factor * plain + more),
        }
    return pd.DataFrame(columns)


def _main():
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("logs", nargs="+", type=Path)
    parser.add_argument("--seeds", type=int, default=5)
    parser.add_argument("--first-seed", type=int, default=0)
    parser.add_argument("--told", action="store_true")
    parser.add_argument("--without-gyro", action="store_true")
    parser.add_argument("--out", type=Path, default=Path("data/robustness_grid.csv"))
    arguments = parser.parse_args()
    logs = {path.stem: read(path) for path in arguments.logs}
    fields = dict(sigma_v=paper.SIGMA_V) if arguments.told else {}
    if arguments.without_gyro:
        fields["sensors"] = ()
    first = arguments.first_seed
    table = grid(logs, range(first, first + arguments.seeds), **fields)
    cells = lost_cells(table)
    cells.round(4).to_csv(arguments.out)
    for error in TOLERANCE:
        lost = cells[cells[f"{error}, is_lost"]]
        print(f"{error}: lost in {len(lost)} of {len(cells)} cells")
        if len(lost):
            print(lost[[f"{error}, plain", f"{error}, robust"]].to_string())


if __name__ == "__main__":
    _main()
