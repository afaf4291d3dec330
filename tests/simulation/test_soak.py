"""What the soak test counts. `make nightly` drives 2.3 days."""

import numpy as np
import pytest
import soak

import rhec
from rhec.simulation import closed_loop
from rhec.simulation.columns import COLUMNS

pytestmark = pytest.mark.nightly

BASE = rhec.Scenario()


def test_each_kind_of_failure_is_counted():
    scenario = soak.leg(BASE, 0, 0)
    setup = closed_loop.set_up(scenario)
    step = closed_loop.build_sample(*setup.structure)["step"]
    stream = closed_loop.noise_and_faults(scenario.seed, scenario.faults, 20, setup.draws)
    driven, _ = soak.run_on(step, setup.memory, stream, setup.settings)
    healthy = np.zeros((60, len(COLUMNS)))
    healthy[:, COLUMNS.index("ok")] = 1

    def found(memory=driven, **wrong):
        rows = healthy.copy()
        for name, value in wrong.items():
            rows[2, COLUMNS.index(name)] = value
        counts, _ = soak.counted(scenario, setup, rows, memory)
        return {name: count for name, count in counts.items() if count and name != "done"}

    assert found() == {}
    assert found(omega_cmd_radps=np.nan) == found(theta_hat_rad=np.inf) == {"not_finite": 1}
    for name, value in (
        ("omega_cmd_radps", -scenario.omega_max_radps * (1 + 1e-15)),
        ("mu_hat", 1 + 1e-15),
        ("kappa_hat", -1e-300),
    ):
        assert found(**{name: value}) == {"out_of_bounds": 1}
    assert found(ok=0) == {"not_ok": 1} and found(y_m=-3) == {"outside": 1}
    healthy[:45, COLUMNS.index("ok")] = 0  # as many as the gate of 15 intervals has patience for
    assert found() == {"not_ok": 45}
    healthy[45, COLUMNS.index("ok")] = 0
    assert found() == {"not_ok": 46, "stuck": 1}
    healthy[:, COLUMNS.index("ok")] = 1
    for row, column, factor in ((0, 0, -1), (0, 1, 2), (0, 0, 1e-30), (5, 5, np.nan)):
        memory = driven.copy()
        P = setup.unpack(memory)["estimator"]["P"]
        P[row, column] = factor * P[row, column] + (row != column) * 1e-3
        assert found(memory=memory) == {"not_definite": 1}
