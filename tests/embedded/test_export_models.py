"""Exports of Models answer as the live objects, whatever these are and whatever they are told."""

import ctypes
import re
from typing import NamedTuple

import casadi as ca
import numpy as np
import pytest
from helpers import no_compiler
from in_c import InC
from oracles import mhe_instance
from robots import DT, ROBOTS
from rotating_masses import INERTIA, measured, mhe_of_masses

import rhec
from notebooks.studies import toolchain
from rhec.core._casadi import compiled

needs_compiler = pytest.mark.skipif(not compiled.compiler(), reason="there is no C compiler")
TOLERANCE = 1e-9  # of answers, relative and absolute
BOTH_RESTARTED = toolchain.STATUS["estimator_restarted"] + toolchain.STATUS["controller_restarted"]
STAGES = 3  # of a controller; more only compile longer
BICYCLE = ROBOTS["bicycle"]


def compared(answer, expected):
    np.testing.assert_allclose(answer, expected, rtol=TOLERANCE, atol=TOLERANCE)


class Case(NamedTuple):
    """An estimator or a controller, what it is given at each sample, and which steps are solved."""

    part: object
    given: list
    solved: object  # a function of the flags of all steps


def bicycle_controller(**options):
    settings = dict(dt=DT, horizon=STAGES) | BICYCLE.controller
    return rhec.RHC(model=rhec.Model(**BICYCLE.model), **settings | options)


def problems(samples):
    """Random states and references, which keep bounds active."""
    rng = np.random.default_rng(6)
    p = np.mean(BICYCLE.p_range, axis=0)
    for _ in range(samples):
        x, x_ref = (rng.uniform(*BICYCLE.x_range, (n, 3)).T for n in (1, STAGES + 1))
        yield [x[:, 0], p, x_ref, rng.uniform(*BICYCLE.u_range, (STAGES, 2)).T]


def stiff():
    """One Runge-Kutta step would multiply an error by 291."""
    return Case(mhe_of_masses(steps=5), measured(0), lambda ok: ok[-1])


def without_slopes():
    """A tank whose outflow has no slope below the ground, measured with much noise."""
    model = rhec.Model(
        states=("level",), inputs=("inflow",), parameters={"outflow": (0.2, 3.0)},
        outputs=("level", "inflow"), f=lambda x, u, p: [u[0] - p[0] * ca.sqrt(x[0])],
    )  # fmt: skip
    noise = dict(sigma_v=(0.1, 0.02), sigma_w=(0.05, 0.02), sigma_guess=(0.5, 0.5))
    mhe = rhec.RHE(model=model, dt=0.2, horizon=10, guess=(1.0, 1.0), **noise)
    exact = [(0.01 if k < 40 else 0.3, 0.0) for k in range(80)]
    z = exact + np.random.default_rng(0).normal(size=(80, 2)) * noise["sigma_v"]
    return Case(mhe, z, lambda ok: not all(ok) and all(ok[-30:]))


def constrained():
    """Bounds on a state, on an output (soft) and on changes; some steps are not ok."""
    mpc = bicycle_controller(
        bounds=BICYCLE.bounds | dict(theta_rad=(-3.2, 3.2), y=rhec.Bound(-0.2, 0.3, linear=5.0)),
        outputs=dict(y=lambda x, u, p: x[1]),
        q_y=(0.1,),
        r_delta=(0.5, 0.5),
        delta_bounds=dict(speed_mps=(-0.3, 0.3)),
    )
    given = [*problems(30)]
    for x, *_ in given[5::10]:
        x[2] += 4.0  # a heading that cannot be brought back
    return Case(mpc, given, lambda ok: 20 <= sum(ok) < 30)


def not_commanded():
    """An input that is not commanded stays finite where its reference is not."""
    command = dict(command=("steering_rad",), r=(1.0,))
    mpc = bicycle_controller(**command, bounds=dict(steering_rad=(-0.35, 0.35)))
    given = [*problems(5)]
    for (*_, u_ref), speed in zip(given, [np.nan, 0.5, np.nan, -np.inf, 0.4]):
        u_ref[0] = speed
    return Case(mpc, given, lambda ok: [*ok] == [False, True, False, False, True])


CASES = (constrained, stiff, without_slopes, not_commanded)


@pytest.mark.nightly(keep=1)
@needs_compiler
@pytest.mark.parametrize("make", CASES)
def test_an_estimator_or_a_controller_alone_answers_as_in_python(make, tmp_path):
    with no_compiler():
        part, rows, solved = make()
        in_c = InC(rhec.export(part, tmp_path / "rhec"))
    name, other = "estimate", "control"
    if isinstance(part, rhec.RHC):
        name, other = other, name
    assert not hasattr(in_c.library, f"rhec_{other}")
    header = (tmp_path / "rhec" / "rhec_memory.h").read_text()
    states = (part.stages if name == "control" else part).model.states
    assert f"#define RHEC_STATES {len(states)} /* {', '.join(states)} */" in header
    guessed = part.model.joint_names if name == "estimate" else ["unused"]
    assert f"#define RHEC_GUESS {len(guessed)} /* {', '.join(guessed)} */" in header
    assert re.findall(r"RHEC_HORIZON (\d+) ", header) == [str(STAGES)] * (name == "control")
    flags = []
    for row in rows:
        part.prepare()
        in_c.prepare()
        found = part.feedback(*row) if name == "control" else part.feedback(row)
        expected = found if name == "control" else np.concatenate(found[:3])
        answer, status = in_c.call(
            name, *(row if name == "control" else [row]), length=len(expected)
        )
        assert np.isfinite(answer).all() and (status == 0) == part.ok
        compared(answer, expected)
        flags.append(part.ok)
    assert solved(flags)
    if make is stiff:
        assert answer[-1] == pytest.approx(INERTIA, rel=0.01)
    if make is not_commanded:
        assert answer[0] == 0.4
    given = [row if name == "control" else [row] for row in rows[:3]]
    assert any(restarted_as_begun(in_c, name, given, len(answer)))


def restarted_as_begun(in_c, name, rows, length):
    """Whether it restarts, for some of its numbers that are overwritten: then it is as just begun.

    The answer to the next sample is finite whichever number it is.
    """
    doubles = np.frombuffer(in_c.memory, dtype=float)
    for place in range(3, doubles.size, 7):
        in_c.begin()
        for row in rows[:2]:
            in_c.call(name, *row, length=length)
        doubles[place] = np.nan
        answer, status = in_c.call(name, *rows[2], length=length)
        assert np.isfinite(answer).all()
        if status & BOTH_RESTARTED:
            in_c.begin()
            np.testing.assert_array_equal(answer, in_c.call(name, *rows[2], length=length)[0])
        yield status & BOTH_RESTARTED


@pytest.mark.nightly(keep=1)
@needs_compiler
@pytest.mark.parametrize("bounds", [None, {"x_m": (-50.0, 0.1)}], ids=["free", "bounded"])
def test_an_exports_process_noise_may_change_by_sample(bounds, tmp_path):
    """Within the window, through a copy of the settings that the caller changes."""
    rng = np.random.default_rng(5)
    guess, z = mhe_instance(BICYCLE, rng, 29, missing=0.2)
    guess[0] = min(guess[0], 0.1)
    model = rhec.Model(**BICYCLE.model, state_bounds=bounds)
    options = dict(model=model, dt=DT, horizon=4, guess=tuple(guess), noise_in_window=True)
    with no_compiler():
        mhe = rhec.RHE(**options, **BICYCLE.estimator)
        folder = rhec.export(mhe, tmp_path / "rhec")
    in_c = InC(folder)
    struct = (folder / "rhec_memory.h").read_text().split("struct rhec_settings {")[1].split("}")[0]
    lengths = dict(re.findall(r"double (\w+)\[(\d+)\]", struct))
    begin = sum(int(n) for n in [*lengths.values()][: [*lengths].index("W")])
    size = sum(map(int, lengths.values()))
    copied = (ctypes.c_double * size).in_dll(in_c.library, "rhec_scenario")
    changed = (ctypes.c_double * size)(*copied)
    first = (ctypes.c_double * len(guess)).in_dll(in_c.library, "rhec_scenario_guess")
    in_c.library.rhec_init(in_c.memory, changed, first)
    for row in z:
        sigma_w = np.array(BICYCLE.sigma_w) * rng.uniform(0, 5, len(guess))
        changed[begin : begin + len(guess)] = np.square(sigma_w)
        mhe.prepare()
        live = np.concatenate(mhe.feedback(row, sigma_w=sigma_w)[:3])
        answer, _ = in_c.call("estimate", row, length=len(mhe.model.names))
        compared(answer, live)
