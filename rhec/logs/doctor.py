"""What is wrong with a recorded log, all at once, and what to do about it.

`rhec.replay` refuses a log for its first fault. The doctor goes on and lists all that it finds:
rates, dropouts, clock, units, signs and scale of the encoders, bias, noise as declared and as
measured, and what the robot would have to drive for the rest to be known.

    rhec doctor FILE [--sigma-m 0.02] [--json]

ends with exit code 0 if there are no findings, 1 if there are, 2 if the file cannot be read.
"""

import json
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pandas as pd

from rhec.core._casadi.validation import Positive, checked
from rhec.logs.log_checks import best_delay, halves_agree, refuse_implausible
from rhec.logs.position_noise import position_sigma_m
from rhec.logs.reader import read
from rhec.logs.recording import Recording, prepare
from rhec.logs.sensor_checks import refuse_implausible_sensors
from rhec.simulation.columns import MEASUREMENTS, SENSORS

_X, _Y, _NU, _OMEGA = MEASUREMENTS
_POSITION = [_X, _Y]
_GYRO = SENSORS["gyro"]
_MOVING = 0.05  # encoder speed of a moving robot [m/s, rad/s]
_STILL = 0.02  # encoder speed of a standing robot [m/s, rad/s]
_WINDOW_S = 5.0
_LEAST_RATE_HZ = 0.9  # of positions
_LONGEST_GAP_S = 5.0  # without positions or encoders, of a moving robot
_MOST_UNUSABLE = 0.01  # share of rows whose time cannot be used
_LATE_S = 0.15
_LEAST_GAIN = 0.004  # of the explained share, for a delay
_MOST_MU = 1.05
_MOST_KAPPA = 1.05
_ERRORS = 5.0  # standard errors by which a slope must be outside
_NOISE_RATIO = 2.0  # measured noise over the declared one, or the reverse
_JUMP_M = 0.5  # a step beyond what the speed allows
_MOST_JUMPS = 2e-4  # share of positions
_SILENT_S = 30.0
_MOVED_M = 1.0  # while nothing was recorded
_BIAS_RADPS = 0.01
_BIAS_MPS = 0.03
_MOST_BIAS = 0.1
_LEAST_DRIVEN_M = 20.0
_LEAST_TURNED_RAD = 3.0
_OWN_INTEGRAL = 2e-3  # of the distance: no real robot's encoders are as good


class Finding(NamedTuple):
    """One thing that is wrong with a log."""

    code: str  # such as "late_positions"
    sentence: str  # what was found, with its number
    remedy: str  # what helps


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
        findings = [finding._asdict() for finding in self.findings]
        return json.dumps(dict(ok=self.ok, findings=findings, facts=self.facts), indent=2)

    def __str__(self) -> str:
        lines = [f"{name}: {value:.3g}" for name, value in self.facts.items()]
        lines += [f"- {f.sentence} {f.remedy}" for f in self.findings]
        return "\n".join(lines + ([] if self.findings else ["Nothing was found."]))


class _Log(NamedTuple):
    """What the checks look at."""

    recording: Recording
    rows: pd.DataFrame
    moves: np.ndarray  # whether the robot moves according to its encoders, by row
    declared_m: float | None  # declared noise of positions


@checked
def doctor(
    log: Any, *, sigma_m: Positive | None = None, track_width_m: Positive | None = None
) -> Diagnosis:
    """Find what is wrong with a recorded log.

    Args:
        log: DataFrame, as `rhec.replay` takes it; or the path of a file, as `rhec.logs.read` takes
            it.
        sigma_m: Declared standard deviation of the positions [m], to be compared with the log. By
            default the median of the log's column position_sigma_m, if it has one.
        track_width_m: As in `rhec.replay` [m].

    Returns:
        Diagnosis.

    Raises:
        ValueError: If there is a path, and its file cannot be read.
    """
    if isinstance(log, str | Path):
        log = read(log)
    try:
        recording = prepare(log, track_width_m)
    except ValueError as error:
        remedy = "rhec.logs.read can rename columns and convert times."
        return Diagnosis((Finding("unusable", f"{_sentence(error)}", remedy),), {})
    rows = recording.rows
    if sigma_m is None and "position_sigma_m" in log:
        sigma_m = float(pd.to_numeric(log["position_sigma_m"], errors="coerce").median())
    moves = (rows[[_NU, _OMEGA]].abs() > _MOVING).any(axis=1).to_numpy()
    about = _Log(recording, rows, moves, sigma_m)
    findings = [finding for check in _CHECKS for finding in check(about)]
    return Diagnosis(tuple(findings), _facts(about))


def _sentence(error):
    text = str(error)
    return text[0].upper() + text[1:] + "."


def _rate_hz(rows, column):
    """Median rate of a column's numbers."""
    periods = rows.loc[rows[column].notna()].groupby("segment")["t_s"].diff()
    return float(1 / periods.median()) if periods.notna().any() else np.nan


def _facts(log):
    rows = log.rows
    steps = rows.groupby("segment")["t_s"].diff().clip(upper=1.0)
    return dict(
        duration_s=float(rows.groupby("segment")["t_s"].agg(np.ptp).sum()),
        positions_hz=_rate_hz(rows, _X),
        encoders_hz=_rate_hz(rows, _NU),
        position_sigma_m=position_sigma_m(rows),
        driven_m=float((rows[_NU].abs() * steps).sum()),
        turned_rad=float((rows[_OMEGA].abs() * steps).sum()),
    )


# The checks: each takes a _Log and yields Findings


def _check_clock(log):
    faults = log.recording.faults
    share = faults["unusable_times"] / faults["rows"]
    if share > _MOST_UNUSABLE:
        yield Finding(
            "clock",
            f"{share:.0%} of the rows have times that repeat, fall or jump.",
            "Record the time of measurement by one clock, and sort the rows by it.",
        )


def _check_units(log):
    for check in (refuse_implausible, refuse_implausible_sensors):
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")
                check(log.recording)
        except ValueError as error:
            yield Finding("implausible", _sentence(error), "Correct it where the log is read.")


def _check_rates(log):
    rate = _rate_hz(log.rows, _X)
    if rate < _LEAST_RATE_HZ:
        yield Finding(
            "low_rate",
            f"Positions come at {rate:.2g} Hz.",
            "Set the receiver to at least 1 Hz, better 5 Hz.",
        )
    for column, what in ((_X, "positions"), (_NU, "encoder speeds")):
        gap_s = _longest_gap(log, column)
        if gap_s > _LONGEST_GAP_S:
            yield Finding(
                "dropout",
                f"The {what} are missing for up to {gap_s:.1f} s while the robot moves.",
                "Estimates are predictions there: look at sigma_x_m, and at the receiver's view "
                "of the sky or the cable.",
            )


def _longest_gap(log, column):
    """Longest time [s] between numbers of a column in which the other sensor sees motion."""
    longest = 0.0
    for _, part in log.rows.groupby("segment"):
        there = part[part[column].notna()]
        t = there["t_s"].to_numpy()
        if len(t) < 2:
            continue
        gaps = np.diff(np.concatenate([t, part["t_s"].to_numpy()[-1:]]))
        way = np.hypot(*there[_POSITION].ffill().bfill().diff(-1).abs().to_numpy().T)
        usual = np.median(gaps)
        for k in np.flatnonzero(gaps > max(_LONGEST_GAP_S, 3 * usual)):
            inside = part["t_s"].between(t[k], t[k] + gaps[k])
            drives = log.moves[part.index[inside]].mean() > 0.5
            if drives or (column == _NU and way[k] > _MOVED_M):
                longest = max(longest, gaps[k])
    return longest


def _check_encoders(log):
    rows = log.rows
    nu, omega = (rows[column].to_numpy() for column in (_NU, _OMEGA))
    period_s = rows["t_s"].diff().median()
    n = max(round(_WINDOW_S / period_s), 3)
    way = np.hypot(*(rows[c].ffill().diff(n).to_numpy() for c in _POSITION))
    zero = pd.Series((nu == 0) & (omega == 0)).rolling(n).min().to_numpy() == 1
    far = zero & (way > max(_MOVED_M, 6 * position_sigma_m(rows)))
    if far.sum() > n // 2:
        yield Finding(
            "encoders_dead",
            f"Both encoders show 0 for {far.sum() * period_s:.0f} s while the positions move.",
            "Look at the encoders' cable; mark these rows with encoders_ok = 0.",
        )
    with np.errstate(divide="ignore", invalid="ignore"):
        ratio = pd.Series(np.where(log.moves, omega / nu, np.nan))
    spread = ratio.rolling(n, min_periods=n).std() / ratio.rolling(n).mean().abs()
    speed_spread = pd.Series(nu).rolling(n).std()
    for sign, side in ((1, "left"), (-1, "right")):
        dead = (spread < 1e-3) & (speed_spread > 1e-3) & (ratio * sign > 0.2)
        if dead.sum() > n // 2:
            yield Finding(
                "track_dead",
                f"The {side} encoder shows 0 for {dead.sum() * period_s:.0f} s or more.",
                "Look at its cable; mark these rows with encoders_ok = 0.",
            )


def _check_delay(log):
    with np.errstate(all="ignore"):
        delay_s, _ = best_delay(log.rows, _LEAST_GAIN)
        late = abs(delay_s) >= _LATE_S and halves_agree(log.rows, delay_s, _LEAST_GAIN)
    if late:
        yield Finding(
            "late_positions",
            f"Positions come {delay_s:+.2f} s later than the encoder speeds.",
            f"rhec.replay(log, position_delay_s={delay_s:.2f}) corrects it.",
        )


def _check_scale(log):
    with np.errstate(all="ignore"):
        _, slopes = best_delay(log.rows)
    if slopes is None:
        return
    mu, kappa = slopes
    if mu.share > 0.5 and mu.value - _ERRORS * mu.sigma > _MOST_MU:
        yield Finding(
            "scale_of_speed",
            f"The positions go {mu.value:.3g} times as far as the encoders say; tracks only slip "
            "the other way.",
            "The wheel radius or the encoders' scale is too small.",
        )
    if kappa.share > 0.3 and kappa.value - _ERRORS * kappa.sigma > _MOST_KAPPA:
        yield Finding(
            "corrected_yaw_rate",
            f"The course turns {kappa.value:.3g} times as far as the encoders say, so that κ is at "
            "its bound 1.",
            "The driver may already correct the yaw rate (wheel_separation_multiplier): use the "
            "track speeds with the geometric track_width_m.",
        )


def _check_noise(log):
    measured = position_sigma_m(log.rows)
    declared = log.declared_m
    if declared and not 1 / _NOISE_RATIO <= measured / max(declared, 0.03) <= _NOISE_RATIO:
        yield Finding(
            "declared_noise",
            f"The positions' white noise is {measured:.2g} m and was declared as {declared:.2g} m.",
            "Leave sigma_v out: rhec.replay asks the log.",
        )
    values = log.rows[_POSITION].dropna().to_numpy()
    for step in (1.0, 0.5, 0.25, 0.2, 0.1, 0.05):
        if len(values) > 100 and np.abs(values / step - np.round(values / step)).max() < 1e-6:
            yield Finding(
                "rounded_positions",
                f"The positions are rounded to {step:g} m.",
                "Record more digits; as latitude and longitude, eight decimals.",
            )
            break


def _check_jumps(log):
    sigma_m = position_sigma_m(log.rows)
    jumps = 0
    positions = 0
    moved_m = 0.0
    for _, part in log.rows.groupby("segment"):
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
        yield Finding(
            "jumps",
            f"{jumps} of {positions} positions are farther from the last than the robot drives.",
            "Outliers, or a receiver that changes its mode: use pos_ok for the receiver's quality.",
        )
    if moved_m > max(_MOVED_M, 8 * sigma_m):
        yield Finding(
            "moved_in_silence",
            f"The robot was {moved_m:.1f} m away after a pause of the recording.",
            "Give each drive its own number in a column segment.",
        )


def _check_bias(log):
    rows = log.rows
    speeds = rows[[_NU, _OMEGA]].abs().max(axis=1)
    still = speeds.rolling(20, center=True).max() < _STILL
    if _GYRO in rows:
        still_gyro = rows.loc[still, _GYRO].dropna()
        bias = still_gyro.median()
        if len(still_gyro) > 50 and abs(bias) > 2 * _BIAS_RADPS:
            yield Finding(
                "gyro_bias",
                f"The gyro shows {bias:.3g} rad/s while the robot stands.",
                "rhec.replay estimates a bias; a smaller one converges sooner.",
            )
    n = 50
    way = np.hypot(*(rows[c].ffill().diff(n).shift(-n // 2).to_numpy() for c in _POSITION))
    span_s = rows["t_s"].diff(n).shift(-n // 2)
    stands = pd.Series(way < 3 * position_sigma_m(rows), index=rows.index)
    constant = (rows[[_NU, _OMEGA]].rolling(n, center=True).std() < 1e-2).all(axis=1)
    offsets = rows.loc[stands & constant & (span_s > 0), [_NU, _OMEGA]].median()
    for column, least, unit in ((_NU, _BIAS_MPS, "m/s"), (_OMEGA, _BIAS_RADPS, "rad/s")):
        # A larger yaw rate is that of a robot that turns on the spot.
        if (stands & constant).sum() > n and least < abs(offsets[column]) < _MOST_BIAS:
            yield Finding(
                "encoder_bias",
                f"{log.recording.columns[column]} is {offsets[column]:.3g} {unit} while the "
                "positions stand still.",
                "Subtract it where the log is read.",
            )


def _check_own_integral(log):
    total = 0.0
    apart = 0.0
    for _, part in log.rows.groupby("segment"):
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
        yield Finding(
            "own_integral",
            f"The positions are the integral of the encoders, to {apart:.2g} m in {total:.0f} m.",
            "An odometry's pose is no measurement: take positions from a receiver.",
        )


def _check_manoeuvres(log):
    facts = _facts(log)
    if facts["driven_m"] < _LEAST_DRIVEN_M:
        yield Finding(
            "too_short",
            f"The robot drives {facts['driven_m']:.2g} m: μ, the yaw and the lever arm stay open.",
            "Drive 50 m, straight and in curves.",
        )
    if facts["turned_rad"] < _LEAST_TURNED_RAD:
        yield Finding(
            "never_turns",
            f"The robot turns {facts['turned_rad']:.2g} rad in all: κ stays open.",
            "Drive a figure of eight, and turn on the spot in both directions.",
        )


_CHECKS: tuple[Callable, ...] = (
    _check_clock,
    _check_units,
    _check_rates,
    _check_encoders,
    _check_delay,
    _check_scale,
    _check_noise,
    _check_jumps,
    _check_bias,
    _check_own_integral,
    _check_manoeuvres,
)
