"""Compare the tables in figures/ with those that this commit is expected to make.

    python -m docs.site.check_figures

It fails if one differs, and says where. Tables of computation times, which `make bench` leaves in
data/results/benchmark/, are not among them. A table
that a notebook has made with other parameters is of another world, and is compared with nothing.
"""

import sys

import pandas as pd
from pandas.testing import assert_frame_equal

from notebooks.studies.answer import RESULTS
from rhec.style import ROOT, note_of

TOLERANCE = 1e-6  # relative: more than compilers differ by, less than any conclusion needs


def difference(made, expected):
    """What pandas says of the first column in which two tables differ; "" if none does."""
    try:
        assert_frame_equal(
            _without_times(made),
            _without_times(expected),
            check_dtype=False,
            rtol=TOLERANCE,
            atol=0.0,
            obj="the table",
        )
    except AssertionError as error:
        return "; ".join(line for line in str(error).splitlines() if 0 < len(line) < 100)
    return ""


def _without_times(table):
    """A table without its texts on computation times, of which each machine has its own."""
    return table.mask(table.map(lambda cell: "on this machine" in str(cell)), "a time")


def main():
    accept = []
    is_all_the_papers = True
    for file in sorted(RESULTS.glob("*.csv")):
        made = ROOT / "figures" / file.name
        if not made.exists():
            print(f"{file.stem}: not made yet")
            continue
        if note := note_of(made):
            print(f"{file.stem}: another world ({note}); `make figures studies` makes the paper's")
            is_all_the_papers = False
            continue
        found = difference(pd.read_csv(made), pd.read_csv(file))
        print(f"{file.stem}: {found or 'the same'}")
        accept += [f"figures/{file.name}"] if found else []
    if accept:
        print("\nIf the new numbers are right:")
        print(f"  cp {' '.join(accept)} data/results/ && python -m docs.site.results")
    return int(bool(accept) or not is_all_the_papers)


if __name__ == "__main__":
    sys.exit(main())
