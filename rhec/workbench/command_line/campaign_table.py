"""`rhec campaign`: every combination of parameter values on many seeds, as a table."""

import itertools
import os
from pathlib import Path

from rhec.workbench.command_line.options import value_of

__all__ = ["ABOUT", "add_options", "run"]

ABOUT = (
    "Run every combination of parameter values on many seeds; the same command continues a "
    "campaign. The folder receives the rows of finished runs and the table campaign.parquet."
)
# The metrics with printed means.
_PRINTED = ["settling_time_s", "mean_error_m", "mean_error_true_m", "violations", "violations_true"]


def add_options(parser):
    """Add the options of a campaign to an argparse.ArgumentParser."""
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


def run(given):
    """Run or continue the campaign, write its table, and print means."""
    from rhec.simulation.campaigns.campaign import campaign
    from rhec.simulation.scenario import Scenario

    values = _values(given)
    combinations = itertools.product(*values.values())
    scenarios = [Scenario(**dict(zip(values, combination))) for combination in combinations]
    table = campaign(scenarios, given.folder, given.workers)
    file = given.folder / "campaign.parquet"
    _write(table, file)
    varied = [name for name in values if name != "seed"]
    if len(table) and varied:
        print(table.groupby(varied, sort=False, dropna=False)[_PRINTED].mean().to_string())
    errors = table.loc[table["error"] != "", "error"]
    first = f", the first with {errors.iloc[0]}" if len(errors) else ""
    print(f"{len(table)} runs, {len(errors)} failed{first}; the table is {file}")


def _values(given):
    """{parameter: its values} of the options; by default both estimators with both W."""
    if given.seeds < 1:
        raise ValueError(f"--seeds was {given.seeds}; it should be at least 1")
    for name, *texts in given.p:
        if not texts:
            raise ValueError(f"-p {name} had no value; it should have at least one")
    values = {name: [value_of(text) for text in texts] for name, *texts in given.p}
    values = values or dict(estimator=["rhe", "ekf"], process_noise=["printed", "calibrated"])
    return values | dict(seed=values.get("seed", range(given.seeds)))


def _write(table, file):
    """Write the table, or leave an older one unchanged if writing fails, as on a full disk."""
    unfinished = file.with_suffix(".unfinished")
    try:
        table.to_parquet(unfinished)
        os.replace(unfinished, file)
    finally:
        unfinished.unlink(missing_ok=True)
