"""A recorded log at a glance: what was taken for what, the traction, and whether to trust it.

    rhec log FILE

reads and checks the log, smooths it, runs the estimator as the robot would have on its way, hides
positions from it, and says what follows.
"""

from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pandas as pd

from rhec.core._casadi.validation import Flag, Positive, Real, checked
from rhec.logs.calibration import outage_errors
from rhec.logs.doctor import Diagnosis, doctor
from rhec.logs.reader import found_lines, read
from rhec.logs.recording import delayed, prepare, travelled
from rhec.logs.replay import InitialGuess, estimate_samples, replay_scenario
from rhec.logs.terms import slopes
from rhec.simulation.columns import ESTIMATE, MEASUREMENTS, RECORDED_TRUTH, SENSORS, SIGMA

_MOVING = 0.05  # encoder speed of a moving robot [m/s, rad/s]
_KNOWN_YAW_RAD = 0.25  # standard deviation of a yaw that is known
_OFTEN = 0.1  # share of the samples in which the robot moves
_LEAST_TURNED_RAD = 6.0  # by the encoders; a log that turns less does not determine κ
_LEAST_COVERED = 0.8  # share of the causal yaw within its 95 % of the smoothed one
_SETTLED_S = 10.0  # after which the causal estimate is compared with the smoothed one


class Summary(NamedTuple):
    """What a log says of its robot.

    Args:
        taken: Sentences: which columns were taken for what, by which clock, and which track width.
        diagnosis: The Diagnosis of the log.
        traction: DataFrame, rows μ and κ: value of the whole log with its 95 % interval (low,
            high), and the median of the estimates on the way. None for a log that is refused.
        figures: {name: number} by which to judge the estimator; None likewise.
        verdict: Whether to trust it, and if not, why and what helps.
        samples: DataFrame of the smoothed samples; None likewise.
    """

    taken: list
    diagnosis: Diagnosis
    traction: pd.DataFrame | None
    figures: dict | None
    verdict: str
    samples: pd.DataFrame | None

    def __str__(self) -> str:
        lines = ["Taken for what:", *(f"  {line}" for line in self.taken), "", "Checked:"]
        lines += [f"  {line}" for line in str(self.diagnosis).splitlines()]
        if self.traction is not None:
            table = self.traction.to_string(float_format="{:.3f}".format)
            lines += ["", "Traction (motion over ground by motion of the tracks):"]
            lines += [f"  {line}" for line in table.splitlines()]
            lines += [f"  {name}: {value:.3g}" for name, value in self.figures.items()]
        return "\n".join([*lines, "", self.verdict])


@checked
def summarise(
    log: Any,
    *,
    track_width_m: Positive | None = None,
    position_delay_s: Real = 0.0,
    trust_log: Flag = False,
) -> Summary:
    """Summarise what a recorded log says of its robot.

    Args:
        log: DataFrame, as `rhec.replay` takes it; or the path of a file, as `rhec.logs.read` takes
            it.
        track_width_m: As in `rhec.replay` [m].
        position_delay_s: Delay of the time stamps of the positions [s].
        trust_log: Whether to go on with a log that `rhec.replay` would refuse.

    Returns:
        Summary.

    Raises:
        ValueError: If there is a path, and its file cannot be read.
    """
    if isinstance(log, str | Path):
        log = read(log)
    diagnosis = doctor(log, track_width_m=track_width_m, position_delay_s=position_delay_s)
    errors = [each for each in diagnosis.findings if each.severity == "error"]
    is_parsed = bool(diagnosis.facts)
    if errors and not (trust_log and is_parsed):
        verdict = f"No estimate: {errors[0].sentence} {errors[0].remedy}"
        return Summary(found_lines(log), diagnosis, None, None, verdict, None)
    recording = delayed(prepare(log, track_width_m), position_delay_s)
    scenario = replay_scenario("rhe", recording, {})
    about = InitialGuess(about_arm_m=log.attrs.get("lever_arm_m", (0.0, 0.0)))
    causal = estimate_samples(recording, scenario, about)
    smoothed = estimate_samples(recording, scenario, about, smooth=True)
    traction = _traction(causal, smoothed)
    figures = _figures(recording, causal, smoothed)
    verdict = _verdict(recording, traction, figures)
    taken = [*found_lines(log), *_taken(recording, track_width_m)]
    return Summary(taken, diagnosis, traction, figures, verdict, smoothed)


def _taken(recording, track_width_m):
    """Which columns were taken for what, and the track width."""
    roles = dict(
        positions=MEASUREMENTS[:2],
        encoders=MEASUREMENTS[2:],
        gyro=[SENSORS["gyro"]],
        heading=[SENSORS["heading"]],
        truth=RECORDED_TRUTH,
    )
    lines = []
    for role, names in roles.items():
        columns = [recording.columns[name] for name in names if name in recording.rows]
        unused = ", which no estimator sees" if role == "truth" else ""
        if columns:
            lines.append(f"{role}: {', '.join(dict.fromkeys(columns))}{unused}")
    width = f"track width: {recording.track_width_m:.3g} m"
    if not track_width_m:
        width += (
            ", by the log's track speeds or the paper; track_width_m (--track-width-m) tells it"
        )
    return [*lines, width]


def _traction(causal, smoothed):
    """μ and κ of the whole log by smoothed motion, and the medians of the causal estimates."""
    rows = {}
    for name, slope, column in zip("μκ", slopes(smoothed), ESTIMATE[4:]):
        low = slope.value - 1.96 * slope.sigma
        high = slope.value + 1.96 * slope.sigma
        median = causal.loc[_moves(causal), column].median()
        rows[name] = {"value": slope.value, "low": low, "high": high, "on the way": median}
    return pd.DataFrame(rows).T


def _moves(samples):
    return (samples[MEASUREMENTS[2:]].abs() > _MOVING).any(axis=1)


def _figures(recording, causal, smoothed):
    """Numbers by which to judge the estimates, {name: number}."""
    yaw = ESTIMATE[2]
    sigma_yaw = SIGMA[2]
    moves = _moves(causal)
    begins = causal.groupby("segment")["t_s"].transform("first")
    settled = moves & (causal["t_s"] > begins + _SETTLED_S) & causal[yaw].notna()
    apart = (causal[yaw] - smoothed[yaw] + np.pi) % (2 * np.pi) - np.pi
    known = smoothed.dropna(subset=yaw).groupby("segment")
    errors_m = outage_errors(recording, {}, known[yaw].first())
    return {
        "turned [rad]": travelled(recording.rows, MEASUREMENTS[3]),
        "positions used": float((causal["position_accepted"] & moves).sum() / moves.sum()),
        "yaw unknown, share": float((smoothed[sigma_yaw] > _KNOWN_YAW_RAD)[moves].mean()),
        "yaw within its 95 % of the smoothed one": float(
            (apart.abs() <= 1.96 * causal[sigma_yaw])[settled].mean()
        ),
        "yaw from the smoothed one, RMS [rad]": float(np.sqrt((apart[settled] ** 2).mean())),
        "10 s without positions, median error [m]": float(np.nanmedian(errors_m))
        if len(errors_m)
        else np.nan,
    }


def _verdict(recording, traction, figures):
    """Whether to trust the estimates, and if not, why and what helps."""
    doubts = []
    if figures["turned [rad]"] < _LEAST_TURNED_RAD:
        doubts.append("κ is not excited: drive two figures of eight")
    if figures["yaw unknown, share"] > _OFTEN:
        doubts.append(
            f"the yaw is unknown in {figures['yaw unknown, share']:.0%} of the drive, because "
            "positions and encoders contradict each other or say little: log a gyro or a heading"
        )
    if figures["yaw within its 95 % of the smoothed one"] < _LEAST_COVERED:
        doubts.append("σ is too small for this log: run rhec calibrate, and replay with it")
    if traction.loc["κ", "value"] > 1:
        doubts.append(
            "κ is above 1, so the driver has already corrected the yaw rate: give the track speeds "
            "and the geometric track_width_m"
        )
    if doubts:
        return f"Do not trust it yet: {'; '.join(doubts)}."
    heading = " A gyro or a heading would check the yaw." if not recording.sensors else ""
    return (
        "Trust it. Tracks that slip sideways all the time, as on ice, look alike without a "
        f"heading.{heading} Next: rhec calibrate FILE --yaml robot.yaml, rhec replay FILE."
    )
