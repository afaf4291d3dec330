"""do-mpc's rotating masses: a stiff model with an unknown inertia, and exact measurements of it."""

import casadi as ca
import numpy as np
from scipy.linalg import expm

import rhec

DT = 0.1
INERTIA = 2.25e-4  # of each mass [kg m²]
STIFFNESS = np.array([2.697, 2.66, 3.05, 2.86]) * 1e-3
DAMPING = np.array([6.78, 8.01, 8.82]) * 1e-5
MOTOR_S = 0.01


def masses(**options):
    """Three rotating masses between two motors of 10 ms, sampled every 100 ms."""

    def f(x, u, p):
        angle, rate, motor = x[:3], x[3:6], x[6:]
        chain = ca.vertcat(motor[0], angle, motor[1])
        springs = ca.DM(STIFFNESS) * (chain[1:] - chain[:-1])
        torque = springs[1:] - springs[:-1] - ca.DM(DAMPING) * rate
        return ca.vertcat(rate, torque / ca.vertcat(p, INERTIA, INERTIA), (u - motor) / MOTOR_S)

    return rhec.Model(
        states=("a1", "a2", "a3", "w1", "w2", "w3", "m1", "m2"),
        inputs=("set1", "set2"),
        parameters={"inertia": (1e-5, 1e-3)},
        outputs=("a1", "a2", "a3", "set1", "set2"),
        f=f,
        **options,
    )


def mhe_of_masses(arrival_mean="smoothed", **options):
    """With do-mpc's weights: P_x = 1e-4, P_p = 1, P_v = 1 for the angles and 20 for the motors."""
    noise = dict(sigma_v=(1.0,) * 3 + (20**-0.5,) * 2, sigma_w=(0.0,) * 9)
    guess = dict(guess=(0.0,) * 8 + (1e-4,), sigma_guess=(100.0,) * 8 + (1.0,))
    options = dict(model=masses(**options), arrival_mean=arrival_mean)
    return rhec.RHE(dt=DT, horizon=10, **options, **noise, **guess)


def measured(seed, n=60):
    """Measurements (n, 5) of masses whose motors get new random set points every fifth sample.

    The model is linear for a given inertia, so that a matrix exponential solves it exactly.
    """
    rng = np.random.default_rng(seed)
    slopes = np.array(masses(steps=5).slopes(np.zeros(8), [0, 0], [INERTIA]))
    by_input = np.vstack([np.zeros((6, 2)), np.eye(2) / MOTOR_S])
    exact = expm(np.block([[slopes, by_input], [np.zeros((2, 10))]]) * DT)
    x = rng.random(8) - 0.5
    u = np.zeros(2)
    z = []
    for k in range(n):
        if k % 5 == 0:
            u = rng.uniform(-2, 2, 2)
        x = exact[:8] @ np.array([*x, *u])
        z.append([*(x[:3] + 0.01 * rng.standard_normal(3)), *u])
    return np.array(z)
