"""Receding horizon control: eq. (NMPC), one Gauss-Newton iteration a sample, or iterated."""

import numpy as np
import pytest
from problems import N, drive, move, rhc_by_ipopt, rhc_instance, rhc_weights

import rhec

pytestmark = pytest.mark.usefixtures("virtual_machine")
SOLVERS = ["daqp", "qpoases", "qrqp"]
STRAIGHT = dict(pose=(0.0, 0.0, 0.0), p=(0.5, 0.9, 0.8), xi_ref=drive([0, 0, 0, 0.45, 1, 1], np.zeros(N))[0][:, :3].T, omega_ref=np.zeros(N))


def test_iterated_to_convergence_it_is_the_optimum_that_ipopt_finds():
    """On 200 random instances, each with weights of its own; at least a third of them at the bounds."""
    rng, bounded = np.random.default_rng(0), 0
    for k in range(200):
        problem, weights = rhc_instance(rng), rhc_weights(rng)
        rhc = rhec.RHC(**weights, qp=SOLVERS[k % 2])
        command = rhc.solve(**problem, iterations=25)
        optimum = rhc_by_ipopt(problem, **weights)
        np.testing.assert_allclose(rhc.omega_plan, optimum, rtol=0, atol=1e-6 * np.abs(optimum).max())
        assert command == rhc.omega_plan[0]
        assert rhc.kkt < 1e-9
        bounded += np.abs(rhc.omega_plan).max() == weights["omega_max"]
    assert 70 <= bounded <= 190


def test_all_solvers_give_the_same_commands():
    rng = np.random.default_rng(1)
    for _ in range(10):
        controllers, weights = [], rhc_weights(rng)
        controllers = [rhec.RHC(**weights, qp=solver) for solver in SOLVERS]
        for _ in range(10):
            problem, plans = rhc_instance(rng), []
            for rhc in controllers:
                rhc.prepare()
                rhc.feedback(**problem)
                plans.append(rhc.omega_plan)
            np.testing.assert_allclose(plans[1:], [plans[0]] * 2, rtol=0, atol=1e-8)


def test_commands_never_leave_the_bounds():
    """Not by one bit; and they do reach them."""
    rng = np.random.default_rng(2)
    for solver in SOLVERS:
        for _ in range(20):
            omega_max, most = rng.uniform(0.01, 0.2), 0.0
            rhc = rhec.RHC(r=0.5, omega_max=omega_max, qp=solver)
            for _ in range(10):
                problem = rhc_instance(rng)
                rhc.prepare()
                command = rhc.feedback(**problem)
                most = max(most, np.abs(rhc.omega_plan).max())
                assert abs(command) <= omega_max and most <= omega_max
            assert most == omega_max


def test_one_feedback_solves_a_linear_problem():
    """With a weight on the yaw alone, yaw rates in and yaw out are linear: whatever the robot did before, one step is exact."""
    rng = np.random.default_rng(3)
    rhc = rhec.RHC(q=(0, 0, 1), r=0.3)
    for _ in range(10):
        rhc.prepare()
        rhc.feedback(**rhc_instance(rng))       # leaves a plan behind
        problem = rhc_instance(rng) | dict(p=(0.5, 0.9, 0.8))
        rhc.solve(**problem, iterations=1)      # κ of the linearisation
        rhc.prepare()
        rhc.feedback(**problem)
        optimum = rhc_by_ipopt(problem, q=(0, 0, 1), qn_factor=10, r=0.3, omega_max=0.1)
        np.testing.assert_allclose(rhc.omega_plan, optimum, rtol=0, atol=1e-7)
        assert rhc.kkt > 1e-4
        rhc.solve(**problem, iterations=1)
        rhc.solve(**problem, iterations=1)
        assert rhc.kkt < 1e-12


def test_kkt_tolerance_is_positive_and_falls_to_zero():
    rng = np.random.default_rng(4)
    for _ in range(10):
        problem, rhc = rhc_instance(rng), rhec.RHC()
        tolerances = []
        for _ in range(25):
            rhc.solve(**problem, iterations=1)
            tolerances.append(rhc.kkt)
        assert tolerances[0] > 1e-3 and min(tolerances) >= 0
        assert tolerances[3] < 0.2 * tolerances[0]
        assert tolerances[-1] < 1e-10


def test_on_its_reference_it_commands_what_the_reference_asks_for():
    rhc = rhec.RHC()
    assert rhc.solve(**STRAIGHT) == pytest.approx(0, abs=1e-15)
    bend, _ = drive([1, 2, 0.3, 0.5, 0.9, 0.8], np.full(N, 0.07))
    rhc.solve(pose=bend[0, :3], p=bend[0, 3:], xi_ref=bend[:, :3].T, omega_ref=np.full(N, 0.07))
    np.testing.assert_allclose(rhc.omega_plan, 0.07, rtol=1e-7)


def test_without_a_weight_on_the_pose_it_commands_the_input_reference():
    rhc, omega_ref = rhec.RHC(q=(0, 0, 0)), np.linspace(-0.2, 0.2, N)
    rhc.solve(**STRAIGHT | dict(omega_ref=omega_ref))
    np.testing.assert_allclose(rhc.omega_plan, np.clip(omega_ref, -0.1, 0.1), atol=1e-12)


def test_the_reference_at_node_0_has_no_weight_and_every_other_has():
    problem, plans = STRAIGHT | dict(pose=(0.0, 0.05, 0.0)), []
    for node in (None, *range(N + 1)):
        rhc, xi_ref = rhec.RHC(omega_max=10.0), problem["xi_ref"].copy()
        if node is not None:
            xi_ref[:, node] += 0.01
        rhc.solve(**problem | dict(xi_ref=xi_ref))
        plans.append(rhc.omega_plan)
    np.testing.assert_array_equal(plans[1], plans[0])
    assert all(np.abs(plan - plans[0]).max() > 1e-6 for plan in plans[2:])


def test_the_plan_is_a_trajectory_of_the_model_from_the_pose():
    rng = np.random.default_rng(5)
    for _ in range(5):
        problem, rhc = rhc_instance(rng), rhec.RHC()
        rhc.solve(**problem, iterations=25)
        plan = rhc.xi_plan
        np.testing.assert_array_equal(plan[:, 0], problem["pose"])
        for i, omega in enumerate(rhc.omega_plan):
            np.testing.assert_allclose(plan[:, i + 1], move(plan[:, i], *problem["p"], omega), atol=1e-9)


def test_a_sample_later_the_plan_has_moved_on():
    """Warm start: the plan of a converged sample, one interval on, is where the next sample begins, so that it has next to nothing to change."""
    reference, _ = drive([0, 0, 0, 0.5, 0.9, 0.8], np.zeros(2 * N))
    rhc, pose = rhec.RHC(omega_max=1.0), np.array([0.0, 0.1, 0.05])
    rhc.solve(pose=pose, p=reference[0, 3:], xi_ref=reference[:N + 1, :3].T, omega_ref=np.zeros(N))
    planned, pose = rhc.omega_plan, rhc.xi_plan[:, 1]
    rhc.prepare()
    rhc.feedback(pose=pose, p=reference[0, 3:], xi_ref=reference[1:N + 2, :3].T, omega_ref=np.zeros(N))
    warm = rhc.kkt
    cold = rhec.RHC(omega_max=1.0)
    cold.feedback(pose=pose, p=reference[0, 3:], xi_ref=reference[1:N + 2, :3].T, omega_ref=np.zeros(N)) if cold.prepare() is None else None
    assert warm < 0.05 * cold.kkt
    np.testing.assert_allclose(rhc.omega_plan[:5], planned[1:6], atol=0.02)


def test_estimate_and_references_count_in_feedback_alone():
    """Two controllers with one past and one preparation: what differs is what feedback was given, and it is all there."""
    rng = np.random.default_rng(6)
    past, then = [rhc_instance(rng) for _ in range(3)], rhc_instance(rng)
    for change in (dict(pose=then["pose"] + 0.05), dict(p=(0.4, 0.7, 0.6)), dict(xi_ref=then["xi_ref"] + 0.05), dict(omega_ref=then["omega_ref"] + 0.01)):
        one, other = rhec.RHC(omega_max=1.0), rhec.RHC(omega_max=1.0)
        for rhc in (one, other):
            for problem in past:
                rhc.prepare()
                rhc.feedback(**problem)
            rhc.prepare()
        assert one.feedback(**then) != other.feedback(**then | change)


def test_feedback_without_preparation_is_refused():
    rhc = rhec.RHC()
    rhc.prepare()
    rhc.feedback(**STRAIGHT)
    with pytest.raises(RuntimeError, match=r"prepare\(\) must be called before each feedback\(\)"):
        rhc.feedback(**STRAIGHT)
    rhc.prepare()
    rhc.feedback(**STRAIGHT)


@pytest.mark.parametrize("bad, sentence", [
    (dict(pose=(0, 0)), r"pose had shape \(2,\); it should have \(3,\)"),
    (dict(p=(1, 1, 1, 1)), r"p had shape \(4,\); it should have \(3,\)"),
    (dict(xi_ref=np.zeros((N + 1, 3))), r"xi_ref had shape \(16, 3\); it should have \(3, 16\)"),
    (dict(omega_ref=0.0), r"omega_ref had shape \(\); it should have \(15,\)"),
])
def test_a_wrong_shape_is_named(bad, sentence):
    rhc = rhec.RHC()
    rhc.prepare()
    with pytest.raises(ValueError, match=sentence):
        rhc.feedback(**STRAIGHT | bad)


@pytest.mark.parametrize("bad, name", [
    (dict(q=(1, 1)), "q"), (dict(q=(1, 1, -1)), r"q\[2\]"), (dict(r=0), "r"), (dict(qn_factor="10"), "qn_factor"), (dict(omega_max=float("nan")), "omega_max"),
    (dict(dt=-0.2), "dt"), (dict(horizon=1), "horizon"), (dict(horizon=15.0), "horizon"), (dict(qp="osqp"), "qp"),
])
def test_a_bad_argument_is_named_in_one_sentence(bad, name):
    with pytest.raises(ValueError, match=f"^{name} was .*; .*$"):
        rhec.RHC(**bad)


def test_an_unknown_argument_is_refused_with_a_suggestion():
    with pytest.raises(ValueError, match="RHC has no parameter 'omega_mx'; did you mean 'omega_max'"):
        rhec.RHC(omega_mx=0.1)
