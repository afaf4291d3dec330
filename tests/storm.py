"""A long campaign through a storm: workers are killed all the time, the campaign itself once, and
once the disk is full. 20,000 runs with a worker killed every twelve seconds tell as much as 100,000
with one a minute.

Each time the command ends it is given again, as a person would. At the end there must be one row
a run, none lost, twice or with an error, and some are run again here: the same to the last bit.
"""

import argparse
import contextlib
import dataclasses
import json
import os
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import psutil
import pyarrow.parquet as pq

import rhec
from rhec.simulation.campaigns import store

ROOT = Path(rhec.__file__).parents[1]
BASE = rhec.Scenario()
CHECKED = 100  # rows that are run again


def on_a_small_disk(folder):
    """Start this program anew where `folder` is a disk of its own; False where only root could."""
    if os.environ.get("RHEC_STORM") or os.geteuid():
        return bool(os.environ.get("RHEC_STORM"))
    if subprocess.run(["unshare", "-m", "true"], capture_output=True).returncode:
        return False
    folder.mkdir(parents=True, exist_ok=True)
    mount = 'mount -t tmpfs -o size=1g none "$0" && exec "$@"'
    again = ["unshare", "-m", "sh", "-c", mount, str(folder), sys.executable, *sys.argv]
    os.execvpe("unshare", again, os.environ | dict(RHEC_STORM="1"))


class Rows:
    """How many rows the files in a folder hold; each file is looked at once."""

    def __init__(self, folder):
        self.folder, self.counted = folder, {}

    def count(self):
        for file in self.folder.glob("*/*.parquet"):
            if file not in self.counted:
                self.counted[file] = pq.read_metadata(file).num_rows
        return sum(self.counted.values())


def workers_of(process):
    """The worker processes that a process has started."""
    found = []
    for child in process.children(recursive=True):
        with contextlib.suppress(psutil.NoSuchProcess):  # it has just ended
            if "popen_loky" in " ".join(child.cmdline()):
                found.append(child)
    return found


def fill(file):
    """Leave no room beside this file."""
    with open(file, "wb", buffering=0) as filler:
        try:
            while True:
                filler.write(bytes(1 << 20))
        except OSError:
            pass


def attempt(options, rows, log, disk):
    """The command, once; its return code and what it said."""
    command = [sys.executable, "-m", "rhec", "campaign", "--seeds", str(options.runs)]
    command += ["-p", "duration_s", str(BASE.duration_s), "--folder", str(options.folder)]
    command += ["--workers", str(options.workers)]
    files = dict(stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, cwd=ROOT)
    process = psutil.Popen(command, **files)
    before, filler, next_kill = rows.count(), options.folder / "filler", np.inf
    while process.poll() is None:
        time.sleep(0.2)
        done = rows.count()
        try:
            if done > before:  # all have started
                next_kill = min(next_kill, time.monotonic() + options.kill_every_s)
            if time.monotonic() > next_kill and (living := workers_of(process)):
                living[log["workers_killed"] % len(living)].kill()
                log["workers_killed"] += 1
                next_kill = time.monotonic() + options.kill_every_s
            if done > options.runs / 3 and not log["campaigns_killed"]:
                process.kill()
                log["campaigns_killed"] += 1
            elif disk and done > 2 * options.runs / 3 and not log["disks_full"]:
                fill(filler)
                log["disks_full"] += 1
        except psutil.NoSuchProcess:
            pass
    out, err = process.communicate()
    filler.unlink(missing_ok=True)
    return process.returncode, out, err


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--runs", type=int, default=20_000)
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--kill-every-s", type=float, default=12.0)
    parser.add_argument("--folder", type=Path, default=ROOT / "build/storm")
    options = parser.parse_args()
    if options.runs < 1:
        parser.error(f"--runs was {options.runs}; it should be at least 1")
    disk = on_a_small_disk(options.folder)
    if not disk:
        print("the disk is not filled: that takes a disk of its own, which only root may mount")
    log = dict(workers_killed=0, campaigns_killed=0, disks_full=0)
    rows, began, ends = Rows(options.folder), time.monotonic(), []
    for _ in range(10):
        code, out, err = attempt(options, rows, log, disk)
        ends.append(code)
        where = f"{time.monotonic() - began:.0f} s, {rows.count()} rows"
        print(f"{where}: ended with {code}: {(err or out).strip()}", flush=True)
        assert "Traceback" not in err, err
        if code == 0:
            break
    seconds = time.monotonic() - began

    kept = {}
    for of_a_file in store.load_rows(store.open_folder(options.folder)):
        kept |= of_a_file
    wanted = [dataclasses.replace(BASE, seed=seed) for seed in range(options.runs)]
    keys = list(map(store.scenario_key, wanted))
    again = np.random.default_rng(0).choice(options.runs, min(CHECKED, options.runs), replace=False)
    differing = sum(
        repr(rhec.simulate(wanted[seed]).metrics | dict(error="")) != repr(kept.get(keys[seed]))
        for seed in again
    )
    result = log | dict(
        runs=options.runs,
        lost=len(set(keys) - kept.keys()),
        foreign=len(kept.keys() - set(keys)),
        twice=rows.count() - len(kept),
        checked=len(again),
        differing=differing,
        ends=ends,
        runs_per_s=round(options.runs / seconds, 1),
    )
    print(json.dumps(result, indent=1))
    bad = ("lost", "foreign", "twice", "differing")
    raise SystemExit(ends[-1] != 0 or any(result[name] for name in bad))


if __name__ == "__main__":
    main()
