"""The claims ledger: what the evidence says of every checkable sentence of the paper.

The sentences and their rules are in claims.toml (`rules.load`). A field is one seed: its soil and
its noise together. A bound on the true error is judged relative to the oracle, a robot that knows
its true pose and soil: fields where the oracle fails too are left out.

Verdicts are those of the default world. Beside them stands the share of the posterior's worlds in
which a claim about driving holds (`worlds`). A verdict *by derivation* follows from equations or
from the paper's own numbers, which no world could change.
"""

import numpy as np
import pandas as pd
from scipy import stats

from notebooks.claims import run_sets
from notebooks.claims.rules import CLAIMS
from notebooks.studies.statistics import UNDECIDED, coverage, difference_of_means, ratio_of_means
from notebooks.studies.tables import interval_text

_PAIRS = ("rhe", "ekf"), ("rhe", "no_slip"), ("fixed_traction", "rhe"), ("q3", "q2")
_COLUMNS = (
    "id section claim quote test bound paper value low high n unit verdict derived condition "
    "confidence above below p p_adjusted conditions other_condition other_value other_low "
    "other_high other_n other_verdict other_above other_below beside posterior posterior_low "
    "posterior_high posterior_n why"
).split()


def _largest_p(findings, verdict):
    """The largest p of the conditions; undecided ones count only where they decide. NaN if none."""
    ps = [
        finding.p
        for finding in findings.values()
        if verdict == UNDECIDED or finding.verdict != UNDECIDED
    ]
    return pd.Series(ps, dtype=float).max()


def _other(findings, deciding):
    """Columns of the Finding to show beside the deciding one: the first whose verdict differs."""
    others = {name: finding for name, finding in findings.items() if name != deciding}
    if not others:
        return dict(other_condition="", other_verdict="")
    differs = [name for name in others if others[name].verdict != findings[deciding].verdict]
    name = next(iter(differs or others))
    columns = {f"other_{field}": value for field, value in others[name]._asdict().items()}
    return dict(other_condition=name) | columns


def _posterior(share):
    """Columns of the share of the posterior's worlds in which a claim holds; None: none of them."""
    if share is None:
        return {}
    columns = dict(posterior=share.value, posterior_low=share.low)
    return columns | dict(posterior_high=share.high, posterior_n=share.n)


def _row(id_, claim, findings, looks, beside, share):
    """The ledger's row on one claim, but for p_adjusted, which depends on all rows."""
    verdict, deciding = claim.rule.combined(findings)
    row = claim._asdict() | findings[deciding]._asdict() | claim.rule._asdict()
    row |= dict(id=id_, condition=deciding, p=_largest_p(findings, verdict))
    row |= dict(verdict=verdict, confidence=looks[deciding])
    row["conditions"] = "; ".join(f"{name}: {each.verdict}" for name, each in findings.items())
    row["beside"] = "; ".join(
        f"{what}: {interval_text(number.value, number.low, number.high)}"
        for what, number in beside.items()
    )
    return row | _posterior(share) | _other(findings, deciding)


def ledger(findings, looks, beside, shares, claims=CLAIMS):
    """Judge claims: what the paper says, what the evidence says, and the verdict.

    Args:
        findings, looks, beside: Of `evidence.collect`.
        shares: Of `worlds.shares`, of the posterior's worlds; claims that it leaves out have none.
        claims: {id: Claim}.

    Returns:
        DataFrame, one row a claim: id, section, claim, quote, test, bound, paper, the Finding under
        the condition that decides (value, low, high, n, unit, condition, above, below), the
        verdict, whether it is by derivation, and the confidence of the look that decided; the
        verdict under each condition; the Finding under the first that says otherwise, or else the
        next (other_condition, other_value, …); the numbers beside; the share of the posterior's
        worlds where the claim holds (posterior, posterior_low, …); and why. p is the largest of
        the conditions', p_adjusted the same with the false discovery rate held over the whole
        ledger (Benjamini and Yekutieli); NaN where nothing is left to chance.
    """
    rows = [
        _row(id_, claim, findings[id_], looks[id_], beside[id_], shares.get(id_))
        for id_, claim in claims.items()
    ]
    table = pd.DataFrame(rows, columns=_COLUMNS)
    chance = table["p"].notna()
    adjusted = stats.false_discovery_control(table.loc[chance, "p"], method="by")
    # Claims share runs, so their tests are dependent; Benjamini and Yekutieli allow for that.
    table.loc[chance, "p_adjusted"] = adjusted
    return table


def coverages(tables):
    """How often the intervals behind the ledger cover the truth, by resampling.

    Args:
        tables: The evidence, of `evidence.collect`.

    Returns:
        DataFrame, one row a process noise and a statistic of RUNS' metrics.
    """
    cases = [
        (np.mean, ["rhe"], metric)
        for metric in ("mean_error_m", "mean_error_true_m", "violations", "rms_kappa")
    ]
    cases += [(difference_of_means, [one, other], "mean_error_true_m") for one, other in _PAIRS]
    cases += [(ratio_of_means, ["rhe", "oracle"], "mean_error_true_m")]
    rows = []
    for process_noise in run_sets.PROCESS_NOISES:
        for statistic, ids, metric in cases:
            # Unequal tables are cut to the seeds that both have.
            found = [tables[process_noise, "runs", id_][metric] for id_ in ids]
            n = min(map(len, found))
            share = coverage(statistic, *(values[:n] for values in found))
            about = dict(statistic=statistic.__name__, runs=" ".join(ids), metric=metric)
            rows.append(about | dict(process_noise=process_noise, n=n, coverage=share))
    return pd.DataFrame(rows)
