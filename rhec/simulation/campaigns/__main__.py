"""Run every combination of parameter values on many seeds; the same command continues a campaign.

The folder receives the rows of finished runs and the table campaign.parquet.
"""

import argparse
import itertools
import json
import os
from pathlib import Path

from rhec.simulation.campaigns.campaign import campaign
from rhec.simulation.scenario import Scenario

# The metrics with printed means.
_PRINTED = ["settling_time_s", "mean_error_m", "mean_error_true_m", "violations", "violations_true"]


def main():
    """Read the command line, run the campaign, write the table, and print means."""
    parser = _parser()
    options = parser.parse_args()
    if options.seeds < 1:
        parser.exit(2, f"--seeds was {options.seeds}; it should be at least 1\n")
    for name, *texts in options.p:
        if not texts:
            parser.exit(2, f"-p {name} had no value; it should have at least one\n")
    values = {name: [_parse(text) for text in texts] for name, *texts in options.p}
    values = values or dict(estimator=["rhe", "ekf"], process_noise=["printed", "calibrated"])
    values.setdefault("seed", range(options.seeds))
    file = options.folder / "campaign.parquet"
    try:
        combinations = itertools.product(*values.values())
        scenarios = [Scenario(**dict(zip(values, combination))) for combination in combinations]
        table = campaign(scenarios, options.folder, options.workers)
        _write(table, file)
    except ValueError as error:
        parser.exit(2, f"{error}\n")
    except (ImportError, OSError, RuntimeError) as error:
        parser.exit(1, f"{error}\n")
    except KeyboardInterrupt as error:
        parser.exit(130, f"{error}\n")
    varied = [name for name in values if name != "seed"]
    if len(table) and varied:
        print(table.groupby(varied, sort=False, dropna=False)[_PRINTED].mean().to_string())
    errors = table.loc[table["error"] != "", "error"]
    first = f", the first with {errors.iloc[0]}" if len(errors) else ""
    print(f"{len(table)} runs, {len(errors)} failed{first}; the table is {file}")


def _parser():
    parser = argparse.ArgumentParser("python -m rhec.simulation.campaigns", description=__doc__)
    parser.add_argument(
        "-p",
        nargs="+",
        action="append",
        default=[],
        metavar=("NAME", "VALUE"),
        help="a parameter of rhec.Scenario and its values: numbers, words or lists like [1,1,0]",
    )
    parser.add_argument(
        "--seeds", type=int, default=250, help="number of seeds, from 0 (default: 250)"
    )
    parser.add_argument(
        "--folder",
        type=Path,
        default=Path("build/campaign"),
        help="folder of the rows and of campaign.parquet (default: build/campaign)",
    )
    parser.add_argument(
        "--workers",
        type=int,
        help="processes on this machine (default: one per core, or DASK_SCHEDULER_ADDRESS)",
    )
    return parser


def _parse(text):
    """Return a value of the command line: JSON or, if it is not JSON, a string."""
    try:
        value = json.loads(text)
    except (ValueError, RecursionError):
        return text
    return tuple(value) if isinstance(value, list) else value


def _write(table, file):
    """Write the table, or leave an older one unchanged if writing fails, as on a full disk."""
    unfinished = file.with_suffix(".unfinished")
    try:
        table.to_parquet(unfinished)
        os.replace(unfinished, file)
    finally:
        unfinished.unlink(missing_ok=True)


if __name__ == "__main__":
    main()
