"""The ledger for readers: its verdicts in numbers, its tables, and one claim judged again."""

import numpy as np
import pandas as pd

from notebooks.claims import evidence
from notebooks.claims.rules import CLAIMS
from notebooks.studies.statistics import (
    AS_PRINTED,
    CONFIDENCE,
    FAILS,
    HOLDS,
    LOST,
    UNDECIDED,
    UNTESTABLE,
    share_interval,
)
from notebooks.studies.tables import interval_text, interval_texts
from rhec.style import ROOT

PRINTED = f"{HOLDS} only {AS_PRINTED}"
DEPARTURE = f"{HOLDS} only with a departure"
FIELDS = 40  # of one claim alone, as in the first look of the ledger
_FALSE_DISCOVERY_RATE = 0.05  # over the whole ledger
_LEDGER = ROOT / "data/results/claims.csv"


def class_of(verdict):
    """The class of a verdict; its conditions are left out.

    PRINTED: the claim holds as printed, but not under every departure. DEPARTURE: it does not hold
    as printed, or is undecided, and holds with a departure.
    """
    if verdict.endswith(AS_PRINTED):
        return PRINTED
    return DEPARTURE if verdict.startswith(f"{HOLDS} ") else verdict


def verdict_counts(table):
    """Count the claims by class of verdict.

    Args:
        table: The ledger, of `ledger.ledger` or from claims.csv.

    Returns:
        DataFrame of counts, one row a class (holds, PRINTED, DEPARTURE, does not hold, its rival is
        lost, undecided, cannot be tested here), with columns "claims" and, of those, "by
        derivation". Classes without a claim have 0.
    """
    order = [HOLDS, PRINTED, DEPARTURE, FAILS, LOST, UNDECIDED, UNTESTABLE]
    by_class = table["derived"].groupby(table["verdict"].map(class_of))
    counts = pd.DataFrame({"claims": by_class.size(), "by derivation": by_class.sum()})
    return counts.reindex(order, fill_value=0).astype(int).rename_axis("verdict")


def survivors(table):
    """The verdicts that remain when the false discovery rate of the whole ledger is held at 5 %.

    Args:
        table: The ledger, of `ledger.ledger` or from claims.csv.

    Returns:
        How many verdicts rest on an interval, and the ids of those that do not remain.
    """
    decided = ~table["verdict"].isin([UNDECIDED, UNTESTABLE])
    at_risk = table[table["p"].notna() & decided & ~table["derived"]]
    lost = at_risk["p_adjusted"] >= _FALSE_DISCOVERY_RATE
    return len(at_risk), list(at_risk.loc[lost, "id"])


# Parts of the ledger for readers


def left_aligned(table):
    """A table whose texts and heads begin at the left of their cells, as a pandas Styler."""
    heads = {"selector": "th", "props": "text-align: left"}
    shown = table.style.format(precision=4).set_properties(**{"text-align": "left"})
    return shown.set_table_styles([heads])


def readable_ledger(table, columns=("claim", "verdict", "value", "unit")):
    """Columns of the ledger, with values and shares of worlds as "34.6 [32.3, 37.0]", by id."""
    shown = table.assign(
        value=interval_texts(table, "value"),
        posterior=interval_texts(table, "posterior", "posterior_low", "posterior_high"),
        p_adjusted=table["p_adjusted"].round(4),
    )
    return shown.set_index("id")[list(columns)].fillna("")


def lost(table):
    """The claims whose verdict does not remain, see `survivors`."""
    _, ids = survivors(table)
    rows = table[table["id"].isin(ids)]
    return readable_ledger(rows, ["claim", "value", "verdict", "p_adjusted"])


def failing(table):
    """The claims that hold under no condition, with the rule and the reason."""
    rows = table[table["verdict"] == FAILS]
    return readable_ledger(rows, ["claim", "test", "paper", "value", "n", "beside", "why"])


def depending(table):
    """The claims that hold under some conditions only."""
    rows = table[table["verdict"].map(class_of).isin([PRINTED, DEPARTURE])]
    return readable_ledger(rows, ["claim", "test", "value", "verdict", "conditions"])


def in_worlds(table):
    """The claims about driving with the share of the posterior's worlds in which each holds."""
    rows = table[table["posterior"].notna()]
    return readable_ledger(rows, ["claim", "verdict", "posterior"])


# One claim alone


def listed(claims=CLAIMS):
    """One line for each claim: id, sentence, and the verdict of the ledger."""
    verdicts = pd.read_csv(_LEDGER).set_index("id")["verdict"]
    width = max(len(claim.claim) for claim in claims.values())
    return [f"{id_:4}{claim.claim:{width}}  {verdicts[id_]}" for id_, claim in claims.items()]


def _how_sure(findings):
    """How sure as many cases can be, of a share or of what is true in every case; else nothing.

    If all n cases agree, Clopper and Pearson's interval of their share begins at (α/2)^(1/n), at
    the confidence 1 - α. So n must be above ln(α/2) / ln(bound).
    """
    finding = max(findings.values(), key=lambda finding: finding.n)
    n = finding.n
    low, _ = share_interval(n, n)
    if finding.above == 1:
        text = f"if all {n} agree, up to {1 - low:.1%} of all cases may still be exceptions"
    else:
        enough = int(np.floor(np.log((1 - CONFIDENCE) / 2) / np.log(finding.above))) + 1
        text = f"if all {n} agree, the share is at least {low:.3f}"
        text += f"; to be above {finding.above:g} takes {enough} or more"
    return [f"  how sure {n} cases can be: {text}"]


def _is_share(claim, findings):
    """Whether a claim is about a share with a lower bound, and was tested."""
    bounds = [finding.above for finding in findings.values() if finding.n]
    return claim.rule.unit.startswith("share") and bounds and 0 < max(bounds) <= 1


def report_lines(id_, fields=FIELDS, folder=None, claims=CLAIMS):
    """Judge one claim on a few fields and say what came out.

    Args:
        id_: Of the claim, for example "I2".
        fields: How many fields, from seed 0 on.
        folder: Where the campaign keeps its rows.
        claims: {id: Claim}.

    Returns:
        Lines of text: sentence, section and quote, test, verdict, then one line for each condition.

    Raises:
        ValueError: If there is no such claim, or fewer than 2 fields.
    """
    if id_ not in claims:
        raise ValueError(f"claim was {id_!r}; it should be one of {', '.join(claims)}")
    if fields < 2:
        raise ValueError(f"fields was {fields}; it should be 2 or more")
    claim = claims[id_]
    _, findings, beside, _ = evidence.collect({id_: claim}, [fields], folder)
    verdict, _ = claim.rule.combined(findings[id_])
    derived = ", by derivation" if claim.derived else ""
    lines = [
        f"{id_}: {claim.claim}",
        f"  {claim.section}: “{claim.quote}”",
        f"  test: {claim.test}",
        f"  verdict: {verdict}{derived}",
    ]
    lines += [_line(name, found, claim.rule.unit) for name, found in findings[id_].items()]
    lines += [_line(f"beside it: {what}", found) for what, found in beside[id_].items()]
    lines += [f"  why: {claim.why}"] if claim.why else []
    lines += _how_sure(findings[id_]) if _is_share(claim, findings[id_]) else []
    if evidence.driven_tables_of(claim.rule.by_condition.values()):
        lines.append(f"  seeds 0 to {fields - 1}; intervals and verdicts at {CONFIDENCE:.0%}")
        lines.append("  The ledger (06_claims) has more fields, and other worlds.")
    return lines


def _line(name, found, unit=""):
    """A condition, its number with its interval, n and verdict."""
    number = interval_text(found.value, found.low, found.high)
    unit = "" if unit in ("", "-") else f" {unit}"
    numbers = f"{number}{unit}, n = {found.n}: " if number else ""
    judged = found.verdict if not name.startswith("beside") else ""
    return f"    {name or 'in all cases'}: {numbers}{judged}".rstrip(": ")
