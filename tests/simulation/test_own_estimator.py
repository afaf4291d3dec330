"""An estimator of one's own, `rhec.Estimator`: what it may take and return, and what it is."""

import dataclasses
import pickle

import casadi as ca
import numpy as np
import pytest
from helpers import no_compiler

import rhec
from rhec.simulation.offline import run_estimator
from rhec.style import colour_of, label_of

SHORT = rhec.Scenario(duration_s=10.0)
ONE = (1, 1)
NAMED = {"allow_duplicate_io_names": True}


def step_of(inputs, results, name="mine"):
    """A Function with inputs and results of these shapes, the latter all zeros."""
    inputs = {key: ca.SX.sym(key, *shape) for key, shape in inputs.items()}
    results = {key: ca.SX(ca.DM.zeros(*shape)) for key, shape in results.items()}
    names = [*inputs], [*results], {"allow_duplicate_io_names": True}
    return ca.Function(name, [*inputs.values()], [*results.values()], *names)


PLAIN = dict(memory=(6, 1), z=(4, 1)), dict(memory=(6, 1), estimate=(6, 1))


def all_knowing():
    """An oracle in one line."""
    memory, z, truth = (ca.SX.sym(*of) for of in (("m", 6), ("z", 4), ("truth", 6)))
    names = ["m", "z", "truth"], ["next_m", "hat"], {"allow_duplicate_io_names": True}
    return ca.Function("knows", [memory, z, truth], [truth, truth], *names)


def test_one_that_is_told_the_truth_drives_as_the_oracle():
    with no_compiler():
        own = rhec.simulate(dataclasses.replace(SHORT, estimator=rhec.Estimator(all_knowing())))
        oracle = rhec.simulate(dataclasses.replace(SHORT, estimator="oracle"))
    for name in ("x_m", "theta_rad", "x_hat_m", "kappa_hat", "omega_cmd_radps"):
        np.testing.assert_array_equal(own.columns[name], oracle.columns[name])


def test_a_bare_function_is_an_estimator():
    function = all_knowing()
    scenario = dataclasses.replace(SHORT, estimator=function)
    assert scenario.estimator == rhec.Estimator(function)
    assert scenario == dataclasses.replace(SHORT, estimator=rhec.Estimator(all_knowing()))


def test_its_memory_begins_with_the_first_guess_and_then_with_its_numbers():
    """The numbers are κ here, in two loops of the same code."""
    memory, z = ca.SX.sym("memory", 8), ca.SX.sym("z", 4)
    estimate = ca.vertcat(memory[:5], memory[6])
    step = ca.Function("shows", [memory, z], [memory, estimate])
    with no_compiler():
        logs = [
            rhec.simulate(dataclasses.replace(SHORT, estimator=each)).columns
            for each in (rhec.Estimator(step), rhec.Estimator(step, (0.7,)), step)
        ]
    assert [log["kappa_hat"][-1] for log in logs] == [0.0, 0.7, 0.0]
    start = rhec.simulate(SHORT).columns
    for hat, true in (("x_hat_m", "x_m"), ("y_hat_m", "y_m"), ("theta_hat_rad", "theta_rad")):
        assert logs[0][hat][-1] == start[true][0]


def test_it_is_told_the_noise_that_the_scenario_assumes():
    memory, z, V = ca.SX.sym("memory", 6), ca.SX.sym("z", 4), ca.SX.sym("V", 4)
    estimate = ca.vertcat(z[:2], memory[2], z[2], ca.sqrt(V[0]), ca.sqrt(V[3]))
    names = ["memory", "z", "V"], ["memory", "estimate"], {"allow_duplicate_io_names": True}
    own = rhec.Estimator(ca.Function("told", [memory, z, V], [estimate, estimate], *names))
    with no_compiler():
        scenario = dataclasses.replace(SHORT, estimator=own, sigma_v=(0.5, 0.5, 0.1, 0.25))
        log = rhec.simulate(scenario).columns
    assert set(log["mu_hat"]) == {0.5} and set(log["kappa_hat"]) == {0.25}


def test_a_controller_of_ones_own_takes_its_covariance():
    results = PLAIN[1] | dict(covariance=(2, 2))
    own = rhec.Estimator(step_of(PLAIN[0], results))
    fits, fits_not = (
        rhec.Controller(step_of(dict(covariance=shape), dict(command=ONE), "steer"))
        for shape in ((2, 2), (6, 6))
    )
    dataclasses.replace(SHORT, estimator=own, controller=fits)
    with pytest.raises(ValueError, match=r"^step has the input 'covariance' of shape \(6, 6\)"):
        dataclasses.replace(SHORT, estimator=own, controller=fits_not)


def test_equal_estimators_are_equal_in_any_process():
    own, same = rhec.Estimator(all_knowing()), rhec.Estimator(all_knowing())
    other = rhec.Estimator(step_of(*PLAIN))
    again = pickle.loads(pickle.dumps(own))
    assert own == same == again and hash(own) == hash(again) and own.key == again.key
    assert own != other and own != "oracle" and len({own, same, again, other}) == 2
    assert pickle.loads(pickle.dumps(again)).key == own.key
    assert repr(own) == "Estimator('knows', memory of 0)"


@pytest.mark.parametrize(
    ("inputs", "results", "memory", "sentence"),
    [
        (dict(memory=(6, 1)), PLAIN[1], (), "step had 1 inputs and 2 results; it should have"),
        (PLAIN[0], dict(memory=(6, 1)), (), "step had 2 inputs and 1 results; it should have"),
        (PLAIN[0] | dict(wind=ONE), PLAIN[1], (), "step has the input 'wind'; it should be one of"),
        (PLAIN[0], PLAIN[1] | dict(p=ONE), (), "step has the result 'p'; it should be one of"),
        (PLAIN[0], PLAIN[1] | dict(estimate=(2, 1)), (), "step has the result 'estimate' of shape"),
        (PLAIN[0], PLAIN[1] | dict(memory=(7, 1)), (), "step has the result 'memory' of shape"),
        (PLAIN[0] | dict(z=(5, 1)), PLAIN[1], (), "step has the input 'z_N' of shape (5, 1)"),
        (*PLAIN, (1.0,), "memory had 1 numbers; behind the first guess the memory of step has"),
        (*PLAIN, ("a",), "memory was ('a',); it should be a sequence of finite numbers"),
        (*PLAIN, (np.nan,), "memory was (nan,); it should be a sequence of finite numbers"),
    ],
)
def test_what_is_no_estimator_is_refused_in_one_sentence(inputs, results, memory, sentence):
    with pytest.raises(ValueError) as refused:
        rhec.Estimator(step_of(inputs, results), memory)
    assert str(refused.value).startswith(sentence) and "\n" not in str(refused.value)


# W, what it is told, and a first memory of its own


def filter_of_yaw_rates(**options):
    """An estimator with W and one state: it takes the position as measured."""
    names = dict(memory=1, z_N=4, V=4, W=1, mean_traction=2)
    given = {name: ca.SX.sym(name, size) for name, size in names.items()}
    variance = given["memory"] + given["W"]
    estimate = ca.vertcat(given["z_N"][:2], 0, given["z_N"][2], given["mean_traction"])
    results = dict(memory=variance, estimate=estimate, covariance=variance)
    step = ca.Function(
        "with_w", [*given.values()], [*results.values()], [*given], [*results], NAMED
    )
    first = ca.Function("first", [ca.SX.sym("guess", 6)], [0], ["guess"], ["memory"])
    return rhec.Estimator(step, first=first, states=("yaw",), **options)


def test_its_w_is_the_scenarios_or_that_of_a_rule_that_it_brings():
    own = filter_of_yaw_rates(noises=dict(prediction=((0.1,), None), printed=((0.3,), None)))
    for fields, sigma in (
        ({}, 0.1),
        (dict(process_noise="printed"), 0.3),
        (dict(sigma_w=(2.0,)), 2.0),
    ):
        run = rhec.simulate(dataclasses.replace(SHORT, estimator=own, **fields))
        variances = run_estimator(run.scenario, run, "covariance")["covariance"]
        np.testing.assert_allclose(variances.ravel()[:3], sigma**2 * np.array([1, 2, 3]))
        np.testing.assert_allclose(
            run.log[["mu_hat", "kappa_hat"]], [run.terrain.mean] * len(run.log)
        )
    assert pickle.loads(pickle.dumps(own)) == own != filter_of_yaw_rates()


def test_a_w_that_nobody_gives_is_asked_for():
    with pytest.raises(
        ValueError, match="^sigma_w was None for the estimator .*should have 1 entr"
    ):
        rhec.Scenario(estimator=filter_of_yaw_rates())
    with pytest.raises(ValueError, match="^process_noise was 'tracking'; for the estimator"):
        own = filter_of_yaw_rates(noises=dict(prediction=((0.1,), None)))
        rhec.Scenario(estimator=own, process_noise="tracking")


def test_what_it_brings_has_to_fit():
    with pytest.raises(ValueError, match="^states was .*it should have 1 names"):
        dataclasses.replace(filter_of_yaw_rates(), states=("x", "y"))
    with pytest.raises(ValueError, match="^sigma_w of 'printed' was .*it should have 1 entries"):
        filter_of_yaw_rates(noises=dict(printed=((0.1, 0.2), None)))
    with pytest.raises(ValueError, match="^first returned"):
        dataclasses.replace(
            filter_of_yaw_rates(),
            memory=(),
            first=ca.Function("f", [ca.SX.sym("guess", 6)], [ca.SX(2, 1)], ["guess"], ["memory"]),
        )


# Sensors, and what figures call it


def dead_reckoning(sensors=("gyro",), **options):
    """An estimator with a state for the yaw, which turns by the gyro, and takes all else."""
    n_z = 4 + len(sensors)
    names = dict(memory=6, z=n_z, V=n_z)
    given = {name: ca.SX.sym(name, size) for name, size in names.items()}
    z, V = given["z"], given["V"]
    yaw = given["memory"][2] + 0.2 * z[4]
    estimate = ca.vertcat(z[:2], yaw, z[2], ca.sqrt(V[4]), 1)
    results = dict(memory=estimate, estimate=estimate)
    step = ca.Function(
        "by_gyro", [*given.values()], [*results.values()], [*given], [*results], NAMED
    )
    return rhec.Estimator(step, sensors=sensors, **options)


EXACT_GYRO = dict(gyro_sigma_radps=0.0, gyro_bias_radps=0.0, gyro_scale=1.0)


def test_it_reads_the_sensors_that_it_names():
    """An exact gyro's mean rates add up to the yaw; a heading stands behind it in z."""
    for sensors in (("gyro",), ("heading", "gyro")):
        fields = dict(sensors=sensors, sigma_gyro=(0.125, 0.0), **EXACT_GYRO)
        with no_compiler():
            run = rhec.simulate(
                dataclasses.replace(SHORT, estimator=dead_reckoning(sensors), **fields)
            )
        np.testing.assert_allclose(run.columns["theta_hat_rad"], run.columns["theta_rad"])
        assert set(run.columns["mu_hat"]) == {0.125}


def test_it_replays_a_log_with_its_sensors_and_no_other():
    own = dead_reckoning()
    fields = dict(estimator=own, sensors=("gyro",), duration_s=60.0, **EXACT_GYRO)
    run = rhec.simulate(rhec.Scenario(**fields))
    estimates = rhec.replay(run.log, estimator=own, first_yaw_rad=0.0)
    np.testing.assert_allclose(estimates["theta_hat_rad"], run.log["theta_rad"], atol=1e-9)
    with pytest.raises(ValueError, match=r"^sensors was \('gyro',\); the log has no numbers in"):
        rhec.replay(run.log.drop(columns="gyro_meas_radps"), estimator=own)


@pytest.mark.parametrize("sensors", [(), ("heading",), ("gyro", "heading")])
def test_a_robot_with_other_sensors_is_refused(sensors):
    with pytest.raises(ValueError) as refused:
        rhec.Scenario(estimator=dead_reckoning(), sensors=sensors)
    assert str(refused.value).startswith(f"sensors was {sensors!r}; for the estimator Estimator(")
    assert str(refused.value).endswith("it should be ('gyro',)")


@pytest.mark.parametrize(
    ("options", "sentence"),
    [
        (dict(sensors=("lidar",)), "sensors was ('lidar',); it should name some of ('gyro', "),
        (dict(sensors=("gyro", "gyro")), "sensors was ('gyro', 'gyro'); it should name some of"),
        (dict(sensors=("gyro",)), "step has the input 'z_N' of shape (4, 1); it should have (5, 1"),
        (dict(label=1), "label was 1; it should be text"),
        (dict(colour="blue"), "colour was 'blue'; it should be text such as '#009E73', or None"),
    ],
)
def test_what_does_not_fit_is_refused_in_one_sentence(options, sentence):
    with pytest.raises(ValueError) as refused:
        rhec.Estimator(step_of(*PLAIN), **options)
    assert str(refused.value).startswith(sentence) and "\n" not in str(refused.value)


def test_label_and_colour_are_those_of_its_function_or_its_own_and_change_no_run():
    plain, named = (
        rhec.Estimator(step_of(*PLAIN), **options)
        for options in ({}, dict(label="UKF", colour="#123456"))
    )
    assert label_of(plain) == "mine" and colour_of(plain) == colour_of("mine")
    assert label_of(named) == "UKF" and colour_of(named) == "#123456" != colour_of("UKF")
    assert pickle.loads(pickle.dumps(named)).colour == named.colour
    assert plain == named
    assert colour_of("rhe") == colour_of("RHE") != colour_of("ekf")
