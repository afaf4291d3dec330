"""The masses brought to rest, after do-mpc's "Getting started: MPC"."""

import casadi as ca
import do_mpc
import numpy as np

STIFFNESS = np.array([2.697, 2.66, 3.05, 2.86]) * 1e-3
DAMPING = np.array([6.78, 8.01, 8.82]) * 1e-5
INERTIA = 2.25e-4
START = np.array([1.0, 0.6, 0.1, 0.0, 0.0, 0.0])

model = do_mpc.model.Model("continuous")
phi = model.set_variable("_x", "phi", (3, 1))
dphi = model.set_variable("_x", "dphi", (3, 1))
motors = model.set_variable("_u", "motors", (2, 1))
turns = ca.vertcat(motors[0], phi, motors[1])
springs = STIFFNESS * (turns[1:] - turns[:-1])
torque = springs[1:] - springs[:-1] - DAMPING * dphi
model.set_rhs("phi", dphi)
model.set_rhs("dphi", torque / INERTIA)
model.setup()

mpc = do_mpc.controller.MPC(model)
mpc.set_param(n_horizon=20, t_step=0.1)
mpc.settings.supress_ipopt_output()
cost = ca.sumsqr(phi)
mpc.set_objective(mterm=cost, lterm=cost)
mpc.set_rterm(motors=1e-2)
mpc.bounds["lower", "_u", "motors"] = -2 * np.pi
mpc.bounds["upper", "_u", "motors"] = 2 * np.pi
mpc.setup()

simulator = do_mpc.simulator.Simulator(model)
simulator.set_param(t_step=0.1)
simulator.setup()

x = START
mpc.x0 = x
simulator.x0 = x
mpc.set_initial_guess()
for k in range(50):
    u = mpc.make_step(x)
    x = simulator.make_step(u)
LAST = np.ravel(x)
