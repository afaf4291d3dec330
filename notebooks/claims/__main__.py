"""Judge claims of the paper again: `python -m notebooks.claims B5 B6` (`make claim ID="B5 B6"`).

Without an id it lists all claims with the verdicts of the ledger.
"""

import argparse
import itertools
import os
import sys

import pandas as pd

from notebooks.claims import evidence
from notebooks.claims.rules import CLAIMS
from notebooks.studies.answer import RESULTS
from notebooks.studies.statistics import CONFIDENCE
from notebooks.studies.tables import interval_text, with_minus

_FIELDS = 40  # as in the first look of the ledger
_NOT_YET = "not judged yet"  # of a claim that the ledger in data/results does not have


def _listed():
    """One line for each claim: id, sentence, and the verdict of the ledger."""
    verdicts = pd.read_csv(RESULTS / "claims.csv").set_index("id")["verdict"]
    width = max(len(claim.claim) for claim in CLAIMS.values())
    return [
        f"{id_:4}{claim.claim:{width}}  {verdicts.get(id_, _NOT_YET)}"
        for id_, claim in CLAIMS.items()
    ]


def _report_lines(id_, fields):
    """Judge one claim on a few fields and say what came out.

    Args:
        id_: Of the claim, for example "I2".
        fields: How many fields, from seed 0 on.

    Returns:
        Lines of text: sentence, section and quote, test, verdict, then one line for each condition.

    Raises:
        ValueError: If there is no such claim, or fewer than 2 fields.
    """
    if id_ not in CLAIMS:
        merged = [into for into, claim in CLAIMS.items() if claim.mended.startswith(f"{id_} ")]
        lists = "`make claim` without an ID lists those there are"
        known = f"it is part of {merged[0]} now" if merged else lists
        raise ValueError(f"claim was {id_!r}; {known}")
    if fields < 2:
        raise ValueError(f"fields was {fields}; it should be 2 or more")
    claim = CLAIMS[id_]
    _, findings, beside, _ = evidence.collect({id_: claim}, [fields])
    verdict, _ = claim.rule.combined(findings[id_])
    derived = ", by derivation" if claim.derived else ""
    lines = [
        f"{id_}: {claim.claim}",
        f"  {claim.section}: “{claim.quote}”",
        f"  test: {with_minus(claim.test)}",
        f"  verdict: {verdict}{derived}",
    ]
    unit = claim.rule.unit.removeprefix("-")
    for name, found in findings[id_].items():
        lines.append(_line(name or "in all cases", found, unit, found.verdict))
    lines += [_line(f"beside it: {what}", found, "", "") for what, found in beside[id_].items()]
    lines += [f"  why: {claim.why}"] if claim.why else []
    if evidence.driven_tables_of(claim.rule.by_condition.values()):
        lines.append(f"  seeds 0 to {fields - 1}; intervals and verdicts at {CONFIDENCE:.0%}")
        lines.append("  The ledger (06_claims) has more fields, and other worlds.")
    return lines


def _line(name, found, unit, verdict):
    """A condition, or what stands beside it: its number with its interval, n and verdict."""
    number = interval_text(found.value, found.low, found.high)
    numbers = [f"{number} {unit}".rstrip(), f"n = {found.n}"] if number else []
    return f"    {name}: " + ": ".join(filter(None, [", ".join(numbers), verdict]))


def main(arguments=None):
    """Print claims' sentences, verdicts and the numbers behind them, or the list of all claims.

    Args:
        arguments: Of the command line; those of the process by default.

    Raises:
        SystemExit: With code 2 and one sentence if there is no such claim, or too few fields.
    """
    parser = argparse.ArgumentParser("python -m notebooks.claims", description=__doc__)
    text = "of a claim, for example I2; without any, all claims are listed"
    parser.add_argument("ids", metavar="id", nargs="*", help=text)
    text = f"simulated fields, at least 2 (default: {_FIELDS})"
    parser.add_argument("--fields", type=int, default=_FIELDS, help=text)
    given = parser.parse_args(arguments)
    ids = " ".join(given.ids).replace(",", " ").upper().split()
    if not ids:
        print("\n".join(_listed()))
    try:
        for line in itertools.chain(*(_report_lines(id_, given.fields) for id_ in ids)):
            print(line)
    except ValueError as error:
        parser.exit(2, f"{error}\n")


if __name__ == "__main__":
    try:
        main()
    except BrokenPipeError:
        # What reads the list has ended, as in `make claim | head`; nothing more can be printed.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
