"""Judge one claim of the paper again: `python -m notebooks.claims B6` (`make claim ID=B6`)."""

import argparse

from notebooks.claims import summary


def main(arguments=None):
    """Print the claim's sentence, its verdict and the numbers behind it.

    Args:
        arguments: Of the command line; those of the process by default.

    Raises:
        SystemExit: With code 2 and one sentence if there is no such claim, or too few fields.
    """
    parser = argparse.ArgumentParser("python -m notebooks.claims", description=__doc__)
    parser.add_argument("id", help="of the claim, for example I2")
    text = f"simulated fields, at least 2 (default: {summary.FIELDS})"
    parser.add_argument("--fields", type=int, default=summary.FIELDS, help=text)
    given = parser.parse_args(arguments)
    try:
        lines = summary.report_lines(given.id, given.fields)
    except ValueError as error:
        parser.exit(2, f"{error}\n")
    print("\n".join(lines))


if __name__ == "__main__":
    main()
