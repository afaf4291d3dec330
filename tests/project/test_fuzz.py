"""Absurd input of every public entry: one sentence that names what was wrong, or a sane result."""

import dataclasses
import inspect
import re

import numpy as np
import pandas as pd
import pytest
from hypothesis import HealthCheck, example, given, settings
from hypothesis import strategies as st

import rhec
from rhec import paper
from rhec.simulation import closed_loop, faults
from rhec.simulation.columns import LOG

pytestmark = [pytest.mark.nightly, pytest.mark.usefixtures("virtual_machine")]
N = paper.HORIZON


def some(examples):
    return settings(
        max_examples=examples,
        deadline=None,
        derandomize=True,
        suppress_health_check=list(HealthCheck),
    )


# What a program, a notebook's widget or a file may come up with
EXTREME = (0.0, -0.0, 5e-324, 1e-300, 1e-9, 1.0, 1e9, 1e160, 1.7e308, -1.0, -1e300, 2**70, 10**400)
extreme = st.sampled_from([*EXTREME[:-2], np.inf, -np.inf, np.nan])
number = extreme | st.floats() | st.integers() | st.integers(-3, 300)
scalar = (
    number
    | st.none()
    | st.booleans()
    | st.text(max_size=5)
    | st.binary(max_size=5)
    | st.complex_numbers()
    | st.sampled_from([object, np.float32(2), 10**400])
)
junk = (
    st.recursive(
        scalar,
        lambda inner: (
            st.lists(inner, max_size=6)
            | st.lists(inner, max_size=6).map(tuple)
            | st.dictionaries(st.text(max_size=3), inner, max_size=2)
        ),
        max_leaves=8,
    )
    | st.lists(number, max_size=6).map(tuple)
    | st.lists(st.floats(), max_size=6).map(np.array)
)
numbers = st.lists(number, min_size=2, max_size=6).map(tuple)


def refused_by_name(make, names):
    """What `make` returns, or None where it was refused in one line that begins with one of the
    names.
    """
    try:
        return make()
    except ValueError as error:
        assert re.match(r"\w+", str(error)).group() in names, str(error)
        assert "\n" not in str(error) and len(str(error)) < 1000 and "pydantic" not in str(error)


FIELDS = [field.name for field in dataclasses.fields(rhec.Scenario)]


def as_tuples(value):
    """A scenario keeps lists as tuples."""
    return tuple(map(as_tuples, value)) if isinstance(value, list | tuple) else value


@some(200)
@example({"patches": []})
@example({"patches": [[0.0, 0.0, 1.0, 0.5, 0.5]]})
@given(st.dictionaries(st.sampled_from(FIELDS), junk | numbers, min_size=1, max_size=2))
def test_a_scenario(fields):
    scenario = refused_by_name(lambda: rhec.Scenario(**fields), FIELDS)
    if scenario:
        assert all(
            getattr(scenario, name) == as_tuples(value)
            for name, value in fields.items()
            if not isinstance(value, np.ndarray)
        )


positive = st.sampled_from([1e-300, 1e-9, 1e-3, 0.03, 1.0, 1e3, 1e9, 1e100]) | st.floats(1e-6, 1e6)
or_none = st.just(0.0) | positive
anywhere = st.sampled_from([-1e100, -1e12, -1e5, 0.0, np.pi, 1e5, 1e12, 1e100]) | st.floats(
    -100, 100
)
weird = st.fixed_dictionaries(
    {},
    optional=dict(
        sigma_v=st.tuples(*[positive] * 4), sigma_w=st.tuples(*[or_none] * 6),
        q=st.tuples(*[or_none] * 3), r=positive, qn_factor=positive, omega_max_radps=positive,
        look_ahead_m=or_none, command_delay=st.integers(0, 1), speed_mps=st.floats(1e-12, 1.4),
        backwards=st.booleans(), start_offset_m=anywhere, start_yaw_rad=anywhere,
        guess_yaw_rad=anywhere, gnss_sigma_m=positive, gnss_slow_share=st.floats(0, 1),
        gnss_slow_time_s=positive, encoder_sigma_mps=positive, speed_sigma_mps=positive,
        bump_sigma_radps=positive, rut_length_m=or_none, slip_difference=st.floats(-1, 1),
        rotation_centre_m=anywhere, track_width_m=positive, duration_s=st.floats(0.2, 12),
    ),
)  # fmt: skip
a_fault = st.sampled_from(
    [
        dict(kind="missing", channel="all"), dict(kind="infinite", channel="all"),
        dict(kind="outliers", size_m=1e7), dict(kind="stuck"), dict(kind="dead", channel="left"),
        dict(kind="rate", rate_hz=1e100), dict(kind="disorder", channel="all"),
    ]
)  # fmt: skip
SOIL = rhec.Terrain.uniform(0.9, 0.8)


@some(40)
@given(weird, st.lists(a_fault, max_size=2), st.integers(0, 2**70))
def test_a_simulation(fields, several, seed):
    """Whatever it is tuned to, and wherever it starts: commands keep their bound, estimates are
    finite, traction between 0 and 1.
    """
    broken = tuple(rhec.Fault(**given, start_s=0.6, duration_s=1.0) for given in several) or (
        rhec.Fault(kind="missing", duration_s=0.0),
    )
    scenario = rhec.Scenario(
        **dict(duration_s=5.0) | fields, terrain=SOIL, faults=broken, seed=seed
    )
    with np.errstate(all="ignore"):
        columns = rhec.simulate(scenario).columns
    assert len(columns["t_s"]) == round(scenario.duration_s / 0.2)
    for name in (*LOG["truth"], *LOG["estimate"], "omega_cmd_radps"):
        assert np.isfinite(columns[name]).all(), name
    assert np.all(np.abs(columns["omega_cmd_radps"]) <= scenario.omega_max_radps)
    for name in ("mu_hat", "kappa_hat", "mu", "kappa"):
        assert np.all((columns[name] >= 0) & (columns[name] <= 1)), name


@some(40)
@example(dict(patches=((0.0, 0.0, 1e100, 0.5, 0.5),)))
@given(
    st.fixed_dictionaries(
        {},
        optional=dict(
            row_length_m=positive.filter(lambda m: m <= 1e4),
            headland_radius_m=positive.filter(lambda m: m <= 1e3),
            start_offset_m=anywhere,
            mu_mean=st.floats(1e-300, 1),
            kappa_mean=st.floats(1e-300, 1),
            mu_deviation=st.floats(0, 0.5),
            kappa_deviation=st.floats(0, 0.5),
            correlation_length_m=st.floats(0.5, 1e100),
            patches=st.lists(
                st.tuples(anywhere, anywhere, positive, st.floats(1e-300, 1), st.floats(1e-300, 1)),
                max_size=2,
            ).map(tuple),
        ),
    )
)
def test_a_field(fields):
    with np.errstate(all="ignore"):
        made = refused_by_name(
            lambda: closed_loop.set_up(rhec.Scenario(**fields)), [*FIELDS, "box", "mu", "kappa"]
        )
    assert made is None or np.isfinite(made.settings["slip"]).all()


SETTINGS = "q r qn_factor omega_max dt guess sigma_v sigma_w speed_model process_noise".split()
# {entry: (how it is called, its parameters, how many of them are given)}
ENTRIES = {
    "Fault": (rhec.Fault, [field.name for field in dataclasses.fields(rhec.Fault)], 4),
    "RHE": (rhec.RHE, SETTINGS, 2),
    "RHC": (rhec.RHC, SETTINGS, 2),
}
OF_THE_FIELD = (rhec.Path.from_segments, rhec.Path.racetrack, rhec.Path)
for entry in (*OF_THE_FIELD, rhec.Terrain, rhec.Terrain.uniform, rhec.Terrain.random):
    ENTRIES[entry.__qualname__] = entry, list(inspect.signature(entry).parameters), 9


@pytest.mark.parametrize("name", ENTRIES)
@some(50)
@given(st.data())
def test_an_entry_that_is_given_anything(name, data):
    entry, names, most = ENTRIES[name]
    # Whatever is given, a kind is one of a fault's, and all of a path or a terrain is given.
    anything = junk | numbers | st.lists(numbers.map(lambda n: n[:2]), max_size=4)
    some_names = st.lists(st.sampled_from(names), unique=True, min_size=1, max_size=most)
    chosen = names if most > len(names) else data.draw(some_names)
    arguments = {of: data.draw(anything, label=of) for of in chosen}
    if name == "Fault":
        arguments = dict(kind=data.draw(st.sampled_from(faults.KINDS))) | arguments
    made = refused_by_name(lambda: entry(**arguments), [*names, name])
    if isinstance(made, rhec.Path):
        with np.errstate(all="ignore"):
            points, _ = made.poses(np.linspace(0, made.length_m, 9))
            assert np.shape(made.project(points[:, :2])) == (2, 9)


@some(150)
@given(name=st.sampled_from(["z", "pose", "p", "xi_ref", "omega_ref"]), value=junk)
def test_a_measurement_and_a_reference_of_any_kind(live, name, value):
    straight = dict(
        pose=(0, 0, 0), p=(0.5, 1, 1), xi_ref=np.zeros((3, N + 1)), omega_ref=np.zeros(N)
    )
    rhe, rhc = live
    object_, good = (rhe, {}) if name == "z" else (rhc, straight)
    object_.prepare()
    refused_by_name(lambda: object_.feedback(**good | {name: value}), [name])


@pytest.fixture(scope="module")
def live(virtual_machine):
    return rhec.RHE(), rhec.RHC()


# Recorded logs

COLUMNS = "t_s x_m y_m speed_mps yaw_rate_radps v_left_mps v_right_mps pos_ok encoders_ok".split()
COLUMNS += ["segment", "yaw_true_rad", "anything"]
PARAMETERS = "track_width_m lever_arm_m first_yaw_rad sigma_yaw_rad sigma_v process_noise".split()
PARAMETERS += ["speed_model", "nonsense"]


@st.composite
def logs(draw):
    """A log whose columns may be missing, absurd or of any type; half of the time with a clock that
    runs.
    """
    rows = draw(st.integers(1, 12))
    some_columns = st.lists(st.sampled_from(COLUMNS), unique=True)
    columns = COLUMNS[:5] if draw(st.booleans()) else draw(some_columns)

    def values():
        entry = number | scalar if draw(st.integers(0, 5)) == 0 else number
        return draw(st.lists(entry, min_size=rows, max_size=rows))

    log = pd.DataFrame({column: values() for column in columns})
    return log.assign(t_s=0.2 * np.arange(rows)) if draw(st.booleans()) else log


@pytest.mark.filterwarnings("ignore:The yaw is not known", "ignore:.* left out, because")
@pytest.mark.filterwarnings("ignore:the log's")  # what `doctor` warns of
@some(150)
@given(
    logs() | junk,
    st.dictionaries(st.sampled_from(PARAMETERS), junk | numbers, max_size=1),
    st.booleans(),
)
def test_a_recorded_log(log, fields, simplest):
    """Refused in one sentence, or one finite estimate a row from the first position of its segment
    on, with traction between 0 and 1.
    """
    fields = {} if simplest else fields
    result = refused_by_name(
        lambda: rhec.replay(log, estimator="ekf", **fields), ["log", "the", "replay", *PARAMETERS]
    )
    if result is not None:
        assert len(result) == len(log) and result.index.equals(log.index)
        has_position = result[["x_meas_m", "y_meas_m"]].notna().all(axis=1)
        located = has_position.groupby(result["segment"]).cummax()
        estimate = result[["x_hat_m", "y_hat_m", "theta_hat_rad"]].to_numpy(float)
        assert np.isfinite(estimate[located]).all()
        assert result.loc[located, ["mu_hat", "kappa_hat"]].stack().between(0, 1).all()
