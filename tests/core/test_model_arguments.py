"""What a Model and its estimator cannot be: one sentence for each."""

import math

import casadi as ca
import numpy as np
import pytest

import rhec
from rhec.core._casadi import cache


def model_with(**changed):
    arguments = dict(
        states=("x_m",),
        inputs=("v_mps",),
        parameters=dict(slip=(0.1, 1.0)),
        outputs=("x_m", "v_mps"),
        f=lambda x, u, p: p[0] * u,
    )
    return rhec.Model(**(arguments | changed))


@pytest.mark.parametrize(
    "changed, sentence",
    [
        (dict(max_measurement=5), "max_measurement was 5; it should have 2 entries"),
        (dict(max_measurement="ab"), "max_measurement was 'ab'; it should have 2 entries"),
        (dict(max_measurement=(np.nan, 1.0)), "max_measurement was"),
        (dict(max_measurement=(-1.0, 1.0)), "max_measurement was"),
        (dict(parameters=dict(slip=(ca.SX.sym("a"), 1.0))), "the bounds of 'slip' were"),
        (dict(motion_noise=5), "motion_noise was 5; it should be a MotionNoise or None"),
    ],
)
def test_a_model_refuses_in_a_sentence(changed, sentence):
    with pytest.raises(ValueError, match=sentence.replace("(", r"\(")):
        model_with(**changed)


def test_a_guess_whose_variance_is_implausible_is_refused(virtual_machine):
    options = dict(dt=0.2, sigma_v=(0.1, 0.1), sigma_w=(0.0, 0.01), guess=(0.0, 0.5))
    for estimator in (rhec.RHE, rhec.EKF):
        more = dict(horizon=5) if estimator is rhec.RHE else {}
        with pytest.raises(ValueError, match="sigma_guess was .* each should be below 1e"):
            estimator(model=model_with(), sigma_guess=(1e7, 1.0), **options, **more)


def test_what_does_not_load_is_removed(tmp_path, monkeypatch):
    """A compiler may write nonsense and end with 0; once it is mended, all is built anew."""
    monkeypatch.setenv("RHEC_CACHE", str(tmp_path / "cache"))
    monkeypatch.setenv("TMPDIR", str(tmp_path / "other"))

    def build_with(text):
        return lambda folder: (folder / "library").write_text(text)

    def load(folder):
        text = (folder / "library").read_text()
        if text == "nonsense":
            raise RuntimeError("it does not load")
        return text

    with pytest.raises(cache.UnusableError):
        cache.load_or_build("name", build_with("nonsense"), load)
    assert cache.load_or_build("name", build_with("good"), load) == "good"
    assert (tmp_path / "cache/name").is_dir()
    assert not (tmp_path / "other").exists() or not list((tmp_path / "other").glob("*/name"))


def test_names_may_be_lists_or_a_single_name():
    f = lambda x, u, p: [x[1], u[0]]  # noqa: E731
    lists = rhec.Model(states=["x", "v"], inputs=["force"], outputs=["x"], f=f)
    words = rhec.Model(states=("x", "v"), inputs="force", outputs="x", f=f)
    assert lists == words and words.inputs == ("force",) and words.parameters == {}


def test_a_model_that_only_a_controller_sees_needs_no_outputs(virtual_machine):
    """And by default it commands all inputs, to 0, with Q as the terminal weight."""
    f = lambda x, u, p: [x[1], u[0]]  # noqa: E731
    seen = rhec.Model(states=("x", "v"), inputs="force", outputs="x", f=f)
    unseen = rhec.Model(states=("x", "v"), inputs="force", f=f)
    given = dict(q=[1.0, 0.1], r=[0.1], dt=0.1, horizon=10)
    short = rhec.RHC(model=unseen, **given)
    long = rhec.RHC(model=seen, command=("force",), qn=(1.0, 0.1), **given)
    long.prepare()
    expected = long.feedback(x=(1, 0), p=(), x_ref=np.zeros((2, 11)), u_ref=np.zeros((1, 10)))
    assert short.step((1, 0)) == expected
    noise = dict(sigma_v=(), sigma_w=(0, 0), guess=(0, 0), sigma_guess=(1, 1), dt=0.1)
    for estimator, options in ((rhec.RHE, dict(horizon=5)), (rhec.EKF, {})):
        with pytest.raises(ValueError, match=r"^outputs of the model was \(\); "):
            estimator(model=unseen, **noise, **options)


def test_a_function_that_gives_no_number_is_refused():
    """math.sin makes NaN of CasADi's symbols, silently; a function that may give NaN is allowed."""
    expected = "^f was .*, which is no number whatever x, u and p are; .* ca.sin in place of math"
    with pytest.raises(ValueError, match=expected):
        rhec.Model(states="x", f=lambda x, u, p: -x[0] + math.sin(x[0]))
    with pytest.raises(ValueError, match="^h was "):
        rhec.Model(states="x", outputs="y", f=lambda x, u, p: -x, h=lambda x, u, p: np.nan * x)
    rhec.Model(states="x", f=lambda x, u, p: -ca.sqrt(x[0]))


@pytest.mark.parametrize("bounds", [None, dict(x=(0.0, 5.0))])
@pytest.mark.parametrize("noise_in_window", [False, True])
def test_an_estimator_of_a_model_without_inputs(virtual_machine, bounds, noise_in_window):
    """Decay with an unknown rate: as the EKF finds it, within the noise."""
    model = rhec.Model(
        states="x", parameters=dict(k=(0.0, 2.0)), outputs="x", f=lambda x, u, p: -p[0] * x[0],
        state_bounds=bounds,
    )  # fmt: skip
    noise = dict(sigma_v=[0.01], sigma_w=[1e-4, 1e-4], guess=[1, 0.5], sigma_guess=[1, 1], dt=0.1)
    rhe = rhec.RHE(model=model, horizon=8, noise_in_window=noise_in_window, **noise)
    ekf = rhec.EKF(model=model, **noise)
    rng = np.random.default_rng(0)
    for k in range(30):
        z = [np.exp(-0.1 * k) + 0.01 * rng.normal()]
        estimates = rhe.step(z), ekf.step(z)
        assert rhe.ok and ekf.ok
    assert rhe.u_window.shape == (0, 8) and rhe.x_window.shape == (1, 9)
    for estimate in estimates:
        assert estimate.p[0] == pytest.approx(1.0, abs=3 * np.sqrt(estimate.covariance[1, 1]))
    assert estimates[0].p[0] == pytest.approx(estimates[1].p[0], abs=0.01)


def test_a_filter_whose_estimate_is_no_number_is_not_ok(virtual_machine):
    model = rhec.Model(states="x", outputs="x", f=lambda x, u, p: 1e4 * x)
    ekf = rhec.EKF(model=model, dt=1.0, sigma_v=[1], sigma_w=[1], guess=[1], sigma_guess=[1])
    ekf.step([1.0])
    assert ekf.ok
    for _ in range(9):
        ekf.step([np.nan])
    assert not ekf.ok


@pytest.mark.parametrize("bounds", [(-np.inf, np.inf), (-np.inf, 5.0), (0.0, np.inf)])
def test_an_infinite_bound_is_none(virtual_machine, bounds):
    options = dict(dt=0.2, sigma_v=(0.1, 0.1), sigma_w=(0.0, 0.01))
    options |= dict(guess=(0.0, 0.5), sigma_guess=(1.0, 1.0), horizon=5)
    estimates = []
    for slip in (bounds, None):
        estimator = rhec.RHE(model=model_with(parameters=dict(slip=slip)), **options)
        for k in range(10):
            estimator.prepare()
            estimate = estimator.feedback([0.1 * k, 0.6])
        assert estimator.kkt >= 0
        estimates.append([*estimate.x, *estimate.p])
    np.testing.assert_allclose(*estimates, rtol=1e-9)
