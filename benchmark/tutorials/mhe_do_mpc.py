"""The inertia of one of three masses from noisy angles, after do-mpc's "Getting started: MHE"."""

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
inertia = model.set_variable("_p", "inertia")
model.set_meas("phi", phi, meas_noise=True)
model.set_meas("motors", motors, meas_noise=True)
turns = ca.vertcat(motors[0], phi, motors[1])
springs = STIFFNESS * (turns[1:] - turns[:-1])
torque = springs[1:] - springs[:-1] - DAMPING * dphi
model.set_rhs("phi", dphi)
model.set_rhs("dphi", torque / ca.vertcat(inertia, INERTIA, INERTIA))
model.setup()

mhe = do_mpc.estimator.MHE(model, ["inertia"])
mhe.set_param(n_horizon=10, t_step=0.1, meas_from_data=True)
mhe.settings.supress_ipopt_output()
P_v = np.diag(1 / np.array([0.01, 0.01, 0.01, 1e-3, 1e-3]) ** 2)
P_x = np.eye(6)
P_p = np.array([[1e6]])
mhe.set_default_objective(P_x=P_x, P_v=P_v, P_p=P_p)
mhe.bounds["lower", "_p_est", "inertia"] = 1e-5
mhe.bounds["upper", "_p_est", "inertia"] = 1e-3
mhe.setup()

simulator = do_mpc.simulator.Simulator(model)
simulator.set_param(t_step=0.1)
template = simulator.get_p_template()
template["inertia"] = INERTIA
simulator.set_p_fun(lambda t: template)
simulator.setup()

rng = np.random.default_rng(0)
simulator.x0 = START
mhe.x0 = np.zeros(6)
mhe.p_est0 = 1e-4
mhe.set_initial_guess()
for k in range(100):
    if k % 5 == 0:
        u = 2 * rng.uniform(-1, 1, (2, 1))
    z = simulator.make_step(u, v0=0.01 * rng.normal(size=(5, 1)) * [[1], [1], [1], [0.1], [0.1]])
    mhe.make_step(z)
LAST = float(mhe.p_est0["inertia"])
