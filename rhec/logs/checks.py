"""The checks of a recorded log: what each finds, and in which order.

`rhec.doctor` lists all findings. `rhec.replay` and `rhec.calibrate` refuse a log for its first
error and warn of what comes next. Where there is an error, in units or clocks, the checks of the
motion would only repeat it in other words.
"""

import warnings
from collections.abc import Iterator
from itertools import chain

import numpy as np
import pandas as pd

from rhec.logs.finding import Finding, Severity
from rhec.logs.path_checks import check_clock_offset, check_path, check_standing
from rhec.logs.position_noise import declared_m, position_sigma_m
from rhec.logs.recording import DECLARED, Recording, moves, travelled
from rhec.logs.sensor_checks import check_sensors
from rhec.simulation.columns import MEASUREMENTS

_X, _Y, _NU, _OMEGA = MEASUREMENTS
_POSITION = [_X, _Y]
_WINDOW_S = 5.0
_LEAST_RATE_HZ = 0.9  # of positions
_LONGEST_GAP_S = 5.0  # without positions or encoders, of a moving robot
_MOST_UNUSABLE = 0.01  # share of rows whose time cannot be used
_LEAST_COUNTING = 0.5  # share of the positions that pos_ok leaves
_HOUR_S = 3600.0
# A receiver's own σ: a fixed solution of centimetres has a tenth of the float one.
_FLOAT = 5.0
_BEST = 0.1  # quantile of these σ that is one of the best solution
_NOTABLE = 0.02  # share of positions
_NOISE_RATIO = 2.0  # measured noise over the declared one, or the reverse
_JUMP_M = 0.5  # a step beyond what the speed allows
_MOST_JUMPS = 2e-4  # share of positions
_SILENT_S = 30.0
_MOVED_M = 1.0  # while nothing was recorded
_LEAST_DRIVEN_M = 20.0
_LEAST_TURNED_RAD = 3.0
_OWN_INTEGRAL = 2e-3  # of the distance: no real robot's encoders are as good
_STRAIGHT = 1e-3  # of a step between positions, and as much as logs round [m]:
_ROUNDED_M = 3e-5
_MOST_STRAIGHT = 0.5  # share of positions in the middle between their neighbours
_ALL_STRAIGHT = 0.98  # a larger one is that of a straight path without noise


def facts(recording: Recording) -> dict:
    """What was measured of a Recording, {name: number}."""
    rows = recording.rows
    faults = recording.faults
    counting = int(rows[_X].notna().sum())
    return dict(
        duration_s=float(rows.groupby("segment")["t_s"].agg(np.ptp).sum()),
        rows_usable=len(rows) / faults["rows"],
        positions_usable=counting / max(counting + faults["positions_flagged"], 1),
        positions_hz=_rate_hz(rows, _X),
        encoders_hz=_rate_hz(rows, _NU),
        position_sigma_m=position_sigma_m(rows),
        driven_m=travelled(rows, _NU),
        turned_rad=travelled(rows, _OMEGA),
    )


def findings(recording: Recording) -> Iterator[Finding]:
    """All Findings about a Recording."""
    serious = [*_serious(recording)]
    yield from serious
    yield from chain.from_iterable(check(recording) for check in _OF_ROWS)
    if any(finding.severity is Severity.ERROR for finding in serious):
        return
    yield from chain.from_iterable(check(recording) for check in _OF_MOTION)


def refuse(recording: Recording) -> None:
    """Refuse a Recording for its first error, or warn of what is not one.

    Args:
        recording: The Recording.

    Raises:
        ValueError: If there is an error; the message names the probable cause.

    Warns:
        UserWarning: Such as that the positions are late.
    """
    for finding in _serious(recording):
        if finding.severity is Severity.ERROR:
            raise ValueError(finding.fact)
        if finding.severity is Severity.WARNING:
            warnings.warn(finding.fact, stacklevel=3)


def _serious(recording):
    """What the checks find that also yield errors or warnings."""
    return chain.from_iterable(check(recording) for check in _SERIOUS)


def _note(code, fact, remedy):
    return Finding(Severity.NOTE, code, fact, remedy)


def _rate_hz(rows, column):
    """Median rate of a column's numbers."""
    periods = rows.loc[rows[column].notna()].groupby("segment")["t_s"].diff()
    return float(1 / periods.median()) if periods.notna().any() else np.nan


# Rows and clock


def _check_counting(recording):
    """Find positions that pos_ok leaves out, most of them or all."""
    counting = int(recording.rows[_X].notna().sum())
    hidden = recording.faults["positions_flagged"]
    if hidden and not counting:
        yield Finding(
            Severity.ERROR,
            "no_positions",
            f"the log's pos_ok is true in none of {hidden} rows with a position, so that no "
            "position counts",
            "Set pos_ok to 1 where the position is to be used, or leave the column out.",
        )
    elif hidden and counting / (counting + hidden) < _LEAST_COUNTING:
        yield _note(
            "few_positions",
            f"pos_ok leaves {counting} of {counting + hidden} positions",
            "Look at the receiver's view of the sky, or let worse fixes count with their own "
            "position_sigma_m.",
        )


def _check_declared(recording):
    """Find positions that the receiver declares far worse than the others: RTK float, not fixed."""
    if DECLARED not in recording.rows:
        return
    declared_m = recording.rows.loc[recording.rows[_X].notna(), DECLARED].dropna()
    best_m = declared_m.quantile(_BEST)
    is_float = declared_m > _FLOAT * best_m
    if is_float.mean() > _NOTABLE:
        yield _note(
            "float_positions",
            f"the receiver declares {declared_m[is_float].median():.2g} m for "
            f"{is_float.mean():.0%} of the positions, and {declared_m[~is_float].median():.2g} m "
            "for the others: it has lost its fixed solution (RTK float, or without corrections)",
            f"Leave them out with pos_ok = 0 where {DECLARED} is large, or the whole log is "
            "replayed with one sigma_v.",
        )


def _check_clock(recording):
    faults = recording.faults
    share = faults["unusable_times"] / faults["rows"]
    if share > _MOST_UNUSABLE:
        yield _note(
            "clock",
            f"{share:.0%} of the rows have times that repeat, fall or jump",
            "Record the time of measurement by one clock, and sort the rows by it.",
        )
    back_s = faults["clock_back_s"]
    if back_s:
        hour = " an hour, as at the end of summer time" if abs(back_s - _HOUR_S) < 60 else ""
        yield _note(
            "clock_set_back",
            f"the time falls back by {back_s:.4g} s{',' + hour if hour else ''}; what follows "
            "counts as another drive",
            "If files were pasted together, replay each, or number them in a column segment.",
        )
    if faults["headers"]:
        times = "once" if faults["headers"] == 1 else f"{faults['headers']} times"
        yield _note(
            "repeated_header",
            f"the line of names stands {times} more between the rows",
            "Several files may have been pasted together: replay each by itself.",
        )


def _check_rates(recording):
    rate = _rate_hz(recording.rows, _X)
    if rate < _LEAST_RATE_HZ:
        yield _note(
            "low_rate",
            f"positions come at {rate:.2g} Hz",
            "Set the receiver to at least 1 Hz, better 5 Hz.",
        )
    for column, what in ((_X, "positions"), (_NU, "encoder speeds")):
        gap_s = _longest_gap(recording, column)
        if gap_s > _LONGEST_GAP_S:
            yield _note(
                "dropout",
                f"the {what} are missing for up to {gap_s:.1f} s while the robot moves",
                "Estimates are predictions there: look at sigma_x_m, and at the receiver's view "
                "of the sky or the cable.",
            )


def _longest_gap(recording, column):
    """Longest time [s] between numbers of a column in which the other sensor sees motion.

    Where no sensor was recorded at all, none of them dropped out.
    """
    longest = 0.0
    is_moving = moves(recording.rows)
    for _, part in recording.rows.groupby("segment"):
        there = part[part[column].notna()]
        t = there["t_s"].to_numpy()
        if len(t) < 2:
            continue
        gaps = np.diff(np.concatenate([t, part["t_s"].to_numpy()[-1:]]))
        way = np.hypot(*there[_POSITION].ffill().bfill().diff(-1).abs().to_numpy().T)
        usual = np.median(gaps)
        for k in np.flatnonzero(gaps > max(_LONGEST_GAP_S, 3 * usual)):
            inside = part[part["t_s"].between(t[k], t[k] + gaps[k], inclusive="neither")]
            drives = is_moving[inside.index].mean() > 0.5
            if len(inside) and (drives or (column == _NU and way[k] > _MOVED_M)):
                longest = max(longest, gaps[k])
    return longest


# Motion


def _check_encoders(recording):
    rows = recording.rows
    period_s = rows["t_s"].diff().median()
    n = max(round(_WINDOW_S / period_s), 3)
    dead = pd.Series(False, index=rows.index)
    one_side = {"left": dead.copy(), "right": dead.copy()}
    farthest_m = max(_MOVED_M, 6 * position_sigma_m(rows))
    is_moving = moves(rows)
    for _, part in rows.groupby("segment"):
        nu = part[_NU]
        omega = part[_OMEGA]
        way = np.hypot(*(part[name].ffill().diff(n) for name in _POSITION))
        is_zero = ((nu == 0) & (omega == 0)).astype(float).rolling(n).min() == 1
        is_recorded = part["t_s"].diff(n) < 2 * _WINDOW_S  # not a pause of the recording
        dead[part.index] = is_zero & is_recorded & (way > farthest_m)
        with np.errstate(divide="ignore", invalid="ignore"):
            ratio = (omega / nu).where(is_moving[part.index])
        spread = ratio.rolling(n, min_periods=n).std() / ratio.rolling(n).mean().abs()
        changes = nu.rolling(n).std() > 1e-3
        for side, sign in (("left", 1), ("right", -1)):
            one_side[side][part.index] = (spread < 1e-3) & changes & (ratio * sign > 0.2)
    if dead.sum() > n // 2:
        yield _note(
            "encoders_dead",
            f"both encoders show 0 for {dead.sum() * period_s:.0f} s while the positions move",
            "Look at the encoders' cable; mark these rows with encoders_ok = 0.",
        )
    for side, shows_0 in one_side.items():
        if shows_0.sum() > n // 2:
            yield _note(
                "track_dead",
                f"the {side} encoder shows 0 for {shows_0.sum() * period_s:.0f} s or more",
                "Look at its cable; mark these rows with encoders_ok = 0.",
            )


def _check_noise(recording):
    """Find positions that are worse than the receiver declares.

    Errors that wander for minutes do not show: it may well declare more than is seen.
    """
    measured_m = position_sigma_m(recording.rows)
    told_m = declared_m(recording.rows)
    if 0 < _NOISE_RATIO * told_m < measured_m:
        yield _note(
            "declared_noise",
            f"the positions' white noise is {measured_m:.2g} m and was declared as {told_m:.2g} m",
            "Leave sigma_v out: rhec.replay asks the log.",
        )


def _check_interpolated(recording):
    """Find positions in the middle between their neighbours, as a resampling tool makes them."""
    bends = []
    steps = []
    for _, part in recording.rows.groupby("segment"):
        there = part[part[_X].notna()]
        place = (there[_X] + 1j * there[_Y]).to_numpy()
        bends.append(np.abs(np.diff(place, 2)))
        steps.append(np.abs(np.diff(place))[1:])
    bend = np.concatenate(bends)
    step = np.concatenate(steps)
    moves = step > 10 * _ROUNDED_M
    if moves.sum() < 100:
        return
    share = np.mean((bend < _ROUNDED_M + _STRAIGHT * step)[moves])
    if _MOST_STRAIGHT < share < _ALL_STRAIGHT:
        yield _note(
            "interpolated_positions",
            f"{share:.0%} of the positions lie in the middle between their neighbours: they were "
            "interpolated",
            "Keep the receiver's own positions alone: others look more accurate than they are, "
            "and tell of motion before it happens.",
        )


def _check_jumps(recording):
    sigma_m = position_sigma_m(recording.rows)
    jumps = 0
    positions = 0
    moved_m = 0.0
    for _, part in recording.rows.groupby("segment"):
        there = part[part[_X].notna()]
        step_s = there["t_s"].diff().to_numpy()[1:]
        way = np.hypot(*there[_POSITION].diff().to_numpy()[1:].T)
        fastest = part[_NU].abs().max()
        allowed = 1.5 * fastest * step_s + _JUMP_M + 8 * sigma_m
        positions += len(way)
        jumps += int(((way > allowed) & (step_s < _SILENT_S)).sum())
        rows_s = part["t_s"].diff().to_numpy()
        silent = rows_s > _SILENT_S
        for k in np.flatnonzero(silent):
            before = part.iloc[:k][_POSITION].dropna()
            after = part.iloc[k:][_POSITION].dropna()
            if len(before) and len(after):
                moved_m = max(moved_m, np.hypot(*(after.iloc[0] - before.iloc[-1])))
    if jumps > max(_MOST_JUMPS * positions, 0.5):
        yield _note(
            "jumps",
            f"{jumps} of {positions} positions are farther from the last than the robot drives",
            "Outliers, or a receiver that changes its mode: use pos_ok for the receiver's quality.",
        )
    if moved_m > max(_MOVED_M, 8 * sigma_m):
        yield _note(
            "moved_in_silence",
            f"the robot was {moved_m:.1f} m away after a pause of the recording",
            "Give each drive its own number in a column segment.",
        )


def _check_own_integral(recording):
    total = 0.0
    apart = 0.0
    for _, part in recording.rows.groupby("segment"):
        there = part[_X].notna().to_numpy()
        if there.sum() < 50:
            continue
        step_s = np.diff(part["t_s"])
        speeds = part[[_NU, _OMEGA]].interpolate(limit_direction="both").to_numpy()
        nu, omega = (speeds[1:] + speeds[:-1]).T / 2
        theta = np.append(0, np.cumsum(omega * step_s))
        middle = (theta[1:] + theta[:-1]) / 2
        path = np.append(0, np.cumsum(nu * step_s * np.exp(1j * middle)))[there]
        place = (part[_X] + 1j * part[_Y]).to_numpy()[there]
        path -= path.mean()
        place -= place.mean()
        turn = np.vdot(path, place)
        turn /= max(abs(turn), 1e-12)
        total += np.abs(nu * step_s).sum()
        apart = max(apart, float(np.sqrt(np.mean(np.abs(place - turn * path) ** 2))))
    if total > _LEAST_DRIVEN_M and apart < _OWN_INTEGRAL * total:
        yield _note(
            "own_integral",
            f"the positions are the integral of the encoders, to {apart:.2g} m in {total:.0f} m",
            "An odometry's pose is no measurement: take positions from a receiver.",
        )


def _check_manoeuvres(recording):
    driven_m = travelled(recording.rows, _NU)
    turned_rad = travelled(recording.rows, _OMEGA)
    if driven_m < _LEAST_DRIVEN_M:
        yield _note(
            "too_short",
            f"the robot drives {driven_m:.2g} m: μ, the yaw and the lever arm stay open",
            "Drive 50 m, straight and in curves.",
        )
    if turned_rad < _LEAST_TURNED_RAD:
        yield _note(
            "never_turns",
            f"the robot turns {turned_rad:.2g} rad in all: κ stays open",
            "Drive a figure of eight, and turn on the spot in both directions.",
        )


_SERIOUS = (check_standing, _check_counting, check_sensors, check_clock_offset, check_path)
_OF_ROWS = (_check_clock, _check_rates, _check_declared)
_OF_MOTION = (
    _check_encoders,
    _check_interpolated,
    _check_jumps,
    _check_own_integral,
    _check_manoeuvres,
    _check_noise,
)
