"""Recordings: parse the columns of a log, leave out rows and measurements that cannot be used,
resample the rest at the estimator's rate.

`help(rhec.replay)` lists the columns. Faults of sensors and clocks are no errors. A measurement
that is no finite number of plausible size is missing. A position equal to the one before to the
last digit is an old one held, so it is missing, too. A row is left out where its time is no number,
is far from those of the rows before it or is not later than all of them. Where the clock is set
back, or the log is silent for ten minutes, a new segment begins.
"""

from typing import NamedTuple

import numpy as np
import pandas as pd

from rhec import paper
from rhec.simulation.columns import (
    MEASUREMENTS,
    POSE,
    RECORDED,
    RECORDED_TRUTH,
    TRACKS,
    TRUE_SPEEDS,
)
from rhec.tracked_robot.kinematics import SPEED_MODELS

__all__ = ["MAX_PERIOD", "SECONDS", "Recording", "measured_since", "prepare", "prepare_for"]
__all__ += ["resample", "time_unit"]

_POSITION = MEASUREMENTS[:2]
_ENCODERS = MEASUREMENTS[2:]
_TURNING_RADPS = 0.05  # at a lower yaw rate nothing is said about the track width
# In samples of the estimator:
MAX_PERIOD = 1.25  # between rows, by their median: slower logs are refused
_TRUTH_GAP = 1.75  # true poses further apart are not interpolated between
_ENCODER_GAP = 3.25  # nor encoder measurements, and none is held for longer
_HELD = 15.0  # a longer silence ends with a robot that is taken to stand,
_SEGMENT_GAP = 3000.0  # and a longer one still with a new segment
# times, of a log in order; rows of a segment, on average
_MOST_FALLING = 0.05
_LEAST_ROWS = 5
SECONDS = dict(s=1.0, ms=1e-3, us=1e-6, ns=1e-9)
_SHORTEST_S = 0.004
# A time further from the median of it and the two before is wrong; a clock that is set back by more
# begins a new segment.
_CLOCK = 5.0
_SAME_S = 1e-3  # times this close are the same


class Recording(NamedTuple):
    """A log made ready.

    rows           one for each row of the log that can be used: segment, t_s, measurements and,
                   under the names of a run's log, the truth that is known
    kept           (rows,) their places in the log
    averaged       whether encoder measurements are means over the time since the row before, not
                   values of an instant
    track_width_m  as given, else by the log's track speeds and yaw rate, else the paper's
    faults         how many rows or measurements were left out, by reason
    columns        what the log calls a column of `rows`
    """

    rows: pd.DataFrame
    kept: np.ndarray
    averaged: bool
    track_width_m: float
    faults: dict
    columns: dict


def prepare(log, track_width_m=None, position_delay_s=0.0):
    """The Recording in a DataFrame. track_width_m [m]: take ν and ω from the tracks' speeds, this
    far apart; position_delay_s [s]: how late positions come, a row holds those that come then.
    """
    values, columns, averaged = _parse_columns(log, track_width_m)
    _drop_implausible(
        values, columns, dict(zip(MEASUREMENTS, SPEED_MODELS["parameter"].model.limits))
    )
    values.loc[values[_POSITION].isna().any(axis=1), _POSITION] = np.nan
    rows, kept = _usable_rows(values, paper.DT_S)
    again = (rows[_POSITION].ffill().diff() == 0).all(axis=1) & rows[_POSITION[0]].notna()
    held = again & (rows["segment"].diff() == 0)
    rows.loc[held, _POSITION] = np.nan
    if position_delay_s:
        rows[_POSITION] = rows.groupby("segment", group_keys=False)[["t_s", *_POSITION]].apply(
            _moved_earlier, position_delay_s
        )
    faults = dict(
        rows=len(log),
        no_position=int(values[_POSITION[0]].isna().sum()),
        no_encoders=int(values[_ENCODERS].isna().any(axis=1).sum()),
        unusable_times=len(log) - len(kept),
        positions_held=int(held.sum()),
        segments=int(rows["segment"].max()) + 1,
    )
    width_m = track_width_m or _recorded_width(log)
    return Recording(rows, kept, averaged, width_m, faults, columns)


def _moved_earlier(late, delay_s):
    """Positions that come delay_s late, each in the row nearest to when it was measured."""
    t = late["t_s"].to_numpy()
    known = late[_POSITION[0]].notna().to_numpy()
    row = np.interp(t[known] - delay_s, t, np.arange(len(t)), -1, -1)
    earlier = late[_POSITION] * np.nan
    earlier.iloc[np.rint(row[row >= 0]).astype(int)] = late[_POSITION][known][row >= 0]
    return earlier


def prepare_for(model, dt_s, log):
    """The Recording in a DataFrame with a column for each of a Model's outputs; those that measure
    inputs are means since the row before.
    """
    columns = {name: name for name in model.outputs}
    values = _columns(log, columns)
    _drop_implausible(values, columns, dict(zip(columns, model.limits)))
    rows, kept = _usable_rows(values, dt_s)
    faults = dict(rows=len(log), unusable_times=len(log) - len(kept))
    return Recording(rows, kept, True, np.nan, faults, columns)


def _drop_implausible(values, columns, limits):
    """Make missing what is above its limit, unless most of a column is."""
    for name, limit in limits.items():
        size = values[name].abs()
        if (size > limit).sum() > size.notna().sum() / 2 > _LEAST_ROWS:
            raise ValueError(
                f"the log's {columns[name]} is {size.median():.3g} (median); it may be in another "
                f"unit and should be at most {limit:g}"
            )
        values.loc[~(size <= limit), name] = np.nan


def time_unit(t, max_period_s):
    """The unit of the times t in which rows are 4 ms to max_period_s apart, None if there is none,
    and how far apart they are (median).
    """
    step = np.abs(np.diff(t[np.isfinite(t)]))
    period = np.median(step[step > 0]) if (step > 0).any() else np.nan
    fits = [unit for unit, s in SECONDS.items() if _SHORTEST_S <= period * s <= max_period_s]
    return (*fits, None)[0], period


def _refuse_times(values, dt_s):
    """Say in a sentence that times are not in order, not in seconds, or segments not what they are
    called.
    """
    rows = len(values)
    segments = values["segment"].nunique()
    falling = int((values.groupby("segment")["t_s"].diff() < 0).sum())
    unit, period = time_unit(values["t_s"].to_numpy(), MAX_PERIOD * dt_s)
    if falling > max(2, _MOST_FALLING * rows):
        order = "in reverse" if falling > 0.9 * (rows - 1) else "unsorted"
        raise ValueError(
            f"the log's t_s falls {falling} times in {rows} rows; it may be {order} and should "
            "rise in each segment"
        )
    if segments * _LEAST_ROWS > rows > 2 * _LEAST_ROWS:
        raise ValueError(
            f"the log's segment has {segments} values in {rows} rows; it should be the same in all "
            "rows of a drive"
        )
    if period > MAX_PERIOD * dt_s:
        may = f"t_s may be in {unit}, or the" if unit else "the"
        raise ValueError(
            f"the log had rows {period:.3g} s apart (median); {may}y should be at most {dt_s:g} s "
            "apart, where need be with missing measurements"
        )


def _usable_rows(values, dt_s):
    """The rows whose times can be used, with their segments numbered from 0, and their places."""
    _refuse_times(values, dt_s)
    kept, segment = _usable_times(values["t_s"].to_numpy(), values["segment"].to_numpy(), dt_s)
    if not len(kept):
        raise ValueError(
            "the log had no row whose t_s can be used; t_s should be seconds, rising within each "
            "segment"
        )
    return values.iloc[kept].assign(segment=segment).reset_index(drop=True), kept


def _recorded_width(log):
    """Track width b [m], median of (ν_r - ν_l)/ω where the log has all three and turns, else
    the paper's.
    """
    if not {*TRACKS, RECORDED["omega_meas_radps"]} <= set(log.columns):
        return paper.TRACK_WIDTH_M
    left, right, omega = (_numbers(log, name) for name in (*TRACKS, RECORDED["omega_meas_radps"]))
    turning = np.abs(omega) > _TURNING_RADPS
    width = np.median((right - left)[turning] / omega[turning]) if turning.any() else np.nan
    return float(width) if width > 0 else paper.TRACK_WIDTH_M


def _parse_columns(log, track_width_m):
    """The log's known columns as floats under the names of a run's log, what the log calls them,
    and whether encoder measurements are means.
    """
    simulated = isinstance(log, pd.DataFrame) and MEASUREMENTS[0] in log
    measured = RECORDED
    truth = RECORDED_TRUTH
    if simulated:
        measured = {name: name for name in MEASUREMENTS}
        truth = {name: name for name in (*POSE, "mu", "kappa")}
    if track_width_m is not None:
        measured = measured | dict(zip(_ENCODERS, TRACKS))
    values = _columns(log, measured)
    if track_width_m is not None:
        left, right = (values[name] for name in _ENCODERS)
        values = values.assign(
            nu_meas_mps=(left + right) / 2, omega_meas_radps=(right - left) / track_width_m
        )
        measured |= dict.fromkeys(_ENCODERS, ", ".join(TRACKS))
    for flag, flagged in (("pos_ok", _POSITION), ("encoders_ok", _ENCODERS)):
        if flag in log:
            values.loc[~(_numbers(log, flag) > 0), flagged] = np.nan
    for name, column in truth.items():
        if column in log:
            values[name] = _numbers(log, column)
    if simulated and {"mu", "nu_mps", "kappa", "omega_radps"} <= set(log.columns):
        values["v_true_mps"] = values["mu"] * _numbers(log, "nu_mps")
        values["yaw_rate_true_radps"] = values["kappa"] * _numbers(log, "omega_radps")
    return values, truth | measured, simulated


def _columns(log, measured):
    """Columns of a log as floats: t_s, those of `measured` {name: column}, segment."""
    if not isinstance(log, pd.DataFrame) or not len(log):
        empty = " without rows" if isinstance(log, pd.DataFrame) else ""
        raise ValueError(f"log was {type(log).__name__}{empty}; it should be a DataFrame with rows")
    wanted = dict(t_s="t_s") | measured
    missing = [column for column in wanted.values() if column not in log]
    if missing:
        by_tracks = measured is RECORDED and set(TRACKS) <= set(log.columns)
        raise ValueError(
            f"the log had no column {', '.join(missing)}; it should have "
            f"{', '.join(wanted.values())}"
            + f", or give a track_width_m for {', '.join(TRACKS)}"
            * by_tracks
        )
    values = pd.DataFrame({name: _numbers(log, column) for name, column in wanted.items()})
    for name, column in wanted.items():
        if not np.isfinite(values[name]).any():
            raise ValueError(f"the log's column {column} had no number in it")
    segment = pd.factorize(log["segment"])[0].astype(float) if "segment" in log else 0.0
    return values.assign(segment=segment)


def _numbers(log, column):
    """A column as an array of floats; an entry that is no number becomes NaN."""
    values = log[column]
    if not isinstance(values, pd.Series):
        raise ValueError(f"the log had several columns {column}; it should have one")
    if not (pd.api.types.is_numeric_dtype(values) or pd.api.types.is_bool_dtype(values)):
        values = pd.to_numeric(values.map(str), errors="coerce")  # bytes, too, are no number
    values = values.to_numpy(dtype=float, na_value=np.nan)
    return np.where(np.isfinite(values), values, np.nan)


def _usable_times(t_s, segment, dt_s):
    """Places of the rows whose times can be used, and their segments, numbered from 0."""
    kept = np.flatnonzero(np.isfinite(t_s))
    stamps = pd.Series(t_s[kept]).groupby(segment[kept])
    usual = stamps.transform(lambda t: t.rolling(3, min_periods=1).median()).to_numpy()
    kept = kept[np.abs(t_s[kept] - usual) <= _CLOCK * dt_s]
    step = np.diff(t_s[kept], prepend=np.nan)
    change = np.diff(segment[kept], prepend=np.nan) != 0
    label = np.cumsum(change | (step > _SEGMENT_GAP * dt_s) | (step < -_CLOCK * dt_s)) - 1
    latest = pd.Series(t_s[kept]).groupby(label).cummax()
    rising = t_s[kept] > latest.groupby(label).shift(fill_value=-np.inf).to_numpy()
    return kept[rising], label[rising]


def resample(rows, dt_s, averaged, measured=MEASUREMENTS, means=_ENCODERS):
    """One segment's rows as samples about dt_s [s] apart, from its first row on: t_s, measurements,
    truth. No measurement in a sample was read after it.

    Of the `measured` columns those in `means` are means over the interval that ends at the sample,
    as a model's inputs are, and true speeds are, too. The others are the newest since the sample
    before, and how old each is stands beside it, under its name and `_age_s`. A true pose is
    that at the sample's time.
    """
    t = rows["t_s"].to_numpy()
    grid = t[0] + dt_s * np.arange(int((t[-1] - t[0] + _SAME_S) / dt_s) + 1)
    # A sample is at a row where there is one that close.
    row = t[np.minimum(np.searchsorted(t, grid - _SAME_S), len(t) - 1)]
    at = np.where(np.abs(row - grid) <= _SAME_S, row, grid)
    before = np.append(at[0] - dt_s, at[:-1])
    result = dict(t_s=at)
    for name in rows.columns.drop(["segment", "t_s"]):
        value = rows[name].to_numpy()
        if name in (*means, *TRUE_SPEEDS):
            of_rows = averaged and name in means
            result[name] = _means_since(before, at, t, value, of_rows, _ENCODER_GAP * dt_s)
        elif name in measured:
            result[name], result[f"{name}_age_s"] = _newest_since(before, at, t, value)
        else:
            value = _unwrapped(value) if name == "theta_rad" else value
            result[name] = _truth_at(at, t, value, _TRUTH_GAP * dt_s)
    silent = at - t[np.searchsorted(t, at, side="right") - 1] > _HELD * dt_s
    begins = np.diff(silent, prepend=False) & silent
    for name in _ENCODERS if begins.any() else ():
        result[name][begins] = 0.0  # at which a missing input is held from then on
    return pd.DataFrame(result)


def measured_since(rows, begin_s, dt_s, averaged, means=_ENCODERS):
    """Means of measurements from the times begin_s [s] to each row's own, as a DataFrame."""
    t = rows["t_s"].to_numpy()
    gap_s = _ENCODER_GAP * dt_s
    columns = {name: rows[name].to_numpy() for name in means}
    return pd.DataFrame(
        {name: _means_since(begin_s, t, t, v, averaged, gap_s) for name, v in columns.items()}
    )


def _unwrapped(angle):
    """An angle without jumps of 2π; gaps stay gaps."""
    angle, known = angle.copy(), np.isfinite(angle)
    angle[known] = np.unwrap(angle[known])
    return angle


def _truth_at(at, t, value, gap_s):
    """The value at these times, between two that are close linear."""
    known = np.isfinite(value)
    if not known.any():
        return np.full(len(at), np.nan)
    t = t[known]
    value = value[known]
    after = np.clip(np.searchsorted(t, at), 0, len(t) - 1)
    before = np.maximum(after - 1, 0)
    inside = (t[before] <= at) & (at <= t[after]) & (t[after] - t[before] <= gap_s)
    return np.where(inside | (t[after] == at), np.interp(at, t, value), np.nan)


def _newest_since(begin, end, t, value):
    """The newest measurement in each (begin, end] and its age at the end, NaN where none is new."""
    known = np.isfinite(value)
    t = np.append(-np.inf, t[known])
    value = np.append(np.nan, value[known])
    newest = np.searchsorted(t, end, side="right") - 1
    new = t[newest] > begin
    return np.where(new, value[newest], np.nan), np.where(new, end - t[newest], np.nan)


def _means_since(begin, end, t, value, averaged, gap_s):
    """Mean of a measurement over each (begin, end] as it is known at the end, NaN where less than
    half of that time is: between instants linear, after the newest held, no longer than gap_s.

    The first counts for the interval before it.
    """
    if not averaged:
        known = np.isfinite(value)
        t = t[known]
        value = value[known]
    if not len(t):
        return np.full(len(end), np.nan)
    start = np.append(min(begin[0], t[0]), t)
    mean = np.append(value[:1], value[1:] if averaged else (value[1:] + value[:-1]) / 2)
    length = np.diff(start)
    read = np.searchsorted(t, end, side="right")
    known = np.isfinite(mean) & (length <= gap_s)
    newest = np.append(np.nan, value)[read]
    since = start[read]
    held = np.isfinite(newest) & (end - since <= gap_s)

    def integral(rate, now):
        total = np.append(0, np.cumsum(rate * length))
        driven = total[read] - np.interp(np.minimum(begin, since), start, total)
        return driven + now * (end - np.maximum(begin, since))

    covered = integral(known, held)
    total = integral(np.where(known, mean, 0), np.where(held, newest, 0))
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.where(covered >= 0.5 * (end - begin), total / covered, np.nan)
