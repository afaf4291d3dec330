"""One shooting interval of the system model."""

import numpy as np
import pytest
from oracles import flat

from rhec.core.model import robot_model
from rhec.tracked_robot import kinematics as model
from rhec.tracked_robot.speed_models import speed_model_of

SPEED_MODELS = ["parameter", "input"]


def interval_of(speed_model):
    return robot_model.interval(speed_model_of(speed_model).model)


def arc(pose, nu, mu, kappa, omega, t):
    """Where the robot really is after t seconds: it drives a circle."""
    x, y, theta = pose
    turn, radius = kappa * omega * t, mu * nu / (kappa * omega)
    return np.array(
        [
            x + radius * (np.sin(theta + turn) - np.sin(theta)),
            y - radius * (np.cos(theta + turn) - np.cos(theta)),
            theta + turn,
        ]
    )


def test_the_runge_kutta_step_is_of_fourth_order():
    """Halving the step divides the error of one step by 2⁵."""
    pose, p, omega = np.array([1.0, -2.0, 0.7]), (0.8, 0.9, 0.7), 1.3

    def error(dt):
        return np.linalg.norm(
            flat(model.rk4(model.f, pose, omega, p, dt)) - arc(pose, *p, omega, dt)
        )

    ratios = [error(dt) / error(dt / 2) for dt in (1.0, 0.5, 0.25)]
    np.testing.assert_allclose(ratios, 32, rtol=0.1)
    assert error(0.2) < 1e-6


def test_with_full_traction_it_is_the_traditional_model():
    """Eq. (1): ẋ = ν cos θ, ẏ = ν sin θ, θ̇ = ω."""
    pose = np.array([0.3, 0.1, 0.4])
    np.testing.assert_allclose(
        flat(model.f(pose, 0.2, (0.5, 1, 1))),
        [0.5 * np.cos(0.4), 0.5 * np.sin(0.4), 0.2],
        rtol=1e-15,
    )
    np.testing.assert_allclose(
        flat(model.rk4(model.f, pose, 0.2, (0.5, 1, 1), 0.2)),
        arc(pose, 0.5, 1, 1, 0.2, 0.2),
        atol=1e-9,
    )


@pytest.mark.parametrize("speed_model", [*SPEED_MODELS, "slipping"])
def test_an_interval_says_which_entry_is_what(speed_model):
    """By name: what is bounded, and what each entry of z = (x, y, ν, ω) measures."""
    robot = speed_model_of(speed_model).model
    interval, names = interval_of(speed_model), robot.joint_names
    assert {names[place]: bounds for place, bounds in interval.bounds.items()} == {
        "mu": (0, 1),
        "kappa": (0, 1),
    }
    s, measured = np.arange(len(names)) + 0.5, {}
    for output in interval.outputs:
        measured[names[int(output.h(s))]] = output.row
        np.testing.assert_array_equal(flat(output.H(s)), np.arange(len(names)) == int(output.h(s)))
    measured |= {robot.inputs[place]: row for place, (row, _) in interval.input_outputs.items()}
    assert measured == {"x_m": 0, "y_m": 1, "nu_mps": 2, "omega_radps": 3}


def test_the_output_is_what_the_robot_measures():
    """Eq. (4)."""
    assert flat(model.h((1, 2, 3), 0.1, (0.5, 0.9, 0.8))).tolist() == [1, 2, 0.5, 0.1]
