"""Recordings: parse the columns of a log, drop unusable rows, and resample the others.

`help(rhec.replay)` lists the columns. Faults of sensors and clocks do not raise errors:

- A measurement counts as missing if it is not a finite number of plausible size.
- A value of an encoder that is far from both its neighbours is a counter that rolled over or a bit
  that was lost, and counts as missing; so does a position 100 m away from those about it.
- A position that equals the previous one to the last digit is a repeated one and counts as missing.
- A row is dropped if its time is not a number, is far from the times of the rows before it, or is
  not later than all of them.
- A new segment begins where the clock is set back, after ten minutes without rows, or where the
  positions jump by a kilometre and stay there, as in another zone of UTM.
"""

import dataclasses
import functools

import numpy as np
import pandas as pd

from rhec import paper
from rhec.core._casadi.validation import shown
from rhec.logs.column_names import DECLARED, missing_columns
from rhec.logs.finding import passed
from rhec.logs.motion import MOVING, period_s
from rhec.logs.position_noise import position_sigma_m
from rhec.simulation.columns import (
    MEANS,
    MEASUREMENTS,
    POSE,
    RECORDED,
    RECORDED_SENSORS,
    RECORDED_TRUTH,
    SENSORS,
    TRACKS,
    TRUE_SPEEDS,
)
from rhec.tracked_robot import sensors
from rhec.tracked_robot.kinematics import SPEED_MODELS

_POSITION = MEASUREMENTS[:2]
_ENCODERS = MEASUREMENTS[2:]
# How old the position of a row is [s], in recordings with a delay that is made up for.
POSITION_AGE = "position_age_s"
_FLAGS = {"pos_ok": _POSITION, "encoders_ok": _ENCODERS}  # these are missing where it is false
# Times in sampling periods of the estimator:
MAX_PERIOD = 1.25  # largest median period of a log; slower logs are refused
_TRUTH_GAP = 1.75  # longer gaps between true poses are not interpolated
_ENCODER_GAP = 3.25  # largest gap of encoder measurements that is interpolated or held
_OWN_PERIODS = 1.75  # in periods of an input that is measured less often: the same gap
_STANDING_GAP = 15.0  # after a longer gap the robot is assumed to stand
_SEGMENT_GAP = 3000.0  # after a longer gap a new segment begins
# A time is wrong if it differs by more from the median of itself and the two times before it. A
# clock that is set back by more begins a new segment.
_CLOCK = 5.0
_MOST_FALLING = 0.05  # largest share of falling times in a log that counts as sorted
_LEAST_ROWS = 5  # of a segment, on average
_LEAST_USABLE = 0.1  # share of the rows with a usable time of their own: fewer are no recording
SECONDS = dict(s=1.0, ms=1e-3, us=1e-6, ns=1e-9)  # units of time
_SPIKE = 1.0  # of an encoder, above and below both neighbours [m/s, rad/s]
_FAR_M = 1000.0  # between positions, which no robot drives
_ASTRAY_M = 100.0  # from the positions about it, where a single one is none
_ABOUT = 5  # positions by whose median it is judged
_SHORTEST_S = 0.004  # shortest median period of a log
_SAME_S = 1e-3  # times that differ by less are equal


@dataclasses.dataclass(frozen=True, eq=False)
class Recording:
    """A log that is ready to be resampled."""

    rows: pd.DataFrame  # its usable rows: segment, t_s, measurements, truth, named as in a run
    places: np.ndarray  # (rows,) their positions in the log
    averaged: bool  # whether encoder measurements are means since the previous row
    track_width_m: float
    width_source: str  # of the track width, as part of a sentence
    faults: dict  # {reason: number of unusable rows or measurements}
    columns: dict  # {column of `rows`: column of the log}
    dt_s: float = paper.DT_S  # length of a sample
    # A sample has the newest measurement of these, and of `means` the mean over its interval.
    measured: tuple = (*MEASUREMENTS, *SENSORS.values())
    means: tuple = tuple(MEANS)
    delays_s: dict = dataclasses.field(default_factory=dict)  # {column: of its time stamps [s]}
    # Of a Model's log {mean: longest time over which a measurement is held or interpolated [s]}.
    gaps_s: dict | None = None

    @property
    def sensors(self):
        """The sensors besides GNSS and encoders, names of `columns.SENSORS`."""
        return tuple(name for name, column in SENSORS.items() if column in self.rows)

    @functools.cached_property
    def noise_m(self):
        """Standard deviation of the white noise of the robot's positions [m]."""
        return position_sigma_m(self.rows)

    def with_rows(self, rows):
        """The Recording with other rows."""
        return dataclasses.replace(self, rows=rows)

    def samples(self):
        """The samples, a DataFrame for each segment, as of `resample`."""
        parts = []
        for segment, rows in self.rows.groupby("segment"):
            part = resample(rows, self)
            part.insert(0, "segment", segment)
            parts.append(part)
        return parts


def prepare(log, track_width_m=None):
    """The Recording of a log of the paper's robot.

    Args:
        log: DataFrame, as `rhec.replay` takes it.
        track_width_m: Compute ν and ω from the speeds of tracks this far apart [m].

    Returns:
        Recording.

    Raises:
        ValueError: If the log lacks columns, numbers or times that a replay needs.
    """
    is_simulated = isinstance(log, pd.DataFrame) and MEASUREMENTS[0] in log
    values, columns = _parse_robot(log, is_simulated, track_width_m)
    n_positions = _has_position(values).sum()
    _leave_out_flagged(values, log)
    flagged = int(n_positions - _has_position(values).sum())
    limits = dict(zip(MEASUREMENTS, SPEED_MODELS["parameter"].model.limits))
    limits |= {sensor.column: sensor.limit for sensor in sensors.SENSORS.values()}
    present = {name: limit for name, limit in limits.items() if name in values}
    left_out = _drop_implausible(values, columns, present)
    for name in _ENCODERS:
        left_out[name] += _drop_spikes(values, name)
    # A position with one coordinate is missing.
    values.loc[~_has_position(values), _POSITION] = np.nan
    values, places, n_repeated = _joined(values)
    rows, usable = _usable_rows(values, len(log), paper.DT_S)
    left_out[_POSITION[0]], jumps_m = _split_at_jumps(rows)
    is_repeated = (rows[_POSITION].ffill().diff() == 0).all(axis=1) & rows[_POSITION[0]].notna()
    is_held = is_repeated & (rows["segment"].diff() == 0)
    rows.loc[is_held, _POSITION] = np.nan
    faults = dict(
        rows=len(log),
        unusable_times=len(values) - len(rows) + n_repeated,
        positions_held=int(is_held.sum()),
        positions_flagged=flagged,
        clock_back_s=_set_back_s(values),
        segments=int(rows["segment"].max()) + 1,
        left_out={columns[name]: n for name, n in left_out.items() if n},
        jumps_m=jumps_m,
    )
    width = (track_width_m, "as given") if track_width_m else _recorded_width(log)
    return Recording(rows, places[usable], is_simulated, *width, faults, columns)


def delayed(recording, position_delay_s):
    """The Recording of the paper's robot with positions at the times at which they were measured.

    Args:
        recording: The Recording, with positions at their time stamps.
        position_delay_s: Delay of these [s].
    """
    if not position_delay_s:
        return recording
    rows = recording.rows.copy()
    positions = rows.groupby("segment", group_keys=False)[["t_s", *_POSITION]]
    rows[[*_POSITION, POSITION_AGE]] = positions.apply(_shift_positions, position_delay_s)
    return recording.with_rows(rows)


def prepare_for(model, dt_s, log, delays_s=None):
    """The Recording of a log of a Model, with a column for each output; inputs are means.

    Args:
        model: The rhec.Model.
        dt_s: Length of a sample [s].
        log: DataFrame, as `rhec.replay` takes it.
        delays_s: {output: delay of its time stamps [s]}.

    Raises:
        ValueError: If the log lacks columns, numbers or times, or if a delay is of no output.
    """
    if model.known:
        expected = "a recorded log has none; there they should be outputs of the Model"
        raise ValueError(f"the Model has the known signals {model.known}; {expected}")
    delays_s = delays_s or {}
    unknown = [name for name in delays_s if name not in model.outputs]
    if unknown:
        raise ValueError(
            f"delays_s named {unknown[0]!r}; the model has the outputs {', '.join(model.outputs)}"
        )
    columns = {name: name for name in model.outputs}
    values = _parse(log, columns)
    _drop_implausible(values, columns, dict(zip(columns, model.limits)))
    values, places, n_repeated = _joined(values)
    rows, usable = _usable_rows(values, len(log), dt_s)
    faults = dict(rows=len(log), unusable_times=len(values) - len(rows) + n_repeated)
    inputs = [model.outputs[row] for row in model.input_outputs.values()]
    gaps_s = {
        name: max(_ENCODER_GAP * dt_s, _OWN_PERIODS * period_s(rows, name)) for name in inputs
    }
    return Recording(
        rows=rows,
        places=places[usable],
        averaged=True,
        track_width_m=np.nan,
        width_source="",
        faults=faults,
        columns=columns,
        dt_s=dt_s,
        measured=model.outputs,
        means=tuple(inputs),
        delays_s=delays_s,
        gaps_s=gaps_s,
    )


# Columns


def _parse_robot(log, is_simulated, track_width_m):
    """`_parse` of a log of the paper's robot, and {name: column of the log}."""
    measured = RECORDED
    truth = RECORDED_TRUTH
    sensors = RECORDED_SENSORS
    if is_simulated:
        measured = {name: name for name in MEASUREMENTS}
        truth = {name: name for name in (*POSE, "mu", "kappa")}
        sensors = {name: name for name in RECORDED_SENSORS}
    if track_width_m is not None:
        measured = measured | dict(zip(_ENCODERS, TRACKS))
    values = _parse(log, measured, truth | sensors | {DECLARED: DECLARED})
    # A sensor that never measures anything is none.
    silent = [name for name in sensors if name in values and values[name].isna().all()]
    values = values.drop(columns=silent)
    if track_width_m is not None:
        left = values[_ENCODERS[0]]
        right = values[_ENCODERS[1]]
        values = values.assign(
            nu_meas_mps=(left + right) / 2, omega_meas_radps=(right - left) / track_width_m
        )
        measured = measured | dict.fromkeys(_ENCODERS, ", ".join(TRACKS))
    if is_simulated and {"mu", "nu_mps", "kappa", "omega_radps"} <= set(log.columns):
        # Speed and yaw rate over ground are μ ν and κ ω.
        values["v_true_mps"] = values["mu"] * _numbers(log, "nu_mps")
        values["yaw_rate_true_radps"] = values["kappa"] * _numbers(log, "omega_radps")
    return values, truth | sensors | measured


def _has_position(values):
    return np.isfinite(values[_POSITION].to_numpy()).all(axis=1)


def _leave_out_flagged(values, log):
    """Set measurements to NaN in rows of a log in which their column of _FLAGS is false."""
    for flag, flagged in _FLAGS.items():
        if flag not in log:
            continue
        numbers = _numbers(log, flag)
        words = dict.fromkeys(word for word in log[flag] if isinstance(word, str))
        if words and not np.isfinite(numbers).any():
            named = ", ".join(map(repr, [*words][:3]))
            raise ValueError(
                f"the log's {flag} had the words {named}; it should be 1 where the measurement "
                "counts, else 0"
            )
        values.loc[~(numbers > 0), flagged] = np.nan


def _joined(values):
    """Join the rows of one time, as sensors that are logged in rows of their own make them.

    Returns:
        The rows, with the first number of each column, their places in the log, and the number of
        rows in which a sensor measured again at the same time.
    """
    times = values[["segment", "t_s"]]
    begins = ~(times.diff() == 0).all(axis=1)
    if begins.all():
        return values, np.arange(len(values)), 0
    run = begins.cumsum()
    repeats = (values.drop(columns=[*times]).groupby(run).count() > 1).any(axis=1)
    n_repeated = int((~begins & run.map(repeats)).sum())
    return values.groupby(run).first(), np.flatnonzero(begins), n_repeated


def _set_back_s(values):
    """By how much the clock is set back at most within a segment of the log [s], or 0."""
    stamped = values[values["t_s"].notna()]
    back_s = -stamped.groupby("segment")["t_s"].diff().min()
    return float(back_s) if back_s > _CLOCK * paper.DT_S else 0.0


def _parse(log, measured, optional=None):
    """Columns of a log as floats: t_s, the measurements, segment, and the optional columns present.

    Args:
        log: DataFrame.
        measured: {name: column} of required columns.
        optional: {name: column} of optional columns.
    """
    if not isinstance(log, pd.DataFrame) or not len(log):
        empty = " without rows" if isinstance(log, pd.DataFrame) else ""
        raise ValueError(f"log was {type(log).__name__}{empty}; it should be a DataFrame with rows")
    required = dict(t_s="t_s") | measured
    message = missing_columns(log, required)
    if message:
        raise ValueError(message)
    values = pd.DataFrame({name: _numbers(log, column) for name, column in required.items()})
    for name, column in required.items():
        if not np.isfinite(values[name]).any():
            words = [f", but {shown(str(word))}" for word in log[column].dropna()[:1]]
            may_be = "; it should be in seconds, or ISO 8601" if name == "t_s" else ""
            told = "".join([*words, may_be])
            raise ValueError(f"the log's column {column} had no number in it{told}")
    values = values.assign(segment=_segments(log))
    for name, column in (optional or {}).items():
        if column in log:
            values[name] = _numbers(log, column)
    return values


def _segments(log):
    """The segments, numbered in the order in which they come; 0 without such a column."""
    if "segment" not in log:
        return 0.0
    try:
        return pd.factorize(log["segment"])[0].astype(float)
    except (TypeError, ValueError):  # lists, or several columns of this name
        raise ValueError("the log's segment should be one column of numbers or words") from None


def _numbers(log, column):
    """A column as an array of floats; entries that are not finite numbers become NaN."""
    values = log[column]
    if not isinstance(values, pd.Series):
        raise ValueError(f"the log had several columns {column}; it should have one")
    is_complex = pd.api.types.is_complex_dtype(values)
    is_real = pd.api.types.is_numeric_dtype(values) and not is_complex
    if not (is_real or pd.api.types.is_bool_dtype(values)):
        values = pd.to_numeric(values.map(str), errors="coerce")  # str() turns bytes into NaN
    values = values.to_numpy(dtype=float, na_value=np.nan)
    return np.where(np.isfinite(values), values, np.nan)


def _recorded_width(log):
    """Track width b [m] where none is given, the median of (ν_r - ν_l)/ω, and its source."""
    yaw_rate = RECORDED["omega_meas_radps"]
    if {*TRACKS, yaw_rate} <= set(log.columns):
        left, right, omega = (_numbers(log, name) for name in (*TRACKS, yaw_rate))
        widths = pd.Series(right - left) / omega
        width_m = float(widths[np.abs(omega) > MOVING].median())
        if width_m > 0:
            return width_m, f"by the log's {', '.join(TRACKS)} and {yaw_rate}"
    unknown = f"the paper's, because neither {passed('track_width_m')} nor track speeds tell it"
    return paper.TRACK_WIDTH_M, unknown


def _drop_implausible(values, columns, limits):
    """Set measurements above their limit to NaN; refuse a column if most of it is above.

    Returns:
        {name: how many}.
    """
    dropped = {}
    for name, limit in limits.items():
        size = values[name].abs()
        if (size > limit).sum() > size.notna().sum() / 2 > _LEAST_ROWS:
            raise ValueError(
                f"the log's {columns[name]} is {size.median():.3g} (median); it may be in another "
                f"unit and should be at most {limit:g}"
            )
        dropped[name] = int((size > limit).sum())
        values[name] = values[name].where(size <= limit)
    return dropped


def _drop_spikes(values, name):
    """Set single values far from both neighbours to NaN, and return how many there are.

    A row may so depend on the next one, and on none after it.
    """
    segments, numbers = (values[each].to_numpy() for each in ("segment", name))
    there = np.flatnonzero(np.isfinite(numbers))
    there = there[np.argsort(segments[there], kind="stable")]
    is_next = np.diff(segments[there], prepend=np.nan) == 0
    before = np.where(is_next, np.diff(numbers[there], prepend=np.nan), np.nan)
    after = -np.append(before[1:], before[:1])  # nothing is before the first, nor after the last
    is_spike = (before * after > 0) & (np.minimum(np.abs(before), np.abs(after)) > _SPIKE)
    values.loc[values.index[there[is_spike]], name] = np.nan
    return int(is_spike.sum())


def _split_at_jumps(rows):
    """Begin new segments where the positions jump by more than _FAR_M, in place.

    Single positions away from those about them are set to NaN.

    Returns:
        How many are, and by how much the positions jump [m], a list.
    """
    there = rows.loc[rows[_POSITION[0]].notna(), ["segment", *_POSITION]]
    # The positions that are compared are at most _ABOUT - 1 steps apart: where all steps are this
    # short none can be astray, and none is a jump.
    longest_step_m = np.abs(np.diff(there[_POSITION].to_numpy(), axis=0)).max(initial=0.0)
    if longest_step_m <= _ASTRAY_M / (_ABOUT - 1):
        return 0, []
    about = there.groupby("segment")[_POSITION].transform(
        lambda place: place.rolling(_ABOUT, center=True, min_periods=1).median()
    )
    is_astray = (there[_POSITION] - about).abs().max(axis=1) > _ASTRAY_M
    rows.loc[is_astray.index[is_astray], _POSITION] = np.nan
    there = there[~is_astray]
    step_m = there.groupby("segment")[_POSITION].diff().abs().max(axis=1)
    begins = step_m[step_m > _FAR_M]
    new = rows["segment"].diff().fillna(0.0) != 0
    new |= rows.index.isin(begins.index)
    rows["segment"] = new.cumsum()
    return int(is_astray.sum()), begins.tolist()


def _shift_positions(rows, delay_s):
    """The positions of a segment and their ages [s], measured delay_s before their time stamps.

    Each one moves to the first row that is not before its time. Its age there is at most the
    distance of two rows. Of several positions in one row the newest one stays.
    """
    t = rows["t_s"].to_numpy()
    has_position = rows[_POSITION[0]].notna().to_numpy()
    measured_s = t[has_position] - delay_s
    row = np.searchsorted(t, measured_s - _SAME_S)
    is_inside = (row < len(t)) & (measured_s >= t[0] - _SAME_S)
    age_s = t[row[is_inside]] - measured_s[is_inside]
    earlier = rows[_POSITION].assign(**{POSITION_AGE: 0.0}) * np.nan
    earlier.iloc[row[is_inside], :2] = rows[_POSITION][has_position][is_inside]
    earlier.iloc[row[is_inside], 2] = np.where(age_s > _SAME_S, age_s, 0.0)
    return earlier


# Times


def time_unit(t, max_period_s):
    """The unit of times, inferred from the median period.

    Args:
        t: (n,) times.
        max_period_s: Longest plausible period [s]; the shortest is 4 ms.

    Returns:
        The first unit of SECONDS with a plausible period, or None; and the median period, in the
        unit of t.
    """
    step = np.abs(np.diff(t[np.isfinite(t)]))
    period = np.median(step[step > 0]) if (step > 0).any() else np.nan
    fits = [unit for unit, s in SECONDS.items() if _SHORTEST_S <= period * s <= max_period_s]
    return (*fits, None)[0], period


def _usable_rows(values, n_rows, dt_s):
    """The rows with usable times, with segments numbered from 0, and their places among the rows.

    Args:
        values: DataFrame of the rows.
        n_rows: Number of the log's rows, several of which may have been one row of `values`.
        dt_s: Length of a sample [s].
    """
    n_segments = values["segment"].nunique()
    if n_segments * _LEAST_ROWS > n_rows > 2 * _LEAST_ROWS:
        raise ValueError(
            f"the log's segment has {n_segments} values in {n_rows} rows; it should be the same in "
            "all rows of a drive"
        )
    falling = int((values.groupby("segment")["t_s"].diff() < 0).sum())
    if falling > max(2, _MOST_FALLING * n_rows):
        order = "in reverse" if falling > 0.9 * (n_rows - 1) else "unsorted"
        raise ValueError(
            f"the log's t_s falls {falling} times in {n_rows} rows; it may be {order} and should "
            "rise in each segment"
        )
    unit, period = time_unit(values["t_s"].to_numpy(), MAX_PERIOD * dt_s)
    if period > MAX_PERIOD * dt_s:
        they = f"t_s may be in {unit}, or they" if unit else "they"
        if 2 * len(values) <= n_rows:
            they = f"t_s may be rounded, as {n_rows} rows have {len(values)} times, or they"
        raise ValueError(
            f"the log had rows {period:.3g} s apart (median); {they} should be at most {dt_s:g} s "
            "apart, if necessary with missing measurements"
        )
    places, segment = _usable_times(values["t_s"].to_numpy(), values["segment"].to_numpy(), dt_s)
    if len(places) < _LEAST_USABLE * n_rows:
        raise ValueError(
            f"the log's t_s can be used in {len(places)} of {n_rows} rows; it may be constant or "
            "rounded and should be seconds that rise from row to row"
        )
    return values.iloc[places].assign(segment=segment).reset_index(drop=True), places


def _usable_times(t_s, segment, dt_s):
    """Places of the rows with usable times, and their segments, numbered from 0."""
    places = np.flatnonzero(np.isfinite(t_s))
    stamps = pd.Series(t_s[places]).groupby(segment[places])
    usual = stamps.transform(lambda t: t.rolling(3, min_periods=1).median()).to_numpy()
    places = places[np.abs(t_s[places] - usual) <= _CLOCK * dt_s]
    step = np.diff(t_s[places], prepend=np.nan)
    begins = np.diff(segment[places], prepend=np.nan) != 0
    begins |= (step > _SEGMENT_GAP * dt_s) | (step < -_CLOCK * dt_s)
    label = np.cumsum(begins) - 1
    latest = pd.Series(t_s[places]).groupby(label).cummax()
    rises = t_s[places] > latest.groupby(label).shift(fill_value=-np.inf).to_numpy()
    return places[rises], label[rises]


# Samples


def resample(rows, recording):
    """Resample the rows of one segment; a sample contains no later measurement.

    Args:
        rows: Rows of one segment of the Recording; the first sample is at the first of them.
        recording: The Recording.

    Returns:
        DataFrame with t_s, the measurements, and the truth: speeds as means over the interval, the
        pose at the time of the sample. A measurement that is no mean has its age [s] in the column
        `<name>_age_s`.
    """
    dt_s = recording.dt_s
    t = rows["t_s"].to_numpy()
    grid = t[0] + dt_s * np.arange(int((t[-1] - t[0] + _SAME_S) / dt_s) + 1)
    # A sample takes the exact time of a row that is closer than _SAME_S.
    row = t[np.minimum(np.searchsorted(t, grid - _SAME_S), len(t) - 1)]
    at = np.where(np.abs(row - grid) <= _SAME_S, row, grid)
    before = np.append(at[0] - dt_s, at[:-1])
    result = dict(t_s=at)
    positions_s = t - np.nan_to_num(rows[POSITION_AGE].to_numpy()) if POSITION_AGE in rows else t
    for name in rows.columns.difference(["segment", "t_s", POSITION_AGE], sort=False):
        value = rows[name].to_numpy()
        if name in (*recording.means, *TRUE_SPEEDS):
            result[name] = means_of(rows, name, before, at, recording)
        elif name in recording.measured:
            measured_s = positions_s if name in _POSITION else t
            measured_s = measured_s - recording.delays_s.get(name, 0.0)
            newest = _newest_since(before, at, measured_s, value)
            result[name], result[f"{name}_age_s"] = newest
        else:
            result[name] = _truth_at(at, t, value, _TRUTH_GAP * dt_s, name == "theta_rad")
    is_silent = at - t[np.searchsorted(t, at, side="right") - 1] > _STANDING_GAP * dt_s
    silence_begins = np.diff(is_silent, prepend=False) & is_silent
    if silence_begins.any():
        # The estimator holds missing inputs, so a zero here makes the robot stand from here on.
        for name in set(_ENCODERS) & set(result):
            result[name][silence_begins] = 0.0
    return pd.DataFrame(result)


def means_of(rows, name, begin, end, recording):
    """Means of a column over each (begin, end] [s], as of `_means_since`.

    In a log of the paper's robot a missing value means that the interval since the row before is
    not covered. In that of a Model it means that this column was not measured in this row.
    """
    t = rows["t_s"].to_numpy()
    value = rows[name].to_numpy()
    gap_s = _ENCODER_GAP * recording.dt_s
    if recording.gaps_s is not None:
        there = np.isfinite(value)
        t = t[there] - recording.delays_s.get(name, 0.0)
        value = value[there]
        gap_s = recording.gaps_s.get(name, gap_s)
    is_mean = recording.averaged and name in recording.means
    return _means_since(begin, end, t, value, is_mean, gap_s)


def with_ages(samples, measured):
    """Measurements of the samples of a segment, then their ages [s], (n, 2 n_z).

    What is older than the first sample is left out of it, because no motion is known before it by
    which an estimator could move it to the sample.

    Args:
        samples: DataFrame, as `resample` returns it.
        measured: Names of the measurements, in the order of z.
    """
    z = samples[measured].to_numpy(copy=True)
    ages_s = samples.reindex(columns=[f"{name}_age_s" for name in measured])
    ages_s = np.nan_to_num(ages_s.to_numpy(dtype=float))
    z[0, ages_s[0] > 0] = np.nan
    return np.hstack([z, ages_s])


def _truth_at(at, t, value, gap_s, is_angle):
    """Linear interpolation of a value, or of an angle without its jumps; NaN in longer gaps."""
    known = np.isfinite(value)
    if not known.any():
        return np.full(len(at), np.nan)
    t = t[known]
    value = np.unwrap(value[known]) if is_angle else value[known]
    after = np.clip(np.searchsorted(t, at), 0, len(t) - 1)
    before = np.maximum(after - 1, 0)
    is_inside = (t[before] <= at) & (at <= t[after]) & (t[after] - t[before] <= gap_s)
    return np.where(is_inside | (t[after] == at), np.interp(at, t, value), np.nan)


def _newest_since(begin, end, t, value):
    """The newest measurement in each (begin, end] and its age at the end; NaN without one."""
    is_finite = np.isfinite(value)
    t = np.append(-np.inf, t[is_finite])
    value = np.append(np.nan, value[is_finite])
    newest = np.searchsorted(t, end, side="right") - 1
    is_new = t[newest] > begin
    return np.where(is_new, value[newest], np.nan), np.where(is_new, end - t[newest], np.nan)


def _means_since(begin, end, t, value, averaged, gap_s):
    """Mean of a signal over each (begin, end] [s], from its measurements (t, value) until the end.

    The signal is linear between measurements or, if `averaged`, a value is the mean since the
    previous one. The first and the newest value are held. In gaps longer than gap_s the signal is
    unknown. The mean is ∫ signal dt / ∫ 1 dt over the covered time, or NaN if less than half of the
    interval is covered.
    """
    if not averaged:
        is_finite = np.isfinite(value)
        t = t[is_finite]
        value = value[is_finite]
    if not len(t):
        return np.full(len(end), np.nan)
    edges = np.append(min(begin[0], t[0]), t)
    mean = np.append(value[:1], value[1:] if averaged else (value[1:] + value[:-1]) / 2)
    is_covered = np.isfinite(mean) & (np.diff(edges) <= gap_s)
    n_until_end = np.searchsorted(t, end, side="right")
    newest = np.append(np.nan, value)[n_until_end]
    is_held = np.isfinite(newest) & (end - edges[n_until_end] <= gap_s)
    times = (begin, end, edges, n_until_end)
    covered_s = _integrals(*times, is_covered, is_held)
    integral = _integrals(*times, np.where(is_covered, mean, 0), np.where(is_held, newest, 0))
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.where(covered_s >= 0.5 * (end - begin), integral / covered_s, np.nan)


def _integrals(begin, end, edges, n_until_end, signal, held):
    """∫ over each of n intervals (begin, end] of a signal that is constant between edges.

    The signal has the values `signal` (m,) between the edges; n_until_end (n,) of these pieces end
    before `end`, and after them the signal has the value `held` (n,).
    """
    until_edge = np.append(0, np.cumsum(signal * np.diff(edges)))
    last_edge = edges[n_until_end]
    before = np.interp(np.minimum(begin, last_edge), edges, until_edge)
    return until_edge[n_until_end] - before + held * (end - np.maximum(begin, last_edge))
