"""What is done to the world, and what must follow: relations between runs that need no oracle.

A Change maps a world to another one, and the results of a run in that one back to those of a run in
the first. Both then have to be equal. A world is a dict: a robot of `robots`, as its Model is told,
its settings, and quantities, each a number or a series by name.
"""

import dataclasses
from collections.abc import Callable
from typing import NamedTuple

import casadi as ca
import numpy as np


class Change(NamedTuple):
    """What is done to a world, and how its results are undone."""

    apply: Callable  # world -> world
    undo: Callable  # results -> those of the first world


def largest_difference(first, run, world, change):
    """By how much the results of a run in the other world differ, once undone, from the `first`."""
    return difference(first, change.undo(run(change.apply(world))))


def difference(first, other):
    """The largest difference of results {name: series}, by the size of each quantity.

    That is its range or, of one that never moves, such as a command at its bound, its value.
    """
    sizes = {name: np.ptp(v) or max(np.abs(v).max(), 1e-9) for name, v in first.items()}
    return max(np.max(np.abs(other[name] - first[name])) / sizes[name] for name in first)


class Linear(NamedTuple):
    """Other quantities: each is Σ factor · source + offset; those without a row stay."""

    rows: dict = {}  # {name: {source: factor}}
    offsets: dict = {}

    def row(self, name):
        return self.rows.get(name, {name: 1.0})

    def slopes(self, values):
        """The same without offsets."""
        return {
            name: sum(factor * values[source] for source, factor in self.row(name).items())
            for name in values
        }

    def __call__(self, values):
        return {name: v + self.offsets.get(name, 0.0) for name, v in self.slopes(values).items()}

    def intervals(self, bounds):
        """(lowest, highest) by name, or None, of quantities with one source each."""
        found = {}
        for name in bounds:
            ((source, factor),) = self.row(name).items()
            ends = bounds[source]
            moved = self.offsets.get(name, 0.0)
            found[name] = ends and tuple(sorted(factor * end + moved for end in ends))
        return found

    def variances(self, values):
        """Variances by name."""
        squares = {name: {s: f**2 for s, f in self.row(name).items()} for name in values}
        return Linear(squares)(values)


def in_order(names, values):
    return tuple(values[name] for name in names)


def retold(robot, there, back, time=1.0, order=tuple, keeps_model=False):
    """The robot of `robots` as it is told in other quantities, by Linear `there` and `back`.

    Args:
        robot: What it is.
        there: To the other quantities.
        back: What undoes it.
        time: How many new units of time are an old one.
        order: Names -> the same in the order in which they are told.
        keeps_model: Whether f and h have to be the same in the other quantities, a symmetry.
    """
    p_names = tuple(robot.parameters)
    groups = robot.states, robot.inputs, p_names
    joint = *robot.states, *p_names
    unnamed = [name for name in robot.outputs if name not in {*joint, *robot.inputs}]
    new = [order(names) for names in groups]
    outputs = order(robot.outputs)

    def before(*columns):
        told = dict(
            zip([name for names in new for name in names], ca.vertsplit(ca.vertcat(*columns)))
        )
        values = back(told)
        return [ca.vertcat(ca.SX(0, 1), *in_order(names, values)) for names in groups]

    def f(*columns):
        slopes = dict(zip(robot.states, ca.vertsplit(robot.f(*before(*columns)))))
        return ca.vertcat(*in_order(new[0], there.slopes(slopes))) / time

    def h(*columns):
        values = there(dict(zip(unnamed, ca.vertsplit(robot.h(*before(*columns))))))
        return ca.vertcat(*in_order([name for name in outputs if name in unnamed], values))

    def sigmas(names, values, ordered):
        return tuple(
            np.sqrt(in_order(ordered, there.variances(dict(zip(names, np.square(values))))))
        )

    def weights(names, values, ordered):
        columns = {s: {} for s in names}  # Q in other quantities is B' Q B
        for name in names:
            for source, factor in back.row(name).items():
                columns[source][name] = factor**2
        return in_order(ordered, Linear(columns)(dict(zip(names, values))))

    told = dict(f=robot.f, h=robot.h) if keeps_model else dict(f=f, h=robot.h and h)
    of_parameters = there.intervals(robot.parameters)
    of_joint = (*new[0], *new[2])
    return dataclasses.replace(
        robot,
        states=new[0],
        inputs=new[1],
        parameters={name: of_parameters[name] for name in new[2]},
        outputs=outputs,
        sigma_v=sigmas(robot.outputs, robot.sigma_v, outputs),
        sigma_w=sigmas(joint, robot.sigma_w, of_joint),
        sigma_guess=sigmas(joint, robot.sigma_guess, of_joint),
        q=weights(robot.states, robot.q, new[0]),
        r=weights(robot.inputs, robot.r, new[1]),
        bounds=there.intervals(robot.bounds),
        **told,
    )


QUANTITIES = ("z", "z_moved", "guess", "x", "p", "x_ref", "u_ref")  # of a world, each {name: …}


class Lane(NamedTuple):
    """Bounds of a state, or of a function of (x, u, p), an output."""

    name: str
    ends: tuple
    output: Callable | None = None


def told_in(there, back, time=1.0, **how):
    """The Change of a world that is told in other quantities; arguments are those of `retold`."""

    def apply(world):
        before = world["robot"]
        robot = retold(before, there, back, time=time, **how)
        told = {key: there(world[key]) for key in QUANTITIES}
        lane = world["lane"]

        def place(x, u, p):
            return back(dict(zip(robot.states, ca.vertsplit(x))))[lane.name]

        if len(there.row(lane.name)) > 1:
            lane = lane._replace(output=place)
        else:
            lane = lane._replace(ends=there.intervals({lane.name: lane.ends})[lane.name])
        return world | told | dict(robot=robot, lane=lane, dt=world["dt"] * time)

    return Change(apply, back)
