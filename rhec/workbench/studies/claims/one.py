"""One claim alone: its sentence, its verdict and the numbers behind it, in a few seconds."""

from rhec.workbench.studies.claims import evidence
from rhec.workbench.studies.claims.rules import CLAIMS
from rhec.workbench.studies.statistics import CONFIDENCE, interval_text

__all__ = ["FIELDS", "report_lines"]

FIELDS = 40  # of one claim alone: enough for most verdicts at 99.9 %


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
        ValueError: If there is no such claim.
    """
    if id_ not in claims:
        raise ValueError(f"claim was {id_!r}; it should be one of {', '.join(claims)}")
    claim = claims[id_]
    _, findings, beside, _ = evidence.collect({id_: claim}, fields, fields, folder)
    verdict, _ = claim.rule.combined(findings[id_])
    derived = ", by derivation" if claim.derived else ""
    driven = any(
        kind != "experiments" for _, kind, _ in evidence.tables_of(claim.rule.by_condition.values())
    )
    lines = [
        f"{id_}: {claim.claim}",
        f"  {claim.section}: “{claim.quote}”",
        f"  test: {claim.test}",
        f"  verdict: {verdict}{derived}",
    ]
    lines += [_line(name, found, claim.rule.unit) for name, found in findings[id_].items()]
    lines += [_line(f"beside it: {what}", found) for what, found in beside[id_].items()]
    lines += [f"  why: {claim.why}"] if claim.why else []
    if driven:
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
