"""Judge one claim of the paper again: `python -m notebooks.claims B6` (`make claim ID=B6`).

Without an id it lists all claims with the verdicts of the ledger.
"""

import argparse
import os
import sys

from notebooks.claims import summary


def main(arguments=None):
    """Print a claim's sentence, its verdict and the numbers behind it, or the list of all claims.

    Args:
        arguments: Of the command line; those of the process by default.

    Raises:
        SystemExit: With code 2 and one sentence if there is no such claim, or too few fields.
    """
    parser = argparse.ArgumentParser("python -m notebooks.claims", description=__doc__)
    text = "of the claim, for example I2; without it, all claims are listed"
    parser.add_argument("id", nargs="?", default="", help=text)
    text = f"simulated fields, at least 2 (default: {summary.FIELDS})"
    parser.add_argument("--fields", type=int, default=summary.FIELDS, help=text)
    given = parser.parse_args(arguments)
    if not given.id:
        print("\n".join(summary.listed()))
        return
    try:
        for line in summary.report_lines(given.id, given.fields):
            print(line, flush=True)
    except ValueError as error:
        parser.exit(2, f"{error}\n")


if __name__ == "__main__":
    try:
        main()
    except BrokenPipeError:
        # What reads the list has ended, as in `make claim | head`; nothing more can be printed.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
