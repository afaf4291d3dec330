"""Exports of Models that are stiff or have algebraic variables answer as the live objects."""

import ctypes
import subprocess

import casadi as ca
import numpy as np
import pytest
from helpers import no_compiler
from rotating_masses import INERTIA, measured, mhe_of_masses

import rhec
from rhec.core._casadi import compiled
from rhec.workbench.studies import gallery
from rhec.workbench.studies.embedded import toolchain

COMPILER = compiled.compiler()
needs_compiler = pytest.mark.skipif(not COMPILER, reason="there is no C compiler")
TOLERANCE = 1e-9  # of answers, relative and absolute


class InC:
    """The struct rhec of an export, and its functions."""

    def __init__(self, folder):
        sources = [folder / source for source in toolchain.LIBRARY]
        flags = ["-std=c99", "-ffp-contract=off", "-shared", "-fPIC"]
        out = folder / "rhec.so"
        subprocess.run([COMPILER, *flags, *sources, "-lm", "-o", out], check=True)
        self.library = ctypes.CDLL(str(out))
        sizes = (folder / "rhec_memory.h").read_text()
        n_bytes = int(sizes.split("RHEC_MEMORY_BYTES ")[1].split()[0])
        self.memory = ctypes.create_string_buffer(n_bytes)
        self.begin()

    def begin(self):
        """Begin anew, from the guess."""
        settings, guess = (
            ctypes.byref(ctypes.c_char.in_dll(self.library, f"rhec_scenario{name}"))
            for name in ("", "_guess")
        )
        self.library.rhec_init(self.memory, settings, guess)

    def call(self, name, *arrays, length):
        """Prepare and call: answer (length,) and status."""
        arrays = [np.ravel(array, order="F").astype(float) for array in arrays]
        answer = np.zeros(length)
        getattr(self.library, f"rhec_prepare_{name}")(self.memory)
        function = getattr(self.library, f"rhec_{name}")
        status = function(self.memory, *(array.ctypes for array in arrays), answer.ctypes)
        return answer, status


@needs_compiler
def test_each_estimate_of_stiff_masses_is_finite_and_equal_to_pythons(tmp_path):
    """Ten seeds, 60 estimates each; one Runge-Kutta step would multiply an error by 291."""
    with no_compiler():
        in_c = InC(rhec.export(mhe_of_masses(steps=5), tmp_path / "rhec"))
        for seed in range(10):
            mhe = mhe_of_masses(steps=5)
            in_c.begin()
            for z in measured(seed):
                mhe.prepare()
                estimate = mhe.feedback(z)
                answer, status = in_c.call("estimate", z, length=11)
                assert np.all(np.isfinite(answer))
                assert (status == 0) == mhe.ok
                expected = np.concatenate(estimate[:3])
                np.testing.assert_allclose(answer, expected, rtol=TOLERANCE, atol=TOLERANCE)
            assert answer[-1] == pytest.approx(INERTIA, rel=0.01)


def tank():
    """A tank whose level drives a flow, an algebraic variable, through a pipe."""
    return rhec.Model(
        states=("level",),
        inputs=("inflow",),
        parameters={"laminar": (0.1, 3.0), "turbulent": (0.1, 5.0)},
        outputs=("level", "flow", "inflow"),
        f=lambda x, u, p, a: (u[0] - a[0], p[0] * a[0] + p[1] * a[0] ** 2 - x[0]),
        algebraic={"flow": 1.0},
        rule="radau3",
    )


@needs_compiler
def test_a_model_with_algebraic_variables_answers_in_c_as_in_python(tmp_path):
    rng = np.random.default_rng(0)
    friction = [1.0, 1.5]
    with no_compiler():
        model = tank()
        mhe = rhec.RHE(
            model=model, dt=0.5, horizon=5, sigma_v=(0.01,) * 3, sigma_w=(0.0,) * 3,
            guess=(1.9, 0.7, 1.2), sigma_guess=(0.3,) * 3,
        )  # fmt: skip
        rhc = rhec.RHC(
            model=model, command=("inflow",), q=(1.0,), r=(0.1,), dt=0.5, horizon=8,
            outputs=("flow",), bounds=dict(inflow=(0.0, 1.0), flow=(-1.0, 0.45)),
        )  # fmt: skip
        in_c = InC(rhec.export((mhe, rhc), tmp_path / "rhec"))
        level, u = 2.0, np.zeros(1)
        for k in range(30):
            level = model.simulate([level], [u], friction, dt=0.5)[-1, 0]
            flow = model.consistent([level], u, friction)
            z = np.array([level, *flow, *u]) + 0.01 * rng.normal(size=3)
            z[1] = np.nan if k % 7 == 0 else z[1]
            mhe.prepare()
            rhc.prepare()
            estimate = mhe.feedback(z)
            known = dict(x=estimate.x, p=estimate.p)
            references = dict(x_ref=np.full((1, 9), 1.0), u_ref=np.zeros((1, 8)))
            u = rhc.feedback(**known, **references)
            answer, status = in_c.call("estimate", z, length=4)
            assert (status == 0) == mhe.ok
            expected = np.concatenate(estimate[:3])
            np.testing.assert_allclose(answer, expected, rtol=TOLERANCE, atol=TOLERANCE)
            given = (*known.values(), *references.values())
            command, status = in_c.call("control", *given, length=1)
            assert (status == 0) == rhc.ok
            np.testing.assert_allclose(command, u, rtol=TOLERANCE, atol=TOLERANCE)


@needs_compiler
def test_an_estimate_without_slopes_finds_back_in_c_as_in_python(tmp_path):
    """A tank whose outflow has no slope below the ground, measured with much noise."""
    rng = np.random.default_rng(0)
    model = rhec.Model(
        states=("level",),
        inputs=("inflow",),
        parameters={"outflow": (0.2, 3.0)},
        outputs=("level", "inflow"),
        f=lambda x, u, p: [u[0] - p[0] * ca.sqrt(x[0])],
    )
    with no_compiler():
        mhe = rhec.RHE(
            model=model, dt=0.2, horizon=10, sigma_v=(0.1, 0.02), sigma_w=(0.05, 0.02),
            guess=(1.0, 1.0), sigma_guess=(0.5, 0.5),
        )  # fmt: skip
        in_c = InC(rhec.export(mhe, tmp_path / "rhec"))
        oks = []
        for k in range(80):
            z = np.array([0.01 if k < 40 else 0.3, 0.0]) + (0.1, 0.02) * rng.normal(size=2)
            mhe.prepare()
            estimate = mhe.feedback(z)
            answer, status = in_c.call("estimate", z, length=3)
            assert (status == 0) == mhe.ok
            expected = np.concatenate(estimate[:3])
            np.testing.assert_allclose(answer, expected, rtol=TOLERANCE, atol=TOLERANCE)
            oks.append(mhe.ok)
        assert not all(oks) and all(oks[-30:])


@needs_compiler
def test_a_controller_with_exact_hessians_commands_in_c_as_in_python(tmp_path):
    """A pendulum swings up: where the Hessian has a minimum, and where it has none."""
    problem = gallery.pendulum()
    options = problem.options | dict(horizon=15)
    with no_compiler():
        rhc = rhec.RHC(**options, hessian="exact")
        mhe = rhec.RHE(
            model=options["model"], dt=0.025, horizon=3, sigma_v=(0.01,) * 4, sigma_w=(0.01,) * 4,
            guess=problem.start, sigma_guess=(0.1,) * 4,
        )  # fmt: skip
        in_c = InC(rhec.export((mhe, rhc), tmp_path / "rhec"))
        x = np.array(problem.start) + 0.2
        for _ in range(20):
            rhc.prepare()
            given = (x, [], np.zeros((4, 16)), np.zeros((1, 15)))
            u = rhc.feedback(*given)
            command, status = in_c.call("control", *given, length=1)
            assert (status == 0) == rhc.ok
            np.testing.assert_allclose(command, u, rtol=TOLERANCE, atol=TOLERANCE)
            x = options["model"].simulate(x, [u], dt=0.025)[-1]
