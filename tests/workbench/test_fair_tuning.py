"""One tuner for controller and estimator: the same rules for all, and a search that can go on."""

import numpy as np
import pytest

import rhec
from rhec.tracked_robot.tuned_loops import TUNED
from rhec.workbench.studies import fair_tuning

SMALL = 6  # evaluations for each unknown
WORLD = dict(duration_s=20.0)


class Counted:
    """A smooth error with its minimum at R = 0.5 and all standard deviations 0.02."""

    def __init__(self, fail_after=np.inf):
        self.fields, self.seeds, self.fail_after = [], set(), fail_after

    def __call__(self, fields, seeds):
        if len(self.fields) == self.fail_after:
            raise KeyboardInterrupt
        self.fields.append(fields)
        self.seeds |= set(seeds)
        sigma = np.array(fields.get("sigma_w", [0.02]))
        return float(np.log(fields.get("r", 1) / 0.5) ** 2 + np.square(np.log(sigma / 0.02)).sum())


def tuned(monkeypatch, folder, name="bounded_ekf", **options):
    error = Counted(**options)
    monkeypatch.setattr(fair_tuning, "_error_m", error)
    return fair_tuning.tune(name, WORLD, folder=folder, evaluations=SMALL), error


@pytest.mark.parametrize("name", fair_tuning.CONTESTANTS)
def test_every_contestant_has_the_same_budget_for_each_unknown(name, monkeypatch, tmp_path):
    (fields, _), error = tuned(monkeypatch, tmp_path, name)
    unknowns = fair_tuning.CONTESTANTS[name].unknowns
    assert len(error.fields) <= SMALL * len(unknowns)
    assert len(error.fields) > 0.5 * SMALL * len(unknowns)
    assert min(error.seeds) >= 1000
    # What is tuned is a scenario, and all that it sets is within its bounds.
    rhec.Scenario(**fields)
    for tried in error.fields:
        for unknown in unknowns:
            values = [tried["sigma_w"][place] for place in unknown.places] or [
                tried["q"][2] if unknown.name == "q_theta"
                else tried["sigma_v"][3] if unknown.name == "sigma_omega"
                else tried[unknown.name]
            ]  # fmt: skip
            low, high = 0.99 * unknown.least, 1.01 * unknown.most
            assert all(low <= value <= high for value in values)


def test_the_search_finds_the_minimum(monkeypatch, tmp_path):
    monkeypatch.setattr(fair_tuning, "_error_m", Counted())
    fields, error = fair_tuning.tune("traction_oracle", WORLD, folder=tmp_path, evaluations=60)
    assert fields["r"] == pytest.approx(0.5, rel=0.1)
    np.testing.assert_allclose(fields["sigma_w"], 0.02, rtol=0.1)
    assert error < 0.02


def test_an_interrupted_search_goes_on_to_the_same_result(monkeypatch, tmp_path):
    whole, error = tuned(monkeypatch, tmp_path / "whole")
    with pytest.raises(KeyboardInterrupt):
        tuned(monkeypatch, tmp_path / "cut", fail_after=17)
    continued, rest = tuned(monkeypatch, tmp_path / "cut")
    assert continued == whole
    assert len(rest.fields) == len(error.fields) - 17
    again, none = tuned(monkeypatch, tmp_path / "cut")
    assert again == whole and not none.fields


def test_the_error_is_the_mean_of_single_runs():
    fields = dict(estimator="ekf", r=1.0) | WORLD
    alone = [rhec.simulate(rhec.Scenario(seed=seed, **fields)) for seed in (1000, 1001)]
    mean = np.mean([run.metrics["mean_error_true_m"] for run in alone])
    assert fair_tuning._error_m(fields, (1000, 1001)) == pytest.approx(mean, rel=1e-12)


@pytest.mark.parametrize("world", TUNED)
def test_what_was_tuned_is_stored_and_is_a_scenario(world):
    assert set(TUNED[world]) == set(fair_tuning.CONTESTANTS)
    for name, fields in TUNED[world].items():
        chosen = fair_tuning.CONTESTANTS[name]
        assert chosen.fields.items() <= fields.items()
        scenario = rhec.Scenario(**fields)
        assert scenario.sigma_w is not None or name == "oracle"
