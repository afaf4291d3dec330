"""Interpretation G15: when ν̂, μ̂ and κ̂ reach the controller."""

import casadi as ca
import numpy as np
import pytest

import rhec

pytestmark = pytest.mark.usefixtures("virtual_machine")
# The commands do not depend on κ̂ by another way than the model of the controller.
COMMAND = "omega_cmd_radps"


def estimator_with(kappa_of):
    """An estimator of one's own: the measured pose along x, and κ̂ as a function of the sample."""
    memory = ca.SX.sym("memory", 7)
    z = ca.SX.sym("z", 4)
    theta = memory[2] + 0.2 * 0.8 * z[3]
    estimate = ca.vertcat(z[:2], theta, 0.5, 1.0, kappa_of(memory[6]))
    following = ca.vertcat(z[:2], theta, memory[3:6], memory[6] + 1)
    return ca.Function("own", [memory, z], [following, estimate])


def kappa_at(k):
    return 0.7 + 0.2 * ca.sin(k)


def commands(**choice):
    return rhec.simulate(rhec.Scenario(duration_s=20.0, **choice)).log[COMMAND]


def test_estimates_that_do_not_change_may_reach_the_controller_at_any_time():
    estimator = estimator_with(lambda k: 1.0)  # as in the first guess
    first = commands(estimator=estimator)
    for timing in ("sample_before", "prepared_anew"):
        found = commands(estimator=estimator, traction_timing=timing)
        np.testing.assert_allclose(found, first, atol=1e-12)


def test_the_sample_before_is_an_estimator_that_tells_them_a_sample_later():
    prompt = estimator_with(kappa_at)
    late = estimator_with(lambda k: ca.if_else(k > 0, kappa_at(k - 1), 1.0))
    before = commands(estimator=prompt, traction_timing="sample_before")
    anew = commands(estimator=late, traction_timing="prepared_anew")
    np.testing.assert_allclose(before, anew, atol=1e-12)
    for timing in ("feedback", "prepared_anew"):
        other = commands(estimator=prompt, traction_timing=timing)
        assert np.abs(other - before).max() > 1e-4, timing


def test_a_missing_yaw_rate_is_the_last_command():
    """A controller whose command follows from the desired yaw rate, here the measured one."""
    u_ref = ca.SX.sym("u_ref", 1, 15)
    step = ca.Function("half", [u_ref], [0.5 * u_ref[0] + 0.01], ["u_ref"], ["command"])
    fault = rhec.Fault(kind="missing", start_s=5.0, duration_s=3.0, channel="all")
    found = commands(controller=rhec.Controller(step), faults=(fault,)).to_numpy()
    np.testing.assert_allclose(found[25:40], 0.5 * found[24:39] + 0.01)
