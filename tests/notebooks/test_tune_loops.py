"""One tuner for controller and estimator: the same rules for all."""

import numpy as np
import pytest

import rhec
from notebooks.further import tune_loops
from notebooks.further.rivals.tuned_loops import TUNED

SMALL = 6  # evaluations for each unknown


class Counted:
    """A smooth error with its minimum at R = 0.5 and all standard deviations 0.02."""

    def __init__(self):
        self.fields = []

    def __call__(self, **fields):
        self.fields.append(fields)
        sigma = np.array(fields.get("sigma_w", [0.02]))
        return float(np.log(fields.get("r", 1) / 0.5) ** 2 + np.square(np.log(sigma / 0.02)).sum())


@pytest.mark.parametrize("loop", tune_loops.LOOPS)
def test_every_loop_has_the_same_budget_for_each_unknown(loop):
    error_m = Counted()
    fields, _ = tune_loops.tune(loop, error_m, SMALL)
    _, unknowns = tune_loops.LOOPS[loop]
    assert 0.5 * SMALL * len(unknowns) < len(error_m.fields) <= SMALL * len(unknowns)
    # What is tuned is a scenario, and all that it sets is within its bounds.
    rhec.Scenario(**fields)
    for tried in error_m.fields:
        for name in unknowns:
            values = (
                [tried["sigma_w"][place] for place in tune_loops._PLACES[name]]
                if name in tune_loops._PLACES
                else [tried["q"][2]] if name == "q_theta"
                else [tried["sigma_v"][3]] if name == "sigma_omega"
                else [tried[name]]
            )  # fmt: skip
            least, most = tune_loops.BOUNDS[name]
            assert all(0.99 * least <= value <= 1.01 * most for value in values)


def test_the_search_finds_the_minimum():
    fields, error = tune_loops.tune("traction_oracle", Counted(), 60)
    assert fields["r"] == pytest.approx(0.5, rel=0.1)
    np.testing.assert_allclose(fields["sigma_w"], 0.02, rtol=0.1)
    assert error < 0.02


@pytest.mark.parametrize("loop", tune_loops.LOOPS)
def test_what_was_tuned_is_stored_and_is_a_scenario(loop):
    kept, _ = tune_loops.LOOPS[loop]
    assert kept.items() <= TUNED[loop].items()
    assert rhec.Scenario(**TUNED[loop]).sigma_w is not None or loop == "oracle"
