"""The checks of a recorded log: what each finds, and in which order.

`rhec.doctor` lists all findings; `rhec log FILE --check` prints them, and ends with exit code 1 if
there are any. `rhec.replay` and `rhec.calibrate` refuse a log for its first error and warn of what
comes next. Where there is an error, in units or clocks, the checks of the motion would only repeat
it in other words.
"""

import json
import warnings
from collections.abc import Iterator
from itertools import chain
from typing import Any, NamedTuple

import numpy as np

from rhec.core._casadi.validation import Positive, Real, checked
from rhec.logs import causes
from rhec.logs.finding import Finding, Severity, note, refused, warning
from rhec.logs.motion import LEAST_TURNED_RAD, MOVING, moves, period_s, travelled, turned_rad
from rhec.logs.path_checks import check_clock_offset, check_path
from rhec.logs.position_noise import LEAST_M, declared_m
from rhec.logs.reader import read_if_path
from rhec.logs.recording import Recording, delayed, prepare
from rhec.logs.sensor_checks import check_sensors
from rhec.simulation.columns import MEASUREMENTS

_X, _Y, _NU, _OMEGA = MEASUREMENTS
_POSITION = [_X, _Y]
_WINDOW_S = 5.0  # in which an encoder counts as dead
_LONGEST_GAP_S = 5.0  # without positions or encoders, of a moving robot
_MOST_UNUSABLE = 0.01  # share of rows whose time cannot be used
_LEAST_HELD = 5  # positions that repeat the one before
_MOST_SPIKES = 0.02  # share of the values of an encoder
_ROUNDED_M = 0.25  # distance of two numbers of a position
_HOUR_S = 3600.0
_JUMP_M = 0.5  # a step beyond what the speed allows
_MOST_JUMPS = 2e-4  # share of positions
_SILENT_S = 30.0
_MOVED_M = 1.0  # while nothing was recorded
_STANDING = 0.3  # a robot that drove and turned less than this [m, rad] never moved
_LEAST_ROWS = 50  # of a robot that could have moved
_LEAST_DRIVEN_M = 20.0


def facts(recording: Recording) -> dict:
    """What was measured of a Recording, {name: number}."""
    rows = recording.rows
    faults = recording.faults
    counting = int(rows[_X].notna().sum())
    return dict(
        duration_s=float(rows.groupby("segment")["t_s"].agg(np.ptp).sum()),
        rows_usable=1 - faults["unusable_times"] / faults["rows"],
        positions_usable=counting / max(counting + faults["positions_flagged"], 1),
        positions_hz=1 / period_s(rows, _X),
        encoders_hz=1 / period_s(rows, _NU),
        position_sigma_m=recording.noise_m,
        declared_sigma_m=declared_m(rows),
        driven_m=travelled(rows, _NU),
        turned_rad=travelled(rows, _OMEGA),
    )


def findings(recording: Recording) -> Iterator[Finding]:
    """All Findings about a Recording."""
    found = [*chain.from_iterable(check(recording) for check in _CHECKS)]
    yield from found
    if not any(finding.severity is Severity.ERROR for finding in found):
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
    for finding in findings(recording):
        if finding.severity is Severity.ERROR:
            raise ValueError(finding.fact)
        if finding.severity is Severity.WARNING:
            warnings.warn(finding.fact, stacklevel=3)


def _lengths(steps):
    """Lengths of changes of the position [m], a Series."""
    return np.hypot(steps[_X], steps[_Y])


# Rows and clock


def _check_counting(recording):
    """Find positions of which none counts: by pos_ok, or because they repeat."""
    faults = recording.faults
    counting = int(recording.rows[_X].notna().sum())
    hidden = faults["positions_flagged"]
    if hidden and not counting:
        yield refused(
            f"the log's pos_ok is true in none of {hidden} rows with a position, so that no "
            "position counts",
            "no_positions",
            "Set pos_ok to 1 where the position is to be used, or leave the column out.",
        )
    elif counting <= faults["segments"] and faults["positions_held"] >= _LEAST_HELD:
        place = ", ".join(recording.columns[name] for name in _POSITION)
        yield refused(f"the log's {place} should be of a robot that moves: they never change")


def _check_rounded(recording):
    """Find positions with too few digits, as a spreadsheet or a float32 has them."""
    for name in _POSITION:
        steps_m = np.diff(np.unique(recording.rows[name].dropna()))
        step_m = steps_m.min(initial=np.inf)
        are_multiples = np.abs(steps_m / step_m - np.round(steps_m / step_m)).max(initial=0) < 1e-3
        if _ROUNDED_M < step_m < np.inf and are_multiples:
            yield warning(
                "rounded",
                f"the log's {recording.columns[name]} is rounded to {step_m:.3g} m",
                "Write it with all its digits, or from a place near the robot on.",
            )


def _check_clock(recording):
    """Find times that cannot be used, a clock that is set back, and files pasted together."""
    faults = recording.faults
    share = faults["unusable_times"] / faults["rows"]
    if share > _MOST_UNUSABLE:
        yield note(
            "clock",
            f"{share:.0%} of the rows have times that repeat, fall or jump",
            "Record the time of measurement by one clock, and sort the rows by it.",
        )
    back_s = faults["clock_back_s"]
    if back_s:
        is_hour = abs(back_s - _HOUR_S) < 60
        hour = ", an hour, as at the end of summer time" if is_hour else ""
        yield note(
            "clock_set_back",
            f"the time falls back by {back_s:.4g} s{hour}; what follows counts as another drive",
            "If files were pasted together, replay each, or number them in a column segment.",
        )


def _check_silence(recording):
    """Find sensors that fall silent while the robot moves."""
    rows = recording.rows
    place = rows.groupby("segment")[_POSITION].ffill()
    at_encoders = place.where(rows[_NU].notna()).groupby(rows["segment"]).ffill()
    is_carried = _lengths(place - at_encoders) > _MOVED_M
    drives = rows[_NU].abs() > MOVING
    silent = (("positions", _X, drives), ("encoder speeds", _NU, is_carried))
    for what, column, sees_motion in silent:
        gap_s = _silence_s(rows, column)[sees_motion].max(initial=0.0)
        if gap_s > _LONGEST_GAP_S:
            yield note(
                "dropout",
                f"the {what} are missing for up to {gap_s:.1f} s while the robot moves",
                "Estimates are predictions there: look at sigma_x_m, and at the receiver's view "
                "of the sky or the cable.",
            )


def _silence_s(rows, column):
    """Time since the last number of a column before each row [s], without pauses."""
    begins = rows["segment"].diff().to_numpy() != 0
    step_s = np.where(begins, 0.0, rows["t_s"].diff().clip(upper=1.0))
    until_s = np.cumsum(step_s)
    follows = begins | rows[column].notna().shift(fill_value=False)
    return until_s - np.maximum.accumulate(np.where(follows, until_s - step_s, 0.0))


def _check_left_out(recording):
    """Tell how many values were left out, and where a new drive begins."""
    encoders = [recording.columns[name] for name in (_NU, _OMEGA)]
    for column, n in recording.faults["left_out"].items():
        # Of so many wrong speeds others are near the right ones, and are not left out.
        are_many = column in encoders and n > _MOST_SPIKES * len(recording.rows)
        yield (warning if are_many else note)(
            "left_out",
            f"{n} values of {column} are left out, because none is as large or so far from both "
            "its neighbours",
            "Look for a counter that rolls over, for bits that are lost, or for a number such as "
            "-1 in the place of none.",
        )
    for jump_m in recording.faults["jumps_m"]:
        place = ", ".join(recording.columns[name] for name in _POSITION)
        yield warning(
            "far_jump",
            f"the log's {place} jump by {jump_m / 1000:.4g} km, as in another zone of UTM",
            "Write all positions in one zone: what follows counts as another drive.",
        )


def _check_common_time(recording):
    """Find positions and encoders that were never measured in one drive: by two clocks."""
    counts = recording.rows.groupby("segment")[[_X, _NU]].count()
    if (counts > 0).all(axis=1).any() or not counts[_X].any():
        return
    spans = []
    for name in (_X, _NU):
        t_s = recording.rows.loc[recording.rows[name].notna(), "t_s"]
        spans.append(f"from {t_s.min():.6g} to {t_s.max():.6g} s")
    yield refused(
        f"the log's positions ({spans[0]}) and its encoders ({spans[1]}) have no time in common: "
        "they are by two clocks",
        "two_clocks",
        "Record both by one clock, such as the computer's, or add the difference to the times of "
        "one file.",
    )


# Motion


def _check_standing(recording):
    """Find a robot that never moves."""
    rows = recording.rows
    # In windows the noise of the encoders cancels.
    farthest = max(travelled(rows, column, _WINDOW_S) for column in (_NU, _OMEGA))
    if farthest < _STANDING and len(rows) >= _LEAST_ROWS:
        speeds = ", ".join(dict.fromkeys(recording.columns[name] for name in (_NU, _OMEGA)))
        yield refused(
            f"the log's {speeds} should be of a robot that moves: it drove and turned "
            f"{farthest:.2g} m and rad at most"
        )


def _check_excited(recording):
    """Find a robot that moves too little."""
    driven_m = travelled(recording.rows, _NU)
    turned = turned_rad(recording.rows)
    if driven_m < _LEAST_DRIVEN_M:
        yield note(
            "too_short",
            f"the robot drives {driven_m:.2g} m: μ, the yaw and the lever arm stay open",
            "Drive 50 m, straight and in curves.",
        )
    if turned < LEAST_TURNED_RAD:
        yield note(
            "never_turns",
            f"the robot turns {turned:.2g} rad in all: κ stays open",
            "Drive a figure of eight, and turn on the spot in both directions.",
        )


def _check_encoders(recording):
    """Find encoders that show 0: both while the positions move, or one of them."""
    rows = recording.rows
    step_s = period_s(rows, _NU)
    if np.isnan(step_s):
        return
    n = max(round(_WINDOW_S / step_s), 3)
    sigma_m = recording.noise_m
    there = rows.assign(**rows.groupby("segment")[_POSITION].ffill())[rows[_NU].notna()]
    nu = there[_NU]
    is_recorded = there["t_s"].diff(n).between(0, 2 * _WINDOW_S)  # without a pause
    way_m = _lengths(there[_POSITION].diff(n))
    is_zero = ((nu == 0) & (there[_OMEGA] == 0)).rolling(n).min() == 1
    dead = is_zero & is_recorded & (way_m > max(_MOVED_M, 6 * sigma_m))
    # A track that stands makes ω/ν a constant.
    ratio = (there[_OMEGA] / nu).where(moves(there) & (nu != 0))
    window = ratio.rolling(n)
    is_constant = window.std() < 1e-3 * window.mean().abs()
    one_side = is_constant & is_recorded & (nu.rolling(n).std() > 1e-3)
    # Of a robot that starts from rest along one curve it seems so for a moment, each time.
    run = (one_side != one_side.shift()).cumsum()
    lasting = one_side & (one_side.groupby(run).transform("sum") > n // 2)
    # It is so of one that drives along one curve faster and slower. But without one track's speed
    # the encoders' way is shorter than that of the positions, which slip makes none.
    driven_m = step_s * nu.abs().rolling(n).sum()
    beyond = way_m**2 - 4 * sigma_m**2 - driven_m**2
    lasting &= beyond.groupby(run).transform("sum") > 0
    for code, what, shows_0 in (
        ("encoders_dead", "both encoders show 0 while the positions move, for", dead),
        ("track_dead", "the left encoder shows 0 for at least", lasting & (ratio > 0.2)),
        ("track_dead", "the right encoder shows 0 for at least", lasting & (ratio < -0.2)),
    ):
        if shows_0.sum() > n // 2:
            yield warning(
                code,
                f"{what} {shows_0.sum() * step_s:.0f} s",
                "Look at the cable; mark these rows with encoders_ok = 0.",
            )


def _check_jumps(recording):
    """Find positions farther apart than the robot drives, and a robot moved in a pause."""
    rows = recording.rows
    noise_m = 8 * recording.noise_m
    steps = rows[rows[_X].notna()].groupby("segment")[["t_s", *_POSITION]].diff()
    way_m = _lengths(steps)
    pauses = (rows.groupby("segment")["t_s"].diff() > _SILENT_S).cumsum()
    is_over_pause = pauses[steps.index].diff() > 0
    fastest_mps = rows[_NU].abs().groupby(rows["segment"]).transform("max")[steps.index]
    allowed_m = 1.5 * fastest_mps * steps["t_s"] + _JUMP_M + noise_m
    jumps = int((way_m > allowed_m)[(steps["t_s"] < _SILENT_S)].sum())
    if jumps > max(_MOST_JUMPS * len(steps), 0.5):
        yield note(
            "jumps",
            f"{jumps} of {len(steps)} positions are farther from the last than the robot drives",
            "Outliers, or a receiver that changes its mode: use pos_ok for the receiver's quality.",
        )
    moved_m = way_m[is_over_pause].max()
    if moved_m > max(_MOVED_M, noise_m):
        yield warning(
            "moved_in_silence",
            f"the robot was {moved_m:.1f} m away after a pause of the recording",
            "Give each drive its own number in a column segment.",
        )


def _check_columns(recording):
    """Find the fault of a column that explains the log, or else wrong units, axes and delays."""
    found = [*causes.find(recording)]
    yield from found or check_path(recording)


_CHECKS = (
    _check_counting,
    _check_rounded,
    _check_clock,
    _check_common_time,
    _check_left_out,
    _check_standing,
    check_clock_offset,
    _check_columns,
    check_sensors,
)
_OF_MOTION = (_check_excited, _check_silence, _check_encoders, _check_jumps)


# The doctor


class Diagnosis(NamedTuple):
    """All findings about a log.

    Args:
        findings: (Finding, …), none for a healthy log.
        facts: {name: number} that were measured, such as the rates.
    """

    findings: tuple
    facts: dict

    @property
    def ok(self) -> bool:
        """Whether there are no findings."""
        return not self.findings

    def to_json(self) -> str:
        """The diagnosis as JSON."""
        findings = [each._asdict() | dict(sentence=each.sentence) for each in self.findings]
        return json.dumps(dict(ok=self.ok, findings=findings, facts=self.facts), indent=2)

    def __str__(self) -> str:
        told = {name: f"{value:.3g}" for name, value in self.facts.items()}
        if self.facts.get("position_sigma_m") == LEAST_M:
            told["position_sigma_m"] = f"at most {LEAST_M}, the least that is assumed"
        lines = [f"{name}: {value}" for name, value in told.items()]
        lines += [f"- {each.severity}: {each.sentence} {each.remedy}" for each in self.findings]
        return "\n".join(lines + ([] if self.findings else ["Nothing was found."]))


@checked
def doctor(
    log: Any, *, track_width_m: Positive | None = None, position_delay_s: Real = 0.0
) -> Diagnosis:
    """Find what is wrong with a recorded log.

    Args:
        log: DataFrame, as `rhec.replay` takes it; or the path of a file, as `rhec.logs.read` takes
            it.
        track_width_m: As in `rhec.replay` [m].
        position_delay_s: Delay of the time stamps of the positions [s], as in `rhec.replay`.

    Returns:
        Diagnosis.

    Raises:
        ValueError: If there is a path, and its file cannot be read.
    """
    _, diagnosis = diagnosed(read_if_path(log), track_width_m, position_delay_s)
    return diagnosis


def diagnosed(
    log: Any, track_width_m: float | None, position_delay_s: float
) -> tuple[Recording | None, Diagnosis]:
    """The Recording of a log, with positions at their time stamps or None, and its Diagnosis.

    The arguments are those of `doctor`, with a log that was read.
    """
    try:
        recording = prepare(log, track_width_m)
    except ValueError as error:
        return None, Diagnosis((refused(str(error), "unusable"),), {})
    in_time = delayed(recording, position_delay_s)
    return recording, Diagnosis(tuple(findings(in_time)), facts(in_time))
