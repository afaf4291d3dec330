"""Exports of Models that are stiff or have no slopes somewhere answer as the live objects."""

import casadi as ca
import numpy as np
import pytest
from helpers import no_compiler
from in_c import InC
from rotating_masses import INERTIA, measured, mhe_of_masses

import rhec
from rhec.core._casadi import compiled

needs_compiler = pytest.mark.skipif(not compiled.compiler(), reason="there is no C compiler")
TOLERANCE = 1e-9  # of answers, relative and absolute


@pytest.mark.nightly
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
                in_c.prepare()
                answer, status = in_c.call("estimate", z, length=11)
                assert np.all(np.isfinite(answer))
                assert (status == 0) == mhe.ok
                expected = np.concatenate(estimate[:3])
                np.testing.assert_allclose(answer, expected, rtol=TOLERANCE, atol=TOLERANCE)
            assert answer[-1] == pytest.approx(INERTIA, rel=0.01)


@pytest.mark.nightly
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
            in_c.prepare()
            answer, status = in_c.call("estimate", z, length=3)
            assert (status == 0) == mhe.ok
            expected = np.concatenate(estimate[:3])
            np.testing.assert_allclose(answer, expected, rtol=TOLERANCE, atol=TOLERANCE)
            oks.append(mhe.ok)
        assert not all(oks) and all(oks[-30:])
