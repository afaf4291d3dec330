"""acados beside the others: its own process answers and is timed when its turn comes."""

import json
import os
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np

from benchmark import peers
from rhec import paper
from rhec.studies.timing import PHASES

NAME, SHARE, ITERATIONS = "acados, in C", 50, 30
_OWN_PYTHON = Path(__file__).parents[2] / ".venv" / "acados" / "bin" / "python"


def command():
    """How to run Python with acados, and its environment; None where there is none."""
    source = os.environ.get("ACADOS_SOURCE_DIR")
    if source:
        paths = Path(source, "interfaces", "acados_template"), Path(source, "lib")
        added = zip(("PYTHONPATH", "LD_LIBRARY_PATH"), map(str, paths))
        return sys.executable, os.environ | dict(added)
    return (str(_OWN_PYTHON), dict(os.environ)) if _OWN_PYTHON.exists() else None


class Acados:
    """Solvers of both problems, built for these problems in a folder of their own."""

    def __init__(self, recorded):
        python, environment = command()
        self._folder, self._count = tempfile.TemporaryDirectory(), len(recorded)
        data = dict(zip(recorded[0]._fields, map(np.array, zip(*recorded))))
        data |= dict(dt_s=paper.DT_S, weights=peers.WEIGHTS, Q=peers.Q, QN=peers.QN, R=paper.R)
        path = Path(self._folder.name, "problems.npz")
        np.savez(path, omega_max=paper.OMEGA_MAX_RADPS, **data)
        script = Path(__file__).with_name("acados_solver.py")
        self._process = subprocess.Popen(
            [python, script, path, self._folder.name], env=environment, text=True,
            stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL,
        )  # fmt: skip
        self.qp_solvers = json.loads(self._process.stdout.readline())

    def _ask(self, **question):
        print(json.dumps(question), file=self._process.stdin, flush=True)
        return json.loads(self._process.stdout.readline())

    def answers(self):
        """Pairs (estimate, plan) at convergence."""
        found = self._ask(begin=0, count=self._count, iterations=ITERATIONS)
        return [tuple(map(np.array, pair)) for pair in found]

    def block(self, number):
        """A contestant's block: one real-time iteration a problem."""
        share = min(SHARE, self._count)
        begin = share * number % (self._count - share + 1)
        rhe, rhc = self._ask(begin=begin, count=share)
        return dict(zip(PHASES, (*rhe[:2], *rhc[:2])))

    def close(self):
        """End its process."""
        self._process.stdin.close()
        self._process.wait()
        self._folder.cleanup()
