"""The soak test: an endless drive that can be cut and resumed anywhere, and its counts.
`make nightly` drives ten times as far.
"""

import numpy as np
import pytest
import soak

import rhec
from rhec.simulation import closed_loop, faults
from rhec.simulation.columns import COLUMNS

pytestmark = pytest.mark.nightly

BASE = rhec.Scenario()


def test_a_drive_can_be_cut_anywhere():
    """Equal to the last bit, on either side of the end of a leg, of a check and of a block."""
    begun, cuts = soak.init(BASE, 0), [1, 15, 484, 777, 1499, 1500, 1501, 2003]
    whole, cut = soak.drive(begun, BASE, 2003), begun
    for samples in np.diff([0, *cuts]):
        cut = soak.drive(cut, BASE, int(samples))
    np.testing.assert_equal(cut, whole)
    another = soak.drive(soak.init(BASE, 1), BASE, 100)
    assert another["digest"] != soak.drive(begun, BASE, 100)["digest"]


def test_legs_differ_but_not_in_the_loops_structure():
    legs = [soak.leg(BASE, 0, number) for number in range(40)]
    assert legs == [soak.leg(BASE, 0, number) for number in range(40)]
    assert legs[3] != soak.leg(BASE, 1, 3) and len({leg.seed for leg in legs}) == 40
    assert {fault.kind for leg in legs for fault in leg.faults} == set(faults.KINDS)
    # The delay of a command is another wire, with the same memory.
    setups = {leg: closed_loop.set_up(leg) for leg in legs[:8]}
    assert len({(leg.command_delay, setup.structure) for leg, setup in setups.items()}) == 2
    assert len({(*setup.layout, len(setup.memory)) for setup in setups.values()}) == 1


def test_each_kind_of_failure_is_counted():
    state = soak.drive(soak.init(BASE, 0), BASE, 20)
    scenario = soak.leg(BASE, 0, 0)
    setup = closed_loop.set_up(scenario)
    healthy = np.zeros((60, len(COLUMNS)))
    healthy[:, COLUMNS.index("ok")] = 1

    def found(memory=state["memory"], **wrong):
        rows = healthy.copy()
        for name, value in wrong.items():
            rows[2, COLUMNS.index(name)] = value
        counts, _ = soak.counted(scenario, setup, rows, memory)
        return {name: count for name, count in counts.items() if count}

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
        memory = state["memory"].copy()
        P = setup.unpack(memory)["estimator"]["P"]
        P[row, column] = factor * P[row, column] + (row != column) * 1e-3
        assert found(memory=memory) == {"not_definite": 1}
