"""Algebraic variables: models whose equations contain quantities that have no slope of their own.

The oracles are SUNDIALS' IDAS, the same model solved by hand for its algebraic variable, and IPOPT
with all stages as unknowns.
"""

import casadi as ca
import numpy as np
import pytest
from oracles import flat

import rhec
from rhec.core.model import base

G = 9.81


def pendulum(**options):
    """A pendulum in Cartesian coordinates; the tension is what keeps its length of 1 m."""

    def f(x, u, p, a):
        px, py, vx, vy = x
        ax = u[0] - a[0] * px
        ay = -p[0] - a[0] * py
        return [vx, vy, ax, ay], vx**2 + vy**2 + px * ax + py * ay

    names = dict(states=("x", "y", "vx", "vy"), inputs=("push",), parameters={"g": None})
    outputs = ("x", "y", "tension", "push")
    options = dict(rule="radau5", steps=2) | options
    return rhec.Model(**names, outputs=outputs, f=f, algebraic={"tension": 0.0}, **options)


def swinging(model=None, **options):
    """The same with the tension by hand."""

    def tension(x, u, p):
        px, py, vx, vy = ca.vertsplit(x)
        return (vx**2 + vy**2 + px * u[0] - py * p[0]) / (px**2 + py**2)

    def f(x, u, p):
        px, py, vx, vy = x
        a = tension(x, u, p)
        return [vx, vy, u[0] - a * px, -p[0] - a * py]

    names = dict(states=("x", "y", "vx", "vy"), inputs=("push",), parameters={"g": None})
    outputs = ("x", "y", "tension", "push")
    options = dict(rule="radau5", steps=2) | options
    return rhec.Model(**names, outputs=outputs, f=f, h=tension, **options)


def tank(**options):
    """A tank whose level drives a flow through a pipe, of laminar and turbulent friction."""

    def f(x, u, p, a):
        return u[0] - a[0], p[0] * a[0] + p[1] * a[0] ** 2 - x[0]

    names = dict(states=("level",), inputs=("inflow",), outputs=("level", "flow", "inflow"))
    friction = {"laminar": (0.1, 3.0), "turbulent": (0.1, 5.0)}
    options = dict(rule="radau3") | options
    return rhec.Model(**names, parameters=friction, f=f, algebraic={"flow": 1.0}, **options)


def draining(**options):
    """The same with the flow by hand."""

    def flow(x, u, p):
        return (ca.sqrt(p[0] ** 2 + 4 * p[1] * x[0]) - p[0]) / (2 * p[1])

    names = dict(states=("level",), inputs=("inflow",), outputs=("level", "flow", "inflow"))
    friction = {"laminar": (0.1, 3.0), "turbulent": (0.1, 5.0)}
    options = dict(rule="radau3") | options
    f = dict(f=lambda x, u, p: u[0] - flow(x, u, p), h=flow)
    return rhec.Model(**names, parameters=friction, **f, **options)


X_PENDULUM = np.array([np.sin(1.0), -np.cos(1.0), 0.0, 0.0])
# Of each model: itself, the one by hand, a start, its parameters, the length of a sample.
PAIRS = {
    "pendulum": (pendulum, swinging, X_PENDULUM, [G], 0.05),
    "tank": (tank, draining, np.array([2.0]), [1.0, 1.5], 0.5),
}


def by_idas(model, x, u, p, dt):
    """States (n + 1, n_x) and the last algebraic variables, by SUNDIALS' IDAS."""
    sizes = dict(x=len(model.states), z=len(model.algebraic), p=len(model.inputs))
    symbols = {name: ca.SX.sym(name, size) for name, size in sizes.items()}
    ode, alg = model.f(*map(ca.vertsplit, (symbols["x"], symbols["p"], ca.DM(p), symbols["z"])))
    ode = ca.vertcat(*ode) if isinstance(ode, list) else ode
    options = dict(reltol=1e-11, abstol=1e-12)
    step = ca.integrator("step", "idas", symbols | dict(ode=ode, alg=alg), 0, dt, options)
    states, a = [x], ca.DM([*model.algebraic.values()])
    for row in u:
        end = step(x0=states[-1], z0=a, p=row)
        states.append(flat(end["xf"]))
        a = end["zf"]
    return np.array(states), flat(a)


@pytest.mark.parametrize("name", PAIRS)
def test_a_simulation_is_that_of_idas(name):
    make, _, x, p, dt = PAIRS[name]
    u = 0.3 + 0.2 * np.sin(np.arange(20.0))[:, None]
    model = make(rule="radau5", steps=4)
    states = model.simulate(x, u, p, dt=dt)
    expected, a = by_idas(model, x, u, p, dt)
    np.testing.assert_allclose(states, expected, atol=1e-8)
    np.testing.assert_allclose(model.consistent(states[-1], u[-1], p), a, atol=1e-7)
    # One step of third order is coarser, so that the comparison can fail.
    coarse = make(rule="radau3", steps=1).simulate(x, u, p, dt=dt)
    assert np.abs(coarse - expected).max() > 1e-6


@pytest.mark.parametrize("name", PAIRS)
@pytest.mark.parametrize("options", [dict(rule="radau3", steps=1), dict(rule="radau5", steps=2)])
def test_an_interval_and_its_derivatives_are_those_of_the_model_solved_by_hand(name, options):
    dae, ode, x, p, dt = PAIRS[name]
    s = np.array([*x, *p])
    intervals = [base.interval(make(**options), measured=False) for make in (dae, ode)]
    for pushed in (0.0, 0.7):
        (end, D, B), (end_0, D_0, B_0) = (
            [np.array(each) for each in interval.linearised(s, [pushed], dt)]
            for interval in intervals
        )
        np.testing.assert_allclose(end, end_0, rtol=1e-10, atol=1e-12)
        slopes, slopes_0 = (
            np.array(interval.A_0) + part for interval, part in zip(intervals, (D, D_0))
        )
        np.testing.assert_allclose(slopes, slopes_0, rtol=1e-8, atol=1e-10)
        np.testing.assert_allclose(B, B_0, rtol=1e-8, atol=1e-10)


def test_an_equation_need_not_contain_the_variable_of_its_place():
    """Two variables, each in the other's equation."""

    def f(x, u, p, a):
        first, second = a
        return [second - first], [x[0] - 2 * second, first + second**3 - u[0]]

    names = dict(states=("x",), inputs=("w",), parameters={}, outputs=("x",))
    start = {"first": 0.0, "second": 0.0}
    model = rhec.Model(**names, f=f, algebraic=start, rule="radau5")
    np.testing.assert_allclose(model.consistent([1.0], [0.5]), [0.5 - 0.125, 0.5], rtol=1e-12)
    by_hand = rhec.Model(**names, f=lambda x, u, p: x / 2 - (u - (x / 2) ** 3), rule="radau5")
    ends = [each.simulate([1.0], [[0.5], [0.2]], dt=0.3) for each in (model, by_hand)]
    np.testing.assert_allclose(*ends, rtol=1e-10)


NOISE = {
    "pendulum": dict(
        sigma_v=(0.01, 0.01, 0.2, 0.01), sigma_w=(0.0,) * 5, guess=(*X_PENDULUM, 9.0),
        sigma_guess=(0.1,) * 4 + (1.0,),
    ),
    "tank": dict(
        sigma_v=(0.01, 0.01, 0.01), sigma_w=(0.0,) * 3, guess=(1.9, 0.7, 1.2),
        sigma_guess=(0.3, 0.3, 0.3),
    ),
}  # fmt: skip


def samples_of(name, n, seed=0):
    """Noisy measurements (n, n_z) of states, algebraic variable and input, the first of no input.

    Every seventh of the algebraic variable is missing.
    """
    make, _, x, p, dt = PAIRS[name]
    rng = np.random.default_rng(seed)
    model = make()
    u = 0.3 + 0.2 * np.sin(np.arange(n))[:, None]
    states = model.simulate(x, u, p, dt=dt)[1:]
    z = [flat(model.measurement(state, row, p)) for state, row in zip(states, u)]
    z = np.array(z) + rng.normal(size=(n, len(model.outputs))) * NOISE[name]["sigma_v"]
    z[::7, -2] = np.nan
    return z


@pytest.mark.parametrize("name", PAIRS)
@pytest.mark.parametrize("iterated", [False, True])
def test_estimates_are_those_of_the_model_solved_by_hand(name, iterated, virtual_machine):
    """RHE and EKF; the algebraic variable is measured, and depends on an input."""
    dae, ode, _, p, dt = PAIRS[name]
    pairs = [(rhec.RHE(model=make(), dt=dt, horizon=5, **NOISE[name]), make) for make in (dae, ode)]
    filters = [rhec.EKF(model=make(), dt=dt, **NOISE[name]) for make in (dae, ode)]
    for z in samples_of(name, 25):
        estimates = []
        for mhe, _ in pairs:
            mhe.prepare()
            estimates.append(mhe.solve(z, 3) if iterated else mhe.feedback(z))
            assert mhe.ok
        for first, second in (estimates, [each.feedback(z) for each in filters]):
            np.testing.assert_allclose(first.x, second.x, rtol=1e-7, atol=1e-8)
            np.testing.assert_allclose(first.p, second.p, rtol=1e-7, atol=1e-8)
    guess = np.array(NOISE[name]["guess"])[len(first.x) :]
    assert np.linalg.norm(estimates[0].p - p) < np.linalg.norm(guess - p)


def plan_by_ipopt(dt, N, level, target, flow_most, friction=(1.0, 1.5)):
    """Inflows (N,) by IPOPT: each stage of Radau's rule of third order with unknowns of its own."""
    points = ca.collocation_points(2, "radau")
    C, _, weights = ca.collocation_coeff(points)
    unknowns = dict(u=ca.SX.sym("u", N), x=ca.SX.sym("x", N + 1), a=ca.SX.sym("a", 2, N))
    inner = ca.SX.sym("inner", 2, N)  # states of the stages
    cost = 0
    rows = [unknowns["x"][0] - level]
    for k in range(N):
        begin = unknowns["x"][k]
        nodes = ca.horzcat(begin, inner[:, k].T)
        a = unknowns["a"][:, k]
        slope = unknowns["u"][k] - a
        rows += [(nodes @ C).T - dt * slope, begin + dt * slope.T @ weights - unknowns["x"][k + 1]]
        rows.append(friction[0] * a + friction[1] * a**2 - inner[:, k])
        cost += (begin - target) ** 2 + 0.1 * unknowns["u"][k] ** 2
    cost += (unknowns["x"][N] - target) ** 2
    # Where the flow is bounded: at each node, with the inflow of its interval, but the first node.
    n_first = N + 1 + 2 * N + 2 * N
    x = ca.vertcat(*map(ca.vec, (*unknowns.values(), inner)))
    g = ca.vertcat(*map(ca.vec, rows))
    at_nodes = unknowns["a"][1, :].T
    lower = [0.0] * N + [-np.inf] * n_first
    upper = [1.0] * N + [np.inf] * n_first
    problem = dict(x=x, f=cost, g=ca.vertcat(g, at_nodes))
    quiet = {"print_time": 0, "ipopt": dict(print_level=0, sb="yes", tol=1e-11)}
    solver = ca.nlpsol("solver", "ipopt", problem, quiet | dict(ipopt=quiet["ipopt"]))
    n_g = g.numel()
    found = solver(
        x0=0.7, lbx=lower, ubx=upper, lbg=[0.0] * n_g + [-np.inf] * N,
        ubg=[0.0] * n_g + [flow_most] * N,
    )  # fmt: skip
    assert solver.stats()["success"]
    return flat(found["x"])[:N]


@pytest.mark.parametrize("flow_most", [np.inf, 0.45])
def test_a_plan_is_ipopts(flow_most, virtual_machine):
    """Fill a tank, without and with a bound of its flow, which the plan then reaches."""
    N, dt = 12, 0.5
    rhc = rhec.RHC(
        model=tank(), command=("inflow",), q=(1.0,), r=(0.1,), qn_factor=1.0, dt=dt, horizon=N,
        outputs=("flow",), bounds=dict(inflow=(0.0, 1.0), flow=(-10.0, min(flow_most, 10.0))),
    )  # fmt: skip
    rhc.solve(x=[0.3], p=[1.0, 1.5], x_ref=[1.0], u_ref=[0.0], iterations=100)
    assert rhc.ok and rhc.converged
    expected = plan_by_ipopt(dt, N, 0.3, 1.0, flow_most)
    np.testing.assert_allclose(rhc.u_plan[0], expected, atol=1e-6)
    flows = [rhc.problem.model.consistent([x], [0.0], [1.0, 1.5])[0] for x in rhc.x_plan[0]]
    assert (max(flows) > 0.449) and (np.isinf(flow_most) == (max(flows) > 0.4501))


def test_estimates_stay_finite_where_there_is_no_solution_and_find_back(virtual_machine):
    """Levels of -1 m are measured for a while. The equation of the flow has no solution there.

    After 30 rejected samples the window restarts and keeps to the lowest level that is allowed.
    """
    model = tank(state_bounds={"level": (0.0, 10.0)})
    mhe = rhec.RHE(model=model, dt=0.5, horizon=5, **NOISE["tank"])
    good = samples_of("tank", 70)
    oks = []
    for k, z in enumerate(good):
        mhe.prepare()
        estimate = mhe.feedback([-1.0, -1.0, 0.3] if 10 <= k < 50 else z)
        assert np.all(np.isfinite([*estimate.x, *estimate.p, *estimate.covariance.ravel()]))
        assert np.all(np.isfinite(model.consistent(estimate.x, [0.3], estimate.p)))
        oks.append(mhe.ok)
    assert all(oks[:10]) and not any(oks[10:40]) and all(oks[-10:])
    assert estimate.x[0] == pytest.approx(good[-1][0], abs=0.05)


def test_a_controller_where_there_is_no_solution_says_so(virtual_machine):
    rhc = rhec.RHC(
        model=tank(), command=("inflow",), q=(1.0,), r=(0.1,), dt=0.5, horizon=5,
        bounds=dict(inflow=(0.0, 1.0)),
    )  # fmt: skip
    given = dict(p=[1.0, 1.5], x_ref=[1.0], u_ref=[0.0])
    with pytest.raises(ValueError, match=r"no solution of g = 0 at x = \[-1.0\]"):
        rhc.feedback(x=[-1.0], **given)
    oks = []
    for x in (0.5, 0.5, -1.0, -1.0, 0.5, 0.5, 0.5):
        rhc.prepare()
        command = rhc.feedback(x=[x], **given)
        assert 0 <= command[0] <= 1
        oks.append(rhc.ok)
    # A feedback linearises at the previous plan: the next sample tells that the model has no end.
    assert oks[:2] == [True, True] and not oks[3] and oks[-1]
    rhc.solve(x=[-1.0], iterations=5, **given)
    assert not rhc.converged


def test_a_batch_has_the_bits_of_single_runs():
    runs, z = 5, samples_of("tank", 12)
    z = z[:, None, :] + 0.01 * np.random.default_rng(1).normal(size=(12, runs, 3))

    def make():
        return rhec.RHE(model=tank(), dt=0.5, horizon=4, **NOISE["tank"])

    batch, singles = rhec.batch(make(), runs), [make() for _ in range(runs)]
    for row in z:
        batch.prepare()
        together = batch.feedback(row)
        for i, single in enumerate(singles):
            single.prepare()
            alone = single.feedback(row[i])
            np.testing.assert_array_equal(together.x[i], alone.x)
            np.testing.assert_array_equal(together.p[i], alone.p)


@pytest.mark.parametrize(
    "changed, sentence",
    [
        (dict(rule="rk4"), "rule was 'rk4'; algebraic variables need an implicit rule: 'radau3'"),
        (dict(rule="rk4", discrete=True), "discrete was True; algebraic variables need"),
        (dict(algebraic=("flow",)), r"algebraic was \('flow',\); it should be a dict of names"),
        (dict(algebraic={"flow": None}), "the guess of 'flow' in algebraic was None; it should be"),
        (dict(algebraic={"flow": np.nan}), "the guess of 'flow' in algebraic was nan"),
        (dict(algebraic={"level": 1.0}), "'level' was twice in states, inputs, parameters, alg"),
        (dict(algebraic={"a b": 1.0}), "a name in states, inputs, parameters, algebraic was 'a b'"),
        (dict(f=lambda x, u, p, a: u[0] - a[0]), "f returned SX.*; it should map .* to a pair"),
        (dict(f=lambda x, u, p: (u, x)), r"f was refused .*expressions \(x, u, p, a\) to a pair"),
        (
            dict(f=lambda x, u, p, a: (u[0] - a[0], x[0] - u[0])),
            "the residual of f did not determine the algebraic variables flow; .* index 1",
        ),
        (
            dict(f=lambda x, u, p, a: (u[0], [a[0], a[0]])),
            r"the residual of f was .*, of shape \(2, 1\); it should be a column of 1",
        ),
        (dict(h=lambda x, u, p: x), r"h was refused .*\(x, u, p, a\)"),
    ],
)
def test_what_cannot_be_is_refused_in_a_sentence(changed, sentence):
    options = dict(
        states=("level",), inputs=("inflow",), parameters={}, outputs=("level", "flow", "inflow"),
        f=lambda x, u, p, a: (u[0] - a[0], a[0] + a[0] ** 2 - x[0]), algebraic={"flow": 1.0},
        rule="radau5",
    )  # fmt: skip
    with pytest.raises(ValueError, match=sentence):
        rhec.Model(**options | changed)


def test_a_start_without_a_solution_is_refused_in_a_sentence(virtual_machine):
    sentence = r"algebraic was {'flow': 1.0}; .* no solution of g = 0 at x = \[-3.0\], u = \[0.0\]"
    start = NOISE["tank"] | dict(guess=(-3.0, 0.7, 1.2))
    for make in (
        lambda: rhec.RHE(model=tank(), dt=0.5, horizon=5, **start),
        lambda: rhec.EKF(model=tank(), dt=0.5, **start),
        lambda: tank().simulate([-3.0], [[0.0]], [0.7, 1.2], dt=0.5),
        lambda: tank().consistent([-3.0], [0.0], [0.7, 1.2]),
    ):
        with pytest.raises(ValueError, match=sentence):
            make()


def test_a_model_without_algebraic_variables_has_none():
    assert draining().consistent([1.0], [0.0], [1.0, 1.5]).shape == (0,)
