"""Did it reproduce? The answer in words and tables, computed from the tables in data/results.

README, docs/results.md, the website and notebook 00_start have it. Which words it takes follows
from the tables alone: any of its sentences could come out the other way. A number, an order and
"never" are judged by the functions that judge the claims, see `notebooks.studies.statistics`. One
rule picks W for both estimators, for each its own; R, the weight of the yaw rate in the controller,
is the paper's 10.
"""

from collections import Counter

import pandas as pd

from notebooks.claims.summary import by_condition, verdict_counts
from notebooks.declared import ROOT
from notebooks.studies.names import RULES, TURNS, noise_text
from notebooks.studies.statistics import (
    CONDITIONS,
    FAILS,
    HOLDS,
    LOST,
    LOST_ITSELF,
    MET,
    NOT_MET,
    POSSIBLE,
    UNDECIDED,
    WITHIN,
    WITHIN_COUNTS,
    is_lost,
    verdict_on_never,
    verdict_on_number,
    verdict_on_order,
)
from notebooks.studies.tables import interval_text, three_digits, to_markdown, with_minus
from rhec import paper
from rhec.tracked_robot import tuning

RESULTS = ROOT / "data/results"
LEDGER = "data/results/claims.csv"
_RULES = {rule: RULES[rule] for rule in tuning.RULES_IN_DEFAULT_WORLD}
_ERROR = "mean error, raw GNSS [m]"
_VIOLATIONS = "violations on straights, raw GNSS"
_CLEAN = "share of drives without a violation"
_GAIN = "RHE - EKF"
_P = "P(RHE < EKF)"
_EKF_LOST = "EKF lost"
_SMALLER = "smaller"  # than the paper's, where a number is not met
_LARGER = "larger"
_NONE = "–"
_MM = 1000.0
# Each word with which a cell of a table begins: the class of verdicts that it belongs to.
VERDICTS = {
    HOLDS: HOLDS,
    MET: HOLDS,
    POSSIBLE: POSSIBLE,
    FAILS: FAILS,
    # An error that is smaller than the paper's does not agree with it, but is no failure.
    _SMALLER: UNDECIDED,
    _LARGER: FAILS,
    UNDECIDED: UNDECIDED,
    LOST_ITSELF: LOST,
    _EKF_LOST: LOST,
}


def _table(name):
    """A table of this commit."""
    return pd.read_csv(RESULTS / f"{name}.csv")


def _claims():
    """The ledger of this commit, by id."""
    return _table("claims").set_index("id")


# Scenario B: numbers and verdicts


class Numbers:
    """Scenario B's table on one pattern of turns; each verdict by the rule of its kind.

    Args:
        table: Of `notebooks.studies.scenario_tables.scenario_b_table`.
        turns: The pattern; the table's first one by default.
    """

    def __init__(self, table, turns=None):
        self.turns = turns or next(iter(table["turns"]))
        # Read from a file, what the paper does not report is NaN, else it is empty.
        table = table.assign(paper=pd.to_numeric(table["paper"], errors="coerce"))
        rows = table[table["turns"] == self.turns]
        self._rows = rows.set_index(["estimator", "quantity", "process_noise"]).sort_index()

    def row(self, whose, quantity, rule):
        """The row of an estimator, or of "RHE - EKF", on a quantity under a rule for W."""
        return self._rows.loc[whose, quantity, rule]

    def number(self, estimator, quantity, rule):
        """MET, POSSIBLE, NOT_MET or LOST_ITSELF."""
        row = self.row(estimator, quantity, rule)
        if is_lost(self.row(estimator, _ERROR, rule)["mean"]):
            return LOST_ITSELF
        within = WITHIN_COUNTS if quantity == _VIOLATIONS else WITHIN
        paper_number = row["paper"]
        return verdict_on_number(
            row["low"], row["high"], row["p5"], row["p95"], paper_number, within
        )

    def order(self, quantity, rule):
        """HOLDS, FAILS, UNDECIDED or LOST, the EKF being the rival."""
        row = self.row(_GAIN, quantity, rule)
        return verdict_on_order(row["low"], row["high"], self.row("EKF", _ERROR, rule)["mean"])

    def never(self, rule):
        """HOLDS, FAILS or UNDECIDED: the RHE violates the tolerance in no drive.

        This counts all drives; claim B7 leaves out those in which the oracle violates it, too.
        """
        row = self.row("RHE", _CLEAN, rule)
        return verdict_on_never(row["low"], row["high"])


def _patterns(table):
    """{pattern of turns: Numbers}, the one that the table is about first."""
    return {turns: Numbers(table, turns) for turns in dict.fromkeys(table["turns"])}


# The table of the first screen


def paper_beside_ours(table=None):
    """Scenario B beside the paper, with a verdict in each cell: a row a quantity, a column a rule.

    The last two rows have the verdict on "benefits from traction parameter estimates" (claim B6),
    and the share of the posterior's worlds in which the RHE has the smaller error.

    Args:
        table: Of `notebooks.studies.scenario_tables.scenario_b_table`, of which the rows above the
            last two are made; None: that of this commit, with all rows, and with the ledger's
            verdict on violations, which knows the oracle.

    Returns:
        DataFrame of texts such as "met: 0.0419".
    """
    numbers = Numbers(_table("table_scenario_b") if table is None else table)
    never = (
        {rule: numbers.never(rule) for rule in _RULES} if table is not None else _conditions("B7")
    )
    n = numbers.row("RHE", _ERROR, "printed")["n"]
    difference_mm = _MM * (paper.MEAN_ERROR_RHE_M - paper.MEAN_ERROR_EKF_M)
    rows = {
        "Mean error, RHE [m]": (
            f"{paper.MEAN_ERROR_RHE_M:g}",
            lambda rule: _number_cell(numbers, "RHE", _ERROR, rule),
        ),
        "Mean error, EKF [m]": (
            f"{paper.MEAN_ERROR_EKF_M:g}",
            lambda rule: _number_cell(numbers, "EKF", _ERROR, rule),
        ),
        "RHE − EKF [mm]; share of fields with less": (
            with_minus(f"{difference_mm:.1f}"),
            lambda rule: _order_cell(numbers, rule),
        ),
        "RHE: drives without a violation": ("all", lambda rule: _never_cell(numbers, never, rule)),
        "EKF: violations in a drive": (
            f"{paper.VIOLATIONS_EKF}",
            lambda rule: _number_cell(numbers, "EKF", _VIOLATIONS, rule),
        ),
    }
    if table is None:
        rows |= {
            "The RHE benefits from its traction estimates": ("yes", _conditions("B6").get),
            "Share of worlds that fit the paper in which the RHE's error is less": (
                _NONE,
                _worlds().get,
            ),
        }
    head = f"mean of {n} drives, turns {TURNS[numbers.turns]}"
    return pd.DataFrame(
        [
            {head: label, "the paper": of_paper} | {noise_text(rule): cell(rule) for rule in _RULES}
            for label, (of_paper, cell) in rows.items()
        ]
    ).fillna(_NONE)


def _number_cell(numbers, estimator, quantity, rule):
    """The verdict on a number that the paper reports, and what it is about.

    That is our mean, but where the number is possible: then the middle 90 % of single drives.
    """
    row = numbers.row(estimator, quantity, rule)
    word = _said_of_number(numbers, estimator, quantity, rule)
    text = f"{word}: {three_digits(row['mean'])}"
    if word == POSSIBLE:
        text += f" (drives: {three_digits(row['p5'])} to {three_digits(row['p95'])})"
    return text


def _said_of_number(numbers, estimator, quantity, rule):
    """The verdict on a number; where it is not met, whether ours is smaller or larger."""
    word = numbers.number(estimator, quantity, rule)
    if word != NOT_MET:
        return word
    row = numbers.row(estimator, quantity, rule)
    return _SMALLER if row["mean"] < row["paper"] else _LARGER


def _order_cell(numbers, rule):
    """Which is better, by how much, and in how many fields."""
    word = numbers.order(_ERROR, rule)
    if word == LOST:
        return _EKF_LOST
    gain_mm = _MM * numbers.row(_GAIN, _ERROR, rule)["mean"]
    share = numbers.row(_P, _ERROR, rule)["mean"]
    return f"{word}: {three_digits(gain_mm)}; {_percent(share)}"


def _never_cell(numbers, never, rule):
    """The share of drives without a violation, and the verdict on "never"."""
    share = _percent(numbers.row("RHE", _CLEAN, rule)["mean"])
    return f"{never[rule]}: {share}"


def _percent(share):
    return f"{100 * share:.0f} %"


def _conditions(claim):
    """{rule: verdict} of a claim in the ledger."""
    verdicts = by_condition(_claims().loc[claim, "conditions"])
    return {rule: verdicts[name] for rule, name in CONDITIONS.items()}


def _worlds():
    """{rule: share of the posterior's worlds in which the RHE's mean error is the smaller}."""
    rows = _table("inverse_rules")
    rows = rows[rows["turns"] == "own"].set_index("rule for W")
    found = {}
    for rule in _RULES:
        row = rows.loc[rule]
        ends = f"{100 * row['low']:.0f}, {100 * row['high']:.0f}"
        share = f"{100 * row['RHE better']:.0f} % [{ends}]"
        found[rule] = _EKF_LOST if is_lost(row["EKF [m]"]) else share
    return found


# All numbers


def scenario_b_numbers(table):
    """Scenario B's means with their intervals: a row a quantity, a column a rule for W.

    Args:
        table: Of `notebooks.studies.scenario_tables.scenario_b_table`.

    Returns:
        DataFrame of texts such as "0.0419 [0.0417, 0.0422]".
    """
    numbers = Numbers(table)
    labels = {
        ("RHE", _ERROR): "Mean error, RHE [m]",
        ("EKF", _ERROR): "Mean error, EKF [m]",
        (_GAIN, _ERROR): "RHE − EKF, mean error [m]",
        (_P, _ERROR): "Share of fields where the RHE has less error",
        ("RHE", _VIOLATIONS): "Violations in a drive, RHE",
        ("EKF", _VIOLATIONS): "Violations in a drive, EKF",
        (_GAIN, _VIOLATIONS): "RHE − EKF, violations",
        ("RHE", _CLEAN): "Share of drives without a violation, RHE",
        ("EKF", _CLEAN): "Share of drives without a violation, EKF",
    }
    rows = []
    for (whose, quantity), label in labels.items():
        found = {rule: numbers.row(whose, quantity, rule) for rule in _RULES}
        first = found["printed"]
        row = {f"mean of {first['n']} drives [95 % interval]": label}
        row["the paper"] = _NONE if pd.isna(first["paper"]) else f"{first['paper']:g}"
        row |= {noise_text(rule): _with_interval(ours) for rule, ours in found.items()}
        rows.append(row)
    return pd.DataFrame(rows)


def _with_interval(row):
    return interval_text(row["mean"], row["low"], row["high"])


def by_turns(table):
    """Which way the path turns, and what follows: a row a pattern and rule.

    Args:
        table: As for `scenario_b_numbers`.

    Returns:
        DataFrame of texts: the two mean errors, their difference with its verdict, the share of
        fields in which the RHE has less, and the shares of drives without a violation.
    """
    rows = []
    for turns, numbers in _patterns(table).items():
        for rule in _RULES:
            gain = numbers.row(_GAIN, _ERROR, rule)
            rows.append(
                {
                    "turns": f"{TURNS[turns]} (n = {gain['n']})",
                    "W": _RULES[rule],
                    "RHE [m]": _with_interval(numbers.row("RHE", _ERROR, rule)),
                    "EKF [m]": _with_interval(numbers.row("EKF", _ERROR, rule)),
                    "RHE − EKF [mm]": interval_text(*(_MM * gain[["mean", "low", "high"]])),
                    "RHE is better": _said(numbers.order(_ERROR, rule)),
                    "in fields": _percent(numbers.row(_P, _ERROR, rule)["mean"]),
                    "without violation, RHE": _percent(numbers.row("RHE", _CLEAN, rule)["mean"]),
                    "without violation, EKF": _percent(numbers.row("EKF", _CLEAN, rule)["mean"]),
                }
            )
    return pd.DataFrame(rows)


def _said(verdict):
    return _EKF_LOST if verdict == LOST else verdict


# The sentence of the first screen


def in_short(table):
    """Whether Scenario B reproduced, in one sentence.

    *Yes* needs the order in every case of rule and turns, both mean errors as printed, and no
    violation. *In part* needs one of these, or the order in more than half of the cases.

    Args:
        table: Of `notebooks.studies.scenario_tables.scenario_b_table`.
    """
    patterns = _patterns(table)
    numbers = next(iter(patterns.values()))
    words = [
        _order_of(patterns) == HOLDS,
        numbers.number("RHE", _ERROR, "printed") == MET,
        numbers.number("EKF", _ERROR, "printed") == MET,
        numbers.never("printed") == HOLDS,
    ]
    orders = [word == HOLDS for word in _orders(patterns).values()]
    in_part = any(words) or sum(orders) > len(orders) / 2
    short = "Yes" if all(words) else "In part" if in_part else "No"
    parts = [_says_order(patterns), *_says_lost(patterns), _says_error(numbers)]
    return f"{short}: {'; '.join(parts)}."


def _orders(patterns):
    """{(pattern, rule): verdict} on the order of the mean errors, where the EKF is not lost."""
    found = {
        (turns, rule): numbers.order(_ERROR, rule)
        for turns, numbers in patterns.items()
        for rule in _RULES
    }
    return {case: word for case, word in found.items() if word != LOST}


def _order_of(patterns):
    """The verdict on the order in all cases; LOST if no EKF drives, None if they differ."""
    words = set(_orders(patterns).values())
    if not words:
        return LOST
    return words.pop() if len(words) == 1 else None


def _says_order(patterns):
    """Whether the RHE is better than the EKF, by each rule and on each pattern of turns.

    Exceptions are counted by their turns.
    """
    orders = _orders(patterns)
    rules = "by every rule for W with which the EKF can drive"
    if len(patterns) > 1:
        rules += ", whichever way the path turns"
    same = {
        HOLDS: f"the RHE is better than the EKF {rules}",
        FAILS: f"the RHE is worse than the EKF {rules}",
        UNDECIDED: f"which is better, RHE or EKF, is undecided {rules}",
        LOST: "which is better cannot be judged, since the EKF is lost by every rule for W",
    }
    order = _order_of(patterns)
    if order in same:
        return same[order]
    better = sum(word == HOLDS for word in orders.values())
    text = f"the RHE is better than the EKF in {better} of {len(orders)} cases of rule and turns"
    others = Counter(turns for (turns, _), word in orders.items() if word != HOLDS)
    counts = [
        f"{count} of the {sum(turns == each for each, _ in orders)} with turns {TURNS[turns]}"
        for turns, count in others.items()
    ]
    return f"{text}, but not in {_listed(counts)}" if len(others) <= _FEW else text


_FEW = 3  # patterns of turns with exceptions that a sentence may list


def _says_lost(patterns):
    """The rules by which the EKF is lost on every pattern of turns; nothing if there is none."""
    lost = [
        _RULES[rule]
        for rule in _RULES
        if all(numbers.order(_ERROR, rule) == LOST for numbers in patterns.values())
    ]
    return [f"with W {_listed(lost)} the EKF is lost"] if 0 < len(lost) < len(_RULES) else []


def _says_error(numbers):
    """Whether the RHE as printed has the paper's mean error."""
    row = numbers.row("RHE", _ERROR, "printed")
    ours = f"{row['mean']:.4f} for {row['paper']:.4f} m"
    than = "smaller" if row["mean"] < row["paper"] else "larger"
    said = {
        MET: f"is that of the paper ({ours})",
        POSSIBLE: f"is {than} than the paper's, which is possible for one drive ({ours})",
        NOT_MET: f"is {than} than the paper's ({ours})",
        LOST_ITSELF: f"is that of a robot which is lost ({ours})",
        UNDECIDED: f"cannot be judged ({ours})",
    }
    of_rhe = said[numbers.number("RHE", _ERROR, "printed")]
    return f"the RHE's mean error with W as printed {of_rhe}"


def first_screen():
    """The answer in one sentence and one table, as Markdown."""
    return f"**{in_short(_table('table_scenario_b'))}**\n\n{to_markdown(paper_beside_ours())}"


def scenario_a_in_words(table):
    """What Scenario A's table says of the weight of the yaw, as Markdown.

    The paper's own sentences on it are judged in the ledger.

    Args:
        table: Of `notebooks.studies.scenario_tables.scenario_a_table`.
    """
    table = table.set_index(["weight", "quantity"])
    slow = table.loc[("Q1 / Q3", "settling time, ratio")]
    swings = table.loc[("Q2 / Q3", "overshoot, ratio")]
    errors = _listed(
        f"{table.loc[(name, 'mean error, true [m]'), 'mean']:.3f} m ({sign})"
        for name, sign in {"Q1": "Q¹", "Q2": "Q²", "Q3": "Q³"}.items()
    )
    return (
        f"- **Q¹ is slow.** It takes {three_digits(slow['mean'])} times as long as Q³ to settle "
        f"({slow['n']} fields); that it is at least twice as long {slow['verdict']}.\n"
        f"- **Q² overshoots.** It does so {three_digits(swings['mean'])} times as far as Q³; that "
        f"it is at least twice as far {swings['verdict']}.\n"
        f"- **The mean errors**, by the true position after settling, are {errors}."
    )


def _listed(texts):
    """Texts as "a, b and c"."""
    *others, last = texts
    return f"{', '.join(others)} and {last}" if others else last


# The ledger

_SENTENCES = "B3 B4 B5 B6 B7 B9 B10 B16 S4 A1 A2 A10 A9 T7".split()


def sentences():
    """What the ledger says of the sentences that the answer is about, with every condition.

    Returns:
        DataFrame of texts.
    """
    claims = _claims()
    texts = claims[["claim", "verdict", "conditions"]]
    shown = texts[claims.index.isin(_SENTENCES)].fillna("")
    return pd.DataFrame(
        {
            "id": shown.index,
            "the paper": shown["claim"],
            "verdict": shown["verdict"],
            "by condition": shown["conditions"].str.removeprefix(": "),
        }
    )


def bar(link=LEDGER):
    """How many of the paper's sentences have each verdict, in words, as Markdown.

    Args:
        link: Where the parts lead, or None.
    """
    counts = verdict_counts(_claims())["claims"]
    parts = [f"{verdict}: {count}" for verdict, count in counts.items() if count]
    if link:
        parts = [f"[{part}]({link})" for part in parts]
    return f"Of the {counts.sum()} sentences of the paper that were judged: {' · '.join(parts)}"
