"""The simulated robot for a loop in plain Python, sample by sample: the closed loop's plant with a
scenario's soil, noise and start.
"""

import functools

from rhec import paper
from rhec.core._casadi.build import select_inputs
from rhec.core._casadi.compiled import BufferedFunction
from rhec.core._casadi.packing import unpack_array
from rhec.simulation.closed_loop import set_up
from rhec.tracked_robot import plant as robot
from rhec.tracked_robot import terrain

__all__ = ["LiveRobot"]


@functools.cache
def _functions(shape, soil_under):
    """The plant's measurement and motion, and the soil on a grid of this shape."""
    return robot.measure(paper.DT_S), robot.drive(paper.DT_S), robot.soil(shape, soil_under)


class LiveRobot:
    """A robot that is measured and driven in turn: `for z in robot: …; robot.drive(omega)`.

    Attributes:
        setup: The scenario's Setup.
        pose: The true pose (3,) at the last measurement.
    """

    def __init__(self, scenario):
        self.setup = set_up(scenario)
        self._noise = robot.draw_noise(scenario.seed, round(scenario.duration_s / paper.DT_S))
        shape = terrain.common_shape(self.setup.terrain)
        functions = _functions(shape, scenario.soil_under)
        self._measure, self._drive, self._soil = map(BufferedFunction, functions)
        for call in (self._measure, self._drive, self._soil):
            call.set(**select_inputs(call.function, self.setup.settings))
        memory = self.setup.unpack(self.setup.memory)
        self._state = {name: memory[name] for name in robot.MEMORY}

    def __iter__(self):
        for noise in self._noise:
            self._state |= unpack_array(noise, robot.NOISE)
            self.pose = self._state["pose"].ravel()
            self._soil.set(pose=self.pose)
            self._soil.call()
            self._set(self._measure)
            self._measure.call()
            yield self._measure.results["z"].copy()

    def _set(self, call):
        """Copy into a call what it takes of the state."""
        for name, array in call.arguments.items():
            if name in self._state:
                array[:] = self._state[name].ravel(order="F")

    def drive(self, omega_radps, **speed_mps):
        """Drive for one sample.

        Args:
            omega_radps: Commanded yaw rate.
            speed_mps: Commanded speed; the scenario's, by default.
        """
        self._set(self._drive)
        self._drive.set(**self._soil.results, omega_radps=omega_radps, **speed_mps)
        self._drive.call()
        results = self._drive.results | dict(drift=self._measure.results["drift"])
        self._state |= {name: value.copy() for name, value in results.items()}
