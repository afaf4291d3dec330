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
    "prediction": "by prediction",
    "tracking": "by least tracking error",
}
_OTHERS = tuple(_RULES)[1:]  # the rules that are ours
_ERROR = "mean error, raw GNSS [m]"
_VIOLATIONS = "violations on straights, raw GNSS"
_GAIN = "RHE - EKF"
_ROWS = [  # label, whose, quantity
    ("Mean error, RHE [m]", "RHE", _ERROR),
    ("Mean error, EKF [m]", "EKF", _ERROR),
    ("The RHE is better: RHE − EKF, mean error [m]", _GAIN, _ERROR),
    ("Violations of 0.12 m, RHE", "RHE", _VIOLATIONS),
    ("Violations of 0.12 m, EKF", "EKF", _VIOLATIONS),
    ("The RHE is better: RHE − EKF, violations", _GAIN, _VIOLATIONS),
]
_WEIGHTS = {"Q1": "Q¹", "Q2": "Q²", "Q3": "Q³"}
_MET = "met"
_POSSIBLE = "possible"
_NOT_MET = "not met"
_LOST = "lost"
_EKF_LOST = "EKF lost"
_NEAR = 0.1  # a mean is near the paper's number if it is within this share of it
LEDGER = "data/results/claims.csv"
_SQUARES = {HOLDS: "🟩", PRINTED: "🟦", DEPARTURE: "🟦", FAILS: "🟥", UNDECIDED: "🟧"}
_SQUARES |= {LOST: "🟪", UNTESTABLE: "⬜"}
_SQUARES |= {_MET: "🟩", _POSSIBLE: "🟦", _NOT_MET: "🟥", _LOST: "🟪", _EKF_LOST: "🟪"}
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


def paper_beside_ours(folder=RESULTS, judged=True):
    """Scenario B beside the paper: one row a quantity, one column a rule for W.

    Args:
        folder: Folder of the tables.
        judged: Whether each number has its verdict before it, as "🟩 met: 0.0419".

    Returns:
        DataFrame of texts.
    """
    numbers = _indexed(pd.read_csv(folder / "table_scenario_b.csv"))
    rows = []
    for label, whose, quantity in _ROWS:
        found = {rule: numbers.loc[whose, quantity, rule] for rule in _RULES}
        first = found["printed"]
        row = {f"mean of {first['n']} drives [95 % interval]": label}
        row["the paper"] = f"{first['paper']:g}"
        for rule, ours in found.items():
            # Errors and violations are not negative, only their differences are.
            low = ours["low"] if whose == _GAIN else max(ours["low"], 0)
            text = interval_text(ours["mean"], low, ours["high"])
            if judged:
                word = _judged(numbers, whose, quantity, rule)
                text = f"{_SQUARES[word]} {word}: {text}"
            row[f"W {_RULES[rule]}"] = text
        rows.append(row)
    return pd.DataFrame(rows)


# The sentences


def in_words(folder=RESULTS):
    """The answer as Markdown: one line for each question that a reader has.

    Args:
        folder: Folder of the tables.
    """
    table = pd.read_csv(folder / "table_scenario_b.csv")
    weights = pd.read_csv(folder / "table_scenario_a.csv")
    lines = [
        f"**{in_short(table)}**\n",
        scenario_b_in_words(table),
        scenario_a_in_words(weights),
        _line("Does a step fit into the sample at 5 Hz?", _says_times(folder)),
    ]
    return "\n".join(lines)


def in_short(table):
    """Whether Scenario B reproduced, in one line.

    Args:
        table: Of `notebooks.studies.scenario_tables.scenario_b_table`.
    """
    numbers = _indexed(table)
    has_error = _has_the_papers_error(numbers)
    order = _order(numbers)
    short = "In part"
    if has_error and order == HOLDS:
        short = "Yes"
    elif not has_error and order == FAILS:
        short = "No"
    is_that = "is" if has_error else "is not"
    which = {
        HOLDS: "The RHE is better than the EKF by every rule that picks W.",
        FAILS: "The RHE is better than the EKF by no rule that picks W.",
        _EKF_LOST: "Whether the RHE is better cannot be judged: the EKF is lost by every rule.",
    }.get(order, "Whether the RHE is better than the EKF depends on the rule that picks W.")
    return f"{short}. With W as printed the RHE's mean error {is_that} that of the paper. {which}"


def scenario_b_in_words(table):
    """What Scenario B's table says, as Markdown.

    Args:
        table: Of `notebooks.studies.scenario_tables.scenario_b_table`.
    """
    numbers = _indexed(table)
    said = {
        "Is the RHE's mean error that of the paper?": _says_rhe(numbers),
        "Does the RHE keep the tolerance, as in the paper?": _says_violations(numbers),
        "Is the EKF's mean error that of the paper?": _says_ekf(numbers),
        "Is the RHE better than the EKF?": _says_order(numbers),
        "What decides which is better?": _says_cause(numbers),
    }
    return "\n".join(_line(question, answer) for question, answer in said.items())


def scenario_a_in_words(table):
    """What Scenario A's table says, as Markdown.

    Args:
        table: Of `notebooks.studies.scenario_tables.scenario_a_table`.
    """
    return _line("Do the controller's weights do what the paper says?", _says_weights(table))


def _line(question, answer):
    short, why = answer
    return f"- **{question} {short}** {why}"


def _yes_or_no(is_so):
    return "yes" if is_so else "no"


def _said_of(verdict):
    """A verdict as the answer to a question."""
    return {HOLDS: "yes", FAILS: "no"}.get(verdict, verdict)


def _has_the_papers_error(numbers):
    """Whether the mean error of the RHE as printed is near the paper's."""
    row = numbers.loc["RHE", _ERROR, "printed"]
    return abs(row["mean"] / row["paper"] - 1) <= _NEAR


def _says_rhe(numbers):
    """Whether the RHE as printed has the paper's error, in the mean and as one drive of many."""
    row = numbers.loc["RHE", _ERROR, "printed"]
    off = f"{100 * (row['mean'] / row['paper'] - 1):+.1f} %".replace("-", "−")
    within = "within" if row["p5"] <= row["paper"] <= row["p95"] else "not within"
    why = (
        f"With W as printed it is {row['mean']:.4f} m ({off}), the mean of {row['n']} drives. The "
        f"paper's one drive has {row['paper']:.4f} m, {within} the {row['p5']:.4f} to "
        f"{row['p95']:.4f} m of 90 % of ours."
    )
    return f"{_yes_or_no(_has_the_papers_error(numbers)).capitalize()}.", why


def _says_violations(numbers):
    """Whether the RHE as printed has as few violations as in the paper."""
    short = {_MET: "Yes.", _POSSIBLE: "In some drives."}
    word = _judged(numbers, "RHE", _VIOLATIONS, "printed")
    means = {rule: three_digits(numbers.loc["RHE", _VIOLATIONS, rule]["mean"]) for rule in _RULES}
    why = (
        f"The paper counts {paper.VIOLATIONS_RHE} violations in its drive. Ours have "
        f"{means['printed']} in the mean with W as printed, and "
        f"{_listed(f'{means[rule]} ({_RULES[rule]})' for rule in _OTHERS)} by the other rules."
    )
    return short.get(word, "No."), why


def _says_ekf(numbers):
    """Whether the EKF has the paper's error, by each rule."""
    words = {rule: _judged(numbers, "EKF", _ERROR, rule) for rule in _RULES}
    means = {rule: three_digits(numbers.loc["EKF", _ERROR, rule]["mean"]) for rule in _RULES}
    short = f"As printed: {words['printed']}."
    why = f"The paper has {paper.MEAN_ERROR_EKF_M:.4f} m. With W as printed it is "
    if words["printed"] == _LOST:
        short = "Not as printed."
        why += (
            f"{means['printed']} m: the EKF loses its heading here, so we could not repeat the "
            "paper's drive with that W."
        )
    else:
        why += f"{means['printed']} m."
    words = {rule: _NOT_MET if word == _LOST else word for rule, word in words.items()}
    others = _listed(f"{words[rule]} ({_RULES[rule]}, {means[rule]} m)" for rule in _OTHERS)
    return short, f"{why} By the other rules the paper's number is {others}."


def _listed(texts):
    """Texts as "a, b and c"."""
    *others, last = texts
    return f"{', '.join(others)} and {last}"


def _order(numbers):
    """Whether the RHE has the smaller mean error, by the rules with which the EKF is not lost.

    The verdict by all of them, or None if they differ; _EKF_LOST if it is lost by every rule.
    """
    every = {_judged(numbers, _GAIN, _ERROR, rule) for rule in _RULES}
    words = every - {_EKF_LOST} or every
    return words.pop() if len(words) == 1 else None


def _says_order(numbers):
    """The order of the mean errors by each rule that picks W for both."""
    short = {
        HOLDS: "Yes, by every rule that picks W.",
        FAILS: "No, by no rule that picks W.",
        _EKF_LOST: "This cannot be judged.",
    }
    words = {rule: _judged(numbers, _GAIN, _ERROR, rule) for rule in _RULES}
    said = "; ".join(
        f"{_RULES[rule]}: {_said_of(word)}{_pair(numbers, rule)}" for rule, word in words.items()
    )
    gap = paper.MEAN_ERROR_EKF_M - paper.MEAN_ERROR_RHE_M
    why = f"{said[0].upper()}{said[1:]}. In the paper it is better by {gap:.4f} m."
    return short.get(_order(numbers), "It depends on the rule that picks W."), why


def _pair(numbers, rule):
    """Both mean errors by a rule, unless one is lost."""
    if _is_lost(numbers, "EKF", rule):
        return ""
    rhe, ekf = (numbers.loc[name, _ERROR, rule]["mean"] for name in ("RHE", "EKF"))
    return f" ({rhe:.4f} against {ekf:.4f} m)"


def _says_cause(numbers):
    """Whether an EKF that knows of no slip does as well as the RHE once its W fits."""
    others = [rule for rule in _RULES if rule != "tracking"]
    best_rule = min(others, key=lambda rule: numbers.loc["RHE", _ERROR, rule]["mean"])
    best = numbers.loc["RHE", _ERROR, best_rule]["mean"]
    rhe, ekf = (numbers.loc[name, _ERROR, "tracking"]["mean"] for name in ("RHE", "EKF"))
    short = "Perhaps the traction."
    if ekf < best:
        short = "W, more than the traction."
    why = (
        f"With the W of least tracking error and the same controller, an EKF that knows of no slip "
        f"has {ekf:.4f} m, and the RHE, which estimates the traction, {rhe:.4f} m. By the three "
        f"other rules the RHE has at best {best:.4f} m ({_RULES[best_rule]})."
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
        f"Q¹ is slow: {_said_of(slow['verdict'])}. Q² overshoots: "
        f"{_said_of(swings['verdict'])}. Q³ is the best of the three: "
        f"{_yes_or_no(best == 'Q3')}."
    )
    errors = _listed(f"{mean:.3f} m ({_WEIGHTS[name]})" for name, mean in means.items())
    why = (
        f"On {slow['n']} fields Q¹ takes {three_digits(slow['mean'])} times as long as Q³ to "
        f"settle, and Q² overshoots {three_digits(swings['mean'])} times as far as Q³. The mean "
        f"errors are {errors}."
    )
    return short, why


def _says_times(folder):
    """What the ledger says of the paper's times."""
    verdicts = pd.read_csv(folder / "claims.csv").set_index("id")["verdict"]
    short = f"{_said_of(verdicts['T7']).capitalize()}."
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
