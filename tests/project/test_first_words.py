"""The first mistakes of a newcomer: each gets a sentence that says what to write instead."""

import numpy as np
import pytest

import rhec
from notebooks.claims.__main__ import main as claim


def integrator(horizon):
    """A controller of two states, of which the first is pushed."""
    model = rhec.Model(states=("x", "y"), inputs=("u",), f=lambda x, u, p: [u, x[0]])
    return rhec.RHC(model=model, q=(1, 1), r=(1,), dt=0.1, horizon=horizon)


def test_parameters_of_a_scenario_have_names():
    with pytest.raises(TypeError, match=r"by name, as in Scenario\(estimator=…\).*'ekf'"):
        rhec.Scenario("ekf")


def test_simulate_says_that_parameters_belong_to_a_scenario():
    with pytest.raises(TypeError, match=r"rhec.simulate\(rhec.Scenario\(estimator='ekf'\)\)"):
        rhec.simulate(estimator="ekf")


def test_a_world_that_there_is_not_is_told_those_there_are():
    with pytest.raises(KeyError, match="no world 'sfot'.*uncertain.*did you mean 'soft'"):
        rhec.WORLDS["sfot"]
    assert "sfot" not in rhec.WORLDS and rhec.WORLDS.get("sfot") is None


def test_references_of_another_horizon_name_both():
    rhc = integrator(horizon=20)
    with pytest.raises(ValueError, match=r"\(2, 16\); it should have \(2, 21\).*horizon is 20.*Pa"):
        rhc.feedback((0.0, 0.0), x_ref=np.zeros((2, 16)))


def test_references_by_rows_are_told_to_turn():
    rhc = integrator(horizon=5)
    rows = rhc.stages.model.simulate((0.0, 0.0), np.zeros((5, 1)), dt=0.1)
    with pytest.raises(ValueError, match=r"had shape \(6, 2\).*x_ref.T has that"):
        rhc.feedback((0.0, 0.0), x_ref=rows)
    rhc.feedback((0.0, 0.0), x_ref=rows.T)


def test_the_case_of_a_claim_does_not_matter(capsys):
    claim(["t7", "--fields", "2"])
    # What is compiled is told before.
    assert "\nT7: " in f"\n{capsys.readouterr().out}"
    with pytest.raises(SystemExit):
        claim(["zz"])
    assert capsys.readouterr().err == (
        "claim was 'ZZ'; `make claim` without an ID lists those there are\n"
    )
