"""acados beside the others: its own process answers and is timed when its turn comes."""

import json
import os
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np

from notebooks.studies.timing import PHASES
from rhec import paper

ITERATIONS = 30
SHARE = 10  # problems in a block, which takes less time than a process gets at once
NAMES = {"step by step": "acados in C, step by step", "as it comes": "acados in C"}
_OWN_PYTHON = Path(__file__).parents[1] / ".venv" / "acados" / "bin" / "python"


def command():
    """How to run Python with acados, and its environment; None where there is none."""
    source = os.environ.get("ACADOS_SOURCE_DIR")
    if source:
        paths = Path(source, "interfaces", "acados_template"), Path(source, "lib")
        added = zip(("PYTHONPATH", "LD_LIBRARY_PATH"), map(str, paths))
        return sys.executable, os.environ | dict(added)
    return (str(_OWN_PYTHON), dict(os.environ)) if _OWN_PYTHON.exists() else None


class Acados:
    """Solvers of both problems, chosen and built for these problems in a folder of their own."""

    def __init__(self, case, recorded, tolerance):
        python, self._environment = command()
        self._folder, self._count = tempfile.TemporaryDirectory(), len(recorded)
        data = dict(zip(recorded[0]._fields, map(np.array, zip(*recorded))))
        bounds = list(case.model.parameters.values())
        bounded = [i for i, pair in enumerate(bounds) if pair]
        data |= dict(system=case.system, measured=case.measured, dt_s=paper.DT_S)
        data |= dict(weights=1 / np.square(case.sigma_v), q=case.q, qn_factor=case.qn_factor)
        data |= dict(r=case.r, u_max=case.u_max, bounds=[bounds[i] for i in bounded])
        data["bounded"] = np.array(bounded) + len(case.model.states)
        path = Path(self._folder.name, "problems.npz")
        np.savez(path, tolerance=tolerance, **data)
        script = Path(__file__).with_name("acados_solver.py")
        self._command = [python, script, path, self._folder.name]
        self._process = self._start(self._command)
        self.ways, self.chosen = self._hear(self._process)

    def _start(self, command):
        self._complaints = Path(self._folder.name, "complaints.txt")
        with self._complaints.open("w") as complaints:
            return subprocess.Popen(
                command, env=self._environment, text=True,
                stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=complaints,
            )  # fmt: skip

    def _hear(self, process):
        """Its next answer; RuntimeError with its last line if it has ended."""
        answer = process.stdout.readline()
        if answer:
            return json.loads(answer)
        last = self._complaints.read_text().strip().splitlines()[-1:]
        raise RuntimeError(f"acados ended: {' '.join(last)}")

    def _ask(self, **question):
        print(json.dumps(question), file=self._process.stdin, flush=True)
        return self._hear(self._process)

    def answers(self, way):
        """Pairs (estimate, plan) at convergence."""
        found = self._ask(way=way, begin=0, end=self._count, iterations=ITERATIONS)
        return [tuple(map(np.array, pair)) for pair in found]

    def block(self, way):
        """A contestant's block: one real-time iteration of each of some problems."""

        def times(number):
            begin = number * SHARE % self._count
            end = min(begin + SHARE, self._count)
            rhe, rhc = self._ask(way=way, begin=begin, end=end)
            return dict(zip(PHASES, (*rhe, *rhc)))

        return times

    def counting(self, library, begin, end):
        """What to run, and with which options, so that callgrind counts these problems: each way
        and problem by the name of the contestant and of the problem.
        """
        asked = [
            dict(way=way, begin=begin, end=end, library=library, name=NAMES[way])
            for way in self.ways
        ]
        command = [*self._command, json.dumps(self.chosen)]
        lines = "\n".join(map(json.dumps, asked))
        return command, dict(env=self._environment, input=lines, text=True)

    def close(self):
        """End its process."""
        self._process.stdin.close()
        self._process.wait()
        self._folder.cleanup()
