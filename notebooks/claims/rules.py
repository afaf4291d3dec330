"""The claims of claims.toml as rules: functions of the evidence, one for each condition.

claims.toml holds each sentence of the paper and how it is judged; its first lines say what each
entry means. Evidence is {(process noise, kind, id): DataFrame}, where kind is "runs", "logs" or
"experiments". What follows from the paper's own numbers needs no evidence; it is computed here.
"""

import inspect
import tomllib
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pandas as pd

from notebooks.claims.run_sets import PROCESS_NOISES
from notebooks.studies import statistics, timing
from notebooks.studies.statistics import (
    AS_PRINTED,
    CONDITIONS,
    CONFIDENCE,
    LOST,
    UNTESTABLE,
    Finding,
    is_lost,
)
from rhec import paper
from rhec.tracked_robot.kinematics import SPEED_MODELS

_FILE = Path(__file__).with_name("claims.toml")


class Condition(NamedTuple):
    """A rule under one way to read the paper, called with the evidence and the confidence.

    Args:
        rule: Function of evidence and confidence that returns a Finding.
        tables: (process noise, kind, id) of the tables that it reads.
    """

    rule: Callable
    tables: tuple = ()

    def __call__(self, evidence, confidence=CONFIDENCE):
        """The Finding on this evidence."""
        return self.rule(evidence, confidence)


class Rule(NamedTuple):
    """How a claim is judged.

    Args:
        by_condition: {condition: Condition}, the paper's text first, then departures from it.
        unit: Of the Finding's numbers.
        paper: The paper's number, or its word for it.
        bound: In words, the bound beyond which the verdict changes.
        combined: Function of {condition: Finding} that returns the claim's verdict and condition.
        other_worlds: Whether the claim is judged in the posterior's worlds, too.
    """

    by_condition: dict[str, Condition]
    unit: str = ""
    paper: object = ""
    bound: str = ""
    combined: Callable = statistics.combined
    other_worlds: bool = False


class Claim(NamedTuple):
    """A sentence of the paper and how it is judged.

    Args:
        section: The paper's section.
        claim: The sentence, shortened.
        quote: The paper's own words.
        test: What is measured, in words.
        rule: Its Rule.
        derived: Whether the verdict follows from equations or from the paper's own numbers.
        beside: {what: Condition}, numbers shown beside the verdict that do not decide it.
        why: The reason for the verdict, where it is known.
        mended: What was changed of its rule after a verdict by an earlier one was published.
    """

    section: str
    claim: str
    quote: str
    test: str
    rule: Rule
    derived: bool
    beside: dict[str, Condition]
    why: str
    mended: str


# Rules that are judged on nothing or by the paper's own numbers


def _yaw_rate_error(evidence, confidence):
    """Not testable: the speed loops are this project's. Shows how far ω is from its command."""
    errors = evidence["printed", "logs", "rhe"]["rms_yaw_rate_radps"]
    return Finding(*statistics.mean(errors)[:4], UNTESTABLE)


def _row_clearance():
    """(row spacing - stem - GNSS - robot width) / 2 is the tolerance, to the nearest cm."""
    taken_m = paper.STEM_WIDTH_M + paper.GNSS_ACCURACY_M + paper.ROBOT_WIDTH_M
    return statistics.equal((paper.ROW_SPACING_M - taken_m) / 2, paper.TOLERANCE_M, 0.005)


def _sampling_time():
    """The sampling time is in the range of milliseconds: below 100 of them."""
    return statistics.between(paper.DT_S, below=0.1)


def _process_noise_sizes():
    """Every entry of W of a measured quantity exceeds every entry of one that is not measured.

    It is judged by the ratio of the smallest of the former to the largest of the latter.
    """
    measured = np.take(paper.SIGMA_W_RHE, [0, 1, 3])  # x, y, ν
    unmeasured = np.take(paper.SIGMA_W_RHE, [2, 4, 5])  # θ, μ, κ
    return statistics.between(min(measured) / max(unmeasured), above=1)


def _table_1():
    """The times [ms] of Table 1: a DataFrame, a row each of minimum, average and maximum."""
    return pd.DataFrame(paper.TABLE_1_MS, index=["minimum", "average", "maximum"])


def _table_sums():
    """The averages of the four phases add up to that of the whole step."""
    phases_ms = _table_1().loc["average", [*timing.PHASES]].sum()
    return statistics.equal(phases_ms, paper.STEP_MEAN_MS, 0.01)


def _table_extremes():
    """Overall minimum and maximum of RHE and RHC are not the sums of the two phases' extremes.

    A sample reaches the sum of two maxima only if both phases are worst at that sample. It is
    judged by the smallest of the four differences [ms].
    """
    whole_ms, preparation_ms, feedback_ms = (
        _table_1().xs(phase, axis=1, level=1) for phase in ("overall", "preparation", "feedback")
    )
    apart_ms = (whole_ms - preparation_ms - feedback_ms).loc[["minimum", "maximum"]].abs()
    return statistics.between(apart_ms.min(axis=None), above=2e-4)


def _feedback_share():
    """The feedback phases of RHE and RHC are less than the whole step, by the paper's averages."""
    feedback_ms = _table_1().xs("feedback", axis=1, level=1).loc["average"].sum()
    return statistics.between(feedback_ms / paper.STEP_MEAN_MS, below=1)


def _parameters_of_p(speed_model):
    """Eq. (6) has the two parameters that the paper counts."""
    return statistics.equal(len(SPEED_MODELS[speed_model].model.parameters), 2, 0)


def _known(finding):
    """The Condition of a Finding that no evidence changes."""
    return Condition(lambda evidence, confidence: finding)


_EXACT_RULES = {  # name: {condition: Condition}
    "untestable": {"": _known(Finding(np.nan, np.nan, np.nan, 0, UNTESTABLE))},
    "yaw_rate_error": {"": Condition(_yaw_rate_error, (("printed", "logs", "rhe"),))},
    "row_clearance": {"": _known(_row_clearance())},
    "sampling_time": {"": _known(_sampling_time())},
    "process_noise_sizes": {"": _known(_process_noise_sizes())},
    "table_sums": {"": _known(_table_sums())},
    "table_extremes": {"": _known(_table_extremes())},
    "feedback_share": {"": _known(_feedback_share())},
    "parameters_of_p": {
        AS_PRINTED: _known(_parameters_of_p("parameter")),
        "ν as input": _known(_parameters_of_p("input")),
    },
}


# Rules on tables


class _RuleKind(NamedTuple):
    """A rule on samples.

    Args:
        judge: Function of the samples, its bounds and `confidence` that returns a Finding.
        bound: What it asks for, in words, where no bound says so.
        paper: The paper's word for that.
        combined: As in Rule.
    """

    judge: Callable
    bound: str = ""
    paper: str = ""
    combined: Callable = statistics.combined


_EVERY_CASE = "every case"
_RULES = {
    "always": _RuleKind(statistics.always, _EVERY_CASE, "all"),
    "always_relative_to_oracle": _RuleKind(statistics.always_relative_to_oracle, _EVERY_CASE),
    "difference": _RuleKind(statistics.difference),
    "mean": _RuleKind(statistics.mean),
    "possible": _RuleKind(statistics.possible, "one case", "may", statistics.combined_possible),
    "ratio": _RuleKind(statistics.ratio),
    "relative_to_oracle": _RuleKind(statistics.relative_to_oracle),
    "reported": _RuleKind(statistics.reported, "met"),
    "share": _RuleKind(statistics.share),
    "share_less": _RuleKind(statistics.share_less),
    "share_twice": _RuleKind(statistics.share_twice),
}
_KINDS = {"runs": "runs", "logs": "logs", "experiment": "experiments", "property": "experiments"}
_ENTRIES = {"sentence", "quote", "test", "rule", "of", "departures", "paper", "other_worlds", "why"}
_ENTRIES |= {"derived", "beside", "rival", "process_noises", "mended", *_KINDS}
_BOUNDS = ("above", "below", "least", "within")
_OF_RULES = {"name", "unit", *_BOUNDS}


def _judge(evidence, confidence, rule, bounds, tables, expressions):
    """The Finding of a rule on expressions of tables.

    Tables of unequal length are compared on the seeds that both have.
    """
    found = [evidence[table] for table in tables]
    n = min(map(len, found))
    values = [
        pd.eval(expression, engine="python", resolvers=[table[:n]])
        for table in found
        for expression in expressions
    ]
    return rule(*values, **bounds, confidence=confidence)


def _unless_lost(evidence, confidence, judge, rival):
    """The Finding of `judge`; where the rival is lost, that is its verdict."""
    finding = judge(evidence, confidence)
    if is_lost(evidence[rival]["mean_error_m"].mean()):
        return finding._replace(verdict=LOST, p=np.nan)
    return finding


def _condition(entry, expressions, process_noise, instead):
    """The Condition of an entry under one process noise and departure.

    A name in `instead` is replaced, be it a table's id or an expression.
    """
    (kind,) = (kind for kind in _KINDS if kind in entry)
    settings = entry["rule"]
    rule = _RULES[settings["name"]]
    bounds = {name: settings[name] for name in _BOUNDS if name in settings}
    if "number" in inspect.signature(rule.judge).parameters:
        bounds["number"] = entry["paper"]
    tables = tuple((process_noise, _KINDS[kind], instead.get(id_, id_)) for id_ in entry[kind])
    columns = [expressions.get(each, each) for each in entry["of"]]
    judge = partial(
        _judge,
        rule=rule.judge,
        bounds=bounds,
        tables=tables,
        expressions=[instead.get(column, column) for column in columns],
    )
    if "rival" in entry:
        place = entry[kind].index(entry["rival"])
        judge = partial(_unless_lost, judge=judge, rival=tables[place])
    return Condition(judge, tables)


def _process_noises(entry):
    """The process noises that an entry is judged under; "all" are those of every rule of W.

    None affects a property, so that one is left of them.
    """
    usual = ("printed",) if "property" in entry else PROCESS_NOISES
    noises = entry.get("process_noises", usual)
    return tuple(CONDITIONS) if noises == "all" else tuple(noises)


def _departures_of(entry, departures):
    """The departures that a claim is judged under, by name in claims.toml, the RHE's W first."""
    # The arrival mean (G7) belongs to the RHE alone, and to every claim on it.
    names = entry.get("departures", [])
    if "rhe" in [*entry.get("runs", []), *entry.get("logs", [])]:
        names = ["smoothed", *names]
    return [departures[name] for name in names]


def _by_condition(entry, expressions, departures):
    """{condition: Condition}: the process noises as the paper has it, then with each departure."""
    conditions = {
        CONDITIONS[process_noise]: _condition(entry, expressions, process_noise, {})
        for process_noise in _process_noises(entry)
    }
    for departure in departures:
        for process_noise in departure.get("process_noises", PROCESS_NOISES):
            name = departure["name"]
            if process_noise != "printed":
                name = f"{CONDITIONS[process_noise]}, {name}"
            conditions[name] = _condition(entry, expressions, process_noise, departure["instead"])
    return conditions


def _rule_on_tables(entry, expressions, departures):
    """The Rule of an entry that is judged on tables."""
    settings = entry["rule"]
    kind = _RULES[settings["name"]]
    sides = {">": settings.get("above"), "<": settings.get("below")}
    words = " and ".join(f"{sign} {bound:g}" for sign, bound in sides.items() if bound is not None)
    conditions = _by_condition(entry, expressions, _departures_of(entry, departures))
    is_exact = "property" in entry
    if is_exact and len(conditions) == 1:
        conditions = {"": conditions[AS_PRINTED]}
    changes = not is_exact and not entry.get("derived", False)
    return Rule(
        conditions,
        settings.get("unit", "-"),
        entry.get("paper", kind.paper),
        kind.bound or words,
        kind.combined,
        changes and entry.get("other_worlds", True),
    )


def _beside(entry, expressions):
    """{what: Condition} of the numbers that are shown beside the verdict."""
    found = {}
    for part in entry.get("beside", []):
        for process_noise in _process_noises(part):
            name = "" if "property" in part else f", {CONDITIONS[process_noise]}"
            found[part["what"] + name] = _condition(part, expressions, process_noise, {})
    return found


# The file


def _claim(section, entry, expressions, departures):
    """The Claim of an entry; a ValueError names what nothing would read."""
    settings = entry["rule"]
    if unknown := {*entry} - _ENTRIES or {*settings} - _OF_RULES:
        raise ValueError(f"nothing is called {sorted(unknown)[0]}")
    if settings["name"] in _RULES:
        rule = _rule_on_tables(entry, expressions, departures)
    else:
        conditions = _EXACT_RULES[settings["name"]]
        rule = Rule(conditions, settings.get("unit", ""), entry.get("paper", ""))
    return Claim(
        section,
        entry["sentence"],
        entry["quote"],
        entry.get("test", "-"),
        rule,
        entry.get("derived", False),
        _beside(entry, expressions),
        entry.get("why", ""),
        entry.get("mended", ""),
    )


def load(file=_FILE):
    """Read the claims, {id: Claim} in the file's order.

    Args:
        file: Path of a TOML file such as claims.toml.

    Returns:
        {id: Claim}.

    Raises:
        ValueError: If an entry is incomplete, or names what nothing reads.
    """
    text = tomllib.loads(Path(file).read_text(encoding="utf-8"))
    expressions = text.pop("expressions", {})
    departures = text.pop("departures", {})
    claims = {}
    for section, entries in text.items():
        for id_, entry in entries.items():
            try:
                claims[id_] = _claim(section, entry, expressions, departures)
            except (KeyError, ValueError) as error:
                raise ValueError(f"claim {id_} could not be read: {error!r}") from None
    return claims


CLAIMS = load()
