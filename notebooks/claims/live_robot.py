"""The simulated robot for a loop in plain Python, sample by sample: the closed loop's blocks of a
scenario, but for its estimator and controller.
"""

import functools

import casadi as ca
import numpy as np

from rhec import paper
from rhec.core import blocks, wiring
from rhec.core._casadi.compiled import BufferedFunction
from rhec.simulation.closed_loop import world_of
from rhec.simulation.parts import measuring, moving


class LiveRobot:
    """A robot that is measured and driven in turn: `for z in robot: …; robot.drive(omega)`.

    Attributes:
        world: The scenario's World.
        pose: The true pose (3,) at the last measurement.
    """

    def __init__(self, scenario):
        self.world = world_of(scenario)
        before = tuple(measuring(scenario, self.world))
        after = tuple(moving(scenario, self.world))
        self._measure = BufferedFunction(_joined(tuple(part.block for part in before)))
        self._move = BufferedFunction(_joined(tuple(part.block for part in after)))
        parts = *before, *after
        settings = blocks.brought(parts, "settings")
        samples = round(scenario.duration_s / paper.DT_S)
        self._streams = {
            name: draw(scenario.seed, samples, scenario.faults)
            for name, draw in blocks.brought(parts, "streams").items()
        }
        self._samples = samples
        _set(self._measure, settings)
        _set(self._move, settings)
        self._signals = dict(command=0.0) | blocks.brought(parts, "first")

    def __iter__(self):
        for sample in range(self._samples):
            self.pose = np.array(self._signals["pose"])
            self._signals |= {name: rows[sample] for name, rows in self._streams.items()}
            self._call(self._measure)
            yield self._signals["z"]

    def drive(self, omega_radps):
        """Drive for one sample at this commanded yaw rate."""
        last = {_argument("command@last"): self._signals["command"]}
        self._signals |= last | dict(command=omega_radps)
        self._call(self._move)

    def _call(self, call):
        """Evaluate blocks on the signals, and write theirs."""
        _set(call, self._signals)
        call.call()
        self._signals |= {name: result.copy() for name, result in call.results.items()}


def _set(call, values):
    """Give a call those of these values, {argument: value}, that it has an argument for."""
    call.set(**{name: values[name] for name in call.arguments.keys() & values.keys()})


@functools.cache
def _joined(of_blocks):
    """Blocks as one Function of the signals that come from outside, which returns all of theirs."""
    parts = [block.wired for block in of_blocks]
    outside = {
        place: ca.MX.sym(_argument(place), *function.size_in(name))
        for place, (function, name) in wiring.outside(parts).items()
    }
    signals = wiring.evaluated(parts, outside)
    written = {place: signals[place] for part in parts for place in part.writes.values()}
    results = [ca.densify(value) for value in written.values()]
    names = [*map(_argument, outside)], [*written]
    # A signal may be read from the sample before, and then written.
    options = {"allow_duplicate_io_names": True}
    return ca.Function("joined", [*outside.values()], results, *names, options)


def _argument(place):
    """A place as a name of CasADi's, which has no "@"."""
    return place.replace("@", "_")
