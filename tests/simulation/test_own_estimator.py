"""An estimator of one's own, `rhec.Estimator`: what it may take and return, and what it is."""

import dataclasses
import pickle

import casadi as ca
import numpy as np
import pytest
from helpers import no_compiler
from own_steps import PLAIN, dead_reckoning, filter_of_yaw_rates, step_of

import rhec
from rhec.simulation.offline import run_estimator
from rhec.style import colour_of, label_of

SHORT = rhec.Scenario(duration_s=10.0)


def test_its_memory_begins_with_the_first_guess_and_then_with_its_numbers():
    """The numbers are κ here, in two loops of the same code; the scenario's V says what μ is."""
    memory, z, V = ca.SX.sym("memory", 8), ca.SX.sym("z", 4), ca.SX.sym("V", 4)
    estimate = ca.vertcat(memory[:4], ca.sqrt(V[3]), memory[6])
    names = ["memory", "z", "V"], ["next", "estimate"]
    step = ca.Function("shows", [memory, z, V], [memory, estimate], *names)
    start = rhec.simulate(SHORT).columns
    for own, kappa in ((rhec.Estimator(step), 0.0), (rhec.Estimator(step, (0.7,)), 0.7)):
        fields = dict(sigma_v=(0.5, 0.5, 0.1, 0.25), guess_yaw_rad=0.25)
        scenario = dataclasses.replace(SHORT, estimator=own, **fields)
        with no_compiler():
            log = rhec.simulate(scenario).columns
        assert log["kappa_hat"][-1] == kappa and set(log["mu_hat"]) == {0.25}
        for name, off in (("x{}_m", 0), ("y{}_m", 0), ("theta{}_rad", 0.25)):
            assert log[name.format("_hat")][-1] == start[name.format("")][0] + off


def test_its_looks_change_no_run():
    """A bare Function is an estimator as well."""
    function = step_of(*PLAIN)
    plain = dataclasses.replace(SHORT, estimator=function).estimator
    named = rhec.Estimator(function, label="UKF", colour="#123456")
    assert named == plain and label_of(plain) == "mine" and label_of(named) == "UKF"
    assert colour_of(pickle.loads(pickle.dumps(named))) == "#123456" != colour_of(plain)
    assert colour_of("rhe") == colour_of("RHE") != colour_of("ekf")


def first_of(value):
    return ca.Function("first", [ca.SX.sym("guess", 6)], [ca.DM([value] * 7)], ["guess"], ["m"])


def test_each_argument_but_its_looks_tells_it_from_others_in_any_process():
    shapes = (
        dict(memory=(7, 1), z=(5, 1), W=(1, 1)),
        dict(memory=(7, 1), estimate=(6, 1), covariance=(1, 1)),
    )
    own = rhec.Estimator(step_of(*shapes), states=("yaw",), sensors=("gyro",))
    changes = [
        dict(step=step_of(*shapes, name="other")),
        dict(memory=(0.5,)),
        dict(first=first_of(0.0)),
        dict(first=first_of(1.0)),
        dict(states=("rate",)),
        dict(noises=dict(prediction=((0.5,), None))),
        dict(sensors=("heading",)),
    ]
    changed = {name for change in changes for name in change}
    fields = {field.name for field in dataclasses.fields(rhec.Estimator)}
    assert changed == fields - {"label", "colour"}
    every = [own, *(dataclasses.replace(own, **change) for change in changes)]
    assert len({*every}) == len(every)
    assert [pickle.loads(pickle.dumps(each)) for each in every] == every


# W, what it is told, and a first memory of its own


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


# Sensors, and what figures call it

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
    fields = dict(estimator=own, sensors=("gyro",), duration_s=20.0, **EXACT_GYRO)
    run = rhec.simulate(rhec.Scenario(**fields))
    estimates = rhec.replay(run.log, estimator=own, first_yaw_rad=0.0)
    np.testing.assert_allclose(estimates["theta_hat_rad"], run.log["theta_rad"], atol=1e-9)
    with pytest.raises(ValueError, match=r"^sensors was \('gyro',\); the log has no numbers in"):
        rhec.replay(run.log.drop(columns="gyro_meas_radps"), estimator=own)
