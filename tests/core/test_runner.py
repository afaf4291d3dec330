"""What an estimator makes of recorded measurements is a plain loop over its step."""

import casadi as ca
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from rhec.core import runner
from rhec.core._casadi.build import casadi_function


@casadi_function("step", m=(3, 1), z=(2, 1), V=(2, 1), traction=(2, 1))
def step(m, z, V, traction):
    """Some memory, a number, a vector, a matrix with gaps, and an output that is not wanted."""
    m = 0.5 * m + ca.vertcat(z, traction[0]) / (1 + ca.sumsqr(m))
    sparse = ca.vertcat(ca.horzcat(m.T, ca.SX(1, 1)), ca.horzcat(ca.SX(1, 3), V[1]))
    return dict(m=m, s=ca.sin(m), number=m[0] * traction[1], matrix=sparse, unused=m[1])


OUTPUTS = ["matrix", "estimate", "number"]


def looped(m, z, V, traction):
    """The same by a Python loop over the step."""
    rows = []
    for z_k, traction_k in zip(z, traction):
        m, estimate, number, matrix, _ = step(m, z_k, V, traction_k)
        rows.append((np.array(matrix), estimate.full().ravel(), float(number)))
    shapes = dict(matrix=(2, 4), estimate=(3,), number=())
    return {
        name: np.array([row[k] for row in rows]).reshape(len(z), *shapes[name])
        for k, name in enumerate(OUTPUTS)
    }


@pytest.mark.parametrize("streamed", [(), ("traction",)])
@given(n=st.integers(0, 2 * runner.BLOCK + 3), seed=st.integers(0, 99))
@settings(deadline=None, max_examples=15)
def test_a_scan_equals_a_loop_over_the_step(streamed, n, seed):
    generator = np.random.default_rng(seed)
    m, V = generator.standard_normal(3), generator.standard_normal(2)
    z, traction = generator.standard_normal((2, n, 2))
    stream = np.hstack([z, traction])
    constant = dict(V=V, unknown=np.zeros(7))
    if not streamed:
        stream = z
        constant["traction"] = generator.standard_normal(2)
        traction = np.tile(constant["traction"], (n, 1))
    arrays = runner.record(runner.build_recorded(step, OUTPUTS, streamed), m, stream, constant)
    expected = looped(m, z, V, traction)
    assert list(arrays) == OUTPUTS
    for name in OUTPUTS:
        assert arrays[name].shape == expected[name].shape
        np.testing.assert_array_equal(arrays[name], expected[name])
