"""The masses brought to rest, by rhec."""

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
    return ca.vertcat(x[3:], torque / INERTIA)


states = ("phi_1", "phi_2", "phi_3", "dphi_1", "dphi_2", "dphi_3")
motors = ("motor_1", "motor_2")
model = rhec.Model(states=states, inputs=motors, outputs=states[:3], f=f)
bounds = dict.fromkeys(motors, (-2 * np.pi, 2 * np.pi))
changes = (1e-2, 1e-2)
rhc = rhec.RHC(
    model=model, q=(1, 1, 1, 0, 0, 0), r=(0, 0), r_delta=changes, bounds=bounds, dt=0.1, horizon=20
)
x = START
for k in range(50):
    rhc.prepare()
    u = rhc.feedback(x)
    x = model.simulate(x, u, dt=0.1)[-1]
LAST = np.ravel(x)
