"""Logs that cannot be what their columns say: each is named in a sentence, before anything is
estimated; and what a log may be is not.

The logs are simulated; at night the published ones of four robots must be healthy, too.
"""

import functools
import itertools
import json
import re
import warnings
from pathlib import Path

import fetch_recordings
import make_example_log
import numpy as np
import pandas as pd
import pytest
import requests
from convert_recordings import convert
from helpers import KAPPA, MU, TRACK_WIDTH_M, recorded_log
from spoilt_logs import in_rows_of_their_own, late

import rhec
from rhec import paper
from rhec.cli import main
from rhec.logs import path_checks
from rhec.logs import replay as module
from rhec.logs.path_checks import likeliest_delay
from rhec.logs.recording import prepare

PAGE = Path(__file__).parents[2] / "docs" / "your_log.md"
EXAMPLE = pd.read_csv(make_example_log.FILE)
LOG = recorded_log(10.0, 150.0, noise_m=0.02, seed=3)
T, X, Y = LOG["t_s"], LOG["x_m"], LOG["y_m"]
SPEED, TURN = LOG["speed_mps"], LOG["yaw_rate_radps"]
RANDOM = np.random.default_rng(5)
NOISE = RANDOM.standard_normal((len(LOG), 2))
FAULTY = (T >= 60) & (T < 90)


def change(where, **columns):
    log = LOG.copy()
    for name, values in columns.items():
        log.loc[where, name] = values[where] if isinstance(values, pd.Series) else values
    return log


def by_sides(left, right):
    """The log with the speeds of its tracks times these."""
    v_left = LOG["v_left_mps"] * left
    v_right = LOG["v_right_mps"] * right
    return LOG.assign(
        speed_mps=(v_left + v_right) / 2, yaw_rate_radps=(v_right - v_left) / TRACK_WIDTH_M
    )


def dead(left, right, where=FAULTY):
    """Tracks whose encoders show 0 meanwhile, where that is their factor."""
    return LOG.mask(where, by_sides(left, right), axis=0)


def times(factor, *names):
    return LOG.assign(**{name: factor * LOG[name] for name in names})


def missing(where, *names):
    return change(where, **dict.fromkeys(names, np.nan))


def set_back(seconds):
    return LOG.assign(t_s=T + 4000 - seconds * (T > 75))


def spikes(n):
    """Single speeds of a counter of 8 bits that rolled over n times."""
    return change(LOG.index % (1500 // n) == 5, speed_mps=SPEED - 2.56)


def slips(log, name, sigma):
    return log.assign(**{name: log[name] + sigma * NOISE[:, 0]})


def once(log, name, value):
    """A log in which this value stands once."""
    return log.assign(**{name: log[name].where(log.index != 500, value)})


def noisy(sigma_m, log=LOG):
    return log.assign(**log[["x_m", "y_m"]] + sigma_m * NOISE[: len(log)])


def integrated(factor=1.0):
    """Positions that are the integral of the encoders, but for a factor."""
    step_s = np.gradient(T)
    steps = (SPEED * step_s * np.exp(1j * np.cumsum(TURN * step_s))).to_numpy()
    place = dict(x_m=np.cumsum(steps.real), y_m=np.cumsum(steps.imag))
    return LOG.assign(speed_mps=factor * SPEED, **place)


def gyro(scale=1.0, bias=0.0, sigma=0.005, rows=1500):
    measured = scale * LOG["yaw_rate_true_radps"] + bias + sigma * NOISE[:, 0]
    return LOG.assign(gyro_radps=measured.where(LOG.index < rows))


def heading(offset=0.0, sign=1.0, unit=1.0):
    angle = sign * LOG["yaw_true_rad"] + offset + 0.02 * NOISE[:, 0]
    return LOG.assign(heading_rad=unit * ((angle + np.pi) % (2 * np.pi) - np.pi))


def spinning():
    """A robot that turns by 5.2 rad in the 2 s over which turns are compared.

    Wrapped, its heading turns the other way.
    """
    t = np.arange(0, 60, 0.1)
    yaw = 2.6 * t
    place = dict(x_m=0.2 * np.sin(yaw), y_m=-0.2 * np.cos(yaw))
    turns = dict(yaw_rate_radps=2.6 / 0.75, heading_rad=np.angle(np.exp(1j * yaw)))
    return pd.DataFrame(dict(t_s=t, speed_mps=0.55, **place, **turns))


def driven(duration_s, speed_of, turn_of, noise_m=0.0):
    """A log at 10 Hz of a robot whose speeds are functions of the time."""
    t = np.arange(0, duration_s, 0.1)
    speed = speed_of(t)
    turn = turn_of(t)
    place = np.cumsum(0.1 * MU * speed * np.exp(1j * np.cumsum(0.1 * KAPPA * turn)))
    place += noise_m * RANDOM.standard_normal((2, len(t))).T @ [1, 1j]
    true = dict(t_s=t, x_m=place.real, y_m=place.imag)
    return pd.DataFrame(true | dict(speed_mps=speed, yaw_rate_radps=turn))


def moves_only(speed_mps):
    return driven(60, lambda t: speed_mps + 0 * t, lambda t: 0 * t)


def reverses():
    """A robot that drives to and fro, in curves, and stands for a second in between."""

    def speed(t):
        return np.select([t % 20 < 9, (t % 20 >= 10) & (t % 20 < 19)], [0.6, -0.5], 0.0)

    return driven(200, speed, lambda t: 0.4 * np.sin(t / 7), 0.01)


def along_curves(speed_of):
    """A robot whose speeds keep their ratio along each curve, at a speed that the time gives."""
    return driven(400, speed_of, lambda t: np.where(t % 20 < 10, 0.5, -0.5) * speed_of(t), 0.01)


def circles_by_yaw():
    """A robot on circles, whose yaw from -π to π stands in the place of its rate.

    With the left encoder backwards it would drive nearly the same, but not quite.
    """
    log = driven(120, lambda t: 0.6 + 0.18 * np.sin(t / 5), lambda t: 0.3 + 0.09 * np.cos(t / 7))
    yaw = np.cumsum(0.1 * KAPPA * log["yaw_rate_radps"])
    return log.assign(yaw_rate_radps=np.angle(np.exp(1j * yaw)))


def plain(driven_m=40.0, turned_rad=20.0):
    """A robot that drives and turns so far in a minute, faster and slower."""
    return driven(
        60,
        lambda t: driven_m / 60 * (1 + 0.5 * np.sin(t)),
        lambda t: turned_rad / 60 * (1 + 0.5 * np.cos(t)),
    )


def unfilled(turned_rad=20.0):
    return plain(40.0, turned_rad).assign(yaw_rate_radps=0.0)


def carried(way_m):
    """Carried in the first of two pauses."""
    paused = change(T > 80, t_s=T + 99, x_m=X + way_m)
    return paused.assign(t_s=paused["t_s"] + 99 * (T > 120))


def slow(speed_mps):
    """The log at another speed, without positions for 20 s."""
    times = speed_mps / 0.6
    scaled = LOG.assign(speed_mps=times * SPEED, x_m=times * X, y_m=times * Y)
    return scaled.assign(x_m=scaled["x_m"].where((T < 10) | (T > 30)))


def during(seconds):
    """Rows of so many seconds, in which the robot drives and turns."""
    return T.between(10, 10 + seconds, inclusive="left")


def swapped(n):
    """So many rows with the one behind them in front."""
    place = np.arange(len(LOG))
    place[: 10 * n : 10] += 1
    place[1 : 10 * n : 10] -= 1
    return LOG.iloc[place]


def repeated(share):
    """Rows that have the time of the row before them."""
    return LOG.assign(t_s=T.where((LOG.index < 10) | (LOG.index > 10 + 1500 * share), T[10]))


REVERSES = reverses()
HEADER = pd.DataFrame([dict(zip(LOG, LOG))])
PASTED = pd.concat([LOG, HEADER, LOG.assign(x_m=X + 20)], ignore_index=True)
WORDS = pd.Series(np.where(LOG.index % 3, "FIX", "SINGLE"), dtype=object)
WORDS[5] = np.nan
UNSIGNED = REVERSES.assign(speed_mps=REVERSES["speed_mps"].abs())
UNTURNED = LOG.assign(yaw_rate_radps=TURN.abs())
BACKWARDS = by_sides(-1, 1)
OF_THE_MAP = LOG.assign(speed_mps=SPEED * np.cos(LOG["yaw_true_rad"]))
# {what is wrong: (log, pattern of what is said of it)}; what has an amount is in LIMITS
WRONG = {
    "speed in km/h, after a second": (
        pd.concat([LOG[:10].assign(segment="a"), LOG.assign(segment="b", speed_mps=3.6 * SPEED)]),
        "speed_mps may be in km/h .* 0.25 times",
    ),
    "speed in mm/s": (LOG.assign(speed_mps=1e3 * SPEED), "speed_mps is 566 .*in another unit"),
    "yaw rate clockwise": (LOG.assign(yaw_rate_radps=-TURN), "counted clockwise .* turns -0.754"),
    "gyro in another unit": (gyro(scale=5e3), "gyro_radps is .* it may be in another unit"),
    "heading clockwise": (heading(sign=-1.0), "heading_rad may be counted clockwise"),
    "heading in degrees": (heading(unit=180 / np.pi), "heading_rad may be in degrees .* rad: "),
    "rows in reverse": (LOG[::-1], "t_s falls 1499 times in 1500 rows; it may be in reverse"),
    "time in ms": (LOG.assign(t_s=1e3 * T), "rows 100 s apart .median.; t_s may be in ms, or they"),
    "time in whole seconds": (
        LOG.assign(t_s=np.floor(T)),
        "rows 1 s apart .median.; t_s may be rounded, as 1500 rows have 150 times",
    ),
    "segments that are lists": (LOG.assign(segment=[[1]] * 1500), "segment should be one column"),
    "no numbers": (LOG.assign(speed_mps="fast"), "speed_mps had no number in it, but 'fast'"),
    "time of day": (
        LOG.assign(t_s="10:00:01.2"),
        "t_s had no number in it, but '10:00:01.2'; it should be in seconds, or ISO 8601",
    ),
    "a column twice": (pd.concat([LOG, LOG[["x_m"]]], axis=1), "several columns x_m; it should"),
    "no rows": (LOG[:0], "DataFrame without rows; it should be a DataFrame with rows"),
    "no table": (7, "int; it should be a DataFrame with rows"),
    "words in pos_ok": (LOG.assign(pos_ok=WORDS), "pos_ok had the words 'SINGLE', 'FIX'; it"),
    "words in encoders_ok": (LOG.assign(encoders_ok=WORDS), "encoders_ok had the words 'SINGLE'"),
    "no position that counts": (LOG.assign(pos_ok=0), "pos_ok is true in none of 1500 rows"),
    "positions by GPS time": (
        in_rows_of_their_own(LOG, 18.0),
        "18 s ahead of .*, as GPS .*; position_delay_s=18 corr",
    ),
    "positions 37 s behind": (
        in_rows_of_their_own(LOG, -37.0),
        "37 s behind that of .*; position_delay_s=-37 corr",
    ),
    "positions 0.4 s late": (late(LOG, 4), "y_m come 0.39 ± 0.12 s later than"),
    "positions 0.3 s early": (late(LOG, -3), "seem to come 0.31 ± 0.11 s later than x_m"),
    "right encoder counts backwards": (by_sides(1, -1), ": the right encoder may count backwards"),
    "yaw in the place of the yaw rate": (
        LOG.assign(yaw_rate_radps=np.angle(np.exp(1j * LOG["yaw_true_rad"]))),
        "yaw_rate_radps is the angle since the beginning",
    ),
    "yaw of circles in the place of the yaw rate": (
        circles_by_yaw(),
        "angle since the beginning: so the encoders explain 100% .* as they are 5[01]%$",
    ),
    "counts of the encoders": (
        LOG.assign(speed_mps=0.1 * SPEED.cumsum(), yaw_rate_radps=0.1 * TURN.cumsum()),
        "speed_mps and yaw_rate_radps are way and angle since the beginning",
    ),
    "no speed as -1": (
        LOG.assign(speed_mps=SPEED.where(LOG.index % 7 > 0, -1)),
        "speed_mps are left out",
    ),
    "gyro of another clock": (
        LOG.assign(gyro_radps=np.roll(LOG["yaw_rate_true_radps"], 400)),
        "gyro_radps may be by another clock, or of another drive",
    ),
    "positions and wheels by two clocks": (
        in_rows_of_their_own(LOG, 5e6),
        "have no time in common: they are by two clocks",
    ),
    "two files pasted together": (PASTED, "falls back by 149.9 s; what follows counts as another"),
    "an hour back": (set_back(3600), "falls back by 3600 s, an hour, as"),
    "no positions for 30 s": (missing(FAULTY, "x_m", "y_m"), "positions .*up to 30.1 s"),
    "right encoder dead": (dead(1, 0), "the right encoder shows 0 for at least 2[3-6] s"),
    "straight on": (moves_only(0.5), "turns 0 rad in all: κ stays open"),
}


XY = "x_m", "y_m"
V, W = "speed_mps", "yaw_rate_radps"
# {what: (a log of an amount, what is said of it, an amount of which it is not, one of which it is)}
LIMITS = {
    "rows apart [s]": (lambda s: LOG.assign(t_s=10 * s * T), "s apart", 0.245, 0.255),
    "clock set back [s]": (set_back, "falls back", 1.0, 1.2),
    "minutes from an hour": (lambda m: set_back(3600 - 60 * m), "an hour, as", 1.1, 0.9),
    "rows unsorted": (swapped, "unsorted", 73, 78),
    "time rounded": (repeated, "t_s can be used", 0.89, 0.91),
    "segments": (
        lambda n: LOG[:100].assign(segment=np.arange(100) * n // 100),
        "ment has 21 values in 100 rows",
        20,
        21,
    ),
    "positions that never change": (lambda n: LOG[:n].assign(x_m=1, y_m=1), "never change", 5, 6),
    "rows, clockwise": (lambda n: times(-1, W)[:n], "clockwise|go only", 238, 245),
    "rows, late": (lambda n: late(LOG, 4)[:n], "later than speed_mps", 590, 630),
    "times repeat": (repeated, ": 1% of the rows have times", 0.0095, 0.012),
    "a spike [m/s]": (lambda v: change(T == 70, speed_mps=SPEED - v), "1 values of sp", 0.95, 1.05),
    "counter rolls over": (spikes, "warning: .* left out", 28, 33),
    "astray [m]": (lambda m: change(T == 70, x_m=X + m), "^note: .*1 values of x_m", 98, 102),
    "another zone of UTM": (lambda km: change(T > 75, x_m=X + 1e3 * km), "jump by", 0.98, 1.02),
    "positions rounded": (lambda m: LOG.assign(x_m=m * (X / m).round()), "x_m is r", 0.24, 0.26),
    "y rounded [m]": (lambda m: LOG.assign(y_m=m * (Y / m).round()), "y_m is r", 0.24, 0.26),
    "rows that stand": (lambda n: moves_only(0.001)[:n], "that moves: it drove", 49, 50),
    "way in a window [m]": (lambda m: moves_only(m / 60), "that moves", 0.32, 0.28),
    "way [m]": (plain, "drives 19 m: μ, the yaw and the lever arm stay open", 20.5, 19.0),
    "turns [rad]": (lambda w: plain(40.0, w), "turns 5.8 rad in all: κ stays open", 6.2, 5.8),
    "no positions [s]": (lambda s: missing(during(s), *XY), "positions are missing", 4.8, 5.2),
    "no encoders [s]": (lambda s: missing(during(s), V), "speeds are .* up to 5.2 s", 4.8, 5.2),
    "no positions at a speed [m/s]": (slow, "positions are missing", 0.043, 0.047),
    "no encoders move [s]": (lambda s: dead(0, 0, during(s)), "both .* 0 .* for 3 s", 7.2, 7.6),
    "left encoder dead": (lambda s: dead(0, 1, during(s)), "left .* shows 0", 7.2, 7.6),
    "outliers": (lambda m: change(T == 70, x_m=X + m), "of 1500 positions", 0.80, 0.85),
    "carried by hand in a pause": (lambda s: change(T > 80, t_s=T + s, x_m=X + 3), "pause", 29, 31),
    "carried [m]": (carried, "after a pause", 0.9, 1.02),
    "a gyro's scale": (lambda k: gyro(scale=k), "of another axis .* 0.0959", 0.138, 0.128),
    "gyro in degrees": (lambda k: gyro(scale=k), "in degrees", 12.9, 13.7),
    "a gyro's rows": (lambda n: gyro(-1.0, rows=n), "clockwise", 114, 118),
    "heading from north": (lambda rad: heading(offset=rad), "is 0.516 rad from", 0.49, 0.52),
    "a heading's noise": (lambda w: heading(1.2 + w * NOISE[:, 1]), "in which the", 0.67, 0.60),
    "speed in km/h": (lambda k: times(k, V), "in km/h", 3.1, 3.3),
    "cm/s": (lambda k: times(k, V), "in cm/s .* 0.0195 times", 44, 46),
    "mm/s": (lambda k: times(1 / k, *XY), "in mm/s", 580, 625),
    "degrees as metres": (lambda k: times(1 / k, *XY), "longitude", 17.3e3, 18.6e3),
    "feet": (lambda k: times(k, *XY), "in feet .* 1.59 times", 1.67, 1.77),
    "cm": (lambda k: times(k, *XY), "in cm .* 10.3 times", 10.7, 11.4),
    "positions in mm": (lambda k: times(k, *XY), "in mm", 215, 226),
    "yaw rate in degrees": (lambda k: times(k, W), "degrees per", 8.9, 9.6),
    "a yaw rate's unit": (lambda k: times(1 / k, W), "another unit", 4.2, 4.4),
    "wheels": (lambda k: times(1 / k, V), "go 1.12 times as far as the", 1.22, 1.25),
    "yaw rate corrected": (lambda k: times(1 / k, W), "turns .* times", 1.87, 1.92),
    "speed in knots": (lambda k: times(k, V), "the positions go only", 1.70, 1.75),
    "late [s]": (lambda s: in_rows_of_their_own(LOG, s), "later than speed_mps", 0.31, 0.33),
    "early [s]": (lambda s: in_rows_of_their_own(LOG, -s), "later than x_m", 0.29, 0.32),
    "odometry as positions": (integrated, "are the integral", 1.0020, 1.0016),
    "of the encoders, noisy": (lambda m: noisy(m, integrated()), "the integral", 0.0015, 0.0011),
    "another clock [s]": (lambda s: in_rows_of_their_own(LOG, s), "are by a clock", 66.0, 63.0),
    "another clock, noisy": (lambda m: in_rows_of_their_own(noisy(m), 18), "are by a", 0.12, 0.10),
    # A fault is named where without it 90 % of the path is explained.
    "an encoder backwards, slip": (
        lambda w: slips(BACKWARDS, W, w),
        "left encoder may",
        0.95,
        0.82,
    ),
    "an encoder backwards, noisy": (
        lambda m: noisy(m, BACKWARDS),
        "left encoder may",
        0.065,
        0.054,
    ),
    "a yaw rate's ripple": (
        lambda w: LOG.assign(**{W: w / 2 * np.sin(T)}),
        "in all rows",
        0.0104,
        0.0096,
    ),
    "yaw rate never filled": (unfilled, "in all rows, but", 2.65, 2.9),
    "no yaw rate, noisy": (lambda m: noisy(m, unfilled()), "in all rows, but", 0.3, 0.2),
    "speed without a sign": (lambda v: once(UNSIGNED, V, -v), "has no sign", 0.031, 0.029),
    "yaw rate without a sign": (lambda w: once(UNTURNED, W, -w), "has no sign", 0.021, 0.019),
    "without a sign, noisy": (lambda m: noisy(m, UNTURNED), "radps has no sign", 0.060, 0.048),
    "speed of the map": (lambda v: slips(OF_THE_MAP, V, v), "direction of the map", 0.33, 0.29),
}
WITH_ANOTHER = (  # such as spikes of a noise
    "no positions at a speed [m/s]",
    "another clock [s]",
    "an encoder backwards, slip",
    "speed of the map",
)


def log_with(what):
    """A log of WRONG, or of the amount of which a sentence of LIMITS is said."""
    return LIMITS[what][0](LIMITS[what][-1]) if what in LIMITS else WRONG[what][0]


@functools.cache
def findings_of(what):
    return rhec.doctor(log_with(what)).findings


@pytest.mark.parametrize("what", [*WRONG, *LIMITS])
def test_what_is_wrong_is_named_once(what):
    pattern = (WRONG | LIMITS)[what][1]
    findings = findings_of(what)
    said = [f"{each.severity}: {each.fact}" for each in findings]
    assert any(re.search(pattern, each) for each in said), said
    assert len(said) == 1 + (what in WITH_ANOTHER), said
    assert all(each.sentence.endswith(".") and each.remedy.endswith(".") for each in findings)


@pytest.mark.parametrize("what", LIMITS)
def test_a_sentence_begins_at_an_amount(what):
    log_of, pattern, smaller, _ = LIMITS[what]
    said = [f"{each.severity}: {each.fact}" for each in rhec.doctor(log_of(smaller)).findings]
    assert not any(re.search(pattern, each) for each in said), said


# Errors, warnings and notes, of checks in all places.
REPLAYED = [
    "speed in km/h",
    "gyro in degrees",
    "rows unsorted",
    "no numbers",
    "positions by GPS time",
    "positions 0.4 s late",
    "carried by hand in a pause",
    "straight on",
]


@pytest.mark.parametrize("what", REPLAYED)
def test_a_replay_refuses_for_the_first_error_and_warns(what, monkeypatch):
    """Before anything is estimated, unless it is told to trust the log."""
    monkeypatch.setattr(module, "estimate_samples", lambda *_, **__: 1 / 0)
    first = findings_of(what)[0]
    ends = dict(error=ValueError, warning=UserWarning, note=ZeroDivisionError)[first.severity]
    with warnings.catch_warnings(), pytest.raises(ends) as stopped:
        warnings.simplefilter("error")
        rhec.replay(log_with(what))
    assert first.severity == "note" or str(stopped.value) == first.fact
    if first.code != "unusable":
        with pytest.raises(ZeroDivisionError):
            rhec.replay(log_with(what), trust_log=True)


def test_the_page_says_what_is_said():
    """Each row of its table is a log, and … stands for words that are left out."""
    rows = re.findall(r"^\| ([^|]+) \| ([^|]+) \|$", PAGE.read_text("utf-8"), re.M)
    told = {what: words for what, words in rows if what in WRONG | LIMITS}
    assert len(told) > 40
    for what, words in told.items():
        pattern = re.escape(words).replace("…", ".*")
        said = [finding.fact for finding in findings_of(what)]
        assert any(re.search(pattern, fact) for fact in said), (what, said)


OF_TRACKS = LOG[["t_s", "x_m", "y_m", "v_left_mps", "v_right_mps"]]


@pytest.mark.parametrize(
    "log, width_m, said",
    [
        (OF_TRACKS.assign(v_right_mps=LOG["v_left_mps"]), TRACK_WIDTH_M, "as fast as each other"),
        (OF_TRACKS, 100 * TRACK_WIDTH_M, "v_right_mps by track_width_m may be in another unit"),
    ],
)
def test_tracks_and_their_distance_are_doubted_together(log, width_m, said):
    (found,) = rhec.doctor(log, track_width_m=width_m).findings
    assert said in found.fact


@pytest.mark.parametrize("what", ["speed in km/h", "yaw rate clockwise", "positions 0.4 s late"])
def test_a_position_a_second_is_enough(what):
    log = log_with(what)
    sparse = log.assign(**{name: log[name].where(log.index % 10 == 0) for name in XY})
    found = [each.code for each in rhec.doctor(sparse).findings]
    assert found == [each.code for each in findings_of(what)]


HEALTHY = {
    "simulated": LOG,
    "slower": recorded_log(5.0, 120.0, noise_m=0.03),
    "to and fro": REVERSES,
    "starts again and again": along_curves(lambda t: 0.6 * np.clip(t % 10 - 2, 0, 1)),
    "faster and slower along a curve": along_curves(lambda t: 0.6 + 0.2 * np.sin(t)),
    "the example": EXAMPLE,
    "without noise": recorded_log(10.0, 100.0),
    "without slip": noisy(0.02, integrated()),
    "without slip, noise of 5 mm": noisy(0.005, integrated()),
    "in UTM": LOG.assign(x_m=X + 5e5, y_m=Y + 5e6),
    "with a gyro": gyro(bias=0.02),
    "with a heading": heading(),
    "with a heading that wraps": spinning(),
    "late, then early": pd.concat([late(LOG, 5)[:750], late(LOG, -6)[750:]]),  # by no one delay
    "in rows of their own": in_rows_of_their_own(LOG, 0.05),
    "one row late": late(LOG, 1),
    "a wrapped truth": LOG.assign(yaw_true_rad=np.angle(np.exp(1j * LOG["yaw_true_rad"]))),
    "noise of 0.1 m": noisy(0.1),
    "noise of 0.5 m": noisy(0.5),
    "noise of 2 m": noisy(2.0),
    "a tenth of the positions": missing(LOG.index % 10 > 0, *XY),
    "positions for a second of five": times(1 / 1.3, W).assign(
        **missing(LOG.index % 50 >= 10, *XY)[[*XY]]
    ),
    "much slip": LOG.assign(speed_mps=1.5 * SPEED, yaw_rate_radps=2 * TURN),
    "two drives": pd.concat([LOG.assign(segment="a"), LOG.assign(segment="b", x_m=X + 20)]),
}


@pytest.mark.parametrize("what", HEALTHY)
def test_a_healthy_log_has_no_findings(what):
    diagnosis = rhec.doctor(HEALTHY[what])
    assert diagnosis.ok and str(diagnosis).endswith("Nothing was found.")


PUBLISHED = [name for name, each in fetch_recordings.RECORDINGS.items() if "not_run" not in each]


@pytest.mark.nightly
@pytest.mark.parametrize("name", PUBLISHED)
def test_recorded_logs_are_healthy(name):
    """Four published logs, fetched by their digests where they are not there.

    The tracked robot has seven yaw rates that are far from both neighbours.
    """
    try:
        file = fetch_recordings.fetch(name)
    except requests.ConnectionError:
        pytest.skip("no network, and data/fetch_recordings.py has not fetched it before")
    frame = fetch_recordings.read_frame(file)
    findings = rhec.doctor(convert(frame, fetch_recordings.RECORDINGS[name])).findings
    assert [each.code for each in findings] == ["left_out"] * ("tracked" in name)


@pytest.mark.nightly(keep=1)
@pytest.mark.parametrize("arm_m", [(-0.5, 0.2), (0.0, 0.0), (0.6, 0.0)])
@pytest.mark.parametrize("seed", [5, 6, 7])
def test_a_lever_arm_is_no_delay(arm_m, seed):
    log = recorded_log(10.0, 150.0, noise_m=0.02, seed=seed, arm_m=arm_m)
    assert rhec.doctor(log).ok
    assert abs(likeliest_delay(prepare(log))) < 0.1


@pytest.mark.nightly(keep=2)
@pytest.mark.parametrize("delay_s", [0.3, -1.0, 1.5])
def test_a_delay_is_found_and_made_up_for(delay_s):
    assert likeliest_delay(prepare(late(LOG, round(10 * delay_s)))) == pytest.approx(
        delay_s, abs=0.1
    )
    assert rhec.doctor(late(LOG, round(10 * delay_s)), position_delay_s=delay_s).ok


@pytest.mark.parametrize("share_of_turns, is_late", [(0.81, True), (0.79, False)])
def test_a_delay_explains_distances_and_turns(share_of_turns, is_late):
    """One that explains less of the turns than none does is no delay of the positions."""
    in_time = path_checks._Slope(0.9, 0.01, 0.8), path_checks._Slope(0.8, 0.01, 0.8)
    late = in_time[0]._replace(share=0.9), in_time[1]._replace(share=share_of_turns)
    motion = path_checks._Motion(0.5, 0.01, in_time, late)
    assert path_checks.positions_are_late(motion) == is_late


def test_facts_are_those_of_a_plain_loop_over_the_rows():
    """Of two drives, one with a pause, among rows of an IMU; a pause counts for a second at most.

    Of positions and encoders few count, and the first time after a pause is doubted.
    """
    second = LOG[:300].assign(segment=1, t_s=T + 20.0 * (T > 15))
    log = pd.concat([LOG[:400].assign(segment=0), second], ignore_index=True)
    log = log.assign(pos_ok=log.index % 4 == 0, encoders_ok=log.index % 3 == 0)
    imu = pd.DataFrame(dict(t_s=log["t_s"] + 0.05, segment=log["segment"], gyro_radps=0.1))
    imu = imu.assign(pos_ok=True, encoders_ok=True)
    expected = dict(duration_s=0.0, rows_usable=1 - 1 / 1400, driven_m=0.0, turned_rad=0.0)
    expected |= dict(positions_usable=log["pos_ok"].mean())
    steps_s = dict(pos_ok=[], encoders_ok=[])
    for _, drive in log.groupby("segment"):
        expected["duration_s"] += drive["t_s"].max() + 0.05 - drive["t_s"].min()
        for flag, steps in steps_s.items():
            for one, other in itertools.pairwise(drive[drive[flag]].itertuples()):
                steps.append(other.t_s - one.t_s)
                if flag == "encoders_ok":
                    expected["driven_m"] += abs(other.speed_mps) * min(steps[-1], 1.0)
                    expected["turned_rad"] += abs(other.yaw_rate_radps) * min(steps[-1], 1.0)
    expected["positions_hz"] = 1 / np.median(steps_s["pos_ok"])
    expected["encoders_hz"] = 1 / np.median(steps_s["encoders_ok"])
    both = pd.concat([log, imu]).sort_values(["segment", "t_s"], ignore_index=True)
    found = rhec.doctor(both).facts
    assert {name: found[name] for name in expected} == pytest.approx(expected)


@pytest.mark.parametrize(
    "columns, given_m, width_m, source",
    [
        ([*LOG], 0.6, 0.6, "as given"),
        ([*LOG], None, TRACK_WIDTH_M, "by the log's v_left_mps, v_right_mps and yaw_rate_radps"),
        ([*LOG.columns[:5]], None, paper.TRACK_WIDTH_M, "the paper's"),
    ],
)
def test_the_track_width_has_a_source(columns, given_m, width_m, source):
    recording = prepare(LOG[columns], given_m)
    assert recording.track_width_m == pytest.approx(width_m)
    assert source in recording.width_source


def test_the_command_ends_with_the_exit_code_of_its_findings(tmp_path, capsys):
    for name, log, code in (("good", LOG, 0), ("bad", dead(0, 1), 1)):
        log.to_csv(tmp_path / f"{name}.csv", index=False)
        assert main(["log", str(tmp_path / f"{name}.csv"), "--check", "--json"]) == code
        assert json.loads(capsys.readouterr().out)["ok"] == (code == 0)
    in_rows_of_their_own(LOG, 18.0).to_csv(tmp_path / "gps.csv", index=False)
    assert main(["log", str(tmp_path / "gps.csv"), "--check"]) == 1
    assert "; --position-delay-s 18 corrects this." in capsys.readouterr().out
