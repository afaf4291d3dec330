"""What a Model and its estimator cannot be: one sentence for each."""

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


def test_the_limit_of_outputs_is_documented():
    assert "1e8" in rhec.Model.__doc__


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


def test_a_model_without_inputs_is_refused_where_it_cannot_be_used():
    model = rhec.Model(
        states=("x_m",), inputs=(), parameters={}, outputs=("x_m",), f=lambda x, u, p: -x
    )
    options = dict(dt=0.2, sigma_v=(0.1,), sigma_w=(0.1,), guess=(0.0,), sigma_guess=(1.0,))
    with pytest.raises(ValueError, match="model had no inputs"):
        rhec.RHE(model=model, horizon=5, **options)
