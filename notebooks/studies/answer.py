"""Did it reproduce? The answer in words, computed from the tables in data/results.

README, the website and notebook 00_start begin with it. Which words it takes follows from the
tables alone: any of its sentences could come out the other way.

A mean *meets* a number of the paper if it is within a tenth of it. Otherwise the number is
*possible* if it lies within the middle 90 % of our drives, since the paper's is of one drive. An
estimator is *lost* if its mean error is above the tolerance of the rows. W is picked by one rule
for both estimators.
"""

from pathlib import Path

import pandas as pd

from notebooks.claims.summary import verdict_counts
from notebooks.studies.statistics import FAILS, HOLDS
from notebooks.studies.tables import interval_text, three_digits
from rhec import paper

__all__ = ["RESULTS", "RULES", "bar", "in_words", "paper_beside_ours", "to_markdown"]

RESULTS = Path(__file__).resolve().parents[2] / "data/results"
RULES = {  # {process_noise: heading of its column}
    "printed": "W as printed",
    "consistent": "W consistent",
    "likelihood": "W by likelihood",
}
_ERROR = "mean error, raw GNSS [m]"
_VIOLATIONS = "violations on straights, raw GNSS"
_GAIN = "RHE - EKF"
_ROWS = [  # label, whose, quantity
    ("Mean error, RHE [m]", "RHE", _ERROR),
    ("Mean error, EKF [m]", "EKF", _ERROR),
    ("The RHE's error is the smaller: RHE - EKF [m]", _GAIN, _ERROR),
    ("Violations of 0.12 m, RHE", "RHE", _VIOLATIONS),
    ("Violations of 0.12 m, EKF", "EKF", _VIOLATIONS),
    ("The RHE violates less: RHE - EKF", _GAIN, _VIOLATIONS),
]
_MET = "met"
_POSSIBLE = "possible"
_NOT_MET = "not met"
_LOST = "lost"
_NEAR = 0.1
_LEDGER = "data/results/claims.csv"
_PER_BLOCK = 2  # sentences for each block of the bar


# Scenario B: the paper's numbers beside ours


def _scenario_b():
    """Scenario B's numbers by (estimator, quantity, process noise)."""
    table = pd.read_csv(RESULTS / "table_scenario_b.csv")
    return table.set_index(["estimator", "quantity", "process_noise"]).sort_index()


def _judged(numbers, whose, quantity, rule):
    """What one of our numbers says of the paper's: a word."""
    row = numbers.loc[whose, quantity, rule]
    if whose == _GAIN:
        is_lost = _is_lost(numbers, "EKF", rule)
        return f"{row['verdict']} (the EKF is lost)" if is_lost else row["verdict"]
    if _is_lost(numbers, whose, rule):
        return _LOST
    if abs(row["mean"] - row["paper"]) <= _NEAR * row["paper"]:
        return _MET
    return _POSSIBLE if row["p5"] <= row["paper"] <= row["p95"] else _NOT_MET


def _is_lost(numbers, estimator, rule):
    return numbers.loc[estimator, _ERROR, rule]["mean"] > paper.TOLERANCE_M


def _by_word(words):
    """{rule: word} as "met: as printed; possible: consistent"; the word alone if all agree."""
    if len(set(words.values())) == 1:
        return next(iter(words.values()))
    groups = {}
    for rule, word in words.items():
        groups.setdefault(word, []).append(RULES[rule].removeprefix("W "))
    return "; ".join(f"{word}: {', '.join(rules)}" for word, rules in groups.items())


def _rules_of(numbers):
    return [rule for rule in RULES if rule in numbers.index.get_level_values("process_noise")]


def paper_beside_ours():
    """Scenario B beside the paper: one row a quantity, one column a rule for W, and the verdict.

    Returns:
        DataFrame of texts.
    """
    numbers = _scenario_b()
    rules = _rules_of(numbers)
    rows = []
    for label, whose, quantity in _ROWS:
        of_rules = {rule: numbers.loc[whose, quantity, rule] for rule in rules}
        first = of_rules[rules[0]]
        row = {
            f"mean of {first['n']} fields [95 % interval]": label,
            "the paper": f"{first['paper']:g}",
        }
        for rule, found in of_rules.items():
            row[RULES[rule]] = interval_text(found["mean"], found["low"], found["high"])
        words = {rule: _judged(numbers, whose, quantity, rule) for rule in rules}
        rows.append(row | dict(verdict=_by_word(words)))
    return pd.DataFrame(rows)


# The sentences


def in_words():
    """The answer as Markdown: one line for each question that a reader has."""
    numbers = _scenario_b()
    rules = _rules_of(numbers)
    tracking = _tracking()
    lines = [
        f"- **The numbers: {_says_numbers(numbers)}**",
        f"- **RHE before EKF: {_says_order(numbers, rules, tracking)}**",
        f"- **The cause: {_says_cause(numbers, rules, tracking)}**",
        f"- **The EKF as printed: {_says_printed(numbers)}**",
        f"- **The weights, Scenario A: {_says_weights()}**",
        f"- **Computation times: {_says_times()}**",
    ]
    return "\n".join(lines)


def _yes_or_no(is_so):
    return "yes" if is_so else "no"


def _says_numbers(numbers):
    """Whether the RHE as printed has the paper's error, in the mean and as one drive."""
    row = numbers.loc["RHE", _ERROR, "printed"]
    off = 100 * (row["mean"] / row["paper"] - 1)
    in_the_mean = abs(off) <= 100 * _NEAR
    as_one_drive = row["p5"] <= row["paper"] <= row["p95"]
    ekf = {
        rule: numbers.loc["EKF", _ERROR, rule]
        for rule in _rules_of(numbers)
        if not _is_lost(numbers, "EKF", rule)
    }
    ours = ", ".join(
        f"{row['mean']:.4f} m ({RULES[rule].removeprefix('W ')})" for rule, row in ekf.items()
    )
    ekf_word = _by_count([_judged(numbers, "EKF", _ERROR, rule) for rule in ekf])
    return (
        f"{_yes_or_no(in_the_mean)} in the mean, {_yes_or_no(as_one_drive)} for one drive.** "
        f"The RHE as printed has {row['mean']:.4f} m, the paper {row['paper']:.4f} m "
        f"({off:+.0f} %; 90 % of drives have {row['p5']:.4f} to {row['p95']:.4f} m). "
        f"The EKF has {ours}, the paper {paper.MEAN_ERROR_EKF_M:.4f} m: {ekf_word}."
    )


def _by_count(words):
    """Words for a sentence, each once."""
    return ", ".join(dict.fromkeys(words)) or "it is always lost"


def _says_order(numbers, rules, tracking):
    """The order of the mean errors by each rule that picks W for both."""
    verdicts = {
        RULES[rule].removeprefix("W "): _judged(numbers, _GAIN, _ERROR, rule) for rule in rules
    }
    verdicts["best drive at R = 10"] = tracking["verdict"]
    fair = [word for word in verdicts.values() if _LOST not in word]
    if set(fair) == {HOLDS}:
        short = "yes, by every rule that picks W."
    elif set(fair) == {FAILS}:
        short = "no, by no rule that picks W."
    else:
        short = "it depends on the rule that picks W for both."
    said = "; ".join(f"{rule}: {word}" for rule, word in verdicts.items())
    return f"{short}** {said[0].upper()}{said[1:]}."


def _tracking():
    """RHE and EKF at the paper's R with the W that drives best, in 240 s."""
    table = pd.read_csv(RESULTS / "table_three_rules.csv")
    rows = table.query("drive == '240 s' and process_noise == 'tracking'").set_index("estimator")
    rhe, ekf = rows.loc["RHE"], rows.loc["EKF"]
    if rhe["difference_high"] < 0:
        verdict = HOLDS
    else:
        verdict = FAILS if rhe["difference_low"] > 0 else "undecided"
    words = f"{verdict}, {rhe['mean_error_m']:.4f} against {ekf['mean_error_m']:.4f} m"
    return dict(verdict=words, rhe=rhe["mean_error_m"], ekf=ekf["mean_error_m"])


def _says_cause(numbers, rules, tracking):
    """Whether an EKF that knows of no slip does as well as every RHE once its W fits."""
    best_rule = min(rules, key=lambda rule: numbers.loc["RHE", _ERROR, rule]["mean"])
    best = numbers.loc["RHE", _ERROR, best_rule]["mean"]
    ekf = tracking["ekf"]
    name = RULES[best_rule].removeprefix("W ")
    compared = f"{ekf:.4f} m, against {best:.4f} m of the RHE with W {name}"
    if ekf < best:
        return (
            "the gain on the heading, not the traction.** An EKF that knows of no slip, with a "
            f"larger σ of the yaw in W and nothing else changed, has {compared}."
        )
    return f"the traction may be it.** An EKF that knows of no slip has, at best, {compared}."


def _says_printed(numbers):
    """Whether the printed W of the EKF can be what was driven."""
    row = numbers.loc["EKF", _ERROR, "printed"]
    ours = f"its mean error here is {three_digits(row['mean'])} m, the paper's {row['paper']} m"
    if _is_lost(numbers, "EKF", "printed"):
        return f"this cannot be what was driven.** It loses its heading: {ours}."
    return f"it can be driven.** {ours[0].upper()}{ours[1:]}."


def _says_weights():
    """Scenario A in the paper's words: Q¹ slow, Q² overshoots, Q³ the best of the three."""
    table = pd.read_csv(RESULTS / "table_scenario_a.csv").set_index(["weight", "quantity"])
    slow = table.loc["Q1 / Q3", "settling time, ratio"]
    swings = table.loc["Q2 / Q3", "overshoot, ratio"]
    errors = {name: table.loc[name, "mean error, true [m]"] for name in ("Q1", "Q2", "Q3")}
    best = min(errors, key=lambda name: errors[name]["mean"])
    symbol = dict(Q1="Q¹", Q2="Q²", Q3="Q³")
    means = ", ".join(f"{symbol[name]} {errors[name]['mean']:.3f}" for name in errors)
    return (
        f"Q¹ slow: {_yes_or_no(slow['verdict'] == HOLDS)}. Q² overshoots: "
        f"{_yes_or_no(swings['verdict'] == HOLDS)}. Q³ the best: {_yes_or_no(best == 'Q3')}.** "
        f"Q¹ settles after {three_digits(slow['mean'])} times as long as Q³, Q² swings "
        f"{three_digits(swings['mean'])} times as far, and {symbol[best]} has the least error "
        f"({means} m)."
    )


def _says_times():
    """What the ledger says of the paper's times."""
    verdicts = pd.read_csv(RESULTS / "claims.csv").set_index("id")["verdict"]
    feasible = _yes_or_no(verdicts["T7"] == HOLDS)
    return (
        f"real time at 5 Hz: {feasible}; the paper's {paper.STEP_MEAN_MS} ms: {verdicts['T1']}.** "
        "They belong to its Raspberry Pi 3."
    )


def bar(link=_LEDGER):
    """How many of the paper's sentences have each verdict, as a bar of links in Markdown."""
    counts = verdict_counts(pd.read_csv(RESULTS / "claims.csv"))["claims"]
    parts = [
        f"[{'█' * -(-count // _PER_BLOCK)} {count} {verdict}]({link})"
        for verdict, count in counts.items()
        if count
    ]
    first, *others = parts
    return f"Of the {counts.sum()} sentences that can be checked: " + " · ".join([first, *others])


def to_markdown(frame):
    """A DataFrame as a Markdown table without index."""
    rows = [list(frame), ["---"] * len(frame.columns), *frame.to_numpy()]
    # A vertical line would end the cell.
    cells = [[str(cell).replace("|", "\\|") for cell in row] for row in rows]
    return "\n".join("| " + " | ".join(row) + " |" for row in cells)
