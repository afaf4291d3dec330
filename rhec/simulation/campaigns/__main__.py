"""Run every combination of some parameters on many seeds, or go on where that was interrupted."""

import argparse
import itertools
import json
from pathlib import Path

from rhec.simulation.campaigns.campaign import campaign
from rhec.simulation.scenario import Scenario

__all__ = ["main"]

_SHOWN = ["settling_time_s", "mean_error_m", "mean_error_true_m", "violations", "violations_true"]


def main():
    """Read the command line, run the campaign, print means and write the table."""
    parser = argparse.ArgumentParser("python -m rhec.simulation.campaigns", description=__doc__)
    value = "a parameter of rhec.Scenario and its values: numbers, words or lists such as [1,1,0]"
    parser.add_argument(
        "-p", nargs="+", action="append", default=[], metavar=("NAME", "VALUE"), help=value
    )
    parser.add_argument("--seeds", type=int, default=250, help="how many, from 0 on (250)")
    folder = "where rows are kept, and the table campaign.parquet (build/campaign)"
    parser.add_argument("--folder", type=Path, default=Path("build/campaign"), help=folder)
    workers = "processes on this machine (one a core, or the cluster at DASK_SCHEDULER_ADDRESS)"
    parser.add_argument("--workers", type=int, help=workers)
    args = parser.parse_args()

    vary = {name: list(map(_value, texts)) for name, *texts in args.p} or dict(
        estimator=["rhe", "ekf"], process_noise=["printed", "calibrated"]
    )
    vary = vary if "seed" in vary else vary | dict(seed=range(args.seeds))
    try:
        scenarios = [
            Scenario(**dict(zip(vary, each))) for each in itertools.product(*vary.values())
        ]
        table = campaign(scenarios, args.folder, args.workers)
    except (ValueError, ImportError, OSError, RuntimeError) as error:
        parser.exit(2 if isinstance(error, ValueError) else 1, f"{error}\n")
    except KeyboardInterrupt as error:
        parser.exit(130, f"{error}\n")
    varied = [name for name in vary if name != "seed"]
    if len(table) and varied:
        print(table.groupby(varied, sort=False, dropna=False)[_SHOWN].mean().to_string())
    file = args.folder / "campaign.parquet"
    table.to_parquet(file)
    errors = table.loc[table["error"] != "", "error"]
    first = f", the first by {errors.iloc[0]}" if len(errors) else ""
    print(f"{len(table)} runs, {len(errors)} failed{first}; all of them are in {file}")


def _value(text):
    try:
        value = json.loads(text)
    except ValueError:
        return text
    return tuple(value) if isinstance(value, list) else value


if __name__ == "__main__":
    main()
