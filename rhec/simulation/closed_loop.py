"""The closed loop: a Scenario turned once into blocks and numbers, and scanned over time.

    noise_k ─► robot ─ z_k ─► estimator ─ ξ̂, p̂ ─► path ─ ξ_r, ω_r ─► controller ─ ω ─► robot …

Every tuning parameter is an argument of the compiled Function, so that a change of a weight
compiles nothing. What is compiled is named by the blocks.
"""

from dataclasses import dataclass

import numpy as np

from rhec import paper
from rhec.core import blocks, runner
from rhec.core._casadi import build, early, packing
from rhec.simulation.columns import COLUMNS as COLUMNS  # without those of a scenario's options
from rhec.simulation.columns import FLAGS, of_run
from rhec.simulation.metrics import metrics
from rhec.simulation.parts import World, has_yaw_drift, parts_of
from rhec.simulation.run import Run
from rhec.tracked_robot import plant as robot
from rhec.tracked_robot import terrain
from rhec.tracked_robot.path import Path, path_of
from rhec.tracked_robot.terrain import Terrain


def build_sample(loop, settings):
    """The closed loop of these blocks, {name: Function} of `runner.build`.

    One sample is (memory, noise, settings …) -> (memory, row, covariance).
    """
    return runner.build(blocks.sample(loop, settings, ["row"], ["covariance"]))


@dataclass(frozen=True)
class Setup:
    """A scenario turned into arrays.

    Attributes:
        structure: Arguments of `build_sample`: the blocks, and names of the settings.
        memory: The first memory, packed.
        layout: Shapes of the memory's pieces by name; of estimator and RHC, of theirs.
        settings: The arguments that stay the same over the run, by name.
        draws: The streams of the signals in a row of the run's stream (`noise_and_faults`).
        path: The path to follow.
        terrain: The traction of the soil.
        guess: (x, y, θ, ν, μ, κ), the estimator's first.
    """

    structure: tuple
    memory: np.ndarray
    layout: dict
    settings: dict
    draws: tuple
    path: Path
    terrain: Terrain
    guess: np.ndarray

    def unpack(self, memory):
        """A memory's arrays by name; those of estimator and RHC in dicts of their own."""
        nested = {name: shape for name, shape in self.layout.items() if isinstance(shape, dict)}
        sizes = {name: (build.packed_size(shapes), 1) for name, shapes in nested.items()}
        pieces = packing.unpack_array(memory, self.layout | sizes)
        inner = {name: packing.unpack_array(pieces[name], nested[name]) for name in nested}
        return pieces | inner


def world_of(scenario):
    """The World of a scenario: path, soil and starting point."""
    path = path_of(scenario)
    soil = scenario.terrain or terrain.random_for(scenario, path)
    pose = _start_pose(scenario, path)
    return World(path, soil, pose, _signed_speed(scenario), first_guess(scenario, path))


def set_up(scenario):
    """The Setup of a scenario: its World, memory and settings."""
    world = world_of(scenario)
    parts = tuple(parts_of(scenario, world))
    loop = tuple(part.block for part in parts)
    settings = blocks.brought(parts, "settings")
    first = blocks.brought(parts, "first")
    # What a block need not remember, such as the plan of a controller without memory, is left out.
    memory, layout = _pack({name: first[name] for name in blocks.remembered(loop)})
    streams = blocks.brought(parts, "streams")
    draws = tuple(streams[name] for name in blocks.drawn(loop))
    structure = loop, tuple(settings)
    return Setup(structure, memory, layout, settings, draws, world.path, world.soil, world.guess)


def _signed_speed(scenario):
    return (-1.0 if scenario.backwards else 1.0) * scenario.speed_mps


def first_guess(scenario, path):
    """The estimator's first guess (x, y, θ, ν, μ, κ): the start, and no slip."""
    pose = _start_pose(scenario, path) + (0, 0, scenario.guess_yaw_rad)
    return np.array([*pose, _signed_speed(scenario), 1.0, 1.0])


def _start_pose(scenario, path):
    """The pose at the start, given relative to the path; backwards it is turned by π more."""
    ((x, y, theta),), _ = path.poses([0.0])
    # (-sin θ, cos θ) points to the left.
    x -= scenario.start_offset_m * np.sin(theta)
    y += scenario.start_offset_m * np.cos(theta)
    theta += scenario.start_yaw_rad + np.pi * scenario.backwards
    return np.array([x, y, theta])


def _pack(memory):
    """A memory by name in one vector, and its layout."""
    nested = {name: piece for name, piece in memory.items() if isinstance(piece, dict)}
    flat = memory | {name: packing.pack_array(piece) for name, piece in nested.items()}
    inner = {name: packing.shapes_of(piece) for name, piece in nested.items()}
    return packing.pack_array(flat), packing.shapes_of(flat) | inner


def noise_and_faults(seed, scheduled, samples, draws=(robot.draw_noise,)):
    """The stream that a run is scanned over: noise and the scheduled Faults, one row a sample.

    `draws` are the streams of the signals in a row, in order, such as those of a Setup.
    """
    return np.hstack([draw(seed, samples, scheduled) for draw in draws])


def simulate_setup(scenario, setup):
    """The Run of a scenario that is set up."""
    return simulate_loaded(early.load(build_sample, *setup.structure), scenario, setup)


def simulate_loaded(functions, scenario, setup):
    """The Run of a scenario whose loop is loaded; such runs may share their time in threads."""
    samples = round(scenario.duration_s / paper.DT_S)
    stream = noise_and_faults(scenario.seed, scenario.faults, samples, setup.draws)
    rows = runner.run_one(functions, setup.memory, stream, setup.settings)
    return finished(scenario, setup, rows)


def finished(scenario, setup, rows):
    """The Run of a scenario, from the rows (n, columns) that its loop yielded."""
    path = setup.path
    names = of_run(scenario.sensors, has_yaw_drift(scenario))
    columns = {"t_s": np.arange(len(rows)) * paper.DT_S}
    columns |= dict(zip(names, np.ascontiguousarray(rows.T)))
    columns |= {name: columns[name] == 1 for name in FLAGS}
    measured = np.column_stack([columns["x_meas_m"], columns["y_meas_m"]])
    # A position of which one coordinate is missing or infinite is none.
    measured[~np.isfinite(measured).all(axis=1)] = np.nan
    true = np.column_stack([columns["x_m"], columns["y_m"]])
    # Both at once, because half of the time does not depend on the number of points.
    (error, true_error), (_, s) = np.reshape(path.project(np.vstack([measured, true])), (2, 2, -1))
    poses, curvatures = path.poses(s)
    columns |= dict(error_m=error, error_true_m=true_error, on_straight=curvatures == 0)
    return Run(scenario, metrics(columns, poses), path, setup.terrain, columns)
