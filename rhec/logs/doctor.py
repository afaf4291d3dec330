"""What is wrong with a recorded log, all at once, and what to do about it.

`rhec.replay` refuses a log for its first error. The doctor goes on and lists all that
`rhec.logs.checks` finds.

    rhec log FILE --check [--json]

ends with exit code 0 if there are no findings, 1 if there are, 2 if the file cannot be read.
"""

import json
from typing import Any, NamedTuple

from rhec.core._casadi.validation import Positive, Real, checked
from rhec.logs import checks
from rhec.logs.finding import refused
from rhec.logs.position_noise import LEAST_M
from rhec.logs.reader import read_if_path
from rhec.logs.recording import delayed, prepare


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
    log = read_if_path(log)
    try:
        recording = delayed(prepare(log, track_width_m), position_delay_s)
    except ValueError as error:
        return Diagnosis((refused(str(error), "unusable"),), {})
    return Diagnosis(tuple(checks.findings(recording)), checks.facts(recording))
