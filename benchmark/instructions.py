"""Instructions of a step, counted by valgrind's callgrind: they do not depend on what else the
machine is doing.

Every contestant is set up and has solved some problems before it is counted (`counting.c`). A peer
is counted as it is timed: called from Python where it is one of Python's.
"""

import ctypes
import re
import shutil
import subprocess
import sys
import tempfile
from collections import Counter
from pathlib import Path

import pandas as pd

from benchmark import peers, problems
from notebooks.studies import timing
from rhec.core import runner
from rhec.core._casadi import compiled
from rhec.simulation import closed_loop
from rhec.simulation.scenario import Scenario

IN_C, CLOSED_LOOP = "rhec, in C", "rhec, closed loop"
BEFORE, COUNTED = 5, 10  # problems that a peer solves before it is counted, and then
SCENARIO = Scenario(process_noise="prediction", duration_s=60.0)  # of the loop that is counted


def available():
    return shutil.which("valgrind") and Path("/usr/include/valgrind/callgrind.h").exists()


def compiled_names():
    """The names of the compiled Functions that a phase of rhec calls, {(problem, phase): names}."""
    case = problems.papers_case()
    names = {}
    for problem, live in zip(("RHE", "RHC"), case.live((0.0, 0.0, 0.0, 0.5, 1.0, 1.0))):
        phases = {name: each.function.name() for name, each in live.iteration.phases.items()}
        names[problem, "preparation"] = [phases[n] for n in ("expand", "shift", "linearise")]
        names[problem, "feedback"] = [phases["feedback"]]
    return names


def drive():
    """A minute of the closed loop, then its samples again from Python, phase by phase."""
    timing.phases(SCENARIO)


def count(library):
    """What is run below callgrind: rhec, then every peer."""
    counting = ctypes.CDLL(library)
    counting.begin()
    drive()
    counting.end(b"rhec")
    loop = problems.robot(problems.PAPERS_SIZE[0], BEFORE + COUNTED)
    recorded = problems.record(loop)
    for name, makers in peers.PEERS.items():
        for problem, make in zip(("RHE", "RHC"), makers):
            solve = make(loop.case, recorded[0])
            for each in recorded[:BEFORE]:
                solve(each)
            counting.begin()
            for each in recorded[BEFORE:]:
                solve(each)
            counting.end(f"{name}/{problem}".encode())


def counter(folder):
    """The library with which a process says what is to be counted."""
    library, source = str(Path(folder, "counting.so")), Path(__file__).with_name("counting.c")
    command = [compiled.compiler(), "-shared", "-fPIC", source, "-o", library]
    subprocess.run(command, check=True)
    return library


def below_callgrind(folder, command, **options):
    """Runs it, and returns the callgrind files in the folder by what `end` was told."""
    profile = f"--callgrind-out-file={folder}/callgrind.out"
    valgrind = ["valgrind", "--tool=callgrind", "--instr-atstart=no", profile]
    subprocess.run([*valgrind, *command], check=True, capture_output=True, **options)
    told = re.compile(r"Client Request: (.*)")
    found = {path: told.search(path.read_text()) for path in Path(folder).glob("callgrind.out.*")}
    return {what[1]: path for path, what in found.items() if what}


def total(profile):
    """All instructions of a callgrind file."""
    return int(re.search(r"^totals: (\d+)", profile.read_text(), re.MULTILINE)[1])


def per_call(profile):
    """Instructions a call, with all that is called, of every function in a callgrind file."""
    names, calls, instructions = {}, Counter(), Counter()
    with open(profile) as lines:
        for line in lines:
            if function := re.match(r"c?fn=\((\d+)\)(?: (\S+))?", line):
                # A name is written out once, then goes by its number.
                name = names.setdefault(*function.groups())
            elif line.startswith("calls="):
                # `name` is the one called, the next line says what it cost.
                calls[name] += int(line.split()[0].removeprefix("calls="))
                instructions[name] += int(next(lines).split()[-1])
    return {name: instructions[name] / calls[name] for name in calls}


def measure(acados=None):
    """Table of instructions a sample, by contestant and phase."""
    # What it needs is compiled outside valgrind: the whole loop, too, in whose place a first drive
    # takes what compiles sooner.
    compiled.load(closed_loop.build_sample, *closed_loop.set_up(SCENARIO).structure)
    drive()
    with tempfile.TemporaryDirectory() as folder:
        library = counter(folder)
        script = f"from {__name__} import count; count({library!r})"
        profiles = below_callgrind(folder, [sys.executable, "-c", script])
        cost = per_call(profiles.pop("rhec"))
        counts = {
            IN_C: {
                key: sum(cost[name] for name in names) for key, names in compiled_names().items()
            },
            CLOSED_LOOP: {("closed loop", "overall"): cost["block"] / runner.BLOCK},
        }
        for what, profile in profiles.items():
            name, problem = what.split("/")
            counts.setdefault(name, {})[problem, "overall"] = total(profile) / COUNTED
        if acados:
            command, options = acados.counting(library, BEFORE, BEFORE + COUNTED)
            own = Path(folder, "acados")
            own.mkdir()
            for what, profile in below_callgrind(own, command, **options).items():
                (name, problem), cost = what.split("/"), per_call(profile)
                for phase in ("preparation", "feedback"):
                    counts.setdefault(name, {})[problem, phase] = cost[phase]
    return pd.DataFrame(
        [
            dict(contestant=name, problem=problem, phase=phase, instructions=round(number))
            for name, parts in counts.items()
            for (problem, phase), number in problems.with_sums(parts).items()
        ]
    )
