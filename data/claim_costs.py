"""Measure what judging each claim of the paper costs, into data/claim_costs.csv.

    .venv/bin/python data/claim_costs.py [ID ...]

Each `rhec claim ID` is a process of its own, one after the other in the ledger's order. They share
a folder of compiled code, which is empty at first. A loop that an earlier claim compiled is
therefore not compiled again, and its disk counts for the earlier one. Claims that are not named
keep their rows.
"""

import os
import resource
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import pandas as pd

from rhec.workbench.studies.claims.rules import CLAIMS
from rhec.workbench.studies.timing import machine

_FILE = Path(__file__).with_suffix(".csv")


def measure(id_, cache):
    """What one claim costs.

    Args:
        id_: Of the claim.
        cache: Folder of the compiled code.

    Returns:
        dict: id, command, the seconds that passed, the seconds of all cores together, the megabytes
        that it added to the folder, and the machine.
    """
    bytes_before = _bytes_in(cache)
    cores_before = _core_seconds()
    began = time.perf_counter()
    subprocess.run(
        [sys.executable, "-m", "rhec", "claim", id_],
        env=os.environ | {"RHEC_CACHE": str(cache)},
        stdout=subprocess.DEVNULL,
        check=True,
    )
    return dict(
        id=id_,
        command=f"rhec claim {id_}",
        seconds=round(time.perf_counter() - began, 1),
        core_seconds=round(_core_seconds() - cores_before, 1),
        megabytes=round((_bytes_in(cache) - bytes_before) / 1e6, 2),
        machine=machine(),
    )


def _core_seconds():
    """Computing time of the processes that this one has started and that have ended."""
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


def _bytes_in(folder):
    return sum(file.stat().st_size for file in folder.rglob("*") if file.is_file())


def main():
    """Measure the claims that are named, or all, and write each row as soon as it is there."""
    ids = sys.argv[1:] or [*CLAIMS]
    rows = pd.read_csv(_FILE).set_index("id").to_dict("index") if _FILE.exists() else {}
    with tempfile.TemporaryDirectory() as folder:
        for id_ in ids:
            row = measure(id_, Path(folder))
            rows[row.pop("id")] = row
            there = [each for each in CLAIMS if each in rows]
            table = pd.DataFrame([rows[each] for each in there], index=pd.Index(there, name="id"))
            table.to_csv(_FILE)


if __name__ == "__main__":
    main()
