"""What runs, campaigns, faults, and estimators and controllers of one's own refuse: one sentence
that begins with the parameter and what it was. A Scenario's own fields are in test_scenario.
"""

import dataclasses

import casadi as ca
import numpy as np
import pytest
from helpers import assert_refused
from own_steps import PLAIN, dead_reckoning, filter_of_yaw_rates, largest_error_m, step_of

import rhec

SHORT = rhec.Scenario(estimator="ekf", duration_s=6.0)
IN, OUT = PLAIN
COMMAND = dict(command=(1, 1))
LINE = rhec.Path.from_segments([(9.0, 0.0)])


class Constant(ca.Callback):
    """A Function in Python."""

    def __init__(self):
        super().__init__()
        self.construct("constant")

    def eval(self, arguments):
        return [0.1]


def step_in_python():
    constant, upper = Constant(), ca.MX.sym("upper")
    return ca.Function("own", [upper], [constant(upper)], ["upper"], ["command"])


def scenario_with(shapes, **fields):
    """A Scenario whose controller asks for inputs of these shapes."""
    controller = rhec.Controller(step_of(shapes, COMMAND))
    return dataclasses.replace(SHORT, controller=controller, **fields)


def first_of(rows):
    return ca.Function("f", [ca.SX.sym("guess", 6)], [ca.SX(rows, 1)], ["guess"], ["memory"])


SCENARIO = "; it should be a rhec.Scenario"
FINITE = "; it should be a sequence of finite numbers"
TABLES = dict(a=largest_error_m)
SIMULATIONS = [
    (("rhe",), f"scenario was 'rhe'{SCENARIO}"),
    (([SHORT, 3],), f"scenario[1] was 3{SCENARIO}"),
]
CAMPAIGNS = [
    (dict(scenarios=SHORT), "scenarios was rhec.Scenario(…; it should be a list of rhec.Scenario"),
    (dict(scenarios="rhe"), "scenarios was 'rhe'; it should be a list of rhec.Scenario"),
    (dict(workers=0), "workers was 0; "),
    (dict(workers="2"), "workers was '2'; "),
    (dict(folder=__file__), f"folder was {__file__!r}"),
    (dict(readings=largest_error_m), "readings was <function largest_error_m"),
    (dict(readings=dict(a=1)), "readings was {'a': 1}; it should be a dict of names to"),
    (dict(readings=dict(seed=largest_error_m)), "a name in readings was 'seed'; the table has"),
    (dict(readings=dict(rms_mu=largest_error_m)), "a name in readings was 'rms_mu'; the table"),
    (dict(readings=TABLES, folder="rows"), "folder was 'rows'; with readings"),
]
FAULTS = [
    (dict(kind="broken"), "kind was 'broken'; "),
    (dict(kind="missing", channel="left"), "channel was 'left'; for the kind 'missing' it should"),
    (dict(kind="dead"), "channel was 'gnss'; for the kind 'dead'"),
    (dict(kind="outliers", channel="all", size_m=1.0), "channel was 'all'; "),
    (dict(kind="jump"), "size_m was None; for the kind 'jump' it should be given"),
    (dict(kind="latency", delay_s=1.1), "delay_s was 1.1; "),
    (dict(kind="stuck", size_m=1.0), "size_m was 1.0; for the kind 'stuck' it should be None"),
    (dict(kind="rate", rate_hz=0), "rate_hz was 0; "),
    (dict(kind="missing", duration_s=-1), "duration_s was -1; "),
]
CONTROLLERS = [
    (("steer",), "step was 'steer'; it should be a CasADi Function"),
    ((step_in_python(),), "step was …; it should be made of what CasADi can store"),
    ((step_of({}, COMMAND), 1.0), f"memory was 1.0{FINITE}"),
    ((step_of({}, COMMAND), (np.nan,)), f"memory was (nan,){FINITE}"),
    ((step_of({}, COMMAND), ("a",)), f"memory was ('a',){FINITE}"),
    ((step_of({}, {}),), "step has no result 'command'; it should have one"),
    ((step_of({}, dict(command=(2, 1))),), "step has the result 'command' of shape (2, 1); "),
    ((step_of({}, COMMAND), (0.0, 0.0)), "step has no input 'memory'; for a first memory of 2 "),
    (
        (step_of(dict(memory=(2, 1)), COMMAND), (0.0, 0.0)),
        "step has no result 'memory'; for a first memory of 2 numbers it should have one",
    ),
    (
        (step_of(dict(memory=(2, 1)), COMMAND | dict(memory=(1, 2))), (0.0, 0.0)),
        "step has the result 'memory' of shape (1, 2); it should have (2, 1)",
    ),
]
ESTIMATORS = [
    ((dict(memory=(6, 1)), OUT), "step had 1 inputs and 2 results; it should have"),
    ((IN, dict(memory=(6, 1))), "step had 2 inputs and 1 results; it should have"),
    ((IN | dict(wind=(1, 1)), OUT), "step has the input 'wind'; it should be one of"),
    ((IN, OUT | dict(p=(1, 1))), "step has the result 'p'; it should be one of"),
    ((IN, OUT | dict(estimate=(2, 1))), "step has the result 'estimate' of shape"),
    ((IN, OUT | dict(memory=(7, 1))), "step has the result 'memory' of shape"),
    ((IN | dict(z=(5, 1)), OUT), "step has the input 'z_N' of shape (5, 1)"),
]
OPTIONS = [
    (dict(memory=(1.0,)), "memory had 1 numbers; behind the first guess the memory of step has"),
    (dict(sensors=("lidar",)), "sensors was ('lidar',); it should name some of ('gyro', "),
    (dict(sensors=("gyro", "gyro")), "sensors was ('gyro', 'gyro'); it should name some of"),
    (dict(sensors=("gyro",)), "step has the input 'z_N' of shape (4, 1); it should have (5, 1)"),
    (dict(label=1), "label was 1; it should be text"),
    (dict(colour="blue"), "colour was 'blue'; it should be text such as '#009E73', or None"),
]
WITH_W = [
    (dict(states=("x", "y")), "states was ('x', 'y'); … should have 1 names"),
    (
        dict(noises=dict(printed=((0.1, 0.2), None))),
        "sigma_w of 'printed' was …; it should have 1 entries",
    ),
    (dict(memory=(), first=first_of(2)), "first returned"),
]
SHAPES = [
    ("s_0", (3, 1), (6, 1), {}),
    ("x_ref", (3, 16), (3, 11), dict(prediction_horizon=10)),
    ("covariance", (6, 6), (4, 4), {}),
    ("covariance", (6, 6), (2, 2), dict(estimator=step_of(IN, OUT | dict(covariance=(2, 2))))),
    ("segments", (5, 4), (5, 1), dict(path=LINE)),
]
INPUTS = [
    (({name: shape}, fields), f"step has the input {name!r} of shape {shape}; it should have {fit}")
    for name, shape, fit, fields in SHAPES
]
BROUGHT = filter_of_yaw_rates(noises=dict(prediction=((0.1,), None)))
SCENARIOS = [
    (
        dict(estimator=filter_of_yaw_rates()),
        "sigma_w was None for the estimator … should have 1 entr",
    ),
    (dict(estimator=BROUGHT, process_noise="tracking"), "process_noise was 'tracking'; for the "),
]
SCENARIOS += [
    (
        dict(estimator=dead_reckoning(), sensors=sensors),
        f"sensors was {sensors!r}; … should be ('gyro',)",
    )
    for sensors in ((), ("heading",), ("gyro", "heading"))
]
MADE = {
    "simulate": (rhec.simulate, SIMULATIONS),
    "campaign": (lambda **bad: rhec.campaign(**dict(scenarios=[]) | bad), CAMPAIGNS),
    "Fault": (rhec.Fault, FAULTS),
    "Controller": (rhec.Controller, CONTROLLERS),
    "Controller in a Scenario": (lambda shapes, of: scenario_with(shapes, **of), INPUTS),
    "Estimator": (lambda *shapes: rhec.Estimator(step_of(*shapes)), ESTIMATORS),
    "Estimator's options": (lambda **bad: rhec.Estimator(step_of(*PLAIN), **bad), OPTIONS),
    "Estimator with W": (lambda **bad: dataclasses.replace(BROUGHT, **bad), WITH_W),
    "Estimator in a Scenario": (rhec.Scenario, SCENARIOS),
}


@pytest.mark.parametrize("what", MADE)
def test_a_bad_argument_is_refused_in_one_sentence(what):
    assert_refused(*MADE[what])
