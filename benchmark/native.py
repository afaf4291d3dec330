"""rhec's compiled phases timed as C: called by a C program's loop (driver.c), not by Python."""

import ctypes
import functools
import subprocess
import tempfile
from pathlib import Path

import numpy as np

from notebooks.studies.timing import PHASES
from rhec.core._casadi import cache, compiled

_STRUCTURES = ("window", "stages")  # attributes of rhec's estimator and controller
# As in driver.c.
_FIELDS = ("phase", "arguments", "results", "whole", "work", "to", "rows", "doubles", "timed")


@functools.cache
def _driver():
    with tempfile.TemporaryDirectory() as folder:
        library = Path(folder, "driver.so")
        source = Path(__file__).with_name("driver.c")
        command = [compiled.compiler(), "-O2", "-shared", "-fPIC", source, "-o", library]
        subprocess.run(command, check=True)
        return ctypes.CDLL(str(library))


def _library(build, structure):
    """The C library of a structure's phases."""
    found = cache.load_or_build(
        compiled.library_name(build, (structure,)), None, lambda folder: folder
    )
    return ctypes.CDLL(str(found / "library.so"))


class Steps:
    """What the loop does with each sample, in order."""

    def __init__(self):
        self._rows, self._alive = [], []

    def copy(self, rows, array):
        """Copy this sample's row to an array that a phase reads."""
        rows = np.ascontiguousarray(rows)
        self._alive += [rows, array]
        self._add(to=array.ctypes.data, rows=rows.ctypes.data, doubles=array.size)

    def call(self, library, buffered, timed=False):
        """Call a BufferedFunction's C, on its arrays."""
        name, sizes = buffered.function.name(), [ctypes.c_longlong() for _ in range(4)]
        getattr(library, f"{name}_work")(*map(ctypes.byref, sizes))
        arguments, results, whole, work = (np.zeros(size.value + 1, np.int64) for size in sizes)
        for to, arrays in ((arguments, buffered.arguments), (results, buffered.results)):
            to[: len(arrays)] = [array.ctypes.data for array in arrays.values()]
        self._alive += [arguments, results, whole, work, buffered]
        places = dict(arguments=arguments, results=results, whole=whole, work=work)
        phase = ctypes.cast(getattr(library, name), ctypes.c_void_p).value
        self._add(phase=phase, timed=timed, **{k: a.ctypes.data for k, a in places.items()})

    def _add(self, **fields):
        self._rows.append(tuple(int(fields.get(name, 0)) for name in _FIELDS))

    def run(self, samples):
        """Microseconds a sample from one timed step to the next."""
        rows, us = np.array(self._rows, np.int64), np.zeros(len(self._rows))
        where = (ctypes.c_void_p(array.ctypes.data) for array in (rows, us))
        if _driver().drive(ctypes.c_longlong(samples), ctypes.c_longlong(len(rows)), *where):
            raise RuntimeError("a phase failed")
        return us[: int(rows[:, -1].sum())] / samples


def structures(loop):
    """What the Functions of a loop's estimator and controller are built from."""
    return [getattr(live, name) for live, name in zip(loop.case.live(loop.guess), _STRUCTURES)]


MOST = 60  # problems in a block, which takes less time than a process gets at once


def block(loop, recorded):
    """A contestant: the loop's first problems, one iteration each, the arrival cost updated."""
    case = loop.case
    recorded = recorded[:MOST]
    window, newest = np.split(loop.z[: case.horizon + MOST], [case.horizon])
    columns = dict(zip(recorded[0]._fields, map(np.array, zip(*recorded))))
    libraries = [_library(*each) for each in zip(case.builds, structures(loop))]
    inputs = (
        dict(z_N=newest),
        dict(
            s_0=columns["estimate"],
            x_ref=columns["x_ref"].transpose(0, 2, 1),
            u_ref=columns["u_ref"].transpose(0, 2, 1),
        ),
    )

    def times(_):
        estimator, controller = case.live(loop.guess)
        for z in window:
            estimator.prepare()
            estimator.feedback(z)
        first = recorded[0]
        case.command(controller.feedback, first.estimate, first.x_ref, first.u_ref)
        steps = Steps()
        for live, library, given in zip((estimator, controller), libraries, inputs):
            iteration = live.iteration
            for phase in ("expand", "shift", "linearise"):
                steps.call(library, iteration.phases[phase], timed=phase == "linearise")
            for name, rows in given.items():
                steps.copy(rows, iteration.arrays[name])
            steps.call(library, iteration.phases["feedback"], timed=True)
        return dict(zip(PHASES, steps.run(len(recorded))))

    return times
