"""The l1 gains of the loop on a row, against the loop sample by sample and against drives."""

import dataclasses

import numpy as np
import pytest

import rhec
from rhec import paper
from rhec.core._casadi import compiled, scan
from rhec.core._casadi.build import packed_size
from rhec.simulation.closed_loop import build_sample, finish, set_up
from rhec.tracked_robot import plant
from rhec.tracked_robot.terrain import Terrain
from rhec.workbench.studies import guaranteed

MU, KAPPA, LEAD = 0.9, 1.0, 400
SILENT = dict(
    gnss_sigma_m=0.0, gnss_slow_share=0.0, encoder_sigma_mps=0.0, speed_sigma_mps=0.0,
    bump_sigma_radps=0.0, rut_length_m=0.0, slip_difference=0.0, soil_under="centre",
    start_offset_m=0.0, mu_mean=MU, kappa_mean=KAPPA, kappa_deviation=0.0,
)  # fmt: skip
W = (0.001, 0.001, 0.005, 0.001, 0.001, 0.005)
LOOPS = {
    "bounded EKF": dict(estimator="bounded_ekf", controller="speed_rhc", r=0.1, sigma_w=W),
    "yaw-drift EKF": dict(
        estimator="yaw_drift_ekf", controller="speed_rhc", r=0.1, sigma_w=(*W, 0.001)
    ),
    "RHC, measured reference": dict(estimator="bounded_ekf", r=10.0, sigma_w=W),
}


def drive(scenario, signal, values):
    """The Run of a scenario, without noise, with LEAD samples before the values of a signal.

    The GNSS errors go along y, which is across the row. Without turning κ̂ stays what it was, 1.
    """
    quantity = (dict(gnss_sigma_m=1.0), None, dict(bump_sigma_radps=1.0))[signal]
    scenario = dataclasses.replace(
        scenario, **quantity, path=rhec.Path.from_segments([(1000.0, 0.0)]),
        terrain=Terrain.uniform(MU, KAPPA), duration_s=(LEAD + len(values) + 2) * paper.DT_S,
    )  # fmt: skip
    noise = np.zeros((LEAD + len(values) + 2, packed_size(plant.NOISE)))
    ends = np.cumsum([0] + [packed_size({name: shape}) for name, shape in plant.NOISE.items()])
    first = dict(zip(plant.NOISE, ends))
    column = first["white"] + 1 if signal == 0 else first["bump"]
    noise[LEAD : LEAD + len(values), column] = values
    setup = set_up(scenario)
    functions = compiled.load(build_sample, *setup.structure)
    return finish(scenario, setup, scan.scan(functions, setup.memory, noise, setup.settings)[1])


@pytest.mark.parametrize("loop", LOOPS)
@pytest.mark.parametrize("signal", [0, 2], ids=lambda i: guaranteed.SIGNALS[i])
def test_the_worst_signal_takes_the_simulated_robot_to_the_bound(loop, signal):
    """Small enough for the nonlinear loop to be near the linear one; random signals stay below."""
    scenario = rhec.Scenario(**SILENT | LOOPS[loop])
    bound = guaranteed.gains(scenario)["centre"][signal]
    values = 1e-3 * guaranteed.worst(scenario, signal, 300)
    y = drive(scenario, signal, values).columns["y_m"]
    assert np.abs(y[:LEAD]).max() < 1e-5
    reached = np.abs(y[LEAD : LEAD + 301]).max() / 1e-3
    # The motors' lag is not in the linear loop.
    assert reached == pytest.approx(bound, rel=0.08)
    at_random = 1e-3 * np.random.default_rng(0).choice([-1.0, 1.0], 300)
    assert np.abs(drive(scenario, signal, at_random).columns["y_m"]).max() / 1e-3 < 0.8 * bound


@pytest.mark.parametrize("loop", LOOPS)
def test_no_signal_exceeds_the_gain_and_the_worst_one_attains_it(loop):
    scenario = rhec.Scenario(**SILENT | LOOPS[loop])
    A, B, C = guaranteed.row_loop(scenario)
    assert np.abs(np.linalg.eigvals(A)).max() < 1
    rng = np.random.default_rng(1)
    for place in range(len(guaranteed.SIGNALS)):
        gain = guaranteed.gains(scenario)["centre"][place]
        signals = [guaranteed.worst(scenario, place, 4000), *rng.uniform(-1, 1, (20, 4000))]
        largest = []
        for values in signals:
            state = np.zeros(len(A))
            distances = []
            for value in values:
                state = A @ state + B[:, place] * value
                distances.append(abs((C @ state)[0]))
            largest.append(max(distances))
        assert largest[0] == pytest.approx(gain, rel=1e-6)
        assert max(largest[1:]) < gain


def test_a_constant_yaw_drift_moves_a_robot_that_estimates_it_only_at_first():
    for loop, ends_at_zero in (("bounded EKF", False), ("yaw-drift EKF", True)):
        A, B, C = guaranteed.row_loop(rhec.Scenario(**SILENT | LOOPS[loop]))
        standing = C @ np.linalg.solve(np.eye(len(A)) - A, B[:, 1])
        assert (abs(standing[0]) < 1e-9) == ends_at_zero


def test_the_table_says_what_each_signal_may_be_alone():
    table = guaranteed.guaranteed({"one": SILENT | LOOPS["bounded EKF"]}, tolerance_m=0.24)
    centre, corner = table.to_dict("records")
    assert centre["gnss_m"] * centre["per_gnss"] == pytest.approx(0.24)
    assert corner["bump_radps"] * corner["per_bump_ms"] == pytest.approx(0.24)
    assert corner["gnss_m"] < centre["gnss_m"]
    assert centre["slip_difference"] == pytest.approx(
        centre["yaw_drift_radpm"] * paper.TRACK_WIDTH_M
    )
    assert centre["at_three_sigma_m"] == 0
    noisy = SILENT | LOOPS["bounded EKF"] | dict(gnss_sigma_m=0.01)
    (row, _) = guaranteed.guaranteed({"one": noisy}).to_dict("records")
    assert row["at_three_sigma_m"] == pytest.approx(0.03 * row["per_gnss"])


def test_a_loop_that_is_not_written_down_is_refused():
    for fields in (dict(estimator="rhe"), dict(estimator="bounded_ekf", controller="ltv_mpc")):
        with pytest.raises(ValueError, match="was '.*'; it should be one of"):
            guaranteed.gains(rhec.Scenario(**fields))
