"""The inertia of one of three masses from noisy angles, by rhec."""

import casadi as ca
import numpy as np

import rhec

STIFFNESS = np.array([2.697, 2.66, 3.05, 2.86]) * 1e-3
DAMPING = np.array([6.78, 8.01, 8.82]) * 1e-5
INERTIA = 2.25e-4
START = np.array([1.0, 0.6, 0.1, 0.0, 0.0, 0.0])


def f(x, u, p):
    turns = ca.vertcat(u[0], x[:3], u[1])
    springs = STIFFNESS * (turns[1:] - turns[:-1])
    torque = springs[1:] - springs[:-1] - DAMPING * x[3:]
    return ca.vertcat(x[3:], torque / ca.vertcat(p, INERTIA, INERTIA))


angles = ("phi_1", "phi_2", "phi_3")
motors = ("motor_1", "motor_2")
model = rhec.Model(
    states=(*angles, "dphi_1", "dphi_2", "dphi_3"),
    inputs=motors,
    parameters={"inertia": (1e-5, 1e-3)},
    outputs=(*angles, *motors),
    f=f,
)
sigma_v = (0.01, 0.01, 0.01, 1e-3, 1e-3)
guess = (0, 0, 0, 0, 0, 0, 1e-4)
sigma_guess = (1, 1, 1, 1, 1, 1, 1e-3)
rhe = rhec.RHE(
    model=model, sigma_v=sigma_v, sigma_w=(0,) * 7, guess=guess, sigma_guess=sigma_guess,
    dt=0.1, horizon=10,
)  # fmt: skip

rng = np.random.default_rng(0)
x = START
for k in range(100):
    if k % 5 == 0:
        u = 2 * rng.uniform(-1, 1, 2)
    x = model.simulate(x, u, [INERTIA], dt=0.1)[-1]
    z = np.concatenate([x[:3], u]) + rng.normal(size=5) * sigma_v
    rhe.prepare()
    estimate = rhe.feedback(z)
LAST = float(estimate.p[0])
