"""The paper's receding horizon controller of the tracked robot, eq. (11)-(13), (16), (19)-(22)."""

import functools

import casadi as ca
import numpy as np

from rhec import paper
from rhec.core._casadi.build import unpack, with_packed_memory
from rhec.core.controller import rhc
from rhec.core.controller.problem import Options, Problem, problem_of
from rhec.tracked_robot.kinematics import SPEED_MODELS


def options_of(*, omega_max, r, **others):
    """The arguments of a Model's rhec.RHC that make it the paper's: the yaw rate ω is commanded.

    Args:
        omega_max: Bound of ω [rad/s], eq. (16).
        r: Weight R of ω, eq. (22).
        others: Further arguments of rhec.RHC: its weights, `dt` and `horizon`.
    """
    bounds = dict(omega_radps=(-omega_max, omega_max))
    model = SPEED_MODELS["parameter"].model
    return dict(model=model, command=("omega_radps",), bounds=bounds, r=(r,)) | others


def with_full_steps(problem, qp=None):
    """A Problem whose iterations are full steps, as the paper's are; `qp` is that of Stages."""
    return Problem(problem.stages._replace(damped=False, qp=qp), problem.settings)


def problem_of_scenario(scenario):
    """The Problem of the RHC of a Scenario."""
    return _problem(*_numbers_of(scenario))


def first_plan(scenario, guess):
    """What the RHC of a Scenario remembers before the first sample, {name: array}.

    `guess` is the estimator's first, (x, y, θ, ν, μ, κ).
    """
    return _first_plan(tuple(guess), *_numbers_of(scenario))


def _numbers_of(scenario):
    """All of a Scenario that its Problem depends on."""
    weights = scenario.q, scenario.r, scenario.qn_factor
    return *weights, scenario.omega_max_radps, scenario.prediction_horizon


# Runs that differ in other parameters share what follows from these alone.


@functools.lru_cache
def _problem(q, r, qn_factor, omega_max, horizon):
    weights = dict(q=q, r=r, qn_factor=qn_factor)
    options = options_of(**weights, omega_max=omega_max, dt=paper.DT_S, horizon=horizon)
    return with_full_steps(problem_of(Options(**options)))


@functools.lru_cache
def _first_plan(guess, *numbers):
    stages, settings = _problem(*numbers)
    return rhc.init(stages, np.array(guess[:3]), np.array(guess[3:]), settings)


def build_step(stages, traction_timing="feedback"):
    """The RHC's step, with ν̂, μ̂ and κ̂ that reach it as Scenario's `traction_timing` says."""
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
    def online(s_0, **values):
        plan = {name: values.pop(name) for name in stages.memory}
        p = s_0[n_x:]
        if timing == "prepared_anew":
            plan["s"] = with_traction(plan["s"], p)
        # The data of the preparation are those of the whole step.
        start = ca.vertcat(s_0[:n_x], plan["s"][n_x:, 0])
        result = step(memory=ca.veccat(*plan.values()), s_0=start, **values)
        plan = unpack(result.pop("memory"), stages.memory)
        return result | plan | dict(s=with_traction(plan["s"], p))

    return online
