"""The public face: what it lists, what it loads, what help and the prompt show of it."""

import inspect
import subprocess
import sys

import casadi as ca
import pytest

import rhec

MODEL = rhec.Model(
    states=("x_m",),
    inputs=("v_mps",),
    parameters={"slip": (0, 1), "drift_mps": None},
    outputs=("x_m", "v_mps"),
    f=lambda x, u, p: ca.vertcat(u * (1 - p[0]) + p[1]),
)
SETTINGS = dict(
    model=MODEL,
    dt=0.2,
    sigma_v=(0.1, 0.1),
    sigma_w=(0.0, 0.01, 0.01),
    guess=(0.0, 0.1, 0.0),
    sigma_guess=(1.0, 0.1, 0.1),
)
MODEL_TEXT = """Model
    states:     x_m
    inputs:     v_mps
    parameters: slip in [0, 1], drift_mps
    outputs:    x_m, v_mps"""


def loaded_by(statement):
    """Names of the modules that a new process has loaded after a statement."""
    program = f"import rhec, sys; {statement}; print(*sys.modules)"
    done = subprocess.run(
        [sys.executable, "-c", program], capture_output=True, text=True, check=True
    )
    return set(done.stdout.split())


def test_dir_is_the_face():
    assert [name for name in dir(rhec) if not name.startswith("__")] == sorted(rhec.__all__)


def test_the_core_loads_no_robot_no_tables_and_no_figures():
    modules = loaded_by("rhec.Model, rhec.RHE, rhec.RHC, rhec.EKF")
    assert not modules & {"pandas", "matplotlib", "xarray", "dask", "scipy"}
    ours = {name for name in modules if name.startswith("rhec.")}
    assert {name.split(".")[1] for name in ours} == {"core"}


def test_without_a_model_the_estimator_is_the_papers():
    assert "rhec.tracked_robot.rhe" in loaded_by("rhec.RHE(horizon=2)")


@pytest.mark.parametrize("name", sorted(set(rhec.__all__) - {"logs"}))
def test_signatures_show_plain_types(name):
    public = getattr(rhec, name)
    members = vars(public).values() if inspect.isclass(public) else ()
    functions = [public, *filter(inspect.isfunction, members)]
    for function in functions:
        text = str(inspect.signature(function))
        assert "Annotated" not in text and "FieldInfo" not in text and len(text) <= 2500, text


def test_a_signature_names_what_may_be_passed():
    assert list(inspect.signature(rhec.RHE).parameters) == [*SETTINGS][:2] + ["horizon"] + [
        *SETTINGS
    ][2:] + ["arrival_mean"]
    assert inspect.signature(rhec.EKF).parameters["sigma_v"].annotation == tuple[float, ...]
    assert inspect.signature(rhec.Scenario).parameters["robust"].annotation is bool


def test_objects_show_what_they_are():
    assert repr(MODEL) == MODEL_TEXT
    rhe = rhec.RHE(horizon=3, **SETTINGS)
    assert repr(rhe) == f"RHE, dt 0.2 s, horizon 3, not started\n{MODEL_TEXT}"
    rhe.feedback((0.0, 0.5))
    assert "horizon 3, started\n" in repr(rhe)
    ekf = rhec.EKF(**SETTINGS)
    assert repr(ekf) == f"EKF, dt 0.2 s\n{MODEL_TEXT}"
    assert repr(ekf.feedback((0.0, 0.5))).splitlines() == [
        "Estimate",
        "    x_m: 0 ± 0.1",
        "    v_mps: 0.5",
        "    slip: 0.1 ± 0.1",
        "    drift_mps: 0 ± 0.1",
    ]


@pytest.mark.parametrize(
    "call, sentence",
    [
        (lambda: rhec.Scenario(q=(1, 1)), "q was (1, 1); it should have 3 entries"),
        (lambda: rhec.Scenario(q=()), "q was (); it should have 3 entries"),
        (lambda: rhec.Scenario(q=(1,) * 4), "q was (1, 1, 1, 1); it should have 3 entries"),
        (lambda: rhec.Scenario(q=(1, 1, -1)), "q[2] was -1; it should be greater than or equal"),
        (lambda: rhec.Fault(), "kind was not given; Fault needs it"),
        (lambda: rhec.EKF(model=MODEL), "dt was not given; EKF needs it"),
        (lambda: rhec.EKF(sigma=1), "EKF has no parameter 'sigma'; did you mean 'sigma_"),
    ],
)
def test_an_error_names_the_parameter_its_value_and_what_it_may_be(call, sentence):
    with pytest.raises(ValueError) as refused:
        call()
    assert str(refused.value).startswith(sentence)
