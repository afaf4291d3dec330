"""A scenario is validated strictly: bad input is answered by one sentence that names it."""

import dataclasses
import itertools
import math

import casadi as ca
import numpy as np
import pytest

import rhec
from notebooks.rivals import RIVALS
from rhec import paper
from rhec.simulation.scenario_fields import fields_of
from rhec.tracked_robot import tuning
from rhec.tracked_robot.estimators import estimator_of

FIELDS = [field.name for field in dataclasses.fields(rhec.Scenario)]
DESCRIBED = fields_of(rhec.Scenario)
OUT_OF_RANGE = [
    ("sigma_w", (1, 1, -1, 1, 1, 1)),
    ("sigma_w", (1, 1)),
    ("sigma_v", (0.03, 0.03, 0, 0.01)),
    ("sigma_v", (1, 1, 1)),
    ("estimation_horizon", 1),
    ("estimation_horizon", 241),
    ("prediction_horizon", 1.5),
    ("prediction_horizon", True),
    ("q", (1, 2)),
    ("q", (1, 2, -3)),
    ("q", (1, 2, math.inf)),
    ("q", 1.0),
    ("r", 0),
    ("r", "10"),
    ("r", True),
    ("qn_factor", -1),
    ("omega_max_radps", 0.0),
    ("look_ahead_m", -0.1),
    ("command_delay", 2),
    ("speed_mps", 0),
    ("speed_mps", 1.41),
    ("duration_s", -1),
    ("duration_s", 1e8),
    ("backwards", 1),
    ("row_length_m", 0),
    ("headland_radius_m", -1),
    ("start_offset_m", math.inf),
    ("mu_mean", 0),
    ("mu_mean", 1.01),
    ("kappa_mean", -0.1),
    ("mu_deviation", -0.1),
    ("mu_deviation", 0.3),
    ("mu_deviation", 1e300),
    ("kappa_deviation", 0.4),
    ("kappa_deviation", 1.7e308),
    ("correlation_length_m", 0.4),
    ("patches", ((0, 0, 1, 1),)),
    ("patches", ((0, 0, 1, 1, 1.2),)),
    ("patches", ((0, 0, -1, 1, 1),)),
    ("gnss_sigma_m", -0.01),
    ("gnss_slow_share", 1.1),
    ("gnss_slow_time_s", 0),
    ("encoder_sigma_mps", -1),
    ("speed_sigma_mps", -0.01),
    ("bump_sigma_radps", -1),
    ("rut_length_m", -0.1),
    ("slip_difference", 1.1),
    ("soil_under", "wheels"),
    ("track_width_m", 0),
    ("seed", -1),
    ("seed", 1.0),
    ("seed", "9"),
    ("seed", True),
    ("estimator", "kf"),
    ("estimator", None),
    ("path", [(0, 0)]),
    ("terrain", "wet"),
    ("process_noise", "Printed"),
    ("controller", "mpc"),
    ("controller", None),
    ("controller", ca.Function("own", [], [])),
    ("input_reference", None),
    ("gyro_scale", -1.0),
    ("gyro_sigma_radps", -0.1),
]
DEAD_GYRO = (rhec.Fault(kind="dead", channel="gyro"),)
SENTENCES = [
    (dict(q=()), "q was (); it should have 3 entries"),
    (dict(q=(1, 1)), "q was (1, 1); it should have 3 entries"),
    (dict(q=(1, 1, -1)), "q[2] was -1; it should be at least 0"),
    (dict(sensors=("gyro",), estimator="ekf"), "sensors was"),
    (dict(sensors=("gyro", "gyro")), "it should name each sensor once"),
    (dict(sensors=("heading",), faults=DEAD_GYRO), "with a gyro that fails"),
    (dict(faults=DEAD_GYRO), "sensors should have 'gyro', too"),
]


def refusal(**fields):
    with pytest.raises(ValueError) as refused:
        rhec.Scenario(**fields)
    return str(refused.value)


def test_nonsense_is_refused_by_name():
    for name, value in itertools.product(FIELDS, ["no", math.nan, object()]):
        assert refusal(**{name: value}).startswith(f"{name} was {value!r}; ")


def test_values_out_of_range_are_refused_in_one_sentence():
    for name, value in OUT_OF_RANGE:
        sentence = refusal(**{name: value})
        assert sentence.startswith(name) and " was " in sentence and "; " in sentence, sentence
        assert "\n" not in sentence and "pydantic" not in sentence, sentence
    for fields, words in SENTENCES:
        sentence = refusal(**fields)
        assert words in sentence and "\n" not in sentence, sentence


@pytest.mark.parametrize(
    "name, meant",
    [
        ("sped_mps", "speed_mps"),
        ("prediction_horizn", "prediction_horizon"),
        ("estimater", "estimator"),
        ("Seed", "seed"),
    ],
)
def test_an_unknown_field_is_refused_with_a_suggestion(name, meant):
    assert refusal(**{name: 1}) == f"Scenario has no parameter {name!r}; did you mean {meant!r}?"


def test_fields_have_names():
    with pytest.raises(TypeError):
        rhec.Scenario("rhe")


def test_numpy_scalars_are_numbers():
    scenario = rhec.Scenario(
        seed=np.int64(3),
        r=np.float64(2.5),
        q=(np.float32(1), np.int64(2), 3),
        prediction_horizon=np.int32(9),
        backwards=False,
    )
    assert scenario == rhec.Scenario(seed=3, r=2.5, q=(1, 2, 3), prediction_horizon=9)
    assert all(
        type(value) in (int, float)
        for value in (scenario.seed, scenario.r, scenario.prediction_horizon, *scenario.q)
    )


def test_replacing_a_field_validates_it():
    scenario = rhec.Scenario(seed=1)
    assert dataclasses.replace(scenario, seed=4).seed == 4
    with pytest.raises(ValueError, match="^seed was -4; "):
        dataclasses.replace(scenario, seed=-4)


ABSURD = [
    *((name, 1e300) for name in ("gnss_sigma_m", "encoder_sigma_mps", "bump_sigma_radps")),
    ("sigma_v", (1e300,) * 4),
    ("sigma_w", (1e300,) * 6),
    ("patches", ((1e300, 0.0, 1.0, 0.5, 0.5),)),
    ("patches", ((0.0, 0.0, 1e300, 0.5, 0.5),)),
    ("start_offset_m", -1e300),
]


def test_numbers_whose_squares_are_none_are_refused():
    for name, value in ABSURD:
        sentence = refusal(**{name: value})
        assert sentence.startswith(name) and "1e+100" in sentence, sentence


def test_a_scenario_is_frozen():
    with pytest.raises(dataclasses.FrozenInstanceError):
        rhec.Scenario().seed = 3


def test_every_field_is_documented_once():
    assert list(DESCRIBED) == FIELDS
    for name, field in DESCRIBED.items():
        assert rhec.Scenario.__doc__.count(f"\n    {name}: ") == 1
        assert field.text.endswith(".") and "  " not in field.text and "[" not in field.text
        for choice in field.choices:
            assert isinstance(choice, bool) or str(choice) in field.text, name


def test_a_table_describes_every_parameter():
    table = rhec.Scenario.describe()
    assert list(table.index) == FIELDS
    assert list(table.columns) == ["default", "unit", "group", "what it does"]
    assert rhec.Scenario(**table["default"]) == rhec.Scenario()
    assert (table.loc["speed_mps", ["unit", "group"]] == ["m/s", "the drive"]).all()
    soil = table.index[table["group"] == "the soil"]
    assert {"mu_mean", "patches"} <= {*soil} and "gnss_sigma_m" not in soil


def test_the_described_range_is_the_one_that_is_checked():
    sizes = dict(q=3, sigma_v=4, sigma_w=6, slip=5)
    for name, field in DESCRIBED.items():
        for limit, beyond in ((field.lowest, -1), (field.highest, 1)):
            if limit is not None:
                value = limit + beyond
                given = (value,) * sizes[name] if name in sizes else value
                assert refusal(**{name: given}).startswith(name)


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
        rhec.Scenario(estimator=estimator, speed_model=speed_model, sigma_w=(0.1,) * entries)
        assert f"it should have {entries} entries" in refusal(
            estimator=estimator, speed_model=speed_model, sigma_w=(0.1,) * 3
        )


def sigma_v_and_w(**fields):
    """Standard deviations of measurements and of process noise that an estimator assumes."""
    scenario = rhec.Scenario(**fields)
    settings = estimator_of(scenario.estimator).settings(scenario)
    return tuple(tuple(np.sqrt(settings[name]).round(12)) for name in "VW")


def test_by_default_one_rule_picks_the_noise_of_both():
    printed = {
        name: sigma_v_and_w(estimator=name, process_noise="printed") for name in ("rhe", "ekf")
    }
    assert printed["rhe"] == (paper.SIGMA_V, paper.SIGMA_W_RHE)
    assert printed["ekf"] == (paper.SIGMA_V, paper.SIGMA_W_EKF)
    for name in ("rhe", "ekf"):
        predicting = sigma_v_and_w(estimator=name, process_noise="prediction")
        assert predicting == sigma_v_and_w(estimator=name) != printed[name]
    # Another estimator brings its own default.
    scenario = dataclasses.replace(rhec.Scenario(), estimator="ekf")
    assert scenario == rhec.Scenario(estimator="ekf")


def test_consistent_process_noise_brings_sigma_v_unless_that_is_given():
    sigma_v, sigma_w = sigma_v_and_w(process_noise="consistent")
    assert sigma_v[3] > paper.SIGMA_V[3]
    assert sigma_w == tuning.NOISES["rhe"]["consistent"].sigma_w
    own = dict(sigma_v=(0.1, 0.2, 0.3, 0.4), sigma_w=(0.5,) * 6)
    assert sigma_v_and_w(process_noise="consistent", **own) == tuple(own.values())


def test_a_process_noise_that_an_estimator_has_not_is_refused():
    assert refusal(estimator="bounded_ekf", process_noise="soft_soil") == (
        "process_noise was 'soft_soil'; for the estimator 'bounded_ekf' it should be None or one "
        "of ('printed', 'consistent', 'prediction', 'tracking')"
    )


@pytest.mark.parametrize(
    "fields",
    [dict(headland_radius_m=1000.0), dict(start_offset_m=600.0), dict(start_offset_m=-1e90)],
)
def test_a_field_too_large_for_random_soil_is_refused_when_the_scenario_is_made(fields):
    (name,) = fields
    with pytest.raises(ValueError, match=f"{name}.*at most a square kilometre.*pass a terrain"):
        rhec.Scenario(**fields)
    soil = rhec.Terrain.uniform(0.9, 0.8)
    assert rhec.Scenario(**fields, terrain=soil).terrain is soil
