"""`python -m rhec.workbench.studies.claims ID`: judge one claim of the paper."""

import argparse

from rhec.workbench.studies.claims import one


def main(arguments=None):
    """Print what comes out of one claim.

    Args:
        arguments: Of the command line; those of the process, by default.
    """
    parser = argparse.ArgumentParser("python -m rhec.workbench.studies.claims", description=__doc__)
    parser.add_argument("id", help="of the claim, for example I2")
    parser.add_argument("--fields", type=int, default=one.FIELDS, help="simulated fields")
    chosen = parser.parse_args(arguments)
    if chosen.fields < 2:
        parser.error(f"--fields was {chosen.fields}; it should be 2 or more")
    try:
        lines = one.report_lines(chosen.id, chosen.fields)
    except ValueError as error:
        parser.error(str(error))
    print("\n".join(lines))


if __name__ == "__main__":
    main()
