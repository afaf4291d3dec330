"""Figures of many drives, which no copy shows, are what the logs give; times are those of a clock.

`test_published` has the others.
"""

from types import SimpleNamespace

import numpy as np
import pandas as pd
import pytest
from helpers import recorded_log
from text_boxes import text_defects

import rhec
from notebooks.further import recorded_logs_plots
from notebooks.further.recorded import scores
from notebooks.plots import scenarios
from notebooks.plots.scenarios import stated
from notebooks.studies import timing
from rhec import paper, style


@pytest.fixture(scope="module")
def runs():
    """Runs of the RHE on two fields."""
    usual = dict(process_noise="prediction", duration_s=75.0, row_length_m=4.0)
    return [rhec.simulate(rhec.Scenario(seed=seed, **usual)) for seed in range(2)]


@pytest.fixture(scope="module")
def drawn(runs):
    """The figures of many drives by their function's name."""
    soft = rhec.simulate(rhec.Scenario(duration_s=75.0, **rhec.WORLDS["soft"]))
    return dict(
        estimates=scenarios.estimates({"a title": runs, "soft soil": [soft]}),
        speed=scenarios.speed(runs),
        kkt=scenarios.kkt(runs),
    )


@pytest.mark.nightly
def test_no_text_is_cut_off_or_over_another(drawn):
    for name, figure in drawn.items():
        assert text_defects(figure) == [], name
        assert figure.get_figwidth() in (style.COLUMN_IN, style.DOUBLE_IN), name


@pytest.mark.parametrize("name", ["estimates", "speed"])
def test_a_legend_names_all_that_is_drawn_and_labels_have_units(drawn, name):
    figure = drawn[name]
    (legend,) = figure.legends
    told = {text.get_text() for text in legend.texts}
    drawn_as = {label for axes in figure.axes for label in axes.get_legend_handles_labels()[1]}
    assert told and drawn_as == told
    quantities = [text for each in figure.axes for text in (each.get_xlabel(), each.get_ylabel())]
    assert all("[" in text for text in filter(None, quantities)) and any(quantities)


def test_estimates_have_two_sigma_about_them_and_the_frequencies_of_all_drives(drawn, runs):
    log = runs[0].log
    rows = np.reshape(drawn["estimates"].axes, (3, 4))[:, :2]
    curve_s = log["t_s"][~log["on_straight"]]
    second_row_s = log["t_s"][log["on_straight"] & (log["t_s"] > curve_s.min())]
    for (time, beside), (value, sigma, truth, inside), unit in zip(
        rows, stated(runs[0]).values(), ("θ", "μ", "κ")
    ):
        assert "[" in time.get_ylabel()
        band = time.collections[0].get_paths()[0].vertices
        assert band[:, 1].max() == pytest.approx((value + 2 * sigma).max())
        assert band[:, 1].min() == pytest.approx((value - 2 * sigma).min())
        estimate, true = time.lines
        np.testing.assert_array_equal(estimate.get_ydata(), value)
        np.testing.assert_array_equal(true.get_ydata(), truth)
        assert f": {100 * inside:.0f} % within ± 2 σ" in time.get_title("left")
        for stairs in beside.patches:
            shares, edges, _ = stairs.get_data()
            assert shares.sum() == pytest.approx(100)
            assert time.get_ylim()[0] <= edges[0] < edges[-1] <= time.get_ylim()[1]
        settled = np.concatenate([run.columns["t_s"] >= 20 for run in runs])
        if unit != "θ":
            both = dict(μ=("mu_hat", "mu"), κ=("kappa_hat", "kappa"))[unit]
            at_bound = np.mean((value < 1e-6) | (value > 1 - 1e-6))
            assert f", {100 * at_bound:.0f} % at a bound" in time.get_title("left")
            for stairs, name in zip(beside.patches, both, strict=True):
                values = np.concatenate([run.columns[name] for run in runs])[settled]
                shares, edges, _ = stairs.get_data()
                top = (values >= edges[-2]).mean()
                assert shares[-1] == pytest.approx(100 * top)
    assert rows[0, 0].get_xlim() == (0, log["t_s"].max())
    # The excerpt has the end of the first of two curves in its middle.
    assert second_row_s.min() + 5 < curve_s.max()
    assert np.mean(rows[2, 0].get_xlim()) == pytest.approx(second_row_s.min(), abs=0.3)
    assert np.ptp(rows[2, 0].get_xlim()) == pytest.approx(30)


def test_tolerances_and_speeds_are_those_of_all_drives(drawn, runs):
    for axes, name in zip(drawn["kkt"].axes, ("RHE", "RHC")):
        kkt = [run.columns[f"kkt_{name.lower()}"] for run in runs]
        low, middle, high = np.percentile(kkt, (5, 50, 95), axis=0)
        (line,) = axes.lines
        np.testing.assert_allclose(line.get_ydata(), np.maximum(middle, 5e-6))
        np.testing.assert_allclose(line.get_xdata(), 0.2 * np.arange(1, len(middle) + 1))
        band = axes.collections[0].get_paths()[0].vertices[:, 1]
        assert (band.min(), band.max()) == pytest.approx((max(low.min(), 5e-6), high.max()))
        assert axes.get_xscale() == axes.get_yscale() == "log" and axes.get_ylim()[0] == 1e-5
        largest_s = line.get_xdata()[middle.argmax()]
        assert f"{name}: largest median {middle.max():.2g}, at {largest_s:.1f} s" == axes.get_title(
            "left"
        )
    time, beside = drawn["speed"].axes
    for line, stairs, column in zip(
        time.lines, beside.patches, ("nu_meas_mps", "nu_mps", "nu_hat_mps")
    ):
        np.testing.assert_array_equal(line.get_ydata(), runs[0].log[column])
        shares, edges, _ = stairs.get_data()
        assert shares.sum() == pytest.approx(100) and (edges[0], edges[-1]) == pytest.approx(
            (time.lines[0].get_ydata().min(), time.lines[0].get_ydata().max())
        )
        values = np.concatenate([run.columns[column][run.columns["t_s"] >= 20] for run in runs])
        assert edges[shares.argmax()] - 0.02 < np.median(values) < edges[shares.argmax()] + 0.02
    assert [*time.lines[3].get_ydata()] == [paper.SPEED_MPS] * 2
    settled = np.array([run.columns["nu_meas_mps"][100:] for run in runs])
    assert f"measured {settled.std():.3f}" in drawn["speed"].get_suptitle()


def test_the_yaw_of_a_replay_is_drawn_with_its_sigma():
    """Of a log of two segments, in the second of which the first yaw is a turn off."""
    one = recorded_log(5.0, 30.0, noise_m=0.02, seed=1).assign(segment="a")
    turned = one.assign(segment="b", t_s=one["t_s"] + 30.0)
    log = pd.concat([one, turned], ignore_index=True)
    given = dict(process_noise="prediction", sigma_v=paper.SIGMA_V, trust_log=True)
    replays = {
        name: scores.perturbed_replay(log, 0, yaw_error_rad=off_rad, **given)
        for name, off_rad in (("RHE", 0.3), ("EKF", 3.0))
    }
    figure = recorded_logs_plots.replay_yaw(replays)
    largest = max(scores.yaw_error(samples).abs().max() for samples in replays.values())
    for axes, (name, samples) in zip(figure.axes, replays.items()):
        error = scores.yaw_error(samples)
        drawn = axes.lines[0].get_ydata()
        assert (np.isclose(drawn, error) | np.isnan(drawn)).all()
        # Where the line is broken: at the second segment, and where it would cross the panel.
        is_first = samples["segment"] != samples["segment"].shift(fill_value=0)
        np.testing.assert_array_equal(np.isnan(drawn), is_first | (error.diff().abs() > np.pi))
        found = scores.score(samples)
        assert axes.get_title("left") == (
            f"{name}: RMS {found['yaw_rms_rad']:.3f} rad after 8 m, "
            f"{100 * found['inside_95']:.0f}% within 1.96 σ"
        )
        most = 2 * samples["sigma_theta_rad"].max()
        assert ends_of(axes.collections[0]) == pytest.approx((-most, most))
        low, high = axes.get_ylim()
        assert -low == high == pytest.approx(min(1.1 * largest, np.pi))
        assert axes.lines[0].get_color() == style.COLOURS[name]
    assert axes.get_xlim() == (samples["t_s"].min(), samples["t_s"].max())
    # It is shaded where the robot goes straight, and turns in the rest.
    turning = samples["omega_meas_radps"].abs().rolling(11, center=True, min_periods=1)
    shades = axes.collections[-1].get_paths()
    shaded_s = sum(np.ptp(path.vertices[:, 0]) for path in shades)
    assert shaded_s == pytest.approx(0.2 * (turning.median() < 0.05).sum(), rel=0.2)
    assert text_defects(figure) == []


def ends_of(band):
    """The lowest and the highest value of a filled band."""
    values = np.concatenate([path.vertices[:, 1] for path in band.get_paths()])
    return np.nanmin(values), np.nanmax(values)


def test_what_the_estimator_states_is_what_it_said_in_the_loop(runs):
    run, _ = runs
    found = stated(run)
    for name in ("mu", "kappa"):
        value, sigma, truth, inside = found[name]
        np.testing.assert_allclose(value, run.log[f"{name}_hat"], atol=1e-9)
        settled = run.log["t_s"].to_numpy() >= 20
        assert inside == np.mean((np.abs(value - truth) <= 2 * sigma)[settled])
    error_rad, _, truth, _ = found["theta_rad"]
    np.testing.assert_allclose(
        error_rad, run.log["theta_hat_rad"] - run.log["theta_rad"], atol=1e-9
    )
    assert (truth == 0).all()


def test_each_phase_has_the_time_that_it_took(monkeypatch):
    """Of a clock on which a call takes as many µs as its place, and the references 9."""
    now_us = [0]

    def takes(us, answer=None):
        def call(*_, **__):
            now_us[0] += us
            return answer

        return call

    estimate = SimpleNamespace(pose=None, p=None)
    rhe = SimpleNamespace(prepare=takes(1), feedback=takes(2, estimate))
    rhc = SimpleNamespace(prepare=takes(3), feedback=takes(4))
    monkeypatch.setattr(timing.time, "perf_counter_ns", lambda: 1000 * now_us[0])
    monkeypatch.setattr(timing.rhec, "RHE", lambda **_: rhe)
    tracker = SimpleNamespace(references=takes(9, (None, None)))
    monkeypatch.setattr(timing, "PathTracker", lambda path: tracker)
    taken = timing.phases(rhec.Scenario(duration_s=2.0), lambda **_: rhc)
    np.testing.assert_array_equal(taken, [[1.0, 2.0, 3.0, 4.0]] * 9)
    assert (
        tuple(
            (problem, phase) for problem in ("RHE", "RHC") for phase in ("preparation", "feedback")
        )
        == timing.PHASES
    )


def test_table_1_is_the_papers_form_in_milliseconds():
    times = timing.table(np.array([[400.0, 60.0, 300.0, 20.0], [600.0, 80.0, 500.0, 40.0]]))
    shown = timing.as_in_the_paper(times)
    ours, papers = (shown[whose] for whose in shown.columns.levels[0])
    assert list(ours.loc[("RHE", "overall")]) == [0.46, 0.57, 0.68]
    for place, expected in paper.TABLE_1_MS.items():
        assert list(papers.loc[place]) == pytest.approx(expected)
    skewed = timing.table(np.array([[1.0, 2.0, 3.0, 4.0]] * 2 + [[9.0, 9.0, 9.0, 9.0]]))
    assert timing.feedback_over_preparation(skewed)["ratio"].to_dict() == dict(RHE=2, RHC=4 / 3)
