"""Linear time-varying MPC, to compare the paper's controller with.

    linear = dataclasses.replace(scenario, controller=ltv_mpc.controller(scenario))

It solves the RHC's QP linearised about the path instead of about its last plan. The error to the
path obeys e_{i+1} = A_i e_i + B_i (u_i - ū_i), with A_i and B_i of the model at the desired poses
and ū_i = (θ_r,i+1 - θ_r,i) / (κ̂ Δt), the yaw rate that follows the path (Falcone et al.,
"Predictive active steering control for autonomous vehicle systems", 2007). Cost and bounds are
those of eq. (12).
"""

import functools

import casadi as ca

import rhec
from rhec.core._casadi.build import casadi_function, select_inputs
from rhec.core.controller import rhc
from rhec.tracked_robot.paper_rhc import problem_of_scenario
from rhec.tracked_robot.references import LEAST_KAPPA


def controller(scenario):
    """Linear time-varying MPC for a Scenario, as a rhec.Controller."""
    return rhec.Controller(build_step(problem_of_scenario(scenario).stages))


@functools.cache
def build_step(stages):
    """The step of the controller, with the Stages of the paper's RHC."""
    phases = rhc.build_phases(stages)

    @casadi_function("ltv_mpc_step", ca.MX, **stages.weights, **stages.data)
    def step(**signals):
        x_ref = signals["x_ref"]
        parameters = signals["s_0"][stages.n_x :]
        kappa = ca.fmax(parameters[2], LEAST_KAPPA)
        omega = (x_ref[2, 1:] - x_ref[2, :-1]) / (kappa * stages.dt_s)
        u = ca.fmin(ca.fmax(omega, signals["lower"]), signals["upper"])
        s = ca.vertcat(x_ref, ca.repmat(parameters, 1, stages.N + 1))
        values = signals | dict(s=s, u=u)
        for phase in ("linearise", "feedback", "expand"):
            function = phases[phase]
            values |= function(**select_inputs(function, values))
        return dict(command=values["u_plan"][:, 0], kkt=values["kkt"], ok=values["ok"])

    return step
