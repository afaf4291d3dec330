"""A recorded log at a glance: what was taken for what, the traction, and whether to trust it.

    rhec log FILE

reads and checks the log, smooths it, runs the RHE and two filters as the robot would have on its
way, hides positions from them, and says what follows.
"""

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import pandas as pd
from scipy.special import bdtr

from rhec.core._casadi.validation import Flag, Positive, Real, checked
from rhec.logs import terms
from rhec.logs.comparison import Comparison, compare
from rhec.logs.doctor import Diagnosis, doctor
from rhec.logs.reader import read_if_path
from rhec.logs.recording import delayed, prepare, travelled
from rhec.logs.remarks import unknown_yaw
from rhec.logs.replay import InitialGuess, at_rows, estimate_samples, replay_of, replay_scenario
from rhec.simulation.columns import MEASUREMENTS, RECORDED_TRUTH, SENSORS

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_LEAST_TURNED_RAD = 6.0  # by the encoders; a log that turns less does not determine κ
_LEAST_COVERED = 0.8  # share of the causal yaw within its 95 % of the smoothed one
_HONEST = 0.95  # share of hidden positions within their 95 %
_BY_CHANCE = 0.05  # a share that is less likely than this is not by chance
_EXPLAINED = """\
hidden 2 s, 10 s: error, in the median, so long after the last position
in 95 %: share of n hidden positions within their 95 %, which should be 0.95
NIS: squared innovations by their variance; below 1 the assumed noise is too large
EKF of (μ, κ): the same model, without a lever arm of the antenna; ICR: centres of rotation"""
_ASKED = (
    "If you know them, give the distance of the tracks (--track-width-m), the radius of wheels "
    "whose speeds are in rad/s (--wheel-radius-m), and the factor by which the driver has already "
    "multiplied the distance (--wheel-separation-multiplier)."
)


@dataclass(frozen=True)
class Summary:
    """What a log says of its robot.

    Args:
        taken: {role: what}: which columns were taken for what, which clock, which track width.
        asked: A sentence: what the log does not say of the robot.
        diagnosis: The Diagnosis of the log.
        verdict: Whether to trust the estimates, and if not, why and what helps.
        traction: DataFrame, rows μ and κ: regression of the smoothed motion on the encoders over
            the whole log, with its 95 % interval (low, high). None, as all below, for a log that
            is refused.
        comparison: Comparison of the RHE, causal, with an EKF of (μ, κ) and one of ICR.
        samples: DataFrame of the smoothed samples.
        estimates: DataFrame, the smoothed estimates at the rows of the log, as of `rhec.replay`.
        yaml: The robot's parameters for ROS (`rhec.logs.terms`).
    """

    taken: dict
    asked: str
    diagnosis: Diagnosis
    verdict: str
    traction: pd.DataFrame | None = None
    comparison: Comparison | None = None
    samples: pd.DataFrame | None = None
    estimates: pd.DataFrame | None = None
    yaml: str = ""

    def __str__(self) -> str:
        taken = [f"  {role:<16}{what}" for role, what in self.taken.items()]
        lines = ["Taken for what:", *taken, "", "Checked:"]
        lines += _indented(str(self.diagnosis))
        if self.traction is not None:
            lines += ["", "Traction (motion over ground by motion of the tracks):"]
            lines += _indented(_text(self.traction))
            lines += ["", "On the way, with 10 s of positions hidden again and again:"]
            lines += _indented(_text(self.comparison.table))
            lines += _indented(_EXPLAINED)
        return "\n".join([*lines, "", self.asked, "", self.verdict])

    def plot(self) -> "Figure":
        """Draw traction and yaw with two standard deviations, and the path.

        Returns:
            A matplotlib Figure.

        Raises:
            ValueError: If the log was refused.
        """
        if self.samples is None:
            raise ValueError(f"the log has no estimates to draw. {self.verdict}")
        # Imported here, because most summaries are only printed.
        from rhec.plot import log_overview

        return log_overview(self)


def _text(table):
    return table.to_string(formatters=dict(n="{:.0f}".format), float_format="{:.3f}".format)


def _indented(text):
    return [f"  {line}" for line in text.splitlines()]


@checked
def log(
    file: Any,
    *,
    track_width_m: Positive | None = None,
    position_delay_s: Real = 0.0,
    trust_log: Flag = False,
) -> Summary:
    """Say what a recorded log tells of its robot, and whether to trust it.

    Args:
        file: Path of a file, as `rhec.logs.read` takes it; or a DataFrame, as `rhec.replay` takes.
        track_width_m: As in `rhec.replay` [m].
        position_delay_s: Delay of the time stamps of the positions [s].
        trust_log: Whether to go on with a log that `rhec.replay` would refuse.

    Returns:
        Summary. Printed, it is a page of text; `plot()` draws it.

    Raises:
        ValueError: If there is a path, and its file cannot be read.
    """
    recorded = read_if_path(file)
    diagnosis = doctor(recorded, track_width_m=track_width_m, position_delay_s=position_delay_s)
    errors = [each for each in diagnosis.findings if each.severity == "error"]
    is_parsed = bool(diagnosis.facts)
    if errors and not (trust_log and is_parsed):
        verdict = f"No estimate: {errors[0].sentence} {errors[0].remedy}"
        return Summary(_taken(recorded), _ASKED, diagnosis, verdict)
    recording = delayed(prepare(recorded, track_width_m), position_delay_s)
    about = InitialGuess(about_arm_m=recorded.attrs.get("lever_arm_m", (0.0, 0.0)))
    scenario = replay_scenario("rhe", recording, {})
    smoothed = estimate_samples(recording, scenario, about, smooth=True)
    comparison = compare(recording, smoothed, about)
    slopes = terms.slopes(smoothed)
    rows = [terms.row(*slope)[:3] for slope in slopes]
    traction = pd.DataFrame(rows, index=["μ", "κ"], columns=["value", "low", "high"])
    width_m = recording.track_width_m
    parameters = terms.table(*slopes, width_m, terms.constants(smoothed))
    noise = terms.noise(smoothed)
    return Summary(
        taken=_taken(recorded, recording),
        asked="" if track_width_m else _ASKED,
        diagnosis=diagnosis,
        verdict=_verdict(recording, diagnosis, traction, comparison, smoothed),
        traction=traction,
        comparison=comparison,
        samples=smoothed,
        estimates=at_rows(smoothed, recording, recorded, replay_of(scenario)),
        yaml=terms.as_yaml(parameters, width_m, noise, diagnosis.facts["encoders_hz"]),
    )


def _taken(log, recording=None):
    """What the reader found in a log, which columns were taken for what, and the track width."""
    rows = dict(getattr(log, "attrs", {}).get("inferred", {}))
    if recording is not None:
        roles = {
            "positions": MEASUREMENTS[:2],
            "encoders": MEASUREMENTS[2:],
            "gyro": [SENSORS["gyro"]],
            "heading": [SENSORS["heading"]],
            "truth, unseen": RECORDED_TRUTH,
        }
        for role, names in roles.items():
            # The true speeds of a simulated run are computed from several of its columns.
            columns = [recording.columns[name] for name in names if name in recording.columns]
            if columns:
                found = [*dict.fromkeys(columns), *([rows[role]] if role in rows else [])]
                rows[role] = ", ".join(found)
        rows["track width"] = f"{recording.track_width_m:.3g} m, {recording.width_source}"
    return rows


def _verdict(recording, diagnosis, traction, comparison, smoothed):
    """Whether to trust the estimates, and if not, why and what helps."""
    doubts = [each.fact for each in diagnosis.findings if each.code == "moved_in_silence"]
    if travelled(recording.rows, MEASUREMENTS[3]) < _LEAST_TURNED_RAD:
        doubts.append("κ is not excited: drive two figures of eight")
    if unknown := unknown_yaw(smoothed):
        doubts.append(f"{unknown[0].lower()}{unknown[1:-1]}")
    rhe = comparison.table.iloc[0]
    if rhe["yaw in 95 %"] < _LEAST_COVERED:
        doubts.append(
            f"the yaw is unknown on the way: {rhe['yaw in 95 %']:.0%} of it lie within their 95 % "
            "of the smoothed yaw; give a first_yaw_rad, or log a heading"
        )
    hidden = int(rhe["n"])
    covered = round(rhe["in 95 %"] * hidden) if hidden else 0
    if hidden and bdtr(covered, hidden, _HONEST) < _BY_CHANCE:
        doubts.append(
            f"σ is too small: {rhe['in 95 %']:.0%} of {hidden} positions that were hidden for 10 s "
            "lie within their 95 %, so the yaw is less certain than said: run rhec calibrate"
        )
    if traction.loc["κ", "value"] > 1:
        doubts.append(
            "κ is above 1: where the driver has already corrected the yaw rate, give its "
            "wheel_separation_multiplier (--wheel-separation-multiplier); else the tracks slip "
            "unlike each other"
        )
    if doubts:
        return f"Do not trust it yet: {'; '.join(doubts)}."
    heading = " A gyro or a heading would check the yaw." if not recording.sensors else ""
    return (
        "Trust it. What was checked cannot tell tracks that slip sideways all the time, as on "
        f"ice.{heading} Next: rhec calibrate FILE --yaml robot.yaml, rhec replay FILE --calibrated."
    )
