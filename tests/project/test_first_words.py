"""The first mistakes of a newcomer: each gets a sentence that says what to write instead."""

import numpy as np
import pytest

import rhec


@pytest.fixture(scope="module")
def rhc():
    """A controller of two states, of which the first is pushed."""
    model = rhec.Model(states=("x", "y"), inputs=("u",), f=lambda x, u, p: [u, x[0]])
    return rhec.RHC(model=model, q=(1, 1), r=(1,), dt=0.1, horizon=5)


def test_a_first_mistake_is_told_what_to_write_instead(rhc):
    rows = rhc.stages.model.simulate((0.0, 0.0), np.zeros((5, 1)), dt=0.1)
    rhc.feedback((0.0, 0.0), x_ref=rows.T)
    for call, error, sentence in [
        (lambda: rhec.Scenario("ekf"), TypeError, r"by name, as in Scenario\(estimator=…\).*'ekf'"),
        (
            lambda: rhec.simulate(estimator="ekf"),
            TypeError,
            r"rhec.simulate\(rhec.Scenario\(estimator='ekf'\)\)",
        ),
        (lambda: rhec.WORLDS["sfot"], KeyError, "no world 'sfot'.*uncertain.*did you mean 'soft'"),
        (
            lambda: rhc.feedback((0.0, 0.0), x_ref=np.zeros((2, 16))),
            ValueError,
            r"\(2, 16\); it should have \(2, 6\).*horizon is 5.*Pa",
        ),
        (
            lambda: rhc.feedback((0.0, 0.0), x_ref=rows),
            ValueError,
            r"had shape \(6, 2\).*x_ref.T has that",
        ),
    ]:
        with pytest.raises(error, match=sentence):
            call()
    assert "sfot" not in rhec.WORLDS and rhec.WORLDS.get("sfot") is None
