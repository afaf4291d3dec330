"""Receding horizon control with bounds on states, outputs and changes: on random instances it finds
what IPOPT finds.
"""

import numpy as np
import published_problems
import pytest
import robots
from helpers import model, no_compiler

import rhec
from notebooks.studies.ipopt import PlanProblem

INF = np.inf


# Options of a rhec.RHC, and of the same plan for IPOPT
CART = dict(
    model=model(robots.CART), command=robots.CART.inputs, dt=0.2, horizon=15, q=(1.0, 0.2),
    r=(0.3,), bounds=dict(acceleration_mps2=(-1, 1), velocity_mps=(-0.5, 0.6)), qn_factor=10.0,
)  # fmt: skip
OBSTACLE = published_problems.obstacle(discrete=False).options
OBSTACLE = OBSTACLE | dict(qn=10.0 * np.array(OBSTACLE["q"]))
CHANGES = CART | dict(r_delta=(0.5,), delta_bounds=dict(acceleration_mps2=(-0.25, 0.25)))
SOFT_SPEED = dict(velocity_mps=rhec.Bound(-0.5, 0.6, linear=0.1, quadratic=3.0))
SOFT = CART | dict(bounds=CART["bounds"] | SOFT_SPEED)


def controller(options, **changes):
    with no_compiler():
        return rhec.RHC(**options | changes)


def cart_instance(rng):
    x, p = rng.uniform((-3, -0.4), (3, 0.4)), rng.uniform(-0.1, 0.1, 1)
    return dict(x=x, p=p, x_ref=(0.0, 0.0))


def steady_instance(rng):
    """The first change of the command is from 0."""
    given = cart_instance(rng)
    given["x"][1] = 0.0
    return given


def far_instance(rng):
    return cart_instance(rng) | dict(x_ref=(3.0, 0.0))


def obstacle_instance(rng):
    """Before the obstacle, with the goal behind it."""
    x = np.array([*rng.uniform(-0.3, 0.1, 2), rng.uniform(-0.3, 1.2)])
    return dict(x=x, p=(), x_ref=(1.5, 1.5, 0.0))


def changes_at_their_bound(mpc):
    return np.abs(np.diff(mpc.u_plan[0], prepend=0.0)).max() > 0.2499


def too_fast(mpc):
    return mpc.x_plan[1].max() > 0.6


# {case: (options, instances, iterations, what has to be active; None: a bound of state or output)}
CASES = dict(
    cart=(CART, cart_instance, 8, None),
    changes=(CHANGES, steady_instance, 3, changes_at_their_bound),
    soft=(SOFT, far_instance, 2, too_fast),
    obstacle=(OBSTACLE, obstacle_instance, 60, None),
)


@pytest.mark.parametrize("case", CASES)
def test_iterated_to_convergence_it_is_the_optimum_that_ipopt_finds(case):
    """Bounds of states, outputs and changes, hard ones and ones with a price."""
    options, draw, iterations, is_active = CASES[case]
    rng, oracle, active = np.random.default_rng(0), PlanProblem(options), 0
    for _ in range(6):
        given, mpc = draw(rng), controller(options)
        mpc.solve(**given, iterations=iterations)
        optimum = oracle.solve(**given, u=mpc.u_plan)
        assert optimum.solved and mpc.ok
        np.testing.assert_allclose(mpc.u_plan, optimum.u, rtol=0, atol=1e-6)
        active += is_active(mpc) if is_active else optimum.active
    assert active >= 2


FAST = dict(velocity_mps=(-0.9, 0.9))
STEADY = dict(delta_bounds=dict(acceleration_mps2=(-0.25, 0.25)))


@pytest.mark.nightly(keep=2)
@pytest.mark.parametrize(("bounds", "changes"), [(FAST, {}), ({}, STEADY), ({}, {})])
def test_a_first_plan_of_nothing_is_not_kept_where_the_bounds_exclude_it(bounds, changes):
    """Nor is a plan that `update` leaves beyond the bounds: each is cheaper than what they allow.

    The cart has to be pushed away from where it should be.
    """
    rng = np.random.default_rng(0)
    for _ in range(2):
        side, nearest, width = rng.choice([-1, 1]), *rng.uniform(0.05, 0.3, 2)
        pushed = dict(acceleration_mps2=np.sort([side * nearest, side * (nearest + width)]))
        options = CART | changes | dict(bounds=bounds | pushed)
        given = dict(x=(0.0, 0.0), p=(0.0,), x_ref=(0.0, 0.0))
        solved, live, updated = (controller(options) for _ in range(3))
        solved.solve(**given)
        live.step(**given)
        updated.update(bounds=bounds | dict(acceleration_mps2=(-1, 1)))
        updated.solve(**given, u_ref=-side)
        updated.update(bounds=bounds | pushed)
        updated.solve(**given, u_before=(side * nearest,) if changes else None)
        optimum = PlanProblem(options).solve(**given, u=solved.u_plan)
        assert optimum.solved
        for mpc in (solved, live, updated):
            assert mpc.ok
            low, high = pushed["acceleration_mps2"]
            assert low <= mpc.u_plan.min() and mpc.u_plan.max() <= high
            np.testing.assert_allclose(mpc.u_plan, optimum.u, rtol=0, atol=1e-6)


def test_ok_and_converged_tell_how_far_the_optimum_is():
    """Of plans of ever more iterations, from rest before an obstacle: one that IPOPT improves much
    is neither; it is `ok` before it is converged. The first feedback is iterated.
    """
    given = obstacle_instance(np.random.default_rng(7))
    mpc, oracle = controller(OBSTACLE), PlanProblem(OBSTACLE)
    flags = []
    for iterations in (4, 8, 15, 18, 24, 27):
        mpc.restart()
        mpc.solve(**given, iterations=iterations)
        error = np.abs(mpc.u_plan - oracle.solve(**given, u=mpc.u_plan).u).max()
        assert (mpc.ok, mpc.converged) == (error < 0.1, error < 1e-5)
        assert mpc.ok == (mpc.status == "") and (mpc.ok or "iterations" in mpc.status)
        flags.append(mpc.ok + mpc.converged)
    assert flags == [0, 0, 1, 1, 2, 2]
    live = controller(OBSTACLE)
    live.step(**given)
    np.testing.assert_allclose(live.u_plan, mpc.u_plan, rtol=0, atol=1e-6)
    mpc.step(**given)
    assert mpc.ok and not mpc.converged  # of a single step that is not known


def test_full_weights_and_outputs_are_the_same_cost_in_other_words():
    """(x + y/3)² as a matrix, and as an output; qn and qn_factor; y_ref as x_ref."""
    given = dict(x=(1.0, 0.2), p=(0.0,), x_ref=(0.0, 0.0), u_ref=(0.0,))
    # Singular, and symmetric but for rounding.
    weight = np.array([[1.0, 1 / 3 + 1e-16], [1 / 3, 1 / 9]])
    matrix = controller(CART, q=weight, qn_factor=3.0)
    matrix.solve(**given, iterations=2)
    total = dict(total=lambda x, u, p: x[0] + x[1] / 3)
    output = controller(CART, q=(0.0, 0.0), outputs=total, q_y=(1.0,), qn_factor=3.0)
    output.solve(**given, iterations=2)
    end = controller(CART, q=weight, qn=3 * weight)
    end.solve(**given, iterations=2)
    for other in (output, end):
        np.testing.assert_allclose(other.u_plan, matrix.u_plan, rtol=0, atol=1e-7)
    moved = dict(given, x=(1.3, 0.2), x_ref=(0.3, 0.0))
    output.restart()
    output.solve(**moved, y_ref=(0.3,), iterations=2)
    np.testing.assert_allclose(output.u_plan, matrix.u_plan, rtol=0, atol=1e-7)


def test_terminal_bounds_hold_at_the_end_alone():
    given = dict(x=(1.0, 0.0), p=(0.0,), x_ref=(0.0, 0.0), u_ref=(0.0,))
    free = controller(CART)
    free.solve(**given, iterations=2)
    end = controller(CART, terminal_bounds=dict(velocity_mps=(-0.01, 0.01), position_m=(0.3, 9)))
    end.solve(**given, iterations=2)
    assert end.ok and abs(end.x_plan[1, -1]) <= 0.01 + 1e-9 and end.x_plan[0, -1] >= 0.3 - 1e-9
    assert end.x_plan[1].min() < -0.1 and free.x_plan[0, -1] < 0.3


def test_numbers_change_between_samples_without_a_new_controller():
    """And afterwards it is the controller that was made with them."""
    given = dict(x=(2.0, 0.0), p=(0.0,), x_ref=(0.0, 0.0), u_ref=(0.0,))
    tight = CART["bounds"] | dict(velocity_mps=(-0.3, INF))
    changed, fresh = controller(CART), controller(CART, bounds=tight, q=(2.0, 0.1), r=(0.1,))
    phases = changed.iteration.phases
    changed.update(bounds=tight, q=(2.0, 0.1), r=(0.1,))
    for mpc in (changed, fresh):
        mpc.solve(**given, iterations=2)
    np.testing.assert_array_equal(changed.u_plan, fresh.u_plan)
    assert changed.iteration.phases is phases
    plain = controller(CART, bounds=None)
    plain.update(bounds=dict(acceleration_mps2=(-0.1, 0.1)))
    assert plain.feedback(**given) == -0.1
    assert changed.bounds == tight and plain.bounds == dict(acceleration_mps2=(-0.1, 0.1))


def test_what_an_input_of_the_reference_does_to_an_output_counts_at_once():
    """Of a linear model one feedback is the optimum, also where such an input has just changed."""
    linear = rhec.Model(states="x", inputs=("push", "wind"), f=lambda x, u, p: u[0] + u[1])
    options = dict(model=linear, command="push", q=(0.0,), r=(1.0,), dt=0.5, horizon=4)
    options |= dict(outputs=dict(y=lambda x, u, p: x[0] + 2 * u[1]), q_y=(3.0,))
    before, fresh = controller(options), controller(options)
    before.step((1.0,), u_ref=(0.0, 0.0))
    before.prepare()
    windy = dict(x=(1.0,), u_ref=(0.0, 0.4))
    np.testing.assert_allclose(before.feedback(**windy), fresh.solve(**windy), rtol=1e-9)
