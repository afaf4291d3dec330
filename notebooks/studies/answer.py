"""Did it reproduce? The answer in words, computed from the tables in data/results.

README, the website and notebook 00_start begin with it. Which words it takes follows from the
tables alone: any of its sentences could come out the other way.

A mean *meets* a number of the paper if it is within a tenth of it. Otherwise the number is
*possible* if it lies within the middle 90 % of our drives, since the paper's is of one drive. An
estimator is *lost* if its mean error is above the tolerance of the rows. One rule picks W for both
estimators, for each its own; R, the weight of the yaw rate in the controller, is the paper's 10.
"""

from pathlib import Path

import pandas as pd

from notebooks.claims.summary import DEPARTURE, PRINTED, verdict_counts
from notebooks.studies.statistics import FAILS, HOLDS, LOST, UNDECIDED, UNTESTABLE
from notebooks.studies.tables import interval_text, three_digits
from rhec import paper

RESULTS = Path(__file__).resolve().parents[2] / "data/results"
_RULES = {  # {process_noise: the rule that picks W}
    "printed": "as printed",
    "consistent": "consistent",
    "likelihood": "by likelihood",
    "tracking": "by least tracking error",
}
_SHOWN = ("printed", "consistent", "likelihood")  # as columns of the table
_ERROR = "mean error, raw GNSS [m]"
_VIOLATIONS = "violations on straights, raw GNSS"
_GAIN = "RHE - EKF"
_ROWS = [  # label, whose, quantity
    ("Mean error, RHE [m]", "RHE", _ERROR),
    ("Mean error, EKF [m]", "EKF", _ERROR),
    ("The RHE's error is the smaller: RHE − EKF [m]", _GAIN, _ERROR),
    ("Violations of 0.12 m, RHE", "RHE", _VIOLATIONS),
    ("Violations of 0.12 m, EKF", "EKF", _VIOLATIONS),
    ("The RHE violates less: RHE − EKF", _GAIN, _VIOLATIONS),
]
_WEIGHTS = {"Q1": "Q¹", "Q2": "Q²", "Q3": "Q³"}
_MET = "met"
_POSSIBLE = "possible"
_NOT_MET = "not met"
_LOST = "lost"
_EKF_LOST = "the EKF is lost"
_NEAR = 0.1  # a mean is near the paper's number if it is within this share of it
LEDGER = "data/results/claims.csv"
_SQUARES = {HOLDS: "🟩", PRINTED: "🟦", DEPARTURE: "🟦", FAILS: "🟥", UNDECIDED: "🟧"}
_SQUARES |= {LOST: "🟪", UNTESTABLE: "⬜"}
_PER_SQUARE = 2  # sentences


# Scenario B: the paper's numbers beside ours


def _indexed(table):
    """Scenario B's numbers by (estimator, quantity, process noise)."""
    return table.set_index(["estimator", "quantity", "process_noise"]).sort_index()


def _is_lost(numbers, estimator, rule):
    """Whether a robot with this estimator is, in the mean, beyond the tolerance of the rows."""
    return numbers.loc[estimator, _ERROR, rule]["mean"] > paper.TOLERANCE_M


def _judged(numbers, whose, quantity, rule):
    """What one of our numbers says of the paper's: a word."""
    row = numbers.loc[whose, quantity, rule]
    if whose == _GAIN:
        return _EKF_LOST if _is_lost(numbers, "EKF", rule) else row["verdict"]
    if _is_lost(numbers, whose, rule):
        return _LOST
    if abs(row["mean"] - row["paper"]) <= _NEAR * row["paper"]:
        return _MET
    return _POSSIBLE if row["p5"] <= row["paper"] <= row["p95"] else _NOT_MET


def _by_word(words):
    """{rule: word} as "met: as printed; possible: consistent"; the word alone if all agree."""
    groups = {}
    for rule, word in words.items():
        groups.setdefault(word, []).append(_RULES[rule])
    if len(groups) == 1:
        return next(iter(groups))
    return "; ".join(f"{word}: {', '.join(rules)}" for word, rules in groups.items())


def paper_beside_ours(folder=RESULTS):
    """Scenario B beside the paper: one row a quantity, one column a rule for W, and the verdict.

    Args:
        folder: Folder of the tables.

    Returns:
        DataFrame of texts.
    """
    numbers = _indexed(pd.read_csv(folder / "table_scenario_b.csv"))
    rows = []
    for label, whose, quantity in _ROWS:
        found = {rule: numbers.loc[whose, quantity, rule] for rule in _SHOWN}
        first = found[_SHOWN[0]]
        row = {f"mean of {first['n']} fields [95 % interval]": label}
        row["the paper"] = f"{first['paper']:g}"
        for rule, ours in found.items():
            row[f"W {_RULES[rule]}"] = interval_text(ours["mean"], ours["low"], ours["high"])
        words = {rule: _judged(numbers, whose, quantity, rule) for rule in _SHOWN}
        rows.append(row | dict(verdict=_by_word(words)))
    return pd.DataFrame(rows)


# The sentences


def in_words(folder=RESULTS):
    """The answer as Markdown: one line for each question that a reader has.

    Args:
        folder: Folder of the tables.
    """
    weights = pd.read_csv(folder / "table_scenario_a.csv")
    said = [
        ("The weights (Scenario A)", _says_weights(weights)),
        ("Computation times", _says_times(folder)),
    ]
    table = pd.read_csv(folder / "table_scenario_b.csv")
    short = f"**{in_short(table)}**\n"
    return "\n".join([short, scenario_b_in_words(table), *map(_line, said)])


def in_short(table):
    """Whether Scenario B reproduced, in one sentence.

    Args:
        table: Of `notebooks.studies.scenario_tables.scenario_b_table`.
    """
    numbers = _indexed(table)
    has_error, _ = _says_rhe(numbers)
    in_order, _ = _says_order(numbers)
    short = "In part"
    if has_error.startswith("yes") and in_order.startswith("yes"):
        short = "Yes"
    elif has_error.startswith("no") and in_order.startswith("no"):
        short = "No"
    return f"{short}. The RHE's mean error: {has_error} The RHE before the EKF: {in_order}"


def scenario_b_in_words(table):
    """What Scenario B's table says, as Markdown.

    Args:
        table: Of `notebooks.studies.scenario_tables.scenario_b_table`.
    """
    numbers = _indexed(table)
    said = [
        ("The RHE's mean error", _says_rhe(numbers)),
        ("The EKF's mean error", _says_ekf(numbers)),
        ("RHE before EKF", _says_order(numbers)),
        ("What decides it", _says_cause(numbers)),
    ]
    return "\n".join(map(_line, said))


def scenario_a_in_words(table):
    """What Scenario A's table says, as Markdown.

    Args:
        table: Of `notebooks.studies.scenario_tables.scenario_a_table`.
    """
    return _line(("The weights", _says_weights(table)))


def _line(said):
    what, (short, why) = said
    return f"- **{what}: {short}** {why}"


def _yes_or_no(is_so):
    return "yes" if is_so else "no"


def _said_of(verdict):
    """A verdict as the answer to a question."""
    return {HOLDS: "yes", FAILS: "no"}.get(verdict, verdict)


def _says_rhe(numbers):
    """Whether the RHE as printed has the paper's error, in the mean and as one drive of many."""
    row = numbers.loc["RHE", _ERROR, "printed"]
    off = row["mean"] / row["paper"] - 1
    short = f"{_yes_or_no(abs(off) <= _NEAR)}."
    within = "within" if row["p5"] <= row["paper"] <= row["p95"] else "not within"
    counts = ", ".join(
        f"{three_digits(numbers.loc['RHE', _VIOLATIONS, rule]['mean'])} {_RULES[rule]}"
        for rule in _SHOWN
    )
    why = (
        f"As printed, the mean of {row['n']} drives is {row['mean']:.4f} m "
        f"({_signed_percent(off)}); the paper's one drive has {row['paper']:.4f} m, {within} the "
        f"{row['p5']:.4f} to {row['p95']:.4f} m of 90 % of our drives. Its violations of the "
        f"tolerance in a drive, of which the paper has none, are {counts}."
    )
    return short, why


def _says_ekf(numbers):
    """Whether the EKF has the paper's error, by each rule."""
    words = {rule: _judged(numbers, "EKF", _ERROR, rule) for rule in _SHOWN}
    short = f"as printed: {words['printed']}."
    said = [
        f"{three_digits(numbers.loc['EKF', _ERROR, rule]['mean'])} m {_RULES[rule]} ({word})"
        for rule, word in words.items()
    ]
    why = f"It has {', '.join(said)}; the paper {paper.MEAN_ERROR_EKF_M:.4f} m."
    if words["printed"] == _LOST:
        short = "not as printed."
        why += (
            " With W as printed it loses its heading here: with that W we could not repeat the "
            "paper's drive."
        )
    return short, why


def _signed_percent(share):
    return f"{100 * share:+.1f} %".replace("-", "−")


def _says_order(numbers):
    """The order of the mean errors by each rule that picks W for both."""
    words = {rule: _judged(numbers, _GAIN, _ERROR, rule) for rule in _RULES}
    fair = {word for word in words.values() if word != _EKF_LOST}
    short = "it depends on the rule that picks W."
    if fair == {HOLDS}:
        short = "yes, by every rule that picks W."
    elif fair == {FAILS}:
        short = "no, by none of the rules that pick W."
    said = "; ".join(
        f"{_RULES[rule]}: {word}{_pair(numbers, rule)}" for rule, word in words.items()
    )
    gap = paper.MEAN_ERROR_EKF_M - paper.MEAN_ERROR_RHE_M
    return short, f"{said[0].upper()}{said[1:]}. In the paper the RHE is better by {gap:.4f} m."


def _pair(numbers, rule):
    """Both mean errors by a rule, unless one is lost."""
    if _is_lost(numbers, "EKF", rule):
        return ""
    rhe, ekf = (numbers.loc[name, _ERROR, rule]["mean"] for name in ("RHE", "EKF"))
    return f", {rhe:.4f} against {ekf:.4f} m"


def _says_cause(numbers):
    """Whether an EKF that knows of no slip does as well as the RHE once its W fits."""
    best_rule = min(_SHOWN, key=lambda rule: numbers.loc["RHE", _ERROR, rule]["mean"])
    best = numbers.loc["RHE", _ERROR, best_rule]["mean"]
    rhe, ekf = (numbers.loc[name, _ERROR, "tracking"]["mean"] for name in ("RHE", "EKF"))
    short = "perhaps the traction."
    if ekf < best:
        short = "W, more than the traction."
    why = (
        f"With the W of least tracking error, with the same controller, an EKF that knows of no "
        f"slip has {ekf:.4f} m, and the RHE {rhe:.4f} m. By the three other rules the RHE has at "
        f"best {best:.4f} m ({_RULES[best_rule]})."
    )
    return short, why


def _says_weights(table):
    """Scenario A in the paper's words: Q¹ slow, Q² overshoots, Q³ the best of the three."""
    table = table.set_index(["weight", "quantity"])
    slow = table.loc[("Q1 / Q3", "settling time, ratio")]
    swings = table.loc[("Q2 / Q3", "overshoot, ratio")]
    means = {name: table.loc[(name, "mean error, true [m]"), "mean"] for name in _WEIGHTS}
    best = min(means, key=means.get)
    short = (
        f"Q¹ slow: {_said_of(slow['verdict'])}; Q² overshoots: "
        f"{_said_of(swings['verdict'])}; Q³ the best of the three: "
        f"{_yes_or_no(best == 'Q3')}."
    )
    errors = ", ".join(f"{_WEIGHTS[name]} {mean:.3f} m" for name, mean in means.items())
    why = (
        f"Q¹ takes {three_digits(slow['mean'])} times as long as Q³ to settle, Q² overshoots "
        f"{three_digits(swings['mean'])} times as far as Q³; mean errors {errors}."
    )
    return short, why


def _says_times(folder):
    """What the ledger says of the paper's times."""
    verdicts = pd.read_csv(folder / "claims.csv").set_index("id")["verdict"]
    short = f"real time at 5 Hz: {_said_of(verdicts['T7'])}."
    why = f"The paper's {paper.STEP_MEAN_MS} ms a step on a Raspberry Pi 3: {verdicts['T1']}."
    return short, why


def bar(folder=RESULTS, link=LEDGER):
    """How many of the paper's sentences have each verdict: a bar of links, in Markdown.

    Args:
        folder: Folder of the tables.
        link: Where the parts of the bar lead, or None.
    """
    counts = verdict_counts(pd.read_csv(folder / "claims.csv"))["claims"]
    parts = [
        f"{_SQUARES[verdict] * -(-count // _PER_SQUARE)} {verdict}: {count}"
        for verdict, count in counts.items()
        if count
    ]
    if link:
        parts = [f"[{part}]({link})" for part in parts]
    return f"Of the {counts.sum()} sentences of the paper that were judged: {' · '.join(parts)}"


def to_markdown(frame):
    """A DataFrame as a Markdown table without index."""
    rows = [list(frame), ["---"] * len(frame.columns), *frame.to_numpy()]
    # A vertical line would end the cell.
    cells = [[str(cell).replace("|", "\\|") for cell in row] for row in rows]
    return "\n".join("| " + " | ".join(row) + " |" for row in cells)
