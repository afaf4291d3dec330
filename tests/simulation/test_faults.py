"""Sensor faults: their effect on a stream of measurements and in the closed loop."""

import dataclasses

import numpy as np
import pytest
from helpers import SIMPLE_WORLD
from hypothesis import given, settings
from hypothesis import strategies as st
from oracles import flat

import rhec
from rhec import paper
from rhec.simulation import fault_signals, faults
from rhec.simulation.faults import Fault
from rhec.tracked_robot.sensors import SENSORS

pytestmark = pytest.mark.usefixtures("virtual_machine")
DT, B = paper.DT_S, paper.TRACK_WIDTH_M
T = np.arange(100) * DT
# Smooth, and no two samples alike; a gyro and a heading come last.
Z = np.column_stack([0.1 * T, 3 - T**2, 0.5 + 0.01 * T, 0.1 * np.sin(T), np.cos(0.1 * T), 0.3 * T])
DURING = slice(50, 60)  # 10 s ≤ t < 12 s
SHORT = rhec.Scenario(**SIMPLE_WORLD, process_noise="prediction", duration_s=30.0)


def arriving(*several, seed=0, start_s=10.0):
    """Z as it arrives with these faults of 2 s."""
    several = [Fault(start_s=start_s, duration_s=2.0, **fault) for fault in several]
    return fault_signals.corrupted(Z, several, T, B, seed, tuple(SENSORS))


def channels_of(kind):
    """The channels on which a kind of fault may be."""
    channels = faults.OWN_CHANNELS.get(kind, tuple(faults.CHANNELS))
    return (*channels, *SENSORS) if "encoders" in channels else channels


@pytest.mark.parametrize(
    "fault",
    [
        dict(kind="missing"), dict(kind="infinite"), dict(kind="outliers", size_m=1.0),
        dict(kind="jump", size_m=1.0), dict(kind="stuck"), dict(kind="duplicates"),
        dict(kind="disorder"), dict(kind="latency", delay_s=0.3), dict(kind="rate", rate_hz=1.0),
        dict(kind="dead", channel="left"),
    ],
    ids=str,
)  # fmt: skip
def test_only_the_channel_and_the_time_of_the_fault_are_touched(fault):
    touched = dict(gnss=[0, 1], encoders=[2, 3], gyro=[4], heading=[5], all=range(6))
    touched |= dict(left=[2, 3], right=[2, 3])
    for channel in channels_of(fault["kind"]):
        changed = arriving(fault | dict(channel=channel)) != Z
        assert not changed[:50].any() and not changed[60:].any()
        expected = [row in touched[channel] for row in range(6)]
        assert changed[DURING].any(axis=0).tolist() == expected


NAN = -1
# {kind and options: which sample each of ten samples of a faulty channel is}; NAN: none of them
DELIVERED = {
    "missing": [NAN] * 10,
    "infinite": [NAN] * 10,
    "stuck": [49] * 10,
    "duplicates": [50, 50, 52, 52, 54, 54, 56, 56, 58, 58],
    "disorder": [50, 49, 52, 51, 54, 53, 56, 55, 58, 57],
    "rate": [50, NAN, 52, NAN, 54, NAN, 56, NAN, 58, NAN],
}


@pytest.mark.parametrize("kind", DELIVERED)
def test_some_faults_deliver_earlier_samples_or_none(kind):
    order = np.array(DELIVERED[kind])
    fault = dict(kind=kind, channel="all") | (dict(rate_hz=2.5) if kind == "rate" else {})
    none = np.inf if kind == "infinite" else np.nan

    def expected(order):
        return np.where(order[:, None] == NAN, none, Z[np.maximum(order, 0)])

    np.testing.assert_allclose(arriving(fault)[DURING], expected(order), rtol=1e-15)
    # A fault that begins a sample later does the same to the samples from there on.
    later = np.where(order == NAN, NAN, order + 1)
    np.testing.assert_allclose(arriving(fault, start_s=10.2)[51:61], expected(later), rtol=1e-15)
    # Before the first sample there is none: the first takes its place.
    order = np.where(order == NAN, NAN, np.maximum(order - 50, 0))
    early = arriving(fault, start_s=0.0)[:10]
    np.testing.assert_allclose(early, expected(order), rtol=1e-15)


def test_outliers_have_their_size_and_the_directions_of_their_seed():
    off = [
        (arriving(dict(kind=kind, size_m=3.0), seed=seed) - Z)[DURING, :2]
        for kind in ("outliers", "jump")
        for seed in (0, 0, 1)
    ]
    np.testing.assert_allclose(np.hypot(*np.concatenate(off).T), 3.0)
    for kind in (off[:3], off[3:]):
        np.testing.assert_array_equal(kind[0], kind[1])
        assert np.abs(kind[0] - kind[2]).max() > 0.1
    assert np.ptp(off[0], axis=0).min() > 1 and np.ptp(off[3], axis=0).max() < 1e-12


@pytest.mark.parametrize("delays_s", [(0.1,), (0.35,), (0.6,), (0.6, 0.3), (0.3, 0.6)])
def test_latency_delivers_the_position_of_an_earlier_time(delays_s):
    """Linear between the samples. Of two the longer one counts."""
    several = [dict(kind="latency", delay_s=delay_s) for delay_s in delays_s]
    expected = 0.1 * (T[DURING] - max(delays_s))
    np.testing.assert_allclose(arriving(*several)[DURING, 0], expected, atol=1e-12)
    # There is none before the first.
    np.testing.assert_array_equal(arriving(*several, start_s=0.0)[0], Z[0])


def test_a_dead_encoder_measures_0():
    tracks = Z[DURING, 2, None] + B / 2 * Z[DURING, 3, None] * (-1, 1)
    for channel, alive in dict(left=(0, 1), right=(1, 0), encoders=(0, 0)).items():
        left, right = (tracks * alive).T
        expected = np.column_stack([(left + right) / 2, (right - left) / B])
        found = arriving(dict(kind="dead", channel=channel))[DURING, 2:4]
        np.testing.assert_allclose(found, expected, atol=1e-15)


OF_A_SIZE = dict(
    outliers=dict(size_m=st.floats(0, 100)), jump=dict(size_m=st.floats(0, 100)),
    latency=dict(delay_s=st.floats(0, 1)), rate=dict(rate_hz=st.floats(0.1, 20)),
)  # fmt: skip


@st.composite
def a_fault(draw):
    kind = draw(st.sampled_from(faults.KINDS))
    channel = draw(st.sampled_from(channels_of(kind)))
    size = {name: draw(values) for name, values in OF_A_SIZE.get(kind, {}).items()}
    # Some are there from the first sample, before which there is nothing to deliver.
    start_s = draw(st.just(0.0) | st.floats(-2, 22))
    times = dict(start_s=start_s, duration_s=draw(st.floats(0, 10)))
    return Fault(kind=kind, channel=channel, **size, **times)


@settings(max_examples=30, deadline=None, derandomize=True)
@given(st.lists(a_fault(), max_size=4), st.integers(0, 9))
def test_faults_are_the_same_in_the_closed_loop_and_on_a_recorded_stream(several, seed):
    """Of a robot with all sensors."""
    names = tuple(SENSORS)
    shapes = faults.stream_shapes(len(names))
    deliver, memory, rows = fault_signals.deliver(len(names)), faults.init(len(names)), []
    ends = np.cumsum([n * columns for n, columns in shapes.values()])[:-1]
    for sample, row in zip(Z, fault_signals.stream(several, len(Z), DT, seed, names)):
        signals = dict(zip(shapes, np.split(row, ends)))
        result = deliver(z=sample, **memory, **signals, track_width_m=B)
        memory = {name: result[name] for name in memory}
        rows.append(flat(result["z"]))
    expected = fault_signals.corrupted(Z, several, T, B, seed, names)
    np.testing.assert_allclose(rows, expected, rtol=1e-9, atol=1e-9)


@settings(max_examples=40, deadline=None, derandomize=True)
@given(st.lists(a_fault(), max_size=4), st.integers(1, 100))
def test_a_longer_stream_begins_like_a_shorter_one(several, n):
    longer, shorter = (fault_signals.stream(several, m, DT, 3, tuple(SENSORS)) for m in (100, n))
    np.testing.assert_array_equal(longer[:n], shorter)


# In the closed loop


def simulated(*several, **changes):
    return rhec.simulate(dataclasses.replace(SHORT, faults=several, **changes))


def test_the_log_has_the_measurements_that_arrived():
    """Before the fault the run equals the one without to the last bit; a fault that never comes
    changes nothing.
    """
    healthy, never = simulated(), simulated(Fault(kind="missing", start_s=1e6))
    for name in healthy.columns:
        np.testing.assert_array_equal(never.columns[name], healthy.columns[name])
    during, position = range(50, 60), ["x_meas_m", "y_meas_m"]
    before = healthy.log.drop(columns="on_straight")[:50]
    for kind in ("missing", "infinite", "stuck"):
        log = simulated(Fault(kind=kind, start_s=10.0, duration_s=2.0)).log
        np.testing.assert_array_equal(log.drop(columns="on_straight")[:50], before)
        assert log["error_true_m"].notna().all()
        if kind == "stuck":
            assert (log.loc[during, position] == log.loc[49, position]).all(axis=None)
        else:
            assert not np.isfinite(log.loc[during, position]).any(axis=None)
            assert log.loc[during, "error_m"].isna().all()
            assert log.drop(during)["error_m"].notna().all()


def test_ok_is_false_where_a_step_was_not_solved():
    """A position 90,000 km off for a second, without gating: commands keep their bound, `ok` is
    False for some samples, True again after.
    """
    run = simulated(Fault(kind="jump", size_m=9e7, start_s=20.0, duration_s=1.0), duration_s=60.0)
    ok = run.log["ok"]
    assert ok[:100].all() and not ok.all() and ok[140:].all() and not run.metrics["solver_ok"]
    assert run.log["omega_cmd_radps"].abs().max() <= 0.1
    assert np.isfinite(run.log.filter(like="hat")).all(axis=None)
