"""The closed loop: one source, live or fused, compiled or not, the same from run to run."""

import dataclasses

import casadi as ca
import numpy as np
import pandas as pd
import pytest
from helpers import SIMPLE_WORLD, no_compiler
from oracles import flat
from soak import run_on

import rhec
from rhec import paper
from rhec.core import runner
from rhec.core._casadi import build as function
from rhec.core._casadi import compiled
from rhec.core.controller import rhc as controller
from rhec.simulation import closed_loop
from rhec.simulation import columns as log_columns
from rhec.tracked_robot import plant as robot
from rhec.tracked_robot import references, terrain

COLUMNS = """t_s x_m y_m theta_rad mu kappa nu_mps omega_radps x_meas_m y_meas_m nu_meas_mps
    omega_meas_radps x_hat_m y_hat_m theta_hat_rad nu_hat_mps mu_hat kappa_hat omega_cmd_radps s_m
    curvature_radpm on_straight error_m error_true_m kkt_rhe kkt_rhc ok""".split()
MINUTE = rhec.Scenario(**SIMPLE_WORLD, process_noise="likelihood", duration_s=60.0)
UNLIKE_TRACKS = dict(soil_under="tracks", slip_difference=0.05, rotation_centre_m=-0.2)
UNLIKE_TRACKS |= dict(rut_length_m=0.5, gnss_slow_share=0.7, gnss_slow_time_s=300.0)


def simulated(**changes):
    return rhec.simulate(dataclasses.replace(MINUTE, **changes))


def assert_equal_logs(one, other, atol=0.0):
    pd.testing.assert_frame_equal(one, other, rtol=0, atol=atol, check_exact=atol == 0)


# Live and fused


def live(scenario, samples):
    """The loop in plain Python, from the parts that anyone may use."""
    world, DT = closed_loop.set_up(scenario), paper.DT_S
    given, soil, n_segments = world.settings, world.terrain, len(world.path.segments)
    measure, drive, below = (
        robot.measure(DT),
        robot.drive(DT),
        robot.soil(terrain.common_shape(soil), scenario.soil_under),
    )
    refer = references.build_references(
        DT, scenario.prediction_horizon, n_segments, scenario.input_reference
    )["references"]
    pose, nu = np.array([0, scenario.start_offset_m, scenario.start_yaw_rad]), scenario.speed_mps
    rhe = rhec.RHE(
        process_noise=scenario.process_noise,
        guess=(*pose[:2], pose[2] + scenario.guess_yaw_rad, nu, 1.0, 1.0),
    )
    rhc = rhec.RHC(q=scenario.q, r=scenario.r, omega_max=scenario.omega_max_radps)
    rhc.iteration.start(controller.init(rhc.problem, world.guess[:3], world.guess[3:]))
    memory, s, previous, rows = robot.init(pose, nu), 0.0, 0.0, []
    for drawn in robot.draw_noise(scenario.seed, samples):
        drawn = {
            name: np.array(ca.evalf(value))
            for name, value in function.unpack(ca.MX(ca.DM(drawn)), robot.NOISE).items()
        }
        now = given | memory | drawn
        under = {k: flat(v) for k, v in below(**function.select_inputs(below, now)).items()}
        measured = measure(**function.select_inputs(measure, now))
        z = flat(measured["z"])
        rhe.prepare()
        estimate = rhe.feedback(z)
        target = refer(
            s=s, estimate=estimate[:6], omega_measured=z[3], **function.select_inputs(refer, given)
        )
        s = float(target["s"])
        rhc.prepare()
        command = rhc.feedback(
            estimate[:3], estimate[3:6], np.array(target["xi_ref"]), flat(target["omega_ref"])
        )
        applied, previous = (previous if scenario.command_delay else command), command
        driven = drive(**function.select_inputs(drive, now | under), omega_radps=applied)
        true = *memory["pose"], *under["traction"], *under["yaw_drift_radpm"]
        rows.append([*true, *z, *estimate[:6], command, s, rhe.kkt, rhc.kkt])
        memory = {
            name: flat(value) for name, value in (driven | dict(drift=measured["drift"])).items()
        }
    return np.array(rows)


LIVE = """x_m y_m theta_rad mu kappa yaw_drift_radpm
    x_meas_m y_meas_m nu_meas_mps omega_meas_radps x_hat_m
    y_hat_m theta_hat_rad nu_hat_mps mu_hat kappa_hat omega_cmd_radps s_m kkt_rhe
    kkt_rhc""".split()


@pytest.mark.nightly(keep=1)
@pytest.mark.parametrize(
    "changes",
    [
        dict(),
        dict(process_noise="printed", q=paper.Q1, command_delay=1),
        dict(r=2.0, omega_max_radps=0.2, start_yaw_rad=0.2),
        dict(guess_yaw_rad=0.3),
        UNLIKE_TRACKS,
    ],
    ids=str,
)
def test_a_live_loop_is_the_fused_one(changes):
    scenario = dataclasses.replace(MINUTE, **changes)
    expected = rhec.simulate(scenario).log[LIVE].to_numpy()
    got = live(scenario, len(expected))
    scale = np.maximum(1, np.abs(expected))
    np.testing.assert_allclose(got / scale, expected / scale, rtol=0, atol=1e-9)


@pytest.mark.parametrize("estimator", ["rhe", "ekf"])
def test_compiled_code_and_the_virtual_machine_agree(estimator):
    compiled_log = simulated(estimator=estimator).log
    with no_compiler():
        assert_equal_logs(compiled_log, simulated(estimator=estimator).log, atol=1e-9)


def test_a_run_can_be_cut_anywhere(run):
    made = closed_loop.set_up(MINUTE)
    functions, noise = (
        compiled.load(closed_loop.build_sample, *made.structure),
        robot.draw_noise(MINUTE.seed, 300),
    )
    memory, rows = made.memory, []
    for part in np.split(noise, [1, 16, 37, 200]):
        memory, more = run_on(functions["step"], memory, part, made.settings)
        rows.append(more)
    whole = runner.run_one(functions, made.memory, noise, made.settings)
    np.testing.assert_allclose(np.vstack(rows), whole, rtol=0, atol=1e-12)
    columns = [
        column
        for column in log_columns.COLUMNS
        if column in run.log and column not in log_columns.FLAGS
    ]
    np.testing.assert_allclose(
        pd.DataFrame(whole, columns=log_columns.COLUMNS)[columns],
        run.log[columns],
        rtol=0,
        atol=1e-12,
    )


# Seeds and noise


def test_the_same_scenario_is_the_same_run(run):
    again = simulated()
    assert_equal_logs(run.log, again.log)
    assert str(run.metrics) == str(again.metrics)


@pytest.mark.parametrize("duration_s", [0.2, 3.0, 3.4, 120.0])
def test_a_longer_run_begins_like_a_shorter_one(run, duration_s):
    other = simulated(duration_s=duration_s)
    assert len(other.log) == round(duration_s / 0.2)
    rows = min(len(other.log), len(run.log))
    assert_equal_logs(other.log[:rows], run.log[:rows])


def test_a_seed_changes_terrain_and_noise(run):
    other = simulated(seed=1)
    assert np.abs(run.terrain.kappa - other.terrain.kappa).mean() > 0.01
    noise, others = (each.log["x_meas_m"] - each.log["x_m"] for each in (run, other))
    assert abs(np.corrcoef(noise, others)[0, 1]) < 0.2 < np.abs(noise - others).max() / 0.03


def test_estimators_compared_at_one_seed_see_the_same_terrain_and_noise(run):
    for estimator in ("ekf", "oracle", "traction_oracle"):
        other = simulated(estimator=estimator)
        np.testing.assert_array_equal(other.terrain.mu, run.terrain.mu)
        np.testing.assert_array_equal(other.terrain.kappa, run.terrain.kappa)
        assert np.abs(run.log["x_m"] - other.log["x_m"]).max() > 1e-3
        for measured, true in (("x_meas_m", "x_m"), ("y_meas_m", "y_m")):
            np.testing.assert_allclose(
                other.log[measured] - other.log[true], run.log[measured] - run.log[true], atol=1e-12
            )


def test_the_noise_in_the_log_is_that_of_the_scenario(run):
    assert np.std(
        run.log[["x_meas_m", "y_meas_m"]].to_numpy() - run.log[["x_m", "y_m"]].to_numpy()
    ) == pytest.approx(0.03, rel=0.1)
    assert np.std(run.log["nu_meas_mps"] - 0.5) == pytest.approx(0.05, rel=0.1)
    told, heard = (simulated(estimator="oracle", speed_sigma_mps=s).log for s in (0.0, 0.05))
    assert_equal_logs(told.drop(columns="nu_meas_mps"), heard.drop(columns="nu_meas_mps"))
    silent = dict(gnss_sigma_m=0.0, encoder_sigma_mps=0.0, speed_sigma_mps=0.0)
    quiet = simulated(**silent, bump_sigma_radps=0.0)
    np.testing.assert_array_equal(quiet.log["x_meas_m"], quiet.log["x_m"])
    np.testing.assert_allclose(quiet.log["nu_meas_mps"], 0.5, atol=1e-9)


def test_traction_in_the_log_is_that_of_the_terrain_under_the_robot(run):
    lookup = terrain.lookup(run.terrain.mu.shape)
    for row in run.log[::50].itertuples():
        expected = flat(
            lookup(
                (row.x_m, row.y_m),
                run.terrain.origin_m,
                run.terrain.cell_m,
                terrain.flat(run.terrain),
            )
        )
        assert (row.mu, row.kappa) == pytest.approx(tuple(expected), abs=1e-12)


# The log and its metrics


def test_the_log_has_the_columns_that_other_programs_read(run):
    assert set(COLUMNS) <= set(run.log.columns)
    assert (
        run.log["ok"].dtype == bool and run.log["on_straight"].dtype == bool and run.log["ok"].all()
    )
    np.testing.assert_allclose(run.log["t_s"], 0.2 * np.arange(300), atol=1e-12)
    numbers = run.log.drop(columns="deviance", errors="ignore")
    assert np.all(np.isfinite(numbers.astype(float)))
    _, curvatures = run.path.poses(run.path.project(run.log[["x_m", "y_m"]])[1])
    np.testing.assert_array_equal(run.log["on_straight"], curvatures == 0)
    assert run.scenario == MINUTE


def test_yaw_is_counted_on_lap_after_lap():
    log = simulated(duration_s=600.0).log
    assert (
        np.abs(np.diff(log["theta_rad"])).max() < 0.1
        and np.abs(np.diff(log["theta_hat_rad"])).max() < 0.2
    )
    assert log["theta_rad"].iloc[-1] > 4 * np.pi
    assert np.abs(log["theta_rad"] - log["theta_hat_rad"]).max() < 0.5


def test_errors_are_distances_to_the_path(run):
    for error, x, y in (("error_m", "x_meas_m", "y_meas_m"), ("error_true_m", "x_m", "y_m")):
        np.testing.assert_allclose(
            run.log[error], run.path.project(run.log[[x, y]].to_numpy())[0], atol=1e-12
        )
    late = run.log[run.log["t_s"] > 30]
    np.testing.assert_allclose(
        late["s_m"] % run.path.length_m,
        run.path.project(late[["x_hat_m", "y_hat_m"]].to_numpy())[1],
        atol=0.01,
    )


def test_commands_keep_the_bound(run):
    assert run.log["omega_cmd_radps"].abs().max() == run.scenario.omega_max_radps


@pytest.mark.parametrize(
    "changes",
    [dict(), dict(process_noise="printed", estimator="ekf"), dict(q=paper.Q2, start_offset_m=-1.0)],
    ids=str,
)
def test_metrics_are_what_the_log_says(changes):
    """Recounted sample by sample. Arrival: the first of 25 samples in a row with a true error
    within 0.12 m, after which the count begins; without it the whole run counts.
    """
    run = simulated(duration_s=240.0, **changes)
    log, got = run.log, run.metrics
    inside = [error < 0.12 for error in log["error_true_m"]]
    arrivals = [k for k in range(len(log) - 24) if all(inside[k : k + 25])]
    after = log[arrivals[0] + 25 if arrivals else 0 :]
    straight = after[after["on_straight"]]
    first_row = log[: np.argmax(log["x_m"] > run.scenario.row_length_m)]  # along the x axis
    beyond = -first_row["y_m"] * np.sign(run.scenario.start_offset_m)
    expected = dict(
        settling_time_s=log["t_s"][arrivals[0]] if arrivals else np.nan,
        mean_error_m=after["error_m"].mean(),
        mean_error_true_m=after["error_true_m"].mean(),
        max_error_true_m=after["error_true_m"].max(),
        mean_error_from_start_m=log["error_m"].mean(),
        overshoot_m=max(0, beyond.max()),
        violations=sum(straight["error_m"] > 0.12),
        violations_true=sum(straight["error_true_m"] > 0.12),
        rms_mu=np.sqrt(np.mean((after["mu_hat"] - after["mu"]) ** 2)),
        rms_kappa=np.sqrt(np.mean((after["kappa_hat"] - after["kappa"]) ** 2)),
        rms_yaw_rad=np.sqrt(np.mean((after["theta_hat_rad"] - after["theta_rad"]) ** 2)),
        kkt_rhe_median=after["kkt_rhe"].median(skipna=False),
        kkt_rhc_median=after["kkt_rhc"].median(),
        solver_ok=True,
    )
    assert {name: got[name] for name in expected} == pytest.approx(expected, nan_ok=True)


@pytest.mark.parametrize("straight_m", [2.4, 2.6, 2.8, 3.0])
def test_arrived_is_who_stays_for_five_seconds(straight_m):
    """Between kinks no robot can follow, some straights are just too short for that, and some are
    not.
    """
    kinks = rhec.Path.from_segments(
        [(straight_m, 0.0), (0.5, 0.8), (straight_m, 0.0), (0.5, -0.8)] * 12 + [(60.0, 0.0)]
    )
    with no_compiler():
        run = simulated(estimator="oracle", path=kinks, start_offset_m=0.5)
    inside = (run.log["error_true_m"] < 0.12).to_numpy()
    stays = [k for k in range(len(inside) - 24) if inside[k : k + 25].all()]
    assert run.metrics["settling_time_s"] == pytest.approx(0.2 * stays[0])


def test_a_robot_that_never_arrives_is_judged_on_its_whole_run():
    with no_compiler():
        run = simulated(start_offset_m=-30.0)
    assert np.isnan(run.metrics["settling_time_s"]) and run.metrics[
        "mean_error_m"
    ] == pytest.approx(run.log["error_m"].mean())


# What the loop does


@pytest.mark.parametrize("estimator", ["rhe", "ekf", "oracle", "traction_oracle"])
def test_it_follows_the_path(estimator):
    got = simulated(estimator=estimator, duration_s=240.0).metrics
    assert got["settling_time_s"] < 30 and got["mean_error_true_m"] < 0.08 and got["solver_ok"]


def test_backwards_it_follows_the_path_tail_first():
    run = simulated(backwards=True, duration_s=240.0)
    late = run.log[run.log["t_s"] > 40]
    assert late["error_true_m"].mean() < 0.06 and late["error_true_m"].max() < 0.3
    assert late["nu_mps"].max() < 0 and late["s_m"].iloc[-1] > 75
    heading = run.path.poses(late["s_m"])[0][:, 2] + np.pi
    assert np.all(np.cos(late["theta_rad"] - heading) > 0.9)


def test_a_delayed_command_is_the_one_before():
    """No noise, so what the tracks do follows from the commands alone."""
    names = "gnss_sigma_m encoder_sigma_mps speed_sigma_mps bump_sigma_radps".split()
    quiet = dict.fromkeys(names, 0.0) | dict(duration_s=2.0)
    prompt, late = simulated(**quiet).log, simulated(command_delay=1, **quiet).log
    assert prompt["omega_radps"][1] != 0
    assert late["omega_radps"][1] == 0 and late["omega_radps"][2] != 0
    assert late["omega_cmd_radps"][0] == prompt["omega_cmd_radps"][0] != 0


def test_other_choices_drive_too():
    """Each on the virtual machine, where they need no compiling."""
    with no_compiler():
        for changes in (
            dict(speed_model="input"),
            dict(arrival_mean="filtered"),
            dict(input_reference="curvature"),
            dict(prediction_horizon=8, estimation_horizon=10),
            dict(look_ahead_m=0.3),
            dict(gnss_slow_share=0.5),
        ):
            log = simulated(**changes).log
            assert log["ok"].all() and log["error_true_m"][200:].mean() < 0.1, changes


def test_soil_that_changes_at_once_costs_three_samples_at_each_edge_of_it():
    """The gate cannot tell it from outliers before the fourth sample: the window restarts there."""
    x_m, y_m, radius_m = 15.0, 0.0, 2.0
    with no_compiler():
        log = simulated(patches=((x_m, y_m, radius_m, 0.4, 0.4),)).log
    inside = np.hypot(log["x_m"] - x_m, log["y_m"] - y_m) < radius_m
    edges = np.flatnonzero(np.diff(inside.astype(int)))
    rejected = np.flatnonzero(log["ok"] != 1)
    after = rejected[:, None] - edges
    is_soon = (after >= 0) & (after <= 15)  # the window's length
    assert len(edges) == 2 and is_soon.any(axis=1).all() and (is_soon.sum(axis=0) <= 3).all()
    assert len(rejected) > 0 and log["restarted"].sum() <= 2
    assert log["error_true_m"][200:].mean() < 0.1


# Parts of one's own


def test_an_estimator_of_ones_own():
    """Ten lines: position and speed as measured, yaw by integration; what it is told is what it
    answers with.
    """
    with no_compiler():
        memory, z = ca.SX.sym("memory", 8), ca.SX.sym("z", 4)
        theta, count = memory[2] + 0.2 * 0.8 * z[3], memory[6]
        estimate = ca.vertcat(z[:2], theta, z[2], 0.9, 0.8)
        mine = ca.Function("mine", [memory, z], [ca.vertcat(estimate, count + 1, 0), estimate])
        log = simulated(estimator=mine, guess_yaw_rad=0.1).log
    np.testing.assert_array_equal(log["x_hat_m"], log["x_meas_m"])
    np.testing.assert_allclose(
        log["theta_hat_rad"], 0.1 + 0.16 * np.cumsum(log["omega_meas_radps"]), atol=1e-9
    )
    assert np.all(log["kappa_hat"] == 0.8) and log["kkt_rhe"].isna().all() and log["ok"].all()
    assert log["error_true_m"][100:].mean() < 0.4


def test_terrain_and_path_of_ones_own():
    with no_compiler():
        soil, target = (
            rhec.Terrain.uniform(0.7, 0.6),
            rhec.Path.from_segments([(20.0, 0.0), (20.0, -0.05)], start=(3.0, -2.0, 2.0)),
        )
        run = simulated(terrain=soil, path=target, start_offset_m=-0.3)
    assert run.terrain is soil and run.path is target
    np.testing.assert_allclose(run.log[["mu", "kappa"]], [[0.7, 0.6]] * 300, atol=1e-12)
    first = run.log.iloc[0]
    assert (first["x_m"], first["y_m"], first["theta_rad"]) == pytest.approx(
        (3 + 0.3 * np.sin(2), -2 - 0.3 * np.cos(2), 2)
    )
    assert run.log["error_true_m"][150:250].mean() < 0.05


def test_the_oracles_know_what_they_say():
    log = simulated(estimator="oracle").log
    for hat, true in (
        ("x_hat_m", "x_m"),
        ("theta_hat_rad", "theta_rad"),
        ("nu_hat_mps", "nu_mps"),
        ("kappa_hat", "kappa"),
    ):
        np.testing.assert_array_equal(log[hat], log[true])
    log = simulated(estimator="traction_oracle").log
    np.testing.assert_array_equal(log[["mu_hat", "kappa_hat"]], log[["mu", "kappa"]])
    assert np.all(simulated(estimator="ekf").log[["mu_hat", "kappa_hat"]] == 1)


def test_an_open_path_is_followed_from_its_first_sample_whatever_the_noise():
    path = rhec.Path.from_segments([(15.0, 0.0), (12.0, 0.1), (15.0, 0.0)])
    for seed in range(5):
        run = simulated(path=path, seed=seed)
        assert run.log["s_m"].between(-0.2, path.length_m).all()
        assert run.metrics["mean_error_true_m"] < 0.12


# What a run shows of itself


def test_a_run_says_in_five_lines_what_it_was():
    run = rhec.simulate(rhec.Scenario(process_noise="likelihood", duration_s=60.0))
    lines = repr(run).splitlines()
    assert len(lines) <= 5 and max(map(len, lines)) <= 200
    assert repr(run.scenario) in lines[0]
    assert f"{run.metrics['mean_error_m']:.4f}" in repr(run)
    assert "every QP was solved" in lines[-1]


def test_a_run_says_whether_and_when_the_robot_left_its_row():
    """It leaves it where its positions jump."""
    calm = simulated(estimator="oracle", start_offset_m=0.0, duration_s=20.0)
    assert "the robot stayed in its row: 0 violations" in repr(calm)
    jump = rhec.Fault(kind="jump", size_m=1.0, start_s=20.0, duration_s=20.0)
    run = simulated(estimator="ekf", start_offset_m=0.0, faults=(jump,), duration_s=60.0)
    log = run.log[25 + round(run.metrics["settling_time_s"] / 0.2) :]
    outside = log["t_s"][(log["error_true_m"] > 0.12) & log["on_straight"]]
    assert len(outside) == run.metrics["violations_true"] > 0
    assert f"first at {outside.iloc[0]:.1f} s: {len(outside)} violations" in repr(run)
    assert "never came to stay in its row" in repr(simulated(start_offset_m=-9.0, duration_s=8.0))


def test_in_a_notebook_a_run_is_a_table_of_its_metrics_and_the_picture_of_plot(run, monkeypatch):
    drawn = []
    plot = rhec.Run.plot
    monkeypatch.setattr(rhec.Run, "plot", lambda self: drawn.append(plot(self)) or drawn[-1])
    page = run._repr_html_()
    assert len(drawn) == page.count("<img ") == 1 and "http" not in page
    table = run.metrics._repr_html_()
    assert table in page and all(f"<td>{name}</td>" in table for name in run.metrics)
    assert f"<td>mean_error_m</td><td>{run.metrics['mean_error_m']:.4g}</td><td>m</td>" in table


@pytest.mark.parametrize("estimator", ["rhe", "ekf"])
def test_the_picture_of_a_run_has_path_errors_and_traction(estimator):
    run = simulated(estimator=estimator, duration_s=20.0)
    figure = run.plot()
    assert [axes.get_ylabel() for axes in figure.axes] == ["y [m]", "error [m]", "μ [-]", "κ [-]"]
    robot_line = figure.axes[0].get_lines()[1]
    np.testing.assert_array_equal(robot_line.get_xdata(), run.columns["x_m"])
    # Two standard deviations, where the estimator has them for the traction.
    assert len(figure.axes[3].collections) == (1 if estimator == "rhe" else 0)
    # Most of the height of the axes is for what the traction does.
    for axes, name in zip(figure.axes[2:], ("mu", "kappa")):
        low, high = axes.get_ylim()
        both = np.concatenate([run.columns[name], run.columns[f"{name}_hat"]])
        assert low < np.median(both) < high and high - low < 1.2 * np.ptp(both) + 0.05


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
@pytest.mark.parametrize("name", ["x_meas_m", "y_meas_m"])
def test_half_a_position_has_no_distance_to_the_path(name, value):
    columns = {each: np.zeros(3) for each in ("t_s", "x_meas_m", "y_meas_m", "x_m", "y_m")}
    columns[name][1] = value
    closed_loop._add_errors(rhec.Path.racetrack(30.0, 8.0), [columns])
    np.testing.assert_array_equal(columns["error_m"], [0, np.nan, 0])
    np.testing.assert_array_equal(columns["error_true_m"], np.zeros(3))
