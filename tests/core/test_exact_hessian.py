"""The exact Hessian of a controller: the right one, Newton's convergence, and IPOPT's plan.

The oracle is CasADi's Hessian of the cost of a plan as a function of its commands alone.
"""

import casadi as ca
import numpy as np
import pytest

import rhec
from rhec.workbench.studies import gallery
from rhec.workbench.studies.ipopt_plans import Reference, next_state

FREE = {"bounds": None, "horizon": 12}  # the pendulum without bounds, and few intervals


def pendulum(hessian, **changes):
    """The controller of a pendulum on a cart, which hangs down."""
    return rhec.RHC(**(gallery.pendulum().options | changes), hessian=hessian)


def two_inputs(hessian, **changes):
    """A unicycle with an unknown share of its speed, far from its references."""
    model = rhec.Model(
        states=("x", "y", "theta"), inputs=("v", "w"), parameters={"share": (0.5, 1.0)},
        outputs=("x", "y"),
        f=lambda x, u, p: [p[0] * u[0] * ca.cos(x[2]), p[0] * u[0] * ca.sin(x[2]), u[1]],
    )  # fmt: skip
    options = dict(command=("w", "v"), q=(1.0, 2.0, 0.1), r=(0.5, 0.3), dt=0.2, horizon=8)
    return rhec.RHC(model=model, **(options | changes), hessian=hessian)


def cost_of(rhc, x, p, x_ref, u_ref):
    """The cost of commands (n_c·N,), interval by interval, as a Function, with its derivatives."""
    problem = rhc.problem
    weights = {name: ca.diag(ca.DM(rhc.settings[name])) for name in ("Q", "QN", "R")}
    x_ref = ca.DM(x_ref)
    u_ref = ca.DM(u_ref)
    step = next_state(problem.model, problem.dt_s)
    commands = ca.SX.sym("u", len(problem.command), problem.N)
    cost = 0
    node = ca.SX(ca.DM(x))
    for i in range(problem.N):
        u = ca.SX(u_ref[:, i])
        u[list(problem.command)] = commands[:, i]
        off = u - u_ref[:, i]
        cost += ca.bilin(weights["R"], off[list(problem.command)], off[list(problem.command)]) / 2
        node = step(node, u, p)
        of_node = weights["Q" if i < problem.N - 1 else "QN"]
        cost += ca.bilin(of_node, node - x_ref[:, i + 1], node - x_ref[:, i + 1]) / 2
    hessian, gradient = ca.hessian(cost, ca.vec(commands))
    return ca.Function("cost", [ca.vec(commands)], [cost, gradient, hessian])


def newton_step(rhc, x, p, x_ref, u_ref, u):
    """The change of the commands (n_c·N,) by one step from the inputs u, and whether it is ok."""
    rhc.restart(u_plan=u)
    rhc._set_problem(x, p, x_ref, u_ref, None)
    rhc.iteration.feedback()
    command = list(rhc.problem.command)
    return (rhc.u_plan - u)[command].ravel(order="F"), rhc.ok


def test_a_batch_gives_the_same_bits():
    """Three robots swing up. It comes first: later tests take CasADi's virtual machine."""
    problem = gallery.pendulum()
    make = lambda: rhec.RHC(**(problem.options | dict(horizon=15)), hessian="exact")  # noqa: E731
    singles = [make() for _ in range(3)]
    batch = rhec.batch(make(), 3)
    step = next_state(problem.options["model"], problem.options["dt"])
    rng = np.random.default_rng(0)
    x = problem.start + rng.uniform(-0.5, 0.5, (3, 4))
    x_ref = np.zeros((4, 16))
    u_ref = np.zeros((1, 15))
    for _ in range(10):
        batch.prepare()
        found = batch.feedback(x, np.zeros((3, 0)), x_ref, u_ref)
        for single in singles:
            single.prepare()
        expected = [single.feedback(x[i], [], x_ref, u_ref) for i, single in enumerate(singles)]
        np.testing.assert_array_equal(found, expected)
        x = np.array([step(x[i], u, []).full().ravel() for i, u in enumerate(found)])


@pytest.mark.parametrize("make, start, p", [
    (two_inputs, (0.3, -0.2, 0.4), [0.8]),
    (lambda h: pendulum(h, **FREE), (0.1, 0.6, 0.0, 0.3), []),
])  # fmt: skip
def test_the_matrix_of_a_step_is_the_hessian_of_the_cost(make, start, p, virtual_machine):
    """To 1e-9. References of the commands move the gradient alone, and so show all columns."""
    rhc = make("exact")
    rng = np.random.default_rng(0)
    problem = rhc.problem
    x_ref = np.tile(0.1 * rng.normal(size=(problem.n_x, 1)), problem.N + 1)
    u = 0.3 * rng.normal(size=(problem.n_u, problem.N))
    u_ref = np.zeros((problem.n_u, problem.N))
    n = len(problem.command) * problem.N
    columns = []
    for place in [None, *range(n)]:
        moved = u_ref.copy()
        if place is not None:
            which = problem.command[place % len(problem.command)]
            moved[which, place // len(problem.command)] = 1.0
        change, ok = newton_step(rhc, start, p, x_ref, moved, u)
        assert ok
        columns.append(change)
    response = np.array(columns[1:]).T - columns[0][:, None]  # H⁻¹ R
    of_inputs = np.diag(np.tile(rhc.settings["R"], problem.N))
    _, gradient, hessian = cost_of(rhc, start, p, x_ref, u_ref)(
        u[list(problem.command)].ravel(order="F")
    )
    gradient = gradient.full().ravel()
    hessian = hessian.full()
    assert np.linalg.eigvalsh(hessian)[0] > 0
    found = of_inputs @ np.linalg.inv(response)
    assert np.abs(found - hessian).max() <= 1e-9 * np.abs(hessian).max()
    newton = -np.linalg.solve(hessian, gradient)
    assert np.abs(columns[0] - newton).max() <= 1e-9 * np.abs(newton).max()
    gauss_newton, _ = newton_step(make("gauss_newton"), start, p, x_ref, u_ref, u)
    assert np.abs(gauss_newton - newton).max() > 1e-3 * np.abs(newton).max()


def iterations_to(rhc, solution, tolerance, given, u_plan):
    """How many iterations from a plan bring the inputs within a tolerance of the solution."""
    for iterations in range(1, 300):
        rhc.restart(u_plan=u_plan)
        rhc.solve(**given, iterations=iterations)
        if np.abs(rhc.u_plan - solution).max() <= tolerance:
            return iterations
    raise AssertionError("it did not converge")


def test_it_converges_quadratically_and_to_the_plan_of_ipopt(virtual_machine):
    """A Furuta pendulum that swings up stays far from its reference: Gauss-Newton is slow.

    Beside the solution, Gauss-Newton's steps lead away from it. The line search then stops them.
    """
    problem = gallery.furuta()
    start = problem.start + np.random.default_rng(2).uniform(-0.5, 0.5, 4)
    given = dict(x=start, p=[], x_ref=problem.goal, u_ref=[0.0])
    exact, gauss_newton = (
        rhec.RHC(**problem.options, hessian=hessian) for hessian in ("exact", "gauss_newton")
    )
    exact.solve(**given, iterations=300)
    assert exact.converged
    solution = exact.u_plan
    reference = Reference(problem.options).solve(start, problem.goal, solution)
    assert reference.solved
    assert np.abs(solution - reference.u).max() <= 1e-7
    near = solution + 1e-3 * np.random.default_rng(0).normal(size=solution.shape)
    assert iterations_to(exact, solution, 1e-10, given, near) <= 6
    assert iterations_to(gauss_newton, solution, 1e-5, given, near) >= 20


def test_where_the_hessian_has_no_minimum_it_goes_on_by_gauss_newton(virtual_machine):
    """A pendulum that is asked to stand, and hangs: far from the solution no step may fail."""
    problem = gallery.pendulum()
    rhc = rhec.RHC(**problem.options, hessian="exact")
    reference = Reference(problem.options)
    for seed in range(3):
        start = problem.start + np.random.default_rng(seed).uniform(-0.5, 0.5, 4)
        x_ref = np.tile(np.reshape(problem.goal, (4, 1)), 41)
        _, _, hessian = cost_of(rhc, start, [], x_ref, np.zeros((1, 40)))(np.zeros(40))
        assert np.linalg.eigvalsh(hessian.full())[0] < 0
        rhc.restart()
        rhc.solve(start, [], problem.goal, [0.0], iterations=300)
        assert rhc.ok and rhc.converged
        near = reference.solve(start, problem.goal, rhc.u_plan)
        assert np.abs(rhc.u_plan - near.u).max() <= 1e-6 * 80.0


@pytest.mark.parametrize("changes, sentence", [
    (dict(hessian="newton"), "hessian"),
    (dict(bounds={"p_m": (-1.0, 1.0)}), "hessian was 'exact'"),
    (dict(r_delta=(0.1,)), "hessian was 'exact'"),
    (dict(q=np.diag([1.0, 1.0, 1.0, 1.0])), "hessian was 'exact'"),
])  # fmt: skip
def test_what_it_cannot_do_is_refused_in_a_sentence(changes, sentence, virtual_machine):
    with pytest.raises(ValueError, match=sentence) as error:
        rhec.RHC(**(gallery.pendulum().options | dict(hessian="exact") | changes))
    assert "\n" not in str(error.value)
