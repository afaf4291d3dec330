"""What Models, estimators and controllers refuse: one sentence that names the parameter, what it
was, and what it may be. How a Scenario refuses is in tests/simulation/test_scenario.py.
"""

import re

import casadi as ca
import numpy as np
import pytest
from helpers import controller, estimator, model
from oracles import mhe_instance, mpc_instance
from robots import CART, DT, SKID_STEERED, N

import rhec

pytestmark = pytest.mark.usefixtures("virtual_machine")
ROBOT = SKID_STEERED
BOUNDS = ROBOT.bounds
GUESS = (0.0,) * 5
STRAIGHT = mpc_instance(ROBOT, np.random.default_rng(15))


def refuses(where, call):
    with pytest.raises(ValueError) as refusal:
        call()
    sentence = str(refusal.value)
    assert "\n" not in sentence and len(sentence) < 400
    assert re.search(rf"\b({where})\b", sentence) and re.search("[;?,]", sentence), sentence
    assert re.search(r"\b(was|were|had|has) ", sentence), sentence


TIP = ("tip_m", "v_left_mps", "v_right_mps")


# Each with the names of which one has to be in the sentence.
MODELS = [
    ("states", dict(states=("x_m", "x_m", "theta_rad"))),
    ("states", dict(states=("x_m", 1, "theta_rad"))),
    ("states", dict(states=("x_m", "", "theta_rad"))),
    ("states", dict(states=())),
    ("states|inputs", dict(inputs=("x_m", "v_right_mps"))),
    ("outputs", dict(outputs=("x_m", "x_m", "v_left_mps", "v_right_mps"))),
    ("outputs|h", dict(outputs=("x_m", "z_m", "v_left_mps"))),
    ("parameters", dict(parameters=("slip_left", "slip_right"))),
    ("slip_left", dict(parameters={"slip_left": (1, 0), "slip_right": (0, 1)})),
    ("slip_left", dict(parameters={"slip_left": (0, np.nan), "slip_right": (0, 1)})),
    ("slip_left", dict(parameters={"slip_left": (ca.SX.sym("a"), 1.0), "slip_right": (0, 1)})),
    ("max_measurement", dict(max_measurement=5)),
    ("max_measurement", dict(max_measurement=(-1.0,) * 4)),
    ("motion_noise", dict(motion_noise=5)),
    ("sigma_held", dict(sigma_held=5)),
    ("sigma_held", dict(sigma_held={"x_m": 1.0})),
    ("sigma_held", dict(sigma_held={"v_left_mps": 0.0})),
    ("f", dict(f=3)),
    ("f", dict(f=lambda x, u, p: ca.vertcat(u[0], u[1]))),
    ("f", dict(f=lambda x, u, p: ca.vertcat(u[0], u[1], ca.SX.sym("other")))),
    ("f", dict(f=lambda x, u: x)),
    ("h", dict(outputs=TIP, h=lambda x, u, p: x[:2])),
    ("h", dict(outputs=TIP, h=lambda x, u, p: ca.SX.sym("other"))),
    ("h", dict(outputs=TIP, h=lambda x, u, p: np.nan * x[0])),
    ("steps", dict(steps=0)),
    ("steps", dict(steps=True)),
    ("steps", dict(steps=2.0)),
    ("rule", dict(rule="euler")),
    ("discrete", dict(discrete=1)),
    ("steps", dict(discrete=True, steps=2)),
    ("state_bounds", dict(state_bounds=5)),
    ("state_bounds", dict(state_bounds={"speed": (0, 1)})),
    ("x_m", dict(state_bounds={"x_m": (1, 0)})),
    ("x_m", dict(state_bounds={"x_m": None})),
]
ESTIMATORS = [
    ("sigma_v", dict(sigma_v=(0.1, 0.1))),
    ("sigma_v", dict(sigma_v=(0.1, 0.1, 0.1, 0.0))),
    ("sigma_w", dict(sigma_w=(0.1,) * 3)),
    ("sigma_w", dict(sigma_w=(0.1,) * 4 + (-0.1,))),
    ("guess", dict(guess=(0.0,) * 6)),
    ("guess", dict(guess=(0.0,) * 4 + (np.nan,))),
    ("sigma_guess", dict(sigma_guess=(0.1,) * 4)),
    ("sigma_guess", dict(sigma_guess=(-0.1,) * 5)),
    ("sigma_guess", dict(sigma_guess=(1e6, 1.0, 1.0, 1.0, 1.0))),
    ("dt", dict(dt=0.0)),
    ("model", dict(model="tracked")),
    ("outputs", dict(model=rhec.Model(**ROBOT.model | dict(outputs=(), h=None)), sigma_v=())),
]
HELD = "leave it out of `command`.*a large weight"  # what does the work of equal bounds
HARD, SOFT = dict(x_m=(-1, 1)), rhec.Bound(-1, 1, linear=1)
CONTROLLERS = [
    ("command", dict(command=("v_left_mps", "v_middle_mps"))),
    ("command", dict(command=("v_left_mps", "v_left_mps"))),
    ("command", dict(command=(), bounds={}, r=())),
    ("command", dict(command=("slip_left",))),
    ("bounds", dict(bounds=BOUNDS | {"v_middle_mps": (0, 1)})),
    ("bounds", dict(bounds=BOUNDS | {"v_left_mps": (1, -1)})),
    ("bounds", dict(bounds=BOUNDS | {"v_left_mps": "fast"})),
    ("bounds", dict(bounds=BOUNDS | {"v_left_mps": SOFT})),
    (HELD, dict(bounds=BOUNDS | {"x_m": (1.0, 1.0)})),
    (HELD, dict(terminal_bounds={"x_m": [0, 0]})),
    ("delta_bounds", dict(delta_bounds=dict(x_m=(-1, 1)))),
    ("terminal_bounds", dict(bounds=BOUNDS | HARD, terminal_bounds=dict(x_m=SOFT))),
    ("outputs", dict(outputs=("speed",))),
    ("outputs", dict(outputs=dict(speed=lambda x, u, p: x))),
    ("q", dict(q=(1.0, 1.0))),
    ("q", dict(q=(1.0, 1.0, -1.0))),
    ("q", dict(q=np.array([[1.0, 0.5, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]]))),
    ("q", dict(q=-np.eye(3))),
    ("r", dict(r=(1.0,))),
    ("r", dict(r=(1.0, -1.0))),
    ("r", dict(q=(0.0,) * 3, r=(1.0, 0.0), q_y=(1.0,), outputs=dict(v=lambda x, u, p: u[0]))),
    ("qn_factor", dict(qn_factor=-1.0)),
    ("dt", dict(dt=-0.2)),
    ("horizon", dict(horizon=1)),
    ("RHC", dict(commands=("v_left_mps",))),
]
PAPERS_RHE = [
    ("horizon", dict(horizon=0)),
    ("sigma_w", dict(sigma_w=(1, 1))),
    ("sigma_w", dict(speed_model="input", sigma_w=(1,) * 6)),
    ("guess", dict(guess=(0, 0, 0))),
]
PAPERS_RHC = [("omega_max", dict(omega_max=float("nan")))]
PRICES = [
    (HELD, dict(lowest=1)),
    ("linear", dict(linear=-1)),
    ("linear|quadratic", dict(linear=0)),
    ("quadratic", dict(quadratic=np.nan)),
]
GOOD = dict(model=model(ROBOT), dt=DT, guess=GUESS) | ROBOT.estimator
MADE = {
    "Model": (lambda **bad: rhec.Model(**ROBOT.model | bad), MODELS),
    "RHE": (lambda **bad: rhec.RHE(**dict(horizon=N) | GOOD | bad), ESTIMATORS),
    "EKF": (lambda **bad: rhec.EKF(**GOOD | bad), ESTIMATORS),
    "RHC": (lambda **bad: controller(ROBOT, **bad), CONTROLLERS),
    "the paper's RHE": (rhec.RHE, PAPERS_RHE),
    "the paper's RHC": (rhec.RHC, PAPERS_RHC),
    "Bound": (lambda **bad: rhec.Bound(**dict(lowest=0, highest=1) | bad), PRICES),
}


@pytest.mark.parametrize("what", MADE)
def test_a_bad_argument_is_refused_in_one_sentence(what):
    make, rows = MADE[what]
    if what != "Bound":
        make()
    for where, bad in rows:
        refuses(where, lambda: make(**bad))


# Calls of objects that are there

MEASUREMENTS = [(0.0,) * 3, np.zeros((1, 4)), ("a", 0, 0, 0)]
REFERENCES = [
    ("x", (0.0, 0.0)),
    ("p", (0.1,)),
    ("x_ref", np.zeros((3, N))),
    ("x_ref", np.zeros((N + 1, 3))),
    ("u_ref", np.zeros((2, N + 1))),
    ("u_ref", np.zeros(N)),
]
ITERATIONS = [None, 2.5, -1, 10**400]
NOISES = [(1.0, 2.0), -np.ones(5), "abc", np.nan, np.ones((4, 5))]
COMMANDS = [(1.0, 2.0, 3.0), "a"]
U_PLAN = np.zeros((2, N))
U_PLAN[0, 7] = np.nan
PLANS = [
    ("u_plan", dict(u_plan=np.zeros((1, N)))),
    ("u_plan", dict(u_plan=U_PLAN)),
    ("u_plan", dict(x_plan=np.zeros(3))),
    ("x_plan", dict(u_plan=(0.0, 0.0), x_plan=np.zeros((3, N)))),
]


def test_a_call_that_does_not_fit_is_refused_in_one_sentence():
    """And is as if it had not been made: the object answers the next one."""
    mhe = estimator(ROBOT, GUESS)
    noisy = estimator(ROBOT, GUESS, horizon=3, noise_in_window=True)
    mpc = controller(ROBOT)
    changing = controller(ROBOT, delta_bounds={"v_left_mps": (-0.1, 0.1)})
    z = np.zeros(4)
    for each in (mhe, noisy, mpc, changing):
        each.prepare()
    for bad in MEASUREMENTS:
        refuses("z", lambda: mhe.feedback(bad))
    for bad in NOISES:
        refuses("sigma_w", lambda: noisy.feedback(z, sigma_w=bad))
    refuses("noise_in_window", lambda: mhe.feedback(z, sigma_w=ROBOT.sigma_w))
    for name, bad in REFERENCES:
        refuses(name, lambda: mpc.feedback(**STRAIGHT | {name: bad}))
    for bad in ITERATIONS:
        refuses("iterations", lambda: mpc.solve(**STRAIGHT, iterations=bad))
    for name, bad in PLANS:
        refuses(name, lambda: mpc.restart(**bad))
    for bad in COMMANDS:
        refuses("u_before", lambda: changing.feedback(**STRAIGHT, u_before=bad))
        refuses("u_before", lambda: changing.restart(u_before=bad))
    refuses("u_before", lambda: mpc.feedback(**STRAIGHT, u_before=(1.0, 1.0)))
    refuses("bounds", lambda: mpc.update(bounds=BOUNDS | HARD))
    refuses("update", lambda: mpc.update(weights=(1, 1)))
    assert np.isfinite(mhe.feedback(z).x).all() and np.isfinite(mpc.feedback(**STRAIGHT)).all()


def test_without_prepare_feedback_is_refused():
    guess, z = mhe_instance(CART, np.random.default_rng(14))
    problem = mpc_instance(CART, np.random.default_rng(14))
    for each, given in ((estimator(CART, guess), dict(z=z[0])), (controller(CART), problem)):
        each.prepare()
        each.feedback(**given)
        with pytest.raises(RuntimeError, match=r"prepare\(\) must be called before each feedback"):
            each.feedback(**given)
