"""A scenario is validated strictly: bad input is answered by one sentence that names it."""

import dataclasses
import itertools
import math

import casadi as ca
import numpy as np
import pytest
from helpers import assert_refused

import rhec
from notebooks.rivals import RIVALS
from rhec.simulation.scenario_fields import fields_of
from rhec.tracked_robot import tuning
from rhec.tracked_robot.estimators import estimator_of

FIELDS = [field.name for field in dataclasses.fields(rhec.Scenario)]
DESCRIBED = fields_of(rhec.Scenario)
DEAD_GYRO = (rhec.Fault(kind="dead", channel="gyro"),)
TOO_LARGE = "…at most a square kilometre…pass a terrain"
# What neither a type nor a range tells.
REFUSED = [
    (dict(q=()), "q was (); it should have 3 entries"),
    (dict(q=(1, 2, math.inf)), "q[2] was inf; "),
    (dict(patches=((0, 0, 1, 1),)), "patches[0] was "),
    (dict(patches=((0, 0, 1, 1, 1.2),)), "patches[0][4] was 1.2; "),
    (dict(prediction_horizon=1.5), "prediction_horizon was 1.5; "),
    (dict(prediction_horizon=True), "prediction_horizon was True; "),
    (dict(backwards=1), "backwards was 1; "),
    (dict(controller=ca.Function("own", [], [])), "controller was "),
    (dict(mu_deviation=0.2), "mu_deviation was 0.2; with mu_mean 0.975 it should be below 0.156"),
    (dict(sensors=("gyro",), estimator="ekf"), "sensors was ('gyro',); for the estimator 'ekf'"),
    (dict(sensors=("gyro", "gyro")), "sensors was …it should name each sensor once"),
    (dict(sensors=("heading",), faults=DEAD_GYRO), "faults was …with a gyro that fails; "),
    (dict(faults=DEAD_GYRO), "faults was …sensors should have 'gyro', too"),
    (dict(sped_mps=1), "Scenario has no parameter 'sped_mps'; did you mean 'speed_mps'?"),
    (dict(Seed=1), "Scenario has no parameter 'Seed'; did you mean 'seed'?"),
    (dict(world="soft"), "Scenario has no …Scenario(**rhec.WORLDS['soft'])"),
    (dict(nothing_alike=1), "Scenario has no …help(rhec.Scenario) lists them"),
    (dict(headland_radius_m=1000.0), f"…headland_radius_m 1000.0{TOO_LARGE}"),
    (dict(start_offset_m=600.0), f"start_offset_m{TOO_LARGE}"),
]


def refusal(**fields):
    with pytest.raises(ValueError) as refused:
        rhec.Scenario(**fields)
    return str(refused.value)


def test_nonsense_is_refused_by_name():
    for name, value in itertools.product(FIELDS, ["no", math.nan, object()]):
        assert refusal(**{name: value}).startswith(f"{name} was {value!r}; ")


def test_what_does_not_fit_is_refused_in_one_sentence():
    assert_refused(rhec.Scenario, REFUSED)
    soil = rhec.Terrain.uniform(0.9, 0.8)
    assert rhec.Scenario(start_offset_m=600.0, terrain=soil).terrain is soil


def test_the_described_range_is_the_one_that_is_checked():
    """To the last bit; a number whose square is none is refused in any case."""
    docstring = " ".join(rhec.Scenario.__doc__.split())
    sizes = dict(q=3, sigma_v=4, sigma_w=6, slip=5)

    def refused(name, value):
        given = (value,) * sizes[name] if name in sizes else value
        try:
            rhec.Scenario(**{name: given})
        except ValueError as sentence:
            return str(sentence).startswith((f"{name} was", f"{name}[0] was"))
        return False

    for name, field in DESCRIBED.items():
        is_whole = isinstance(getattr(rhec.Scenario(), name), int)
        for limit, side in ((field.lowest, -1), (field.highest, 1)):
            if limit is not None:
                beyond = limit + side if is_whole else np.nextafter(limit, side * np.inf)
                assert refused(name, beyond), (name, beyond)
        if field.lowest is not None and name not in ("headland_radius_m", "row_length_m"):
            assert refused(name, field.lowest) == field.above_lowest, name
            if field.highest is None:
                least = "above" if field.above_lowest else "at least"
                entry = docstring.split(f" {name}: ")[1].replace("eq. ", "").split(". ")[0]
                assert entry.endswith(f", {least} {field.lowest:g}"), name
        if isinstance(getattr(rhec.Scenario(), name), float):
            assert refused(name, 1e300) and refused(name, math.inf), name


def test_numpy_scalars_are_numbers_and_replacing_one_validates_it():
    given = dict(seed=np.int64(3), r=np.float64(2.5), prediction_horizon=np.int32(9))
    scenario = rhec.Scenario(**given, q=(np.float32(1), np.int64(2), 3))
    assert scenario == rhec.Scenario(seed=3, r=2.5, q=(1, 2, 3), prediction_horizon=9)
    numbers = (scenario.seed, scenario.r, scenario.prediction_horizon, *scenario.q)
    assert {type(value) for value in numbers} == {int, float}
    assert dataclasses.replace(scenario, seed=4).seed == 4
    with pytest.raises(ValueError, match="^seed was -4; "):
        dataclasses.replace(scenario, seed=-4)


def test_help_and_table_describe_every_parameter():
    assert list(DESCRIBED) == FIELDS
    docstring = " ".join(rhec.Scenario.__doc__.split())
    for name, field in DESCRIBED.items():
        assert rhec.Scenario.__doc__.count(f"\n    {name}: ") == 1
        further = field.text.replace("eq. ", "eq.").partition(". ")[2]
        assert further.replace("eq.", "eq. ") in docstring, name
        for choice in field.choices:
            assert isinstance(choice, bool) or str(choice) in field.text, name
    table = rhec.Scenario.describe()
    assert list(table.index) == FIELDS
    assert rhec.Scenario(**table["default"]) == rhec.Scenario()
    assert (table.loc["speed_mps", ["unit", "group"]] == ["m/s", "the drive"]).all()


def test_the_repr_is_python_that_leaves_out_the_defaults():
    fault = rhec.Fault(kind="jump", size_m=0.5, start_s=40.0)
    scenario = rhec.Scenario(seed=3, faults=(fault,), q=(1, 2, 3))
    assert repr(rhec.Scenario()) == "rhec.Scenario()"
    assert eval(repr(scenario)) == scenario and "duration_s" not in repr(scenario)
    assert repr(fault) == "rhec.Fault(kind='jump', start_s=40.0, size_m=0.5)"
    assert repr(rhec.Scenario(path=rhec.Path.racetrack(9.0, 4.0))) == "rhec.Scenario(path=path)"


def test_sigma_w_has_an_entry_for_each_state_of_the_estimator():
    for estimator, speed_model, entries in (
        ("rhe", "parameter", 6),
        ("rhe", "input", 5),
        ("ekf", "parameter", 4),
        (RIVALS["traction_oracle"], "input", 4),
    ):
        fields = dict(estimator=estimator, speed_model=speed_model)
        rhec.Scenario(**fields, sigma_w=(0.1,) * entries)
        assert f"it should have {entries} entries" in refusal(**fields, sigma_w=(0.1,) * 3)


def sigma_v_and_w(**fields):
    """Standard deviations of measurements and of process noise that an estimator assumes."""
    scenario = rhec.Scenario(**fields)
    settings = estimator_of(scenario.estimator).settings(scenario)
    return tuple(tuple(np.sqrt(settings[name]).round(12)) for name in "VW")


def test_one_rule_picks_the_noise_of_both_unless_it_is_given():
    for name in ("rhe", "ekf"):
        found = {
            rule: sigma_v_and_w(estimator=name, process_noise=rule) for rule in tuning.RULES[:4]
        }
        assert len({*found.values()}) == 4
        assert sigma_v_and_w(estimator=name) == found["prediction"]
    own = dict(sigma_v=(0.1, 0.2, 0.3, 0.4), sigma_w=(0.5,) * 6)
    assert sigma_v_and_w(process_noise="consistent", **own) == tuple(own.values())
