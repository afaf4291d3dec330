"""Receding horizon control: eq. (NMPC), one Gauss-Newton iteration a sample, or iterated."""

import contextlib

import numpy as np
import pytest
from condensed_rhc import rhc_by
from oracles import N, drive, move, rhc_by_ipopt, rhc_instance, rhc_weights
from robots import DT, ROBOTS

import rhec
from rhec.core.controller import rhc as builders
from rhec.tracked_robot import rhc as paper_rhc

pytestmark = pytest.mark.usefixtures("virtual_machine")
SOLVERS = ["structured", "daqp", "qpoases"]
STRAIGHT = dict(
    pose=(0.0, 0.0, 0.0),
    p=(0.5, 0.9, 0.8),
    xi_ref=drive([0, 0, 0, 0.45, 1, 1], np.zeros(N))[0][:, :3].T,
    omega_ref=np.zeros(N),
)


@pytest.mark.parametrize("iterations", [None, [3], "3", 2.5, -1, 10**400])
def test_iterations_are_a_number(iterations):
    with pytest.raises(ValueError, match="^iterations was "):
        rhec.RHC().solve(**STRAIGHT, iterations=iterations)


def test_iterated_to_convergence_it_is_the_optimum_that_ipopt_finds():
    """On 200 random instances, each with weights of its own; at least a third of them at the
    bounds.
    """
    rng, bounded = np.random.default_rng(0), 0
    for k in range(200):
        problem, weights = rhc_instance(rng), rhc_weights(rng)
        rhc = rhc_by(SOLVERS[k % 3], **weights)
        command = rhc.solve(**problem, iterations=25)
        optimum = rhc_by_ipopt(problem, **weights)
        np.testing.assert_allclose(
            rhc.omega_plan, optimum, rtol=0, atol=1e-6 * np.abs(optimum).max()
        )
        assert command == rhc.omega_plan[0]
        assert rhc.kkt < 1e-9
        bounded += np.abs(rhc.omega_plan).max() == weights["omega_max"]
    assert 70 <= bounded <= 190


def test_all_solvers_give_the_same_commands():
    """Easy or hard: in some, nearly all inputs are at a bound, some at either."""
    rng = np.random.default_rng(1)
    for _ in range(20):
        weights = rhc_weights(rng) | dict(r=10 ** rng.uniform(-3, 1))
        controllers = [rhc_by(solver, **weights) for solver in SOLVERS]
        for _ in range(10):
            problem, plans = rhc_instance(rng), []
            for rhc in controllers:
                rhc.prepare()
                rhc.feedback(**problem)
                plans.append(rhc.omega_plan)
            np.testing.assert_allclose(
                plans[1:], [plans[0]] * (len(SOLVERS) - 1), rtol=0, atol=1e-8
            )


def test_commands_never_leave_the_bounds():
    """Not by one bit; and they do reach them."""
    rng = np.random.default_rng(2)
    for solver in SOLVERS:
        for _ in range(20):
            omega_max, most = rng.uniform(0.01, 0.2), 0.0
            rhc = rhc_by(solver, r=0.5, omega_max=omega_max)
            for _ in range(10):
                problem = rhc_instance(rng)
                rhc.prepare()
                command = rhc.feedback(**problem)
                most = max(most, np.abs(rhc.omega_plan).max())
                assert abs(command) <= omega_max and most <= omega_max
            assert most == omega_max


def test_one_feedback_solves_a_linear_problem():
    """With a weight on the yaw alone, yaw rates in and yaw out are linear: whatever was planned
    before, one step is exact.
    """
    rng, weights = np.random.default_rng(3), dict(q=(0, 0, 1), qn_factor=10, r=1.0, omega_max=0.3)
    rhc = rhec.RHC(**weights)
    for _ in range(10):
        problem = rhc_instance(rng) | dict(p=(0.5, 0.9, 0.8))
        rhc.prepare()
        rhc.feedback(**problem)
        assert rhc.kkt > 1e-6
        np.testing.assert_allclose(
            rhc.omega_plan, rhc_by_ipopt(problem, **weights), rtol=0, atol=1e-7
        )
        rhc.solve(**problem, iterations=2)
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
            np.testing.assert_allclose(
                plan[:, i + 1], move(plan[:, i], *problem["p"], omega), atol=1e-9
            )


def test_a_sample_later_the_plan_has_moved_on():
    """Warm start: one interval on, the last input repeated, the last node integrated."""
    rng = np.random.default_rng(7)
    s, omega = rng.normal(size=(6, N + 1)), rng.normal(size=(1, N))
    phases = builders.build_phases(paper_rhc.horizon_of(N))
    shifted = phases["shift"](s=s, u=omega)
    last = [*move(s[:3, -1], *s[3:, -1], omega[0, -1]), *s[3:, -1]]
    np.testing.assert_allclose(
        np.array(shifted["s"]), np.column_stack([s[:, 1:], last]), atol=1e-12
    )
    np.testing.assert_array_equal(np.array(shifted["u"]), [[*omega[0, 1:], omega[0, -1]]])


def test_estimate_and_references_count_in_feedback_alone():
    """Two controllers with one past and one preparation: what differs is what feedback was given,
    and it is all there.
    """
    rng = np.random.default_rng(6)
    past, then = [rhc_instance(rng) for _ in range(3)], rhc_instance(rng)
    for name in ("pose", "p", "xi_ref", "omega_ref"):
        one, other = rhec.RHC(omega_max=1.0), rhec.RHC(omega_max=1.0)
        for rhc in (one, other):
            for problem in past:
                rhc.prepare()
                rhc.feedback(**problem)
            rhc.prepare()
        assert one.feedback(**then) != other.feedback(**then | {name: np.array(then[name]) + 0.05})


def test_feedback_without_preparation_is_refused():
    rhc = rhec.RHC()
    rhc.prepare()
    rhc.feedback(**STRAIGHT)
    with pytest.raises(RuntimeError, match=r"prepare\(\) must be called before each feedback\(\)"):
        rhc.feedback(**STRAIGHT)
    rhc.prepare()
    rhc.feedback(**STRAIGHT)


@pytest.mark.parametrize("name", ["pose", "p", "xi_ref", "omega_ref"])
def test_a_value_that_is_no_number_does_no_lasting_harm(name):
    """Refused, or forgotten by the time the plan has been made anew."""
    problem, rhc, other = STRAIGHT | dict(pose=(0.0, 0.1, 0.0)), rhec.RHC(), rhec.RHC()
    for k in range(2 * N):
        rhc.prepare(), other.prepare()
        with contextlib.suppress(ValueError):
            rhc.feedback(
                **problem | ({name: np.full(np.shape(problem[name]), np.nan)} if k == 3 else {})
            )
        other.feedback(**problem)
    np.testing.assert_allclose(rhc.omega_plan, other.omega_plan, atol=1e-6)
    assert np.isfinite(rhc.kkt)


@pytest.mark.parametrize(
    "name, value",
    [
        ("pose", (0, 0)),
        ("pose", 0.0),
        ("p", (1, 1, 1, 1)),
        ("xi_ref", np.zeros((N + 1, 3))),
        ("xi_ref", np.zeros((3, N))),
        ("xi_ref", np.zeros((3, 1))),
        ("omega_ref", np.zeros(N + 1)),
        ("omega_ref", np.zeros((1, N))),
        ("omega_ref", 0.0),
    ],
)
def test_a_wrong_shape_is_named(name, value):
    rhc = rhec.RHC()
    rhc.prepare()
    with pytest.raises(ValueError, match=f"^{name} had .* it should have"):
        rhc.feedback(**STRAIGHT | {name: value})


@pytest.mark.parametrize(
    "bad, name",
    [
        (dict(q=(1, 1)), r"q(\[2\])?"),
        (dict(q=(1, 1, -1)), r"q\[2\]"),
        (dict(r=0), "r"),
        (dict(qn_factor="10"), "qn_factor"),
        (dict(omega_max=float("nan")), "omega_max"),
        (dict(dt=-0.2), "dt"),
        (dict(horizon=1), "horizon"),
        (dict(horizon=15.0), "horizon"),
    ],
)
def test_a_bad_argument_is_named_in_one_sentence(bad, name):
    with pytest.raises(ValueError, match=f"^{name} was .*; .*$"):
        rhec.RHC(**bad)


def test_weights_and_bounds_change_by_the_names_of_the_model():
    """As of any Model's controller: afterwards it commands what one made with them does."""
    problem = STRAIGHT | dict(pose=(0.0, 0.5, 0.0))
    changed, made = rhec.RHC(), rhec.RHC(q=(1, 2, 3), r=0.1, omega_max=0.05)
    changed.update(q=(1, 2, 3), r=(0.1,), bounds={"omega_radps": (-0.05, 0.05)})
    assert changed.solve(**problem) == made.solve(**problem)
    assert abs(made.omega_plan).max() == 0.05
    with pytest.raises(ValueError, match="needs a new rhec.RHC"):
        changed.update(bounds={"x_m": (-1.0, 1.0)})


def test_an_unknown_argument_is_refused_with_a_suggestion():
    with pytest.raises(
        ValueError, match="RHC has no parameter 'omega_mx'; did you mean 'omega_max'"
    ):
        rhec.RHC(omega_mx=0.1)


def test_infinite_bounds_are_no_bounds():
    """Neither in the plan nor in the KKT tolerance, where 0 times infinity would be NaN."""
    robot = ROBOTS["bicycle"]
    problem = dict(x=(0.0, 0.1, 0.1), p=(0.0, 0.0), x_ref=(1.0, 0.0, 0.0), u_ref=(0.5, 0.0))
    answers = []
    for bounds in (None, {"steering_rad": (-np.inf, np.inf)}, {"steering_rad": (-np.inf, 9.0)}):
        options = dict(robot.controller, bounds=bounds)
        rhc = rhec.RHC(model=rhec.Model(**robot.model), dt=DT, horizon=5, **options)
        rhc.prepare()
        answers.append([*rhc.feedback(**problem), rhc.kkt])
        assert rhc.ok and np.isfinite(rhc.kkt)
    np.testing.assert_allclose(answers[1:], answers[:1] * 2, rtol=0, atol=1e-12)


def car():
    """The bicycle's controller, whose speed follows a reference and is not commanded."""
    robot = ROBOTS["bicycle"]
    bounds = dict(steering_rad=robot.bounds["steering_rad"])
    options = dict(robot.controller, command=(*bounds,), bounds=bounds, r=robot.r[1:])
    return rhec.RHC(model=rhec.Model(**robot.model), dt=DT, horizon=5, **options)


CAR = dict(x=(0.0, 0.1, 0.1), p=(0.0, 0.0), x_ref=(1.0, 0.0, 0.0), u_ref=(0.5, 0.0))


@pytest.mark.parametrize(
    "make, problem, name",
    [(rhec.RHC, STRAIGHT, "pose"), (car, CAR, "x"), (car, CAR, "x_ref"), (car, CAR, "u_ref")],
)
def test_a_step_that_was_not_solved_has_no_kkt_tolerance(make, problem, name):
    rhc = make()
    rhc.feedback(**problem)
    assert rhc.ok and np.isfinite(rhc.kkt)
    rhc.prepare()
    rhc.feedback(**problem | {name: np.full(np.shape(problem[name]), np.nan)})
    assert not rhc.ok and np.isnan(rhc.kkt)


def test_without_a_reference_of_inputs_the_last_plan_goes_on():
    """Also that of the inputs that are not commanded."""
    rhc = car()
    rhc.feedback(**CAR)
    before = rhc.u_plan.copy()
    for _ in range(3):
        rhc.prepare()
        rhc.feedback(**CAR | dict(u_ref=(np.nan, np.nan)))
        before = np.hstack([before[:, 1:], before[:, -1:]])
        np.testing.assert_allclose(rhc.u_plan, before, rtol=0, atol=1e-12)
    rhc.prepare()
    rhc.feedback(**CAR)
    assert rhc.ok and np.isfinite(rhc.u_plan).all()
