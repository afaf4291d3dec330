"""A loop as a list of blocks: its memory, stream and settings follow from what blocks read."""

import os
import pickle
import subprocess
import sys

import casadi as ca
import numpy as np
import pytest
from helpers import assert_refused

from rhec.core import runner
from rhec.core._casadi import compiled
from rhec.core._casadi.build import casadi_function
from rhec.core.blocks import Block, drawn, remembered, sample, split

ONE = (1, 1)


def build_plant(dt_s):
    @casadi_function("plant", x=(2, 1), u=ONE, push=ONE)
    def plant(x, u, push):
        return dict(x=x + dt_s * ca.vertcat(x[1], u + push))

    return plant


def build_sensor():
    @casadi_function("sensor", x=(2, 1), w=ONE)
    def sensor(x, w):
        return dict(z=x[0] + w)

    return sensor


def build_controller():
    @casadi_function("controller", measured=ONE, last=ONE, gain=ONE)
    def controller(measured, last, gain):
        return dict(command=-gain * (measured + last))

    return controller


def build_twice():
    @casadi_function("twice", z=ONE)
    def twice(z):
        return dict(z=2 * z)

    return twice


SPLIT = Block(split, ("noise", (("w", ONE), ("push", ONE))), draws=("noise",))
SENSOR = Block(build_sensor)
TWICE = Block(build_twice)
CONTROLLER = Block(
    build_controller, reads=dict(measured="z", last="u@last"), writes=dict(command="u"),
    remembers=("u",),
)  # fmt: skip
PLANT = Block(build_plant, (0.1,), remembers=("x",))
LOOP = SPLIT, SENSOR, CONTROLLER, PLANT
NOISE = np.random.default_rng(0).normal(size=(100, 2))


def build_loop(loop, settings):
    return runner.build(sample(loop, settings, ["x", "z", "u"]))


def run(loop, memory):
    functions = compiled.load(build_loop, loop, ("gain",))
    return runner.run_one(functions, np.array(memory), NOISE, dict(gain=0.7))


def in_numpy(factor=1.0, delay=False):
    """The same loop, written out."""
    x, last, rows = np.array([1.0, 0.0]), 0.0, []
    for w, push in NOISE:
        z = factor * (x[0] + w)
        u = -0.7 * (z + last)
        rows.append([*x, z, u])
        x = x + 0.1 * np.array([x[1], (last if delay else u) + push])
        last = u
        rows[-1][:2] = x
    return np.array(rows)


LATE = Block(build_plant, (0.1,), reads=dict(u="u@last"), remembers=("x",))


@pytest.mark.parametrize(
    ("loop", "expected"),
    [
        (LOOP, in_numpy()),
        ((SPLIT, SENSOR, TWICE, CONTROLLER, PLANT), in_numpy(factor=2.0)),
        ((SPLIT, SENSOR, CONTROLLER, LATE), in_numpy(delay=True)),
    ],
    ids=["as it is", "with a block more", "with a signal of the sample before"],
)
def test_a_loop_is_its_blocks_one_after_the_other(loop, expected):
    assert remembered(loop) == ("u", "x") and drawn(loop) == ("noise",)
    np.testing.assert_allclose(run(loop, [0.0, 1.0, 0.0]), expected, rtol=1e-12, atol=1e-12)


def test_a_signal_from_nowhere_or_of_another_shape_is_refused_in_one_sentence():
    remembering = Block(build_twice, remembers=("z",))
    drawing = Block(build_sensor, draws=("z",))
    unwritten = Block(build_sensor, remembers=("x",))
    mixed = Block(build_sensor, reads=dict(x="z"))
    nowhere = "no block before 'sensor' writes"
    assert_refused(
        lambda *loop: sample(loop, ["gain"], ["u"]),
        [
            ((SENSOR, CONTROLLER, PLANT), f"{nowhere} 'w', and it is no setting"),
            (LOOP[:3], f"{nowhere} 'x', and it is no setting"),
            ((SPLIT, SENSOR, remembering, CONTROLLER, PLANT), "a block remembers 'z', but none"),
            ((SPLIT, drawing, CONTROLLER, PLANT), "a block draws 'z', but none reads it before"),
            ((SPLIT, unwritten, CONTROLLER), "no block writes 'x', which is remembered"),
            ((*LOOP, mixed), "'sensor' reads 'z' of shape (2, 1); it has (1, 1)"),
        ],
    )


def test_blocks_of_equal_code_arguments_and_wires_are_equal_in_any_process():
    """Texts have other hashes there, and what was compiled is looked up by them."""
    again = pickle.loads(pickle.dumps(LOOP))
    assert again == LOOP and hash(again) == hash(LOOP)
    assert again[3].function is LOOP[3].function
    others = [Block(build_plant, (0.2,), remembers=("x",)), Block(build_plant, (0.1,))]
    others += [Block(build_plant, (0.1,), dict(u="u@last"), remembers=("x",)), SENSOR]
    assert len({PLANT, *others}) == 5
    script = """
import pickle, sys
from rhec.core.blocks import Block, split
found = pickle.loads(bytes.fromhex(sys.argv[1]))
assert found in {Block(split, ("noise", (("w", (1, 1)),)), draws=("noise",))}
"""
    block = Block(split, ("noise", (("w", ONE),)), draws=("noise",))
    assert block in {Block(split, ("noise", (("w", ONE),)), draws=("noise",))}
    command = [sys.executable, "-c", script, pickle.dumps(block).hex()]
    subprocess.run(command, check=True, env=os.environ | dict(PYTHONHASHSEED="1"))
    longer = SPLIT, SENSOR, TWICE, CONTROLLER, PLANT
    names = {compiled.library_name(build_loop, (loop, ())) for loop in (LOOP, again, longer)}
    assert len(names) == 2
