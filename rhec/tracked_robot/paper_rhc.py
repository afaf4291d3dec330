"""The paper's receding horizon controller of the tracked robot, eq. (11)-(13), (16), (19)-(22)."""

import casadi as ca

from rhec import paper
from rhec.core._casadi.build import unpack, with_packed_memory
from rhec.core.controller import rhc
from rhec.core.controller.stages import Stages
from rhec.tracked_robot.kinematics import SPEED_MODELS


def stages_of(N):
    """The Stages of the paper's problem, N intervals: the yaw rate ω is commanded."""
    return Stages(SPEED_MODELS["parameter"].model, (0,), paper.DT_S, N)


def build_step(N, traction_timing="feedback"):
    """The RHC's step, with ν̂, μ̂ and κ̂ that reach it as Scenario's `traction_timing` says."""
    stages = stages_of(N)
    step = rhc.build_phases(stages)["step"]
    if traction_timing == "feedback":
        return step
    return _with_online_traction(step, stages, traction_timing)


def _with_online_traction(step, stages, timing):
    """The RHC's step with p̂ = (ν, μ, κ) as data of its preparation (interpretation G15).

    Without this, p̂ of the newest sample acts in the feedback, through the linearised (x, p).

    Args:
        step: Step of `rhc.build_phases`.
        stages: Its Stages.
        timing: "sample_before", the p̂ that was known when the preparation ran, or
            "prepared_anew", the newest p̂, for which the preparation waits.

    Returns:
        A step with the same inputs and outputs.
    """
    n_x = stages.n_x
    shapes = stages.weights | stages.data

    def with_traction(s, p):
        return ca.vertcat(s[:n_x, :], ca.repmat(p, 1, s.size2()))

    @with_packed_memory("rhc_online_step", stages.memory, **shapes)
    def online(s, u, s_0, **given):
        p = s_0[n_x:]
        if timing == "prepared_anew":
            s = with_traction(s, p)
        # The data of the preparation are those of the whole step.
        start = ca.vertcat(s_0[:n_x], s[n_x:, 0])
        result = step(memory=ca.veccat(s, u), s_0=start, **given)
        plan = unpack(result.pop("memory"), stages.memory)
        return result | dict(s=with_traction(plan["s"], p), u=plan["u"])

    return online
