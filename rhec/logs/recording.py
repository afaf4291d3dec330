"""A recorded log as the estimator's samples: what its columns mean, which of its rows can be used,
and what belongs to each sample.

Columns of a recording, SI units, any rate from 5 Hz: `t_s`; the antenna's position `x_m, y_m`; what
the encoders read at that instant, not corrected for slip, `speed_mps, yaw_rate_radps` or, of the
tracks, `v_left_mps, v_right_mps`. Optional: `segment`, never driven through where it changes;
`pos_ok`, `encoders_ok`, false where a reading is none; the truth `x_true_m, y_true_m, yaw_true_rad,
v_true_mps, yaw_rate_true_radps`, which no estimator sees. Other columns are ignored. A log of
`rhec.simulate`, known by its `x_meas_m`, is read as well: README, "The log".

Faults of sensors and clocks are no errors. A reading that is no finite number of possible size is
missing. A position equal to the one before to the last digit is the old one held, so it is missing,
too. A row whose time is no number, far from its neighbours' or not after all before it is left out.
Where the clock is set back, or is silent for long, a new segment begins.
"""

from pathlib import Path
from typing import NamedTuple

import numpy as np
import pandas as pd

from rhec import paper
from rhec.model.tracked_robot import SPEED_MODELS

MEASUREMENTS = [
    "x_meas_m",
    "y_meas_m",
    "nu_meas_mps",
    "omega_meas_radps",
]  # z, as the log of a run names it
RECORDED = dict(zip(MEASUREMENTS, ("x_m", "y_m", "speed_mps", "yaw_rate_radps")))
TRUTH = dict(
    x_m="x_true_m",
    y_m="y_true_m",
    theta_rad="yaw_true_rad",
    v_true_mps="v_true_mps",
    yaw_rate_true_radps="yaw_rate_true_radps",
)

MAX_PERIOD_S = 0.25  # between rows, by their median: slower logs are refused
POSITION_GAP_S = 0.35  # positions further apart are not interpolated between
ENCODER_GAP_S = 0.65  # nor encoder readings
SEGMENT_GAP_S = 2.0  # after a longer silence a new segment begins
TURNING_RADPS = 0.05  # at a lower yaw rate nothing is said about the track width
# a time so far from the median of its neighbours' is wrong; set back by more, the clock begins a
# new segment
CLOCK_S = 1.0


class Recording(NamedTuple):
    """A log made ready: one row for each row of the log that can be used, and which these are."""

    rows: (
        pd.DataFrame
    )  # segment, t_s, READINGS, and the truth there is, under the names of a run's log
    kept: np.ndarray  # places of these rows in the log
    # encoder readings are means over the time since the row before, not values of an instant
    averaged: bool
    # b as given, else as the tracks' speeds and the yaw rate in the log have it, else the paper's
    # robot's
    track_width_m: float
    faults: dict  # how many rows or readings were left out, and why


def read(file):
    """The log in a .csv or .parquet file, as plain data: nothing in it is run."""
    file = Path(file)
    if file.suffix not in (".csv", ".parquet") or not file.is_file():
        raise ValueError(f"log was {str(file)!r}; it should be an existing .csv or .parquet file")
    try:
        return (
            pd.read_csv(file) if file.suffix == ".csv" else pd.read_parquet(file, engine="pyarrow")
        )
    except (
        ValueError,
        UnicodeError,
        OSError,
    ) as error:  # what both raise for a file that is not what its name says
        raise ValueError(f"log was {str(file)!r}, which cannot be read: {error}") from None


def prepare(log, track_width_m=None):
    """The Recording in a DataFrame. track_width_m [m]: take ν and ω from the tracks' speeds, this
    far apart.
    """
    values, averaged = parse_columns(log, track_width_m)
    faults = dict(rows=len(log))
    for name, limit in zip(MEASUREMENTS, SPEED_MODELS["parameter"].model.limits):
        values.loc[~(values[name].abs() <= limit), name] = np.nan
    place, encoders = MEASUREMENTS[:2], MEASUREMENTS[2:]
    values.loc[values[place].isna().any(axis=1), place] = np.nan
    faults |= dict(
        no_position=int(values[place[0]].isna().sum()),
        no_encoders=int(values[encoders].isna().any(axis=1).sum()),
    )

    kept, segment = usable_times(values["t_s"].to_numpy(), values["segment"].to_numpy())
    rows = values.iloc[kept].assign(segment=segment).reset_index(drop=True)
    held = (rows[place].diff() == 0).all(axis=1) & (rows["segment"].diff() == 0)
    rows.loc[held, place] = np.nan
    faults |= dict(
        unusable_times=len(log) - len(kept),
        positions_held=int(held.sum()),
        segments=int(segment.max()) + 1 if len(kept) else 0,
    )
    if not len(kept):
        raise ValueError(
            "the log had no row whose t_s can be used; t_s should be seconds, rising within each segment"
        )
    period = rows.groupby("segment")["t_s"].diff().median()
    if period > MAX_PERIOD_S:
        raise ValueError(
            f"the log had rows {period:.3g} s apart (median); they should be at most 0.2 s apart, where need be with missing readings"
        )
    return Recording(rows, kept, averaged, track_width_m or recorded_width(log), faults)


def recorded_width(log):
    """Track width b [m] of a log that has both the tracks' speeds and the yaw rate, ω = (ν_r -
    ν_l)/b; else that of the paper's robot.
    """
    if not {"v_left_mps", "v_right_mps", "yaw_rate_radps"} <= set(log.columns):
        return paper.TRACK_WIDTH_M
    apart, omega = (
        numbers(log, "v_right_mps") - numbers(log, "v_left_mps"),
        numbers(log, "yaw_rate_radps"),
    )
    turning = np.abs(omega) > TURNING_RADPS
    width = np.median(apart[turning] / omega[turning]) if turning.any() else np.nan
    return float(width) if width > 0 else paper.TRACK_WIDTH_M


def parse_columns(log, track_width_m):
    """The columns of a log that mean something here, as floats under the names of a run's log, and
    whether encoder readings are means.
    """
    if not isinstance(log, pd.DataFrame) or not len(log):
        raise ValueError(
            f"log was {type(log).__name__}{' without rows' if isinstance(log, pd.DataFrame) else ''}; it should be a DataFrame with rows"
        )
    simulated = "x_meas_m" in log
    if simulated:
        readings, truth = (
            {name: name for name in MEASUREMENTS},
            {name: name for name in ("x_m", "y_m", "theta_rad", "mu", "kappa")},
        )
    else:
        readings, truth = dict(RECORDED), dict(TRUTH)
    if track_width_m is not None:
        readings |= dict(nu_meas_mps="v_left_mps", omega_meas_radps="v_right_mps")
    wanted = dict(t_s="t_s") | readings
    missing = [column for column in wanted.values() if column not in log]
    if missing:
        tracks = (
            " and a track_width_m"
            if {"v_left_mps", "v_right_mps"} <= set(log.columns) and track_width_m is None
            else ""
        )
        raise ValueError(
            f"the log had no column {', '.join(missing)}; it should have {', '.join(wanted.values())}{tracks}"
        )
    values = pd.DataFrame({name: numbers(log, column) for name, column in wanted.items()})
    for name, column in wanted.items():
        if not np.isfinite(values[name]).any():
            raise ValueError(f"the log's column {column} had no number in it")
    if track_width_m is not None:
        left, right = values["nu_meas_mps"], values["omega_meas_radps"]
        values = values.assign(
            nu_meas_mps=(left + right) / 2, omega_meas_radps=(right - left) / track_width_m
        )
    for flag, of in (("pos_ok", MEASUREMENTS[:2]), ("encoders_ok", MEASUREMENTS[2:])):
        if flag in log:
            values.loc[~(numbers(log, flag) > 0), of] = np.nan
    values["segment"] = pd.factorize(log["segment"])[0].astype(float) if "segment" in log else 0.0
    for name, column in truth.items():
        if column in log:
            values[name] = numbers(log, column)
    if simulated and {"mu", "nu_mps", "kappa", "omega_radps"} <= set(log.columns):
        values["v_true_mps"] = values["mu"] * numbers(log, "nu_mps")
        values["yaw_rate_true_radps"] = values["kappa"] * numbers(log, "omega_radps")
    return values, simulated


def numbers(log, column):
    """A column as an array of floats; what is no number becomes NaN."""
    values = log[column]
    if not isinstance(values, pd.Series):
        raise ValueError(f"the log had several columns {column}; it should have one")
    if not (pd.api.types.is_numeric_dtype(values) or pd.api.types.is_bool_dtype(values)):
        values = pd.to_numeric(values.map(str), errors="coerce")  # bytes, too, are no number
    values = values.to_numpy(dtype=float, na_value=np.nan)
    return np.where(np.isfinite(values), values, np.nan)


def usable_times(t_s, segment):
    """Places of the rows whose times can be used, and their segments, numbered from 0."""
    kept = np.flatnonzero(np.isfinite(t_s))
    median = pd.Series(t_s[kept]).rolling(5, center=True, min_periods=1).median().to_numpy()
    kept = kept[np.abs(t_s[kept] - median) <= CLOCK_S]
    step, change = np.diff(t_s[kept], prepend=np.nan), np.diff(segment[kept], prepend=np.nan) != 0
    label = np.cumsum(change | (step > SEGMENT_GAP_S) | (step < -CLOCK_S)) - 1
    latest = (
        pd.Series(t_s[kept])
        .groupby(label)
        .cummax()
        .groupby(label)
        .shift(fill_value=-np.inf)
        .to_numpy()
    )
    rising = t_s[kept] > latest
    return kept[rising], label[rising]


def samples(rows, dt_s, averaged):
    """One segment's rows as samples every dt_s from its first row: t_s, READINGS and truth.

    Position and true pose are those at the sample's time. Encoder readings and true speeds are
    means over the interval that ends there, which is what the model's inputs are.
    """
    t = rows["t_s"].to_numpy()
    at = t[0] + dt_s * np.arange(int((t[-1] - t[0]) / dt_s + 0.01) + 1)
    result = dict(t_s=at)
    for name in rows.columns.drop(["segment", "t_s"]):
        value = rows[name].to_numpy()
        if name in ("nu_meas_mps", "omega_meas_radps", "v_true_mps", "yaw_rate_true_radps"):
            result[name] = means_between(
                np.concatenate([[at[0] - dt_s], at]), t, value, averaged and name in MEASUREMENTS
            )
        else:
            result[name] = values_at(at, t, unwrapped(value) if name == "theta_rad" else value)
    return pd.DataFrame(result)


def unwrapped(angle):
    """An angle without jumps of 2π; gaps stay gaps."""
    angle, known = angle.copy(), np.isfinite(angle)
    angle[known] = np.unwrap(angle[known])
    return angle


def values_at(at, t, value):
    """The value at these times: the reading of that time, else between two readings that are close."""
    known = np.isfinite(value)
    if not known.any():
        return np.full(len(at), np.nan)
    t, value = t[known], value[known]
    after = np.clip(np.searchsorted(t, at), 0, len(t) - 1)
    before = np.maximum(after - 1, 0)
    near = np.where(np.abs(t[after] - at) < np.abs(t[before] - at), after, before)
    inside = (t[before] <= at) & (at <= t[after]) & (t[after] - t[before] <= POSITION_GAP_S)
    return np.where(
        np.abs(t[near] - at) < 1e-3, value[near], np.where(inside, np.interp(at, t, value), np.nan)
    )


def means_between(edges, t, value, averaged):
    """Mean of a reading between each two of the edges, where at least half of that time is known;
    between instants it changes linearly.

    The first reading counts for the interval before it.
    """
    if not averaged:
        known = np.isfinite(value)
        t, value = t[known], value[known]
    if not len(t):
        return np.full(len(edges) - 1, np.nan)
    mean = value[1:] if averaged else (value[1:] + value[:-1]) / 2
    start, mean = (
        np.concatenate([[t[0] - (edges[1] - edges[0])], t]),
        np.concatenate([value[:1], mean]),
    )
    length = np.diff(start)
    known = np.isfinite(mean) & (length <= ENCODER_GAP_S)
    covered = np.interp(edges, start, np.concatenate([[0], np.cumsum(length * known)]))
    total = np.interp(
        edges, start, np.concatenate([[0], np.cumsum(np.where(known, mean, 0) * length)])
    )
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.where(
            np.diff(covered) >= 0.5 * np.diff(edges), np.diff(total) / np.diff(covered), np.nan
        )
