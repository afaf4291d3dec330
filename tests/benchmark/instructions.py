"""Instructions of a step, counted by valgrind's callgrind: they do not depend on what else the
machine is doing.
"""

import re
import subprocess
import sys
import tempfile
from collections import Counter
from pathlib import Path

import pandas as pd

from rhec._casadi import scan
from rhec.scenario import Scenario
from rhec.studies import timing

PHASES = {  # the compiled Functions that a phase calls
    ("RHE", "preparation"): ("rhe_expand", "rhe_shift", "rhe_linearise"),
    ("RHE", "feedback"): ("rhe_feedback",),
    ("RHC", "preparation"): ("rhc_expand", "rhc_shift", "rhc_linearise"),
    ("RHC", "feedback"): ("rhc_feedback",),
    ("closed loop", "overall"): ("block",),
}


def drive():
    """What is counted: a minute of the closed loop, then its samples again from Python, phase by
    phase.
    """
    scenario = Scenario(process_noise="calibrated", duration_s=60.0)
    timing.phases(scenario, scenario.qp)


def per_call(profile):
    """Instructions a call, with all that is called, of every function in a callgrind file."""
    names, calls, total = {}, Counter(), Counter()
    with open(profile) as lines:
        for line in lines:
            if function := re.match(
                r"c?fn=\((\d+)\)(?: (\S+))?", line
            ):  # a name is written out once, then goes by its number
                name = names.setdefault(*function.groups())
            elif line.startswith(
                "calls="
            ):  # `name` is the one called, the next line says what it cost
                calls[name] += int(line.split()[0].removeprefix("calls="))
                total[name] += int(next(lines).split()[-1])
    return {name: total[name] / calls[name] for name in calls}


def measure():
    """Table of instructions a sample, by phase."""
    drive()  # what it needs is compiled outside valgrind
    with tempfile.TemporaryDirectory() as folder:
        profile = Path(folder) / "callgrind.out"
        subprocess.run(
            [
                "valgrind",
                "--tool=callgrind",
                f"--callgrind-out-file={profile}",
                sys.executable,
                "-c",
                f"from {__name__} import drive; drive()",
            ],
            check=True,
            capture_output=True,
        )
        cost = per_call(profile)
    cost["block"] /= scan.BLOCK
    return pd.DataFrame(
        [
            dict(
                problem=problem,
                phase=phase,
                instructions=round(sum(cost[function] for function in functions)),
            )
            for (problem, phase), functions in PHASES.items()
        ]
    )
