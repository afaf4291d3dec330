"""The public face: what it lists, how it is documented, what it shows and what it loads.

Who may import whom is import-linter's to check (`make lint`, contracts in pyproject.toml).
"""

import dataclasses
import inspect
import re
import subprocess
import sys
from pathlib import Path

import casadi as ca
import numpy as np
import pytest
from helpers import no_compiler

import rhec
from rhec.core.controller import rhc
from rhec.core.estimator import rhe
from rhec.simulation import worlds
from rhec.tracked_robot import own_loop

ROOT = Path(__file__).parents[2]
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

# What it lists and documents


# The classes of the objects that functions of the face make.
MADE = {
    "core.estimator.rhe.RHE": rhe.RHE,
    "core.controller.rhc.RHC": rhc.RHC,
    "tracked_robot.own_loop.RHE": own_loop.RHE,
    "tracked_robot.own_loop.RHC": own_loop.RHC,
}


def thing_of(name):
    return MADE.get(name) or getattr(rhec, name)


def public(name):
    """{how it is called: function} of what `name` lets a caller call."""
    thing = thing_of(name)
    if inspect.ismodule(thing):
        return {f"{name}.{member}": getattr(thing, member) for member in thing.__all__}
    if isinstance(thing, dict):
        return {}
    if not inspect.isclass(thing):
        return {name: thing}
    members = {key: getattr(thing, key) for key in vars(thing) if not key.startswith("_")}
    methods = {key: member for key, member in members.items() if hasattr(member, "__code__")}
    return {f"{name}.{key}": method for key, method in methods.items()}


NAMES = [*rhec.__all__, *MADE]
CALLABLE = {call: function for name in NAMES for call, function in public(name).items()}


def parameters(function):
    """Names of the parameters that a caller may pass."""
    return [
        name
        for name, parameter in inspect.signature(function).parameters.items()
        if name not in ("self", "cls") and parameter.kind is not parameter.VAR_KEYWORD
    ]


def test_dir_is_the_face():
    assert [name for name in dir(rhec) if not name.startswith("__")] == sorted(rhec.__all__)


def test_a_name_on_the_face_is_documented():
    """One sentence comes first; a constructor's parameters are named in the class."""
    for name in NAMES:
        thing = thing_of(name)
        # What a dict holds is said by the module that makes it.
        text = inspect.getdoc(worlds if isinstance(thing, dict) else thing)
        assert re.match(r"[A-Z].*?[.:](\s|$)", text, re.S), name
        if inspect.isclass(thing) and thing.__init__ is not object.__init__:
            text += thing.__init__.__doc__ or ""
            fields = parameters(thing.__init__)
            if dataclasses.is_dataclass(thing):
                fields = [field.name for field in dataclasses.fields(thing)]
            assert not [field for field in fields if not re.search(rf"\b{field}\b", text)], name


def test_a_function_on_the_face_documents_arguments_and_result():
    for call, function in CALLABLE.items():
        text = inspect.getdoc(function) or ""
        assert re.match(r"[A-Z].*?\.(\s|$)", text, re.S), f"{call}: one sentence comes first"
        for name in parameters(function):
            arguments = re.search(r"^Args:\n(.*?)(?:^\S|\Z)", text, re.S | re.M)
            assert arguments, f"{call}: no Args"
            assert re.search(rf"^ +\*?{name}\b.*:", arguments[1], re.M), f"{call}: {name}"
        if inspect.signature(function).return_annotation not in (None, "None"):
            has_result = re.search(r"^Returns:\n|^Yields:\n", text, re.M)
            assert has_result or not parameters(function), call


# What it shows


@pytest.mark.parametrize("where", MADE)
def test_a_function_that_makes_an_object_names_all_its_options(where):
    """In the order in which the class has them, and no others."""
    made = MADE[where]
    options = inspect.getdoc(getattr(rhec, made.__name__)).split(f"`rhec.{where}`: ")[1]
    named = re.findall(r"[a-z]\w*", options.split(".")[0])
    expected = [name for name in inspect.signature(made).parameters if name != "model"]
    assert [name for name in named if name != "and"] == expected


def test_objects_show_what_they_are():
    assert repr(MODEL) == MODEL_TEXT
    with no_compiler():
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


def test_what_runs_and_campaigns_share_cannot_be_changed():
    """They keep what they have made from it."""
    things = [getattr(rhec, name) for name in rhec.__all__]
    records = [
        thing for thing in things if inspect.isclass(thing) and dataclasses.is_dataclass(thing)
    ]
    assert {rhec.Scenario, rhec.Path, rhec.Terrain, rhec.Model} <= {*records}
    for record in records:
        for field in dataclasses.fields(record):
            with pytest.raises(dataclasses.FrozenInstanceError):
                setattr(object.__new__(record), field.name, None)


# What it loads


def modules_after(statement):
    """Names of the modules that are loaded after a statement, in a new process."""
    program = f"import sys, rhec\n{statement}\nprint(*sys.modules)"
    done = subprocess.run(
        [sys.executable, "-c", program], cwd=ROOT, check=True, capture_output=True, text=True
    )
    return set(done.stdout.split())


@pytest.mark.nightly(keep=1)
@pytest.mark.parametrize("name", ["Model", "RHE", "RHC", "EKF"])
def test_the_core_stands_alone(name):
    """Neither a robot nor tables nor pictures come with what any robot needs."""
    loaded = modules_after(f"rhec.{name}")
    rooms = {module.split(".")[1] for module in loaded if module.startswith("rhec.")}
    assert rooms - {"any_robot"} == {"core", "version"}
    assert loaded.isdisjoint({"pandas", "matplotlib", "scipy", "xarray", "loky", "IPython"})


# Estimators and controllers: classes, and the same verbs


CONTROLLED = dict(model=MODEL, command=("v_mps",), q=(1.0,), r=(1.0,), dt=0.2, horizon=2)
STRAIGHT = np.array([[0.0, 0.1, 0.2], [0.0] * 3, [0.0] * 3]), np.zeros(2)
# {name: (how it is made, its class, two samples that its `feedback` takes)}
OBJECTS = {
    "RHE": (lambda: rhec.RHE(horizon=2), rhec.RHE, [((0, 0, 0.5, 0),), ((0.1, 0, 0.5, 0),)]),
    "RHE of a Model": (
        lambda: rhec.RHE(horizon=2, **SETTINGS),
        rhec.RHE,
        [((0.0, 0.5),), ((0.1, 0.5),)],
    ),
    "EKF": (lambda: rhec.EKF(**SETTINGS), rhec.EKF, [((0.0, 0.5),), ((0.1, 0.5),)]),
    "RHC": (
        lambda: rhec.RHC(horizon=2),
        rhec.RHC,
        [((0, y, 0), (0.5, 1, 1), *STRAIGHT) for y in (0.3, 0.2)],
    ),
    "RHC of a Model": (
        lambda: rhec.RHC(**CONTROLLED),
        rhec.RHC,
        [((x,), (0.1, 0.0), 1.0) for x in (0.3, 0.5)],
    ),
}


def numbers(answer):
    """A command, or the beginning of an estimate, as one vector."""
    parts = answer[:2] if isinstance(answer, tuple) else (answer,)
    return np.concatenate([*map(np.ravel, parts)])


def answers_of(made, samples):
    """What an object answers to samples in turn, as numbers."""
    answers = []
    for sample in samples:
        made.prepare()
        answers.append(numbers(made.feedback(*sample)))
    return answers


@pytest.mark.parametrize("name", OBJECTS)
def test_every_estimator_and_controller_has_the_same_verbs(name):
    make, kind, samples = OBJECTS[name]
    with no_compiler():
        made, stepping = make(), make()
    assert isinstance(made, kind) and repr(made).startswith(kind.__name__)
    assert not made.ok and made.status
    expected = answers_of(made, samples)
    assert made.ok and made.status == ""
    for sample, wanted in zip(samples, expected):
        np.testing.assert_array_equal(numbers(stepping.step(*sample)), wanted)
    made.restart()
    assert not made.ok and made.status
    np.testing.assert_array_equal(answers_of(made, samples), expected)


def test_a_first_mistake_is_told_what_to_write_instead():
    with no_compiler():
        rhc = rhec.RHC(**CONTROLLED)
    x = (0.0,)
    p = (0.1, 0.0)
    for call, error, sentence in (
        (lambda: rhec.Fault(), ValueError, "^kind was not given; Fault needs it"),
        (lambda: rhec.EKF(sigma=1), ValueError, "^EKF has no parameter 'sigma'; did you mean 'sig"),
        (lambda: rhec.Scenario("ekf"), TypeError, r"by name, as in Scenario\(estimator=…\).*'ekf'"),
        (lambda: rhec.simulate(seed=3), TypeError, r"rhec.simulate\(rhec.Scenario\(seed=3\)\)"),
        (lambda: rhec.WORLDS["sfot"], KeyError, "no world 'sfot'.*uncertain.*did you mean 'soft'"),
        (
            lambda: rhc.feedback(x, p, x_ref=np.zeros((1, 16))),
            ValueError,
            r"\(1, 16\); it should have \(1, 3\).*horizon is 2.*Pa",
        ),
        (lambda: rhc.feedback(("a",), p, x_ref=0.0), ValueError, "it should be made of numbers$"),
        (lambda: rhc.feedback(x, p, x_ref=np.zeros((3, 1))), ValueError, "x_ref.T has that"),
    ):
        with pytest.raises(error, match=sentence):
            call()
    assert "sfot" not in rhec.WORLDS and rhec.WORLDS.get("sfot") is None


def test_without_a_model_they_are_the_papers_and_ones_own_class_derives_from_them():
    class Counting(rhec.RHE):
        samples = 0

        def feedback(self, z, sigma_w=None):
            self.samples += 1
            return super().feedback(z, sigma_w)

    with no_compiler():
        assert isinstance(rhec.RHE(horizon=2, model=None), own_loop.RHE)
        assert isinstance(rhec.RHC(horizon=2, model=None), own_loop.RHC)
        made = Counting(horizon=2, **SETTINGS)
    assert not isinstance(made, own_loop.RHE)
    made.step((0.0, 0.5))
    assert type(made) is Counting and made.samples == 1
    for made in (rhec.RHE, rhec.RHC):  # one's own class is never the paper's without a word
        with pytest.raises(ValueError, match="model was not given"):
            type("Own", (made,), {})(horizon=2)


@pytest.mark.nightly
def test_a_run_needs_neither_tables_nor_pictures_nor_campaigns():
    scenario = "rhec.Scenario(estimator='oracle', duration_s=1.0)"
    loaded = modules_after(f"rhec.simulate({scenario})")
    assert loaded.isdisjoint({"pandas", "matplotlib", "loky", "IPython", "notebooks"})
    assert not [name for name in loaded if "campaigns" in name or "lanes" in name]
    # The browser draws the explorer.
    assert "matplotlib" not in modules_after(f"rhec.Explorer({scenario}, against=None)")
