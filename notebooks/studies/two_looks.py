"""Two looks: few fields decide what is clear, all fields decide the rest.

Most questions are decided by few fields, whose intervals are far from the bounds. A first look asks
for 99.9 % confidence, and only what is still undecided is driven on all fields, where 95 %
suffices. That is the group-sequential design of Haybittle (British Journal of Radiology 44, 1971)
and Peto et al. (British Journal of Cancer 34, 1976). A verdict is wrong with a probability of at
most 0.1 % at the first look and 5 % at the second, 5.1 % in all.

What is driven and what is asked are not the same: one question may need several tables, and one
table may serve several questions. So a study says by two functions how a table is made, and which
tables the questions still need.
"""

from typing import NamedTuple

import numpy as np
import pandas as pd

from notebooks.studies.statistics import CONFIDENCE, FIRST_CONFIDENCE

__all__ = ["ERROR_RATE", "Looks", "drive", "with_first_look"]

ERROR_RATE = (1 - FIRST_CONFIDENCE) + (1 - CONFIDENCE)  # of a verdict over both looks, at most


class Looks(NamedTuple):
    """What the looks have driven.

    Args:
        confidence: Of the first look; of the only one, where there is one.
        first: {name: DataFrame}, the rows of the first look.
        tables: {name: DataFrame}, all rows; those of the first look come first.
        again: Names of the tables that had a second look.
    """

    confidence: float
    first: dict
    tables: dict
    again: frozenset


def drive(names, first, seeds, make, undecided):
    """Drive tables in two looks.

    Args:
        names: Of the tables.
        first: Fields of the first look, seeds 0 to first - 1.
        seeds: Fields of both looks. With no more than in the first there is one look, at 95 %, and
            `undecided` is not asked.
        make: Function of a list of names and a range of seeds that returns {name: DataFrame}.
        undecided: Function of {name: DataFrame} and a confidence that returns the names of the
            tables that need a second look.

    Returns:
        Looks.
    """
    names = list(names)
    looked = make(names, range(min(first, seeds)))
    if first >= seeds:
        return Looks(CONFIDENCE, looked, looked, frozenset())
    again = frozenset(undecided(looked, FIRST_CONFIDENCE))
    longer = [name for name in names if name in again]
    more = make(longer, range(first, seeds)) if longer else {}
    tables = looked | {
        name: pd.concat([looked[name], rows], ignore_index=True) for name, rows in more.items()
    }
    return Looks(FIRST_CONFIDENCE, looked, tables, again)


def with_first_look(finding):
    """A second look's Finding: what the first spent of the error rate is part of its p."""
    spent = finding.p + 1 - FIRST_CONFIDENCE
    return finding._replace(p=float(np.minimum(spent, 1.0)))  # NaN stays NaN
