"""A controller of one's own in the closed loop."""

import dataclasses
import json
import pickle

import casadi as ca
import numpy as np
import pandas as pd
import pytest
from helpers import own_controller

import rhec
from notebooks.rivals import RIVALS
from rhec import paper, style

PLAIN = rhec.Scenario(estimator="ekf", process_noise="prediction", duration_s=20.0)
OWN = dataclasses.replace(PLAIN, controller=own_controller(PLAIN))
NAMED = {"allow_duplicate_io_names": True}


# In the loop


def test_ten_lines_steer_the_robot_to_its_path():
    log = rhec.simulate(dataclasses.replace(OWN, duration_s=40.0)).log
    assert log["ok"].all() and (log["kkt_rhc"] == 0).all()
    assert log["error_true_m"][150:].mean() < paper.TOLERANCE_M
    assert log["omega_cmd_radps"].abs().max() <= 1.5 * paper.OMEGA_MAX_RADPS


def test_it_is_told_what_is_promised_and_remembers():
    """A step that checks its inputs against the settings, and counts the samples."""
    names = "memory s_0 x_ref u_ref lower upper Q QN R s_m covariance segments period_m speed_mps"
    shapes = [1, 6, (3, 16), (1, 15), 1, 1, 3, 3, 1, 1, (4, 4), (5, 4), 1, 1, 1]
    names = [*names.split(), "disturbance"]
    given = {name: ca.SX.sym(name, *np.atleast_1d(size)) for name, size in zip(names, shapes)}
    path = rhec.Path.rows(PLAIN.row_length_m, PLAIN.headland_radius_m, turns="left")
    expected = dict(lower=-0.1, upper=0.1, Q=PLAIN.q, QN=10 * np.array(PLAIN.q), R=PLAIN.r)
    expected |= dict(segments=path.segments.T, period_m=path.length_m, speed_mps=-0.5)
    wrong = sum(ca.sumsqr(given[name] - ca.DM(value)) for name, value in expected.items())
    wrong += given["disturbance"] ** 2 + (given["covariance"][0, 0] <= 0)
    # The path's closest point is near the estimate, and the first desired one is that point.
    wrong += (ca.norm_2(given["x_ref"][:2, 0] - given["s_0"][:2]) > 1.5) + (given["s_m"] < -1)
    results = dict(command=0, memory=given["memory"] + 1, kkt=given["memory"])
    results |= dict(ok=ca.logic_and(wrong < 1e-20, given["memory"] < 100))
    step = ca.Function("told", [*given.values()], [*results.values()], names, [*results], NAMED)
    controller = rhec.Controller(step, (5,))
    own = dataclasses.replace(PLAIN, turns="left", backwards=True, controller=controller)
    log = rhec.simulate(own).log
    np.testing.assert_array_equal(log["ok"], np.arange(100) < 95)
    np.testing.assert_array_equal(log["kkt_rhc"], 5 + np.arange(100))
    assert (log["omega_cmd_radps"] == 0).all()


def test_it_may_choose_the_speed():
    speed = ca.SX.sym("speed_mps")
    step = ca.Function(
        "slow", [speed], [0, speed / 2], ["speed_mps"], ["command", "speed_mps"], NAMED
    )
    log = rhec.simulate(dataclasses.replace(PLAIN, controller=rhec.Controller(step))).log
    assert log["nu_mps"].iloc[-1] == pytest.approx(PLAIN.speed_mps / 2, abs=0.03)


def test_the_loop_cancels_the_yaw_drift_for_a_step_that_does_not_take_it():
    """The same law, which takes d off itself, has the same bits; one that ignores d has not."""
    given = {name: ca.SX.sym(name) for name in ("lower", "upper", "disturbance")}
    d = given["disturbance"]
    laws = dict(plain=given["upper"] / 2, cancels=(given["upper"] + d) / 2 - d, ignores=0 * d)
    runs = {}
    for name, command in laws.items():
        taken = {key: each for key, each in given.items() if name != "plain" or key == "upper"}
        step = ca.Function(name, [*taken.values()], [command], [*taken], ["command"])
        drifting = dict(estimator=RIVALS["yaw_drift_ekf"], controller=rhec.Controller(step))
        runs[name] = rhec.simulate(dataclasses.replace(PLAIN, **drifting)).log
    pd.testing.assert_frame_equal(runs["plain"], runs["cancels"])
    assert runs["plain"]["omega_cmd_radps"].nunique() > 50
    assert (runs["ignores"]["omega_cmd_radps"] == 0).all()


# As a value


def test_it_is_a_value_of_its_text_and_memory():
    same, other = own_controller(PLAIN), own_controller(PLAIN, gain=2.0)
    for made in (same, pickle.loads(pickle.dumps(same))):
        assert made == OWN.controller and hash(made) == hash(OWN.controller)
    assert other != OWN.controller != rhec.Controller(OWN.controller.step, (1.0,))
    assert OWN != PLAIN and OWN.controller != "rhc"
    assert repr(OWN.controller) == "Controller('steer', memory of 1)"
    assert "controller=controller" in repr(OWN)
    assert "steer" in json.loads(style._as_json(OWN))["controller"]["step"]
