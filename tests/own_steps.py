"""Steps of estimators and controllers of one's own, as Functions, and paths that end a run.

Worker processes import it, so it imports little.
"""

import dataclasses
import os
import signal

import casadi as ca

import rhec

NAMED = {"allow_duplicate_io_names": True}


def step_of(inputs, results, name="mine"):
    """A Function with inputs and results of these shapes, the latter all zeros."""
    inputs = {key: ca.SX.sym(key, *shape) for key, shape in inputs.items()}
    results = {key: ca.SX(ca.DM.zeros(*shape)) for key, shape in results.items()}
    names = [*inputs], [*results], NAMED
    return ca.Function(name, [*inputs.values()], [*results.values()], *names)


# Inputs and results of an estimator
PLAIN = dict(memory=(6, 1), z=(4, 1)), dict(memory=(6, 1), estimate=(6, 1))


def filter_of_yaw_rates(**options):
    """An estimator with W and one state: it takes the position as measured."""
    names = dict(memory=1, z_N=4, V=4, W=1, mean_traction=2)
    given = {name: ca.SX.sym(name, size) for name, size in names.items()}
    variance = given["memory"] + given["W"]
    estimate = ca.vertcat(given["z_N"][:2], 0, given["z_N"][2], given["mean_traction"])
    results = dict(memory=variance, estimate=estimate, covariance=variance)
    step = ca.Function(
        "with_w", [*given.values()], [*results.values()], [*given], [*results], NAMED
    )
    first = ca.Function("first", [ca.SX.sym("guess", 6)], [0], ["guess"], ["memory"])
    return rhec.Estimator(step, first=first, states=("yaw",), **options)


def dead_reckoning(sensors=("gyro",), **options):
    """An estimator with a state for the yaw, which turns by the gyro, and takes all else."""
    n_z = 4 + len(sensors)
    names = dict(memory=6, z=n_z, V=n_z)
    given = {name: ca.SX.sym(name, size) for name, size in names.items()}
    z, V = given["z"], given["V"]
    yaw = given["memory"][2] + 0.2 * z[4]
    estimate = ca.vertcat(z[:2], yaw, z[2], ca.sqrt(V[4]), 1)
    results = dict(memory=estimate, estimate=estimate)
    step = ca.Function(
        "by_gyro", [*given.values()], [*results.values()], [*given], [*results], NAMED
    )
    return rhec.Estimator(step, sensors=sensors, **options)


# Paths, and what is read of a run

TRACK = rhec.Path.racetrack(30.0, 7.8)


class Untraceable(rhec.Path):
    """A path on which every run fails."""

    # A Scenario reads the path's poses; only a run projects on it.
    def project(self, xy):
        raise ValueError("this path cannot be traced")


@dataclasses.dataclass(frozen=True)
class Lethal(rhec.Path):
    """A path that kills every process but its own."""

    home: int = 0

    def poses(self, s):
        if os.getpid() != self.home:
            os.kill(os.getpid(), signal.SIGKILL)
        return super().poses(s)


def untraceable():
    """A path that a Scenario takes and that no run can follow."""
    return Untraceable(TRACK.segments, TRACK.length_m, True)


def lethal():
    """A path that only this process can follow."""
    return Lethal(TRACK.segments, TRACK.length_m, True, home=os.getpid())


def largest_error_m(run):
    """A reading of a run."""
    return run.columns["error_true_m"].max()
