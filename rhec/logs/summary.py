"""A recorded log on one page: what it is, the traction, how well the yaw is known, and a verdict.

    rhec log FILE

reads and checks the log, smooths it, runs the RHE as the robot would have on its way, hides
positions from it, and says what follows.
"""

import dataclasses
import json
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
import pandas as pd

from rhec.core._casadi.validation import Flag, Positive, Real, checked
from rhec.logs import terms
from rhec.logs.calibration import LOG_ARGUMENTS, calibrate_recorded
from rhec.logs.checks import Diagnosis, diagnosed
from rhec.logs.course import SIGMA_BY_COURSE, unknown_yaw
from rhec.logs.finding import Severity, passed
from rhec.logs.judge import HIDDEN_S, judge
from rhec.logs.likelihood import Calibration
from rhec.logs.motion import LEAST_TURNED_RAD, turned_rad
from rhec.logs.reader import read_if_path
from rhec.logs.recording import Recording, delayed
from rhec.logs.replay import InitialGuess, at_rows, estimate_samples, replay_of, replay_scenario
from rhec.simulation.columns import MEASUREMENTS, RECORDED_TRUTH, SENSORS, SIGMA, SIGMAS_OF_SENSORS
from rhec.simulation.scenario import Scenario
from rhec.tracked_robot.tuning import sigma_v_of

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_LEAST_HIDDEN = 3  # stretches of hidden positions; fewer are no test
# A larger factor of σ says that something happens of which the estimator knows nothing.
_MOST_INFLATED = 4.0
_MOST_TRACTION = 1.5  # a larger one, or a negative one, is none


class Judgement(NamedTuple):
    """The estimator that was judged, of which `rhec.export` makes C."""

    recording: Recording
    scenario: Scenario
    first: InitialGuess
    inflation: float  # by which its standard deviations are to be multiplied


@dataclasses.dataclass(frozen=True)
class Summary:
    """What a log says of its robot.

    Args:
        taken: {role: what}: which columns were taken for what, which clock, which track width.
        diagnosis: The Diagnosis of the log.
        verdict: Whether to trust the estimates, and if not, the strongest doubt and what helps.
        doubts: All doubts, sentences, the strongest first.
        numbers: {name: number} of the page. Empty, and all below None, for a log that is refused.
        traction: DataFrame, rows μ, κ, drift [rad/m]: regression of the smoothed motion on the
            encoders over the whole log, with its 95 % interval (low, high).
        way: DataFrame of the samples of the RHE as a robot runs it on its way.
        samples: DataFrame of the smoothed samples.
        estimates: DataFrame, the smoothed estimates at the rows of the log, as of `rhec.replay`.
        calibration: The Calibration by which was judged, if there was to be one.
        parameters: DataFrame of the robot's parameters with their intervals (`rhec.logs.terms`).
        yaml: These for ROS.
        judged: The estimator that was judged.
    """

    taken: dict
    diagnosis: Diagnosis
    verdict: str
    doubts: tuple = ()
    numbers: dict = dataclasses.field(default_factory=dict)
    traction: pd.DataFrame | None = None
    way: pd.DataFrame | None = None
    samples: pd.DataFrame | None = None
    estimates: pd.DataFrame | None = None
    calibration: Calibration | None = None
    parameters: pd.DataFrame | None = None
    yaml: str = ""
    judged: Judgement | None = None

    def __str__(self) -> str:
        lines = [*_what_it_is(self)]
        if self.traction is not None:
            lines += [_traction_line(self), *_test_lines(self.numbers)]
        lines += [self.verdict]
        if self.numbers:
            warned, noted = (self._said(each) for each in (Severity.WARNING, Severity.NOTE))
            lines += [f"Warnings: {warned or 'none.'}"]
            lines += [f"Notes: {noted}"] if noted else []
        return "\n".join(lines)

    def _said(self, severity):
        """The sentences of the findings of one severity."""
        found = self.diagnosis.findings
        return " ".join(each.sentence for each in found if each.severity is severity)

    @property
    def details(self) -> str:
        """All else: what was taken for what, what was checked, parameters, calibration."""
        taken = [f"  {role:<16}{what}" for role, what in self.taken.items()]
        parts = [["Taken for what:", *taken], ["Checked:", *_indented(str(self.diagnosis))]]
        if self.parameters is not None:
            table = self.parameters.to_string(float_format="{:.4g}".format)
            parts.append(["Parameters of the robot, with 95 % intervals:", *_indented(table)])
        if self.calibration is not None:
            parts.append(["Calibration:", *_indented(str(self.calibration))])
        if self.doubts:
            parts.append(["All doubts:", *(f"  - {doubt}" for doubt in self.doubts)])
        return "\n\n".join("\n".join(part) for part in parts)

    def to_json(self) -> str:
        """All numbers and sentences as JSON; null where a number is not known."""
        tables = {
            name: None if table is None else json.loads(table.to_json(orient="index"))
            for name, table in (("traction", self.traction), ("parameters", self.parameters))
        }
        told = dict(
            verdict=self.verdict,
            doubts=self.doubts,
            taken=self.taken,
            numbers={name: _or_null(value) for name, value in self.numbers.items()},
            **tables,
            calibration=None if self.calibration is None else dict(self.calibration),
            diagnosis=json.loads(self.diagnosis.to_json()),
        )
        return json.dumps(told, indent=2, ensure_ascii=False)

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


def _indented(text):
    return [f"  {line}" for line in text.splitlines()]


def _or_null(value):
    return None if isinstance(value, float) and not np.isfinite(value) else value


# The page


def _what_it_is(summary):
    """What the log is: how long it is, which sensors it has, and by which clock."""
    facts = summary.diagnosis.facts
    if not facts:
        return []
    noise = f"σ {max(facts['position_sigma_m'], facts['declared_sigma_m']):.2g} m"
    sensors = [f"positions at {facts['positions_hz']:.3g} Hz ({noise})"]
    sensors.append(f"encoders at {facts['encoders_hz']:.3g} Hz")
    sensors += [name for name in SENSORS if name in summary.taken]
    size = f"{facts['duration_s']:.0f} s, {facts['driven_m']:.0f} m, {facts['turned_rad']:.0f} rad"
    roles = ("positions", "encoders", *SENSORS, "time")
    taken = [summary.taken[role] for role in roles if role in summary.taken]
    return [f"{size}; {', '.join(sensors)}", f"from {'; '.join(taken)}"]


def _plus_minus(row):
    """A value with half of its 95 % interval, to two digits of the latter."""
    half = (row["high"] - row["low"]) / 2
    if not np.isfinite(half) or half <= 0:
        return "unknown"
    digits = max(0, 1 - int(np.floor(np.log10(half))))
    return f"{row['value']:.{digits}f} ± {half:.{digits}f}"


def _traction_line(summary):
    """μ and κ with their intervals, and the driver's parameters that follow."""
    told = [f"{name} {_plus_minus(summary.traction.loc[name])}" for name in ("μ", "κ")]
    drift = summary.traction.loc["drift"]
    if drift["low"] > 0 or drift["high"] < 0:
        told.append(f"drift {_plus_minus(drift)} rad/m")
    if not 0 < summary.traction.loc["κ", "value"] < _MOST_TRACTION:
        return "   ".join(told)
    multiplier, width = (
        summary.parameters.loc[name, "value"]
        for name in ("wheel_separation_multiplier (1/κ)", "effective track width")
    )
    follows = (
        f"→ wheel_separation_multiplier {multiplier:.3g} beside radius multipliers of 1, "
        f"or a track width of {width:.3g} m"
    )
    return f"{'   '.join(told)}   {follows}"


def _test_lines(numbers):
    """How well the yaw is known, and how many of the hidden positions were where they should."""
    hidden = numbers["hidden"]
    lines = [f"yaw known to {numbers['yaw_sigma_rad']:.2g} rad (σ, on the way)"]
    if not hidden:
        return [*lines, f"no position could be hidden for {HIDDEN_S:g} s: nothing was tested"]
    lines[0] += (
        f"; {numbers['hidden_error_m']:.2g} m off after {HIDDEN_S:g} s without positions (median)"
    )
    test = f"{numbers['hidden_covered']} of {hidden} hidden positions were within their 95 %"
    if numbers["inflation"] > 1:
        test += f"; all σ are made {numbers['inflation']:.2g} times as large as the estimator's"
    return [*lines, test]


# The judgement


@checked
def log(
    file: Any,
    *,
    track_width_m: Positive | None = None,
    position_delay_s: Real = 0.0,
    calibrate: Flag = False,
    trust_log: Flag = False,
) -> Summary:
    """Say what a recorded log tells of its robot, and whether to trust it.

    Args:
        file: Path of a file, as `rhec.logs.read` takes it; or a DataFrame, as `rhec.replay` takes.
        track_width_m: As in `rhec.replay` [m].
        position_delay_s: Delay of the time stamps of the positions [s].
        calibrate: Whether to judge with the noise, the slip, the place of the antenna and the delay
            that `rhec.calibrate` finds in the log. This takes longer.
        trust_log: Whether to go on with a log that `rhec.replay` would refuse.

    Returns:
        Summary. Printed, it is a page of text; `plot()` draws it.

    Raises:
        ValueError: If there is a path, and its file cannot be read.
    """
    recorded = read_if_path(file)
    recording, diagnosis = diagnosed(recorded, track_width_m, position_delay_s)
    errors = [each for each in diagnosis.findings if each.severity is Severity.ERROR]
    if recording is None or (errors and not trust_log):
        verdict = f"No estimate: {errors[0].sentence} {errors[0].remedy}"
        return Summary(_taken(recorded), diagnosis, verdict)
    found = None
    fields = {}
    first = InitialGuess()
    if calibrate:
        found = calibrate_recorded(recording, position_delay_s)
        position_delay_s = found.get("position_delay_s", position_delay_s)
        fields = {name: each for name, each in found.items() if name not in LOG_ARGUMENTS}
        first = first._replace(lever_arm_m=found.get("lever_arm_m"))
    recording = delayed(recording, position_delay_s)
    scenario = replay_scenario("rhe", recording, fields)
    smoothed = estimate_samples(recording, scenario, first, smooth=True)
    way, numbers = judge(
        recording,
        lambda shown: estimate_samples(shown, scenario, first),
        smoothed,
        sigma_v_of(scenario),
    )
    inflation = numbers["inflation"]
    smoothed, way = (_inflated(each, inflation) for each in (smoothed, way))
    slopes = terms.slopes(smoothed)
    parameters = terms.of_log(slopes, smoothed, recording.track_width_m, found)
    traction = pd.DataFrame(
        [terms.row(*slope)[:3] for slope in slopes],
        index=["μ", "κ", "drift"],
        columns=["value", "low", "high"],
    )
    lacking = [*_lacking(recording, traction, numbers)]
    doubts = (
        *_contradicted(recording, diagnosis, traction, found),
        *lacking,
        *_unsure(traction, numbers, smoothed, found),
    )
    yaml = terms.as_yaml(
        parameters, recording.track_width_m, terms.noise(smoothed), diagnosis.facts["encoders_hz"]
    )
    return Summary(
        taken=_taken(recorded, recording),
        diagnosis=diagnosis,
        verdict=_verdict(doubts, lacking, recording, found),
        doubts=doubts,
        numbers=numbers | diagnosis.facts,
        traction=traction,
        way=way,
        samples=smoothed,
        estimates=at_rows(smoothed, recording, recorded, replay_of(scenario)),
        calibration=found,
        parameters=parameters,
        yaml=yaml,
        judged=Judgement(recording, scenario, first, inflation),
    )


def _inflated(samples, factor):
    """Samples with larger standard deviations; what the course adds to that of the yaw stays."""
    sigmas = samples.columns.intersection([*SIGMA, *SIGMAS_OF_SENSORS.values()])
    wider = samples.assign(**{name: factor * samples[name] for name in sigmas})
    yaw = SIGMA[2]
    variance = np.square(wider[yaw]) - (factor**2 - 1) * np.square(samples[SIGMA_BY_COURSE])
    return wider.assign(**{yaw: np.sqrt(np.maximum(variance, 0))})


def _taken(log, recording=None):
    """What the reader found in a log, which columns were taken for what, and the track width."""
    rows = dict(getattr(log, "attrs", {}).get("inferred", {}))
    if recording is not None:
        roles = {
            "positions": MEASUREMENTS[:2],
            "encoders": MEASUREMENTS[2:],
            **{name: [column] for name, column in SENSORS.items()},
            "truth, unseen": RECORDED_TRUTH,
        }
        for role, names in roles.items():
            # The true speeds of a simulated run are computed from several of its columns.
            columns = [
                recording.columns[name]
                for name in names
                if name in recording.columns and name in recording.rows
            ]
            if columns:
                found = [*dict.fromkeys(columns), *([rows[role]] if role in rows else [])]
                rows[role] = ", ".join(found)
        rows["track width"] = f"{recording.track_width_m:.3g} m, {recording.width_source}"
    return rows


def _contradicted(recording, diagnosis, traction, found):
    """Why not to trust a log and what helps, by its findings and its traction, sentences."""
    for name in _told(recording):
        value = traction.loc[name, "value"]
        if not np.isnan(value) and not 0 < value < _MOST_TRACTION:
            yield f"{name} is {value:.3g}, which is no traction: look at the columns and units"
    for finding in diagnosis.findings:
        if finding.severity is Severity.WARNING and not (
            found and finding.code == "late_positions"
        ):
            yield f"{finding.fact}; {finding.remedy[0].lower()}{finding.remedy[1:-1]}"


def _lacking(recording, traction, numbers):
    """What a log is too short or too plain to tell, and what helps, sentences."""
    if "κ" not in _told(recording):
        yield "κ is not excited: drive two figures of eight"
    for name in _told(recording):
        if np.isnan(traction.loc[name, "value"]):
            yield f"the log is too short to tell {name}: drive for a minute, also in curves"
    if numbers["hidden"] < _LEAST_HIDDEN:
        yield (
            f"only {numbers['hidden']} positions could be hidden for {HIDDEN_S:g} s, so that the "
            f"estimates are hardly tested: drive for at least {_LEAST_HIDDEN + 1} times as long "
            "without a gap of the positions"
        )


def _told(recording):
    """Which of μ and κ a drive with as many turns as this one tells."""
    return ("μ", "κ") if turned_rad(recording.rows) >= LEAST_TURNED_RAD else ("μ",)


def _unsure(traction, numbers, smoothed, found):
    """Where the estimates are less sure than they should be, and what helps, sentences."""
    if unknown := unknown_yaw(smoothed):
        yield f"{unknown[0].lower()}{unknown[1:-1]}"
    if numbers["inflation"] > _MOST_INFLATED:
        helps = "no noise explains it: look for slip sideways, a late sensor or outliers"
        if found is None:
            helps = f"judge it with {passed('calibrate', True)}"
        yield (
            f"σ is {numbers['inflation']:.2g} times too small, by {numbers['hidden']} hidden "
            f"positions and the yaw that later ones tell: {helps}"
        )
    if traction.loc["κ", "low"] > 1:
        yield (
            "κ is above 1: where the driver has already corrected the yaw rate, "
            f"{passed('wheel_separation_multiplier')} undoes it; else the tracks slip unlike each "
            "other"
        )


def _verdict(doubts, lacking, recording, found):
    """Whether to trust the estimates, and if not, the strongest doubt."""
    if doubts:
        more = f" ({len(doubts) - 1} more in {passed('details')})" if len(doubts) > 1 else ""
        begin = "Cannot tell yet" if doubts[0] in lacking else "Do not trust it yet"
        return f"{begin}: {doubts[0]}.{more}"
    heading = " A gyro or a heading would check the yaw." if not recording.sensors else ""
    then = f"judge it with {passed('calibrate', True)}"
    if found is not None:
        then = f"take its YAML and its C to the robot: {passed('output', 'FOLDER')}"
    return (
        "Trust it. What was checked cannot tell tracks that slip sideways all the time, as on "
        f"ice.{heading} Next: {then}."
    )
