"""`python -m benchmark [PART …]`: measure, and leave tables in data/results/benchmark/.

Each part writes its own table, so that one can be measured again without the others. The parts are
the functions of this module that `part` registers, in their order.
"""

import os
import sys
from datetime import date

import pandas as pd

from benchmark import (
    acados_peer,
    campaigns,
    condensed,
    first,
    floor,
    instructions,
    latency,
    lines,
    peers,
    problems,
)
from benchmark import step as steps
from benchmark.tables import FOLDER, read
from notebooks.studies import timing
from rhec.simulation.scenario import Scenario

HORIZONS = 15, 40, 100, 200
STATES = 3, 6, 12, 30
SAMPLES, ROUNDS = 60, 15  # of the other sizes
PARTS = {}


def part(function):
    """Register a part by the name of its function."""
    PARTS[function.__name__] = function
    return function


def save(table, name):
    """Print a table, and save it with the machine, its load and the day."""
    load = "{:.1f} to {:.1f}".format(*sorted(os.getloadavg()[:2]))
    table = table.assign(machine=timing.machine(), load=load, day=date.today().isoformat())
    FOLDER.mkdir(parents=True, exist_ok=True)
    table.to_csv(FOLDER / f"{name}.csv", index=False, float_format="%.6g")
    shown = table.drop(columns=["machine", "load", "day"])
    print(f"\n{name}\n{shown.to_string(index=False, float_format='{:.4g}'.format)}", flush=True)


def save_each(loops, name):
    """Measure a step of each loop, and save the table after each of them."""
    found = []
    for loop in loops:
        found.append(steps.measure(loop, ROUNDS)[1])
        save(pd.concat(found), name)


def say_what_is_missing():
    """A line for each contestant, or means of counting, that is not installed."""
    if steps.REFERENCE not in peers.PEERS:
        print(f"{steps.REFERENCE} is not installed (make bench does that), so it is left out.")
    if not acados_peer.command():
        print("acados is missing: its wheel could not be installed, ACADOS_SOURCE_DIR is not set.")
    if not instructions.available():
        print("valgrind is not installed, so no instructions are counted.")


@part
def step():
    """One step at the paper's size."""
    loop = problems.robot(problems.PAPERS_SIZE[0], steps.SAMPLES)
    agreeing, times = steps.measure(loop)
    save(agreeing, "agreement")
    save(times, "step")


@part
def counts():
    """Instructions of a step at the paper's size, where valgrind is installed."""
    if instructions.available():
        loop = problems.robot(problems.PAPERS_SIZE[0], instructions.BEFORE + instructions.COUNTED)
        acados = steps.acados_of(loop.case, problems.record(loop))
        save(instructions.measure(acados), "instructions")


@part
def qp_solvers():
    """The phases of a step from Python, by the solver of the RHC's QP."""
    save(condensed.measure(Scenario(process_noise="prediction")), "qp_solvers")


@part
def horizons():
    """One step by horizon, of the paper's robot."""
    save_each((problems.robot(horizon, SAMPLES) for horizon in HORIZONS), "horizons")


@part
def states():
    """One step by the number of states, of the heated rod."""
    save_each((problems.rod(number, SAMPLES) for number in STATES), "states")


@part
def drives():
    """A drive by rhec.simulate, and campaigns."""
    save(campaigns.drive(), "drive")
    save(campaigns.measure(), "campaigns")


@part
def first_result():
    """From the start of a process to its first result."""
    save(first.measure(), "first")


@part
def near_floor():
    """The operations of a step, and how near to their least time it is."""
    rows = read("step")
    rows = rows[rows["contestant"] == instructions.IN_C].set_index(["problem", "phase"])
    save(floor.measure(rows["median_us"]), "floor")


@part
def explorer():
    """From a key to the picture of the explorer, where there is a Chromium."""
    with latency.opened() as found:
        if found:
            save(latency.measure(*found), "explorer")
        else:
            print("There is no Chromium or no Playwright, so the explorer is not measured.")


@part
def tutorials():
    """The lines that a user writes."""
    save(lines.measure(), "lines")


if __name__ == "__main__":
    unknown = set(sys.argv[1:]) - PARTS.keys()
    if unknown:
        sys.exit(f"{', '.join(sorted(unknown))}: no such part; there are {', '.join(PARTS)}")
    say_what_is_missing()
    for name in sys.argv[1:] or PARTS:
        PARTS[name]()
