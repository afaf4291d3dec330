"""The closed loop: one source, live or fused, compiled or not, the same from run to run."""

import dataclasses
from typing import get_args

import numpy as np
import pytest
from helpers import SIMPLE_WORLD
from pandas.testing import assert_frame_equal

import rhec
from notebooks.rivals import RIVALS
from rhec import paper
from rhec.simulation import closed_loop
from rhec.simulation.columns import ESTIMATE
from rhec.tracked_robot.path import Turns

pytestmark = pytest.mark.usefixtures("virtual_machine")
MEASURED = ["x_meas_m", "y_meas_m"]
MINUTE = rhec.Scenario(**SIMPLE_WORLD, process_noise="prediction", duration_s=60.0)

QUIET = dict.fromkeys(
    "gnss_sigma_m encoder_sigma_mps speed_sigma_mps bump_sigma_radps".split(), 0.0
)


def simulated(**changes):
    return rhec.simulate(dataclasses.replace(MINUTE, **changes))


def test_all_patterns_of_turns_share_one_compiled_loop():
    patterns = [dataclasses.replace(MINUTE, turns=turns) for turns in get_args(Turns)]
    assert len({closed_loop.set_up(each).structure for each in patterns}) == 1


# Seeds and noise


@pytest.mark.parametrize("duration_s", [0.2, 3.4, 60.0, 64.0])
def test_a_longer_run_begins_like_a_shorter_one(run, duration_s):
    other = simulated(duration_s=duration_s)
    assert len(other.log) == round(duration_s / 0.2)
    rows = min(len(other.log), len(run.log))
    assert_frame_equal(other.log[:rows], run.log[:rows], check_exact=True)


def test_a_seed_is_a_soil_and_its_noise_whatever_the_estimator(run):
    """In a world whose drives differ by more than a millimetre; another seed is another noise."""
    oracle = simulated(estimator="oracle")
    other = simulated(seed=1)
    np.testing.assert_array_equal(oracle.terrain.kappa, run.terrain.kappa)
    assert np.abs(run.terrain.kappa - other.terrain.kappa).mean() > 0.01
    assert np.abs(run.log["x_m"] - oracle.log["x_m"]).max() > 1e-3
    noise, same, others = (each.log["x_meas_m"] - each.log["x_m"] for each in (run, oracle, other))
    np.testing.assert_allclose(same, noise, atol=1e-12)
    assert abs(np.corrcoef(noise, others)[0, 1]) < 0.2 < np.abs(noise - others).max() / 0.03


def test_the_noise_in_the_log_is_that_of_the_scenario(run):
    position, measured = (run.log[names].to_numpy() for names in (["x_m", "y_m"], MEASURED))
    assert np.std(measured - position) == pytest.approx(0.03, rel=0.1)
    assert np.std(run.log["nu_meas_mps"] - 0.5) == pytest.approx(0.05, rel=0.1)


# The log and its metrics


def test_errors_are_distances_to_the_path(run):
    for error, names in (("error_m", MEASURED), ("error_true_m", ["x_m", "y_m"])):
        distance, s = run.path.project(run.log[names].to_numpy())
        np.testing.assert_allclose(run.log[error], distance, atol=1e-12)
    np.testing.assert_array_equal(run.log["on_straight"], run.path.poses(s)[1] == 0)
    late = run.log[run.log["t_s"] > 30]
    _, s = run.path.project(late[["x_hat_m", "y_hat_m"]].to_numpy())
    np.testing.assert_allclose(late["s_m"] % run.path.length_m, s, atol=0.01)
    np.testing.assert_allclose(run.log["t_s"], 0.2 * np.arange(300), atol=1e-12)


def corner_errors(run, log):
    """How much nearer to the crop a corner of the robot is than that of one in place [m]."""
    _, s = run.path.project(log[["x_m", "y_m"]])
    poses, _ = run.path.poses(s)
    turned = log["theta_rad"] - poses[:, 2]
    ahead, left = paper.ROBOT_LENGTH_M / 2, paper.ROBOT_WIDTH_M / 2
    off = (log[["x_m", "y_m"]].to_numpy() - poses[:, :2]).T
    aside = off[1] * np.cos(poses[:, 2]) - off[0] * np.sin(poses[:, 2])
    corners = [
        aside + x * np.sin(turned) + y * np.cos(turned)
        for x in (-ahead, ahead)
        for y in (-left, left)
    ]
    return np.abs(corners).max(axis=0) - left


@pytest.mark.parametrize(
    "changes",
    [
        dict(
            estimator="ekf",
            row_length_m=10.0,
            headland_radius_m=3.0,
            faults=(rhec.Fault(kind="jump", size_m=1.0, start_s=30.0, duration_s=20.0),),
            duration_s=80.0,
        ),
        dict(
            q=paper.Q2,
            start_offset_m=-1.0,
            faults=(rhec.Fault(kind="missing", start_s=40.0, duration_s=5.0),),
            duration_s=120.0,
        ),
        dict(start_offset_m=-30.0, faults=(rhec.Fault(kind="missing"),)),
    ],
    ids=str,
)
def test_metrics_are_what_the_log_says(changes):
    """Recounted sample by sample. Arrival: the first of 25 samples in a row with a true error
    within 0.12 m, after which the count begins; without it the whole run counts. The first case
    leaves the path in a turn, which is no violation before the straight behind it.
    """
    run = simulated(**changes)
    log = run.log
    inside = [error < 0.12 for error in log["error_true_m"]]
    arrivals = [k for k in range(len(log) - 24) if all(inside[k : k + 25])]
    after = log[arrivals[0] + 25 if arrivals else 0 :]
    straight = after[after["on_straight"]]
    first_row = log[: np.argmax(log["x_m"] > run.scenario.row_length_m)]  # along the x axis
    beyond = -first_row["y_m"] * np.sign(run.scenario.start_offset_m)

    def rms(hat, true):
        return np.sqrt(np.mean((after[hat] - after[true]) ** 2))

    violations = sum(straight["error_m"] > 0.12)
    violations_true = sum(straight["error_true_m"] > 0.12)
    expected = dict(
        settling_time_s=log["t_s"][arrivals[0]] if arrivals else np.nan,
        mean_error_m=after["error_m"].mean(),
        mean_error_true_m=after["error_true_m"].mean(),
        max_error_true_m=after["error_true_m"].max(),
        max_corner_error_true_m=corner_errors(run, straight).max(),
        mean_speed_mps=after["nu_mps"].abs().mean(),
        mean_error_from_start_m=log["error_m"].mean(),
        overshoot_m=max(0, beyond.max()),
        omega_peak_radps=log["omega_cmd_radps"].abs().max(),
        violations=violations,
        violations_true=violations_true,
        rms_mu=rms("mu_hat", "mu"),
        rms_kappa=rms("kappa_hat", "kappa"),
        rms_yaw_rad=rms("theta_hat_rad", "theta_rad"),
        kkt_rhe_median=after["kkt_rhe"].median(skipna=False),
        kkt_rhc_median=after["kkt_rhc"].median(),
        solver_ok=True,
    )
    assert run.metrics == pytest.approx(expected, nan_ok=True)
    outside = straight["t_s"][straight["error_true_m"] > 0.12]
    said = "stayed in its row" if outside.empty else f"first at {outside.iloc[0]:.1f} s"
    assert (said if arrivals else "never came to stay in its row") in repr(run)
    assert f": {violations_true} violations, {violations} by GNSS\n" in repr(run)
    means_m = (after[name].mean() for name in ("error_m", "error_true_m"))
    assert "mean error {:.4f} m, true {:.4f} m\n".format(*means_m) in repr(run)


# What the loop does


@pytest.mark.parametrize("backwards", [False, True])
def test_a_first_guess_that_is_true_stays_true_without_noise_and_slip(backwards):
    """A robot that begins on the path follows it then to the end, backwards tail first."""
    on_path = dict(terrain=rhec.Terrain.uniform(1.0, 1.0), start_offset_m=0.0)
    log = simulated(**QUIET, **on_path, backwards=backwards, row_length_m=10.0).log
    true = ["x_m", "y_m", "theta_rad", "nu_mps", "mu", "kappa"]
    np.testing.assert_allclose(log[ESTIMATE], log[true], atol=1e-3)
    assert log["error_true_m"].max() < 0.05 and log["s_m"].iloc[-1] > 25
    assert ((log["nu_mps"] < 0) == backwards).all()


@pytest.mark.parametrize("backwards", [False, True])
def test_a_start_is_told_to_the_left_of_the_path(backwards):
    """The first row of paths goes along x; backwards it is driven tail first."""
    start = dict(start_offset_m=0.4, start_yaw_rad=0.3)
    log = simulated(**QUIET | start, backwards=backwards, duration_s=1.0).log
    turned = 0.3 + np.pi * backwards
    np.testing.assert_allclose(log.loc[0, ["x_m", "y_m", "theta_rad"]], [0, 0.4, turned])


def test_a_delayed_command_is_the_one_before():
    """No noise, so what the tracks do follows from the commands alone."""
    prompt, late = (simulated(**QUIET, command_delay=delay, duration_s=2.0).log for delay in (0, 1))
    assert prompt["omega_radps"][1] != 0
    assert late["omega_radps"][1] == 0 and late["omega_radps"][2] != 0
    assert late["omega_cmd_radps"][0] == prompt["omega_cmd_radps"][0] != 0


def test_the_oracles_know_what_they_say():
    log = simulated(estimator="oracle").log
    true = ["x_m", "y_m", "theta_rad", "nu_mps", "mu", "kappa"]
    np.testing.assert_array_equal(log[ESTIMATE], log[true])
    log = simulated(estimator=RIVALS["traction_oracle"]).log
    np.testing.assert_array_equal(log[["mu_hat", "kappa_hat"]], log[["mu", "kappa"]])


# What a run shows of itself


def test_in_a_notebook_a_run_is_a_table_of_its_metrics_and_the_picture_of_plot(run, monkeypatch):
    drawn = []
    plot = rhec.Run.plot
    monkeypatch.setattr(rhec.Run, "plot", lambda self: drawn.append(plot(self)) or drawn[-1])
    page = run._repr_html_()
    assert len(drawn) == page.count("<img ") == 1 and "://" not in page
    assert run.metrics._repr_html_() in page
    assert f"<td>mean_error_m</td><td>{run.metrics['mean_error_m']:.4g}</td><td>m</td>" in page
    labels = [axes.get_ylabel() for axes in drawn[0].axes]
    assert labels == ["y [m]", "error [m]", "μ [-]", "κ [-]"]
    robot_line = drawn[0].axes[0].get_lines()[1]
    np.testing.assert_array_equal(robot_line.get_xdata(), run.columns["x_m"])
    # Most of the height of the axes is for what the traction does, not for what is unsure of it.
    for axes, name in zip(drawn[0].axes[2:], ("mu", "kappa")):
        low, high = axes.get_ylim()
        both = np.concatenate([run.columns[name], run.columns[f"{name}_hat"]])
        assert len(axes.collections) == 1
        assert low < np.median(both) < high and high - low < 1.2 * np.ptp(both) + 0.05
