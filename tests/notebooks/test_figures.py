"""Results: axes with units, our number beside the paper's, tables that equal what the logs give,
verdicts by the rule.
"""

import dataclasses
from types import SimpleNamespace

import numpy as np
import pandas as pd
import pytest
from helpers import recorded_log
from matplotlib.figure import Figure
from text_boxes import text_defects

import rhec
from notebooks.further import recorded_logs_plots
from notebooks.further.recorded import scores
from notebooks.plots import scenarios
from notebooks.plots.scenarios import stated
from notebooks.plots.timing import phases
from notebooks.studies import timing
from notebooks.studies.scenario_tables import scenario_a_table, scenario_b_table
from rhec import paper, style

SEEDS = range(2)
WEIGHTS = {
    "Q1": {"q": paper.Q1},
    "Q2": {"q": paper.Q2},
    "Q2, look-ahead": {"q": paper.Q2, "look_ahead_m": 0.5},
    "Q3": {"q": paper.Q3},
}
TIMES = pd.DataFrame(
    [
        ("RHE", "preparation", 4.0, 5.0, 40.0),
        ("RHE", "feedback", 3.0, 6.0, 30.0),  # made up
        ("RHC", "preparation", 3.0, 4.0, 20.0),
        ("RHC", "feedback", 2.0, 3.5, 15.0),
    ],
    columns=["problem", "phase", "minimum_us", "average_us", "maximum_us"],
)


def scenario(**choice):
    return rhec.Scenario(duration_s=75.0, **choice)


@pytest.fixture(scope="module")
def runs():
    """{process noise: {"RHE": Run, "EKF": Run}}"""
    return {
        process_noise: {
            name: rhec.simulate(scenario(process_noise=process_noise, estimator=name.lower()))
            for name in ("RHE", "EKF")
        }
        for process_noise in ("printed", "prediction")
    }


@pytest.fixture(scope="module")
def by_weight():
    """{weight: one Run a seed}"""
    return {
        weight: [
            rhec.simulate(scenario(process_noise="prediction", seed=seed, **choice))
            for seed in SEEDS
        ]
        for weight, choice in WEIGHTS.items()
    }


@pytest.fixture(scope="module")
def sweep_a(by_weight):
    return pd.DataFrame(
        [
            {"weight": weight, "process_noise": "prediction", "seed": seed} | run.metrics
            for weight, runs in by_weight.items()
            for seed, run in enumerate(runs)
        ]
    )


@pytest.fixture(scope="module")
def sweep_b():
    return rhec.campaign(
        [
            scenario(process_noise=process_noise, estimator=estimator, seed=seed)
            for process_noise in ("printed", "prediction")
            for estimator in ("rhe", "ekf")
            for seed in SEEDS
        ]
    ).assign(turns="alternate")


@pytest.fixture(scope="module")
def drives(runs):
    """{process noise: [Run, Run]} of the RHE on two fields"""
    return {
        noise: [pair["RHE"], rhec.simulate(dataclasses.replace(pair["RHE"].scenario, seed=1))]
        for noise, pair in runs.items()
    }


class Drawn(dict):
    """Figures by their function's name, each drawn when it is asked for."""

    def __init__(self, makers):
        self.makers = makers

    def __missing__(self, name):
        self[name] = self.makers[name]()
        return self[name]


@pytest.fixture(scope="module")
def drawn(runs, drives, by_weight, sweep_a, sweep_b):
    pair, table = runs["prediction"], scenario_b_table(sweep_b)
    first = {weight: of_seeds[0] for weight, of_seeds in by_weight.items()}
    soft = scenario(**rhec.WORLDS["soft"])
    return Drawn(
        {
            "trajectories_q": lambda: scenarios.trajectories_q(first, scenario_a_table(sweep_a)),
            "slip_fields": lambda: scenarios.slip_fields(
                pair["RHE"].terrain, pair["RHE"].path, "slip fields, seed 0"
            ),
            "trajectories": lambda: scenarios.trajectories(runs),
            "errors": lambda: scenarios.errors(runs),
            "violations": lambda: scenarios.violations(table),
            "estimates": lambda: scenarios.estimates(drives | {"soft soil": [rhec.simulate(soft)]}),
            "speed": lambda: scenarios.speed(drives["prediction"]),
            "yaw_rate": lambda: scenarios.yaw_rate(pair["RHE"]),
            "kkt": lambda: scenarios.kkt(drives["prediction"]),
            "phases": lambda: phases(TIMES, "a test"),
        }
    )


def words(figure):
    texts = figure.findobj(lambda each: hasattr(each, "get_text") and each.get_visible())
    return " ".join(text.get_text() for text in texts)


@pytest.mark.nightly
def test_no_text_is_cut_off_or_over_another(drawn):
    for name in drawn.makers:
        figure = drawn[name]
        assert isinstance(figure, Figure) and text_defects(figure) == [], name
        assert figure.get_figwidth() in (style.COLUMN_IN, style.DOUBLE_IN), name


@pytest.mark.parametrize(
    "name", ["trajectories", "errors", "violations", "estimates", "speed", "yaw_rate", "phases"]
)
def test_a_legend_names_all_that_is_drawn_and_labels_have_units(drawn, name):
    figure = drawn[name]
    legends = [*figure.legends, *filter(None, (axes.get_legend() for axes in figure.axes))]
    told = {text.get_text() for legend in legends for text in legend.texts}
    drawn_as = {label for axes in figure.axes for label in axes.get_legend_handles_labels()[1]}
    assert told and drawn_as - {"reference"} == told - {"reference"}
    quantities = [text for each in figure.axes for text in (each.get_xlabel(), each.get_ylabel())]
    assert all("[" in text for text in filter(None, quantities)) and any(quantities)


def test_the_papers_numbers_stand_beside_ours(drawn, runs):
    errors = words(drawn["errors"])
    assert (
        "RHE (the paper's mean: 0.0423 m)" in errors and "EKF (the paper's mean: 0.0514" in errors
    )
    for pair in runs.values():
        for name, run in pair.items():
            assert f"{name} {run.metrics['mean_error_m']:.4f} m" in errors
    diamonds = [line for line in drawn["violations"].axes[0].lines if line.get_marker() == "D"]
    # All drives of the paper's RHE are without a violation, and the one of its EKF is not.
    assert sorted(line.get_xdata()[0] for line in diamonds) == [0, 0, 100, 100]
    assert "here: a test" in words(drawn["phases"]) and "152 µs" in words(drawn["phases"])


def test_the_distance_beside_the_path_is_the_error_with_its_side(drawn, runs):
    """A robot to the left of the path is beside it by a positive distance, as at the start."""
    plane, *panels, _ = drawn["trajectories"].axes
    reference, *_ = plane.lines
    path = next(iter(runs.values()))["RHE"].path
    ends = path.poses(np.array([0.0, path.length_m]))[0][:, :2]
    np.testing.assert_allclose(reference.get_xydata()[[0, -1]], ends, atol=0.1)
    for axes, pair in zip(panels, runs.values()):
        for line, name in zip(axes.lines, ("EKF", "RHE")):
            lateral_m = line.get_ydata()
            np.testing.assert_allclose(np.abs(lateral_m), pair[name].log["error_true_m"], atol=1e-9)
            assert lateral_m[0] == pytest.approx(1.0)
        assert f"RHE {largest_after_settling(pair['RHE']):.2f} m" in axes.get_title("left")


def largest_after_settling(run):
    log = run.log[run.log["t_s"] >= run.metrics["settling_time_s"]]
    return log["error_true_m"].max()


def test_one_drive_is_drawn_as_it_was_and_the_many_beside_it(drawn, drives):
    run, *others = drives["prediction"]
    error = drawn["errors"].axes[1]  # of the second W
    assert any(np.array_equal(line.get_ydata(), run.log["error_m"]) for line in error.lines)
    of_rhe = scenarios.estimates(dict(prediction=drives["prediction"]))
    yaw, _, kappa = of_rhe.axes[::2]
    error_rad = run.log["theta_hat_rad"] - run.log["theta_rad"]
    assert any(np.allclose(line.get_ydata(), error_rad, atol=1e-9) for line in yaw.lines)
    assert any(np.array_equal(line.get_ydata(), run.log["kappa"]) for line in kappa.lines)
    time, beside = drawn["speed"].axes
    np.testing.assert_array_equal(time.lines[0].get_ydata(), run.log["nu_meas_mps"])
    settled = np.array([other.columns["nu_meas_mps"][100:] for other in (run, *others)])
    assert f"measured {settled.std():.3f}" in words(drawn["speed"])
    assert len(beside.patches) == 3


def test_estimates_have_two_sigma_about_them_and_the_frequencies_of_all_drives(drives):
    runs = drives["prediction"]
    log = runs[0].log
    rows = np.reshape(scenarios.estimates({"a title": runs}).axes, (3, 2))
    curve_s = log["t_s"][~log["on_straight"]]
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
    # The excerpt has the end of the first curve, or of the drive, in its middle.
    assert np.mean(rows[2, 0].get_xlim()) == pytest.approx(curve_s.max(), abs=0.3)
    assert np.ptp(rows[2, 0].get_xlim()) == pytest.approx(30)


def test_tolerances_and_speeds_are_those_of_all_drives(drawn, drives):
    runs = drives["prediction"]
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


@pytest.mark.parametrize("process_noise", ["printed", "prediction"])
def test_what_the_estimator_states_is_what_it_said_in_the_loop(runs, process_noise):
    run = runs[process_noise]["RHE"]
    found = stated(run)
    for name in ("mu", "kappa"):
        value, sigma, truth, inside = found[name]
        np.testing.assert_allclose(value, run.log[f"{name}_hat"], atol=1e-9)
        settled = run.log["t_s"].to_numpy() >= 20
        assert inside == np.mean((np.abs(value - truth) <= 2 * sigma)[settled])
    assert (found["theta_rad"][2] == 0).all()


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


def test_at_most_none_includes_none_and_below_zero_does_not_include_zero(sweep_b):
    table = scenario_b_table(sweep_b.assign(violations=0))
    violations = table[table["quantity"] == "violations on straights, raw GNSS"]
    verdicts = violations.set_index("estimator")["verdict"]
    assert (verdicts["RHE"] == "holds").all()
    once = scenario_b_table(sweep_b.assign(violations=1.0 * (np.arange(len(sweep_b)) == 0)))
    of_rhe = once[once["claim"] == "at most 0"].set_index("process_noise")["verdict"]
    assert of_rhe.to_dict() == dict(printed="does not hold", prediction="holds")
    assert set(verdicts["RHE - EKF"]) == {
        "does not hold",
        "its rival is lost",
    }  # W by prediction, printed


def test_runs_that_never_settle_are_counted(sweep_a):
    never = sweep_a.assign(
        settling_time_s=sweep_a["settling_time_s"].where(sweep_a["weight"] != "Q1")
    )
    table = scenario_a_table(never).set_index(["weight", "quantity"])
    assert (
        table.loc[("Q1", "settling time [s]"), "n"] == 0
        and table.loc[("Q1 / Q3", "settling time, ratio"), "verdict"] == "undecided"
    )
