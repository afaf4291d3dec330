"""Runs in a batch are what objects of their own would be, to the last bit."""

import copy
import functools
import pickle

import casadi as ca
import numpy as np
import pytest
from helpers import controller, estimator, model, no_compiler
from robots import DT, ROBOTS, SKID_STEERED, VARIANTS

import rhec
from rhec.core._casadi import cache
from rhec.core.lanes import lanes

RUNS = 11  # not a multiple of any number of lanes
N = 3  # intervals; more of them only compile longer
SAMPLES = 24
CHOSEN = ("skid_steered", "with_track_width", "skid_with_gyro")
ABSURD = (np.nan, np.inf, -np.inf, 1e300, -1e9, 5e-324, 0.0)


def guess_of(robot):
    """A first guess within the bounds: the middle of the range that is drawn from."""
    middle = np.mean(robot.p_range, axis=0)
    return (*np.zeros(len(robot.states)), *np.clip(middle, *limits(robot)))


def limits(robot):
    pairs = [bounds or (-np.inf, np.inf) for bounds in robot.parameters.values()]
    return np.transpose(pairs) if pairs else (-np.inf, np.inf)


def measurements(robot, seed=0):
    """z (samples, runs, n_z): random, some missing, and a few runs with absurd ones."""
    rng = np.random.default_rng(seed)
    z = rng.normal(size=(SAMPLES, RUNS, len(robot.outputs)))
    z[rng.random(z.shape) < 0.1] = np.nan
    bad = rng.random(z.shape) < 0.3
    bad[:, 3:] = False
    z[bad] = rng.choice(ABSURD, bad.sum())
    return z


def filter_of(robot):
    settings = dict(dt=DT, guess=guess_of(robot)) | robot.estimator
    return rhec.EKF(model=model(robot), **settings)


@functools.cache
def in_turn(make, samples, restarted_at):
    """What objects of their own find: a list of results by sample, each a list by run.

    The first five runs begin anew at the sample `restarted_at`.
    """
    objects = [make() for _ in range(RUNS)]
    found = []
    for k in range(SAMPLES):
        if k == restarted_at:
            objects[:5] = [make() for _ in range(5)]
        found.append([one(objects[run], samples(k, run)) for run in range(RUNS)])
    return found


def one(single, arguments):
    single.prepare()
    result = single.feedback(*arguments)
    parts = [*result] if isinstance(result, tuple) else [result]
    return [*parts, *([single.ok, single.kkt] if hasattr(single, "kkt") else [])]


def assert_same_bits(batch, make, samples, restarted_at=9, **tolerance):
    """`samples(k, run)` are the arguments of a sample; `run` may be a slice."""
    expected = in_turn(make, samples, restarted_at)
    for k in range(SAMPLES):
        if k == restarted_at:
            batch.restart(range(5))
        found = one(batch, samples(k, slice(None)))
        for part, runs in zip(found, zip(*expected[k])):
            np.testing.assert_allclose(part, np.array(runs), **dict(rtol=0, atol=0) | tolerance)


class Problem:
    """Makers and samples of a robot, which `functools.cache` can tell apart."""

    def __init__(self, name):
        self.robot = (ROBOTS | VARIANTS)[name]
        self.z = measurements(self.robot)
        self.is_noisy = name == "skid_steered"
        rng = np.random.default_rng(1)
        shape = (SAMPLES, RUNS)
        n_x, n_u = len(self.robot.states), len(self.robot.inputs)
        self.x = rng.normal(size=(*shape, n_x))
        self.p = rng.uniform(*self.robot.p_range, size=(*shape, len(self.robot.parameters)))
        self.x_ref = rng.normal(size=(*shape, n_x, N + 1))
        self.u_ref = rng.normal(size=(*shape, n_u, N))
        self.x[5:8, 0] = np.nan
        self.x[12, 1] = 1e300
        self.sigma_w = self.robot.sigma_w * rng.uniform(0.3, 9.0, (*shape, len(self.robot.sigma_w)))

    def make_rhe(self):
        options = dict(horizon=N, arrival_mean="smoothed", noise_in_window=self.is_noisy)
        return estimator(self.robot, guess_of(self.robot), **options)

    def make_ekf(self):
        return filter_of(self.robot)

    def make_rhc(self):
        return controller(self.robot, horizon=N)

    def readings(self, k, run):
        return (self.z[k, run],)

    def noisy_readings(self, k, run):
        return (self.z[k, run], self.sigma_w[k, run]) if self.is_noisy else (self.z[k, run],)

    def wishes(self, k, run):
        return tuple(each[k, run] for each in (self.x, self.p, self.x_ref, self.u_ref))


@functools.cache
def problem(name):
    made = Problem(name)
    # Bound once, so that `in_turn` recognises them.
    for method in ("make_rhe", "make_ekf", "make_rhc", "readings", "noisy_readings", "wishes"):
        setattr(made, method, getattr(made, method))
    return made


@pytest.mark.nightly(keep=1)
@pytest.mark.parametrize("name", CHOSEN)
def test_estimators(name):
    """With bounds by a formula or by pivoting, with held inputs; bad samples; runs begun anew.
    One robot has noise in the window, of each run and sample its own.
    """
    given = problem(name)
    batch = rhec.batch(given.make_rhe(), RUNS)
    assert_same_bits(batch, given.make_rhe, given.noisy_readings)
    assert not batch.ok.all()


CART = ROBOTS["cart"]


def noisy():
    """Maker and samples of RHEs with noise in the window, of each run and sample its own."""
    z, rng = measurements(CART), np.random.default_rng(3)
    sigma_w = CART.sigma_w * rng.uniform(0.3, 9.0, size=(SAMPLES, RUNS, len(CART.sigma_w)))
    settings = dict(horizon=N, noise_in_window=True)

    def make():
        return estimator(CART, guess_of(CART), **settings)

    return make, lambda k, run: (z[k, run], sigma_w[k, run])


def bounded():
    """The same of RHEs whose states have bounds."""
    z = measurements(CART)
    at_a_wall = rhec.Model(**CART.model, state_bounds={"position_m": (-60.0, 0.9)})

    def make():
        settings = dict(dt=DT, horizon=N, guess=guess_of(CART)) | CART.estimator
        return rhec.RHE(model=at_a_wall, **settings)

    return make, lambda k, run: (z[k, run],)


@pytest.mark.nightly
@pytest.mark.parametrize("kind", [noisy, bounded])
def test_estimators_with_noise_in_the_window_or_bounds_of_states(kind):
    make, samples = kind()
    assert_same_bits(rhec.batch(make(), RUNS), make, samples)


def test_controllers():
    """Of all runs the bounds matter, and one has no finite state for a while."""
    given = problem("skid_steered")
    batch = rhec.batch(given.make_rhc(), RUNS)
    assert_same_bits(batch, given.make_rhc, given.wishes)
    bounds = np.array([*SKID_STEERED.bounds.values()])
    assert np.isin(batch.u_plan, bounds).any(axis=(1, 2)).all()


def pendulum_controller():
    """A cart of 1 kg with a pendulum of 0.1 kg and 0.8 m, as acados' examples have it."""

    def f(x, u, p):
        _, theta, v, w = ca.vertsplit(x)
        sin, cos = ca.sin(theta), ca.cos(theta)
        mass = 1.1 - 0.1 * cos**2
        a = (-0.08 * sin * w**2 + 0.981 * cos * sin + u) / mass
        turn = (-0.08 * cos * sin * w**2 + u * cos + 10.791 * sin) / (0.8 * mass)
        return ca.vertcat(v, w, a, turn)

    pendulum = rhec.Model(
        states=("p_m", "theta_rad", "v_mps", "w_radps"),
        inputs=("force_N",),
        parameters={},
        outputs=("p_m",),
        f=f,
    )
    weights = dict(q=(2e3, 2e3, 2e-2, 2e-2), r=(2e-2,), qn_factor=1.0)
    bounds = dict(force_N=(-80.0, 80.0))
    return rhec.RHC(
        model=pendulum, command=("force_N",), bounds=bounds, dt=0.05, horizon=40, **weights
    )


def swing_up_state(k, run):
    """States (samples, runs, 4) that no plan expects, so that its active set is far off."""
    x = np.random.default_rng(2).normal(size=(SAMPLES, RUNS, 4)) * (1.0, 3.0, 2.0, 2.0)
    return x[k, run], np.zeros((*x[k, run].shape[:-1], 0)), np.zeros((4, 41)), np.zeros((1, 40))


@pytest.mark.nightly
def test_runs_whose_active_set_takes_few_guesses_or_very_many():
    batch = rhec.batch(pendulum_controller(), RUNS)
    assert_same_bits(batch, pendulum_controller, swing_up_state)
    assert batch.ok.any() and not batch.ok.all()
    np.testing.assert_array_equal(np.isfinite(batch.kkt), batch.ok)


def constrained_cart():
    """A cart with a hard bound of its speed, a soft one of an output, and weights of changes."""
    cart = rhec.Model(
        states=("position_m", "velocity_mps"),
        inputs=("acceleration_mps2",),
        parameters={"bias_mps2": None},
        outputs=("position_m",),
        f=lambda x, u, p: ca.vertcat(x[1], u[0] - p[0]),
    )
    soft = rhec.Bound(-2.0, 2.0, linear=1.0)
    bounds = dict(acceleration_mps2=(-1, 1), velocity_mps=(-0.5, 0.6), square_m2=soft)
    return rhec.RHC(
        model=cart, command=cart.inputs, q=(1.0, 0.2), r=(0.3,), r_delta=(0.1,), dt=0.2, horizon=3,
        bounds=bounds, outputs=dict(square_m2=lambda x, u, p: x[0] ** 2),
    )  # fmt: skip


def cart_samples(k, run):
    """Some runs cannot keep their bounds, and one has no finite state for a while."""
    rng = np.random.default_rng(3)
    x = rng.uniform((-3.0, -1.0), (3.0, 1.0), size=(SAMPLES, RUNS, 2))
    x[5:8, 0] = np.nan
    p = rng.uniform(-0.1, 0.1, size=(SAMPLES, RUNS, 1))
    return x[k, run], p[k, run], np.zeros((2, 4)), np.zeros((1, 3))


def test_changes_are_counted_from_the_inputs_that_were_applied():
    """Of each run its own, of some it is not known; from the first sample on."""
    batch = rhec.batch(constrained_cart(), RUNS)
    singles = [constrained_cart() for _ in range(RUNS)]
    applied = np.random.default_rng(4).uniform(-1, 1, size=(SAMPLES, RUNS, 1))
    applied[:, ::3] = np.nan
    for k in range(3):
        found = batch.feedback(*cart_samples(k, slice(None)), u_before=applied[k])
        for run, single in enumerate(singles):
            single.prepare()
            expected = single.feedback(*cart_samples(k, run), u_before=applied[k, run])
            np.testing.assert_array_equal(found[run], expected)
    unlike = [
        rhec.batch(constrained_cart(), RUNS).feedback(*cart_samples(0, slice(None)), u_before=each)
        for each in (None, [0.9])
    ]
    assert not np.array_equal(*unlike)
    with pytest.raises(ValueError, match=r"^u_before had shape \(2,\); it should have \(11, 1\)"):
        batch.feedback(*cart_samples(0, slice(None)), u_before=np.zeros(2))


@pytest.mark.nightly
def test_controllers_with_constraints():
    batch = rhec.batch(constrained_cart(), RUNS)
    assert_same_bits(batch, constrained_cart, cart_samples)
    assert batch.ok.any() and not batch.ok.all()
    batch = rhec.batch(constrained_cart(), RUNS)
    singles = [constrained_cart() for _ in range(RUNS)]
    for k in (0, 1, 2):
        found = batch.solve(*cart_samples(k, slice(None)), iterations=7)
        for run, single in enumerate(singles):
            single.prepare()
            expected = single.solve(*cart_samples(k, run), iterations=7)
            np.testing.assert_array_equal(found[run], expected)
    with pytest.raises(ValueError, match="^y_ref had shape"):
        batch.feedback(*cart_samples(0, slice(None)), y_ref=np.zeros(3))


def test_iterated_to_convergence():
    given = problem("skid_steered")
    batch, single = rhec.batch(given.make_rhc(), RUNS), given.make_rhc()
    found = batch.solve(*given.wishes(10, slice(None)), iterations=7)
    assert np.array_equal(found[4], single.solve(*given.wishes(10, 4), iterations=7))
    batch, single = rhec.batch(given.make_rhe(), RUNS), given.make_rhe()
    for k in (0, 1):
        batch.prepare()
        single.prepare()
        found = batch.solve(given.z[k], iterations=7)
        np.testing.assert_array_equal(found.x[4], single.solve(given.z[k, 4], iterations=7).x)


@pytest.mark.nightly(keep=1)
@pytest.mark.parametrize("what", ["rhe", "rhc", "ekf"])
def test_without_lanes_it_is_the_same_and_says_so(what, monkeypatch, capsys):
    given = problem("skid_steered")
    make, samples = (
        getattr(given, f"make_{what}"),
        given.wishes if what == "rhc" else given.readings,
    )
    monkeypatch.setattr(lanes, "cpp_compiler", lambda: None)
    lanes.load.cache_clear()
    cache.warn_once.cache_clear()
    batch = rhec.batch(make(), RUNS)
    rhec.batch(make(), 3)
    lines = capsys.readouterr().err.splitlines()
    assert [line.startswith("rhec: no SIMD lanes") for line in lines] == [True], lines
    assert repr(batch).endswith("Batch: 11 runs, one after the other")
    assert_same_bits(batch, make, samples)
    lanes.load.cache_clear()


@pytest.mark.nightly
def test_without_a_compiler_it_is_the_same_up_to_rounding():
    given = problem("skid_steered")
    in_turn(given.make_rhe, given.readings, 9)
    with no_compiler(), pytest.MonkeyPatch.context() as patch:
        patch.setattr(lanes, "cpp_compiler", lambda: None)
        lanes.load.cache_clear()
        batch = rhec.batch(given.make_rhe(), RUNS)
        expected = in_turn(given.make_rhe, given.readings, 9)
        for k in range(9):
            found = batch.feedback(given.z[k])
            x, ok = (np.array([run[i] for run in expected[k]]) for i in (0, -2))
            np.testing.assert_array_equal(batch.ok, ok)
            np.testing.assert_allclose(found.x, x, rtol=1e-6, atol=1e-8)
    lanes.load.cache_clear()


def test_an_absurd_run_does_not_affect_the_others():
    given = problem("skid_steered")
    batches = [rhec.batch(given.make_rhe(), RUNS) for _ in range(2)]
    for k in range(SAMPLES):
        z = given.z[k].copy()
        good = batches[0].feedback(z)
        z[::2] = np.resize(ABSURD, z[::2].shape)
        disturbed = batches[1].feedback(z)
        for part, other in zip(good, disturbed):
            np.testing.assert_array_equal(part[1::2], other[1::2])


def test_what_all_runs_share_may_be_given_once():
    given = problem("skid_steered")
    batches = [rhec.batch(given.make_rhc(), RUNS) for _ in range(2)]
    x, p, x_ref, u_ref = given.wishes(10, slice(None))
    once = batches[0].feedback(x, p[0], x_ref[0], u_ref[0])
    repeated = (np.array([each[0]] * RUNS) for each in (p, x_ref, u_ref))
    np.testing.assert_array_equal(once, batches[1].feedback(x, *repeated))


def test_the_object_keeps_its_memory_and_the_batch_begins_anew():
    given = problem("skid_steered")
    for make in (given.make_rhe, given.make_ekf):
        used, fresh, other = make(), make(), make()
        for each in (used, other):
            each.feedback(given.z[0, 4])
            each.prepare()
        batch = rhec.batch(used, 2)
        np.testing.assert_array_equal(
            batch.feedback(given.z[1, 4:6]).x[0], fresh.feedback(given.z[1, 4]).x
        )
        np.testing.assert_array_equal(
            used.feedback(given.z[1, 4]).x, other.feedback(given.z[1, 4]).x
        )


def test_two_batches_of_one_problem_do_not_meet():
    given = problem("skid_steered")
    first, second = (rhec.batch(given.make_rhe(), n) for n in (RUNS, 3))
    for k in range(9):
        found = first.feedback(given.z[k])
        second.feedback(-given.z[k, :3])
    expected = in_turn(given.make_rhe, given.readings, 9)[8]
    np.testing.assert_array_equal(found.x, [run[0] for run in expected])


def refusals():
    """(the beginning of the sentence, the call)"""
    given = problem("skid_steered")
    x, p, x_ref, u_ref = given.wishes(0, slice(None))
    batch = rhec.batch(given.make_rhc(), RUNS)
    of_rhe, of_ekf = (rhec.batch(make(), RUNS) for make in (given.make_rhe, given.make_ekf))
    numbers = "was .*; it should be made of numbers"
    shape = r"^x had shape \(10, 3\); it should have \(11, 3\), or \(3,\) if it is the same"
    yield shape, lambda: batch.feedback(x[:10], p, x_ref, u_ref)
    yield "^x_ref had shape ", lambda: batch.feedback(x, p, x_ref[:, :, 1:], u_ref)
    yield f"^u_ref {numbers}", lambda: batch.feedback(x, p, x_ref, "none")
    dates = np.full(p.shape, "2026-11-23", dtype="datetime64[D]")
    for wrong in (p + 1j, dates):
        yield f"^p {numbers}", lambda: batch.feedback(x, wrong, x_ref, u_ref)
    yield "^z_N had shape ", lambda: of_rhe.feedback(np.zeros((RUNS, 9)))
    for runs in ([99], -12, 1.5, "all", np.ones(RUNS + 1, dtype=bool)):
        yield r"^runs was .* from 0 to 10, or a mask \(11,\)", lambda: of_ekf.restart(runs)
    for n in (0, -1, 2.5, "3", None):
        yield "^n was ", lambda: rhec.batch(given.make_rhc(), n)
    sentence = r"^source was .*; it should be a rhec\.RHC, rhec\.RHE or rhec\.EKF with a model"
    for source in (None, "rhc", given):
        yield f"{sentence}$", lambda: rhec.batch(source, 2)
    for source in (rhec.RHC(), rhec.RHE()):
        yield f"{sentence}; for the paper's, use rhec.campaign$", lambda: rhec.batch(source, 2)


def test_what_does_not_fit_is_refused_in_one_sentence():
    for sentence, call in refusals():
        with pytest.raises(ValueError, match=sentence):
            call()


@pytest.mark.parametrize("what", ["make_rhe", "make_rhc", "make_ekf"])
def test_what_holds_compiled_code_says_that_it_has_no_copy(what):
    single = getattr(problem("skid_steered"), what)()
    for each in (single, rhec.batch(single, RUNS)):
        for copied in (copy.deepcopy, pickle.dumps):
            with pytest.raises(TypeError, match="cannot be copied or pickled; make another one"):
                copied(each)
