"""Results: axes with units, our number beside the paper's, tables that equal what the logs give,
verdicts by the rule.
"""

import itertools
import re

import numpy as np
import pandas as pd
import pytest
from matplotlib.figure import Figure

import rhec
from rhec import paper
from rhec.plots import consistency, scenarios, style
from rhec.plots.timing import phases
from rhec.studies.consistency import Consistency
from rhec.studies.scenario_tables import scenario_a_table, scenario_b_table

SEEDS = range(3)
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
    return rhec.Scenario(duration_s=90.0, **choice)


@pytest.fixture(scope="module")
def runs(virtual_machine):
    """{process noise: {"RHE": Run, "EKF": Run}}"""
    return {
        process_noise: {
            name: rhec.simulate(scenario(process_noise=process_noise, estimator=name.lower()))
            for name in ("RHE", "EKF")
        }
        for process_noise in ("printed", "calibrated")
    }


@pytest.fixture(scope="module")
def by_weight(virtual_machine):
    """{weight: one Run a seed}"""
    return {
        weight: [
            rhec.simulate(scenario(process_noise="calibrated", seed=seed, **choice))
            for seed in SEEDS
        ]
        for weight, choice in WEIGHTS.items()
    }


@pytest.fixture(scope="module")
def sweep_a(by_weight):
    return pd.DataFrame(
        [
            {"weight": weight, "process_noise": "calibrated", "seed": seed} | run.metrics
            for weight, runs in by_weight.items()
            for seed, run in enumerate(runs)
        ]
    )


@pytest.fixture(scope="module")
def sweep_b(virtual_machine):
    return rhec.campaign(
        [
            scenario(process_noise=process_noise, estimator=estimator, seed=seed)
            for process_noise in ("printed", "calibrated")
            for estimator in ("rhe", "ekf")
            for seed in SEEDS
        ]
    )


@pytest.fixture(scope="module")
def drawn(runs, by_weight, sweep_a, sweep_b):
    """Every figure, by its function's name."""
    pair = runs["calibrated"]
    return {
        "trajectories_q": scenarios.trajectories_q(
            {weight: of_seeds[0] for weight, of_seeds in by_weight.items()}
        ),
        "weight_sweep": scenarios.weight_sweep(sweep_a),
        "slip_fields": scenarios.slip_fields(
            pair["RHE"].terrain, pair["RHE"].path, "slip fields, seed 0"
        ),
        "trajectories": scenarios.trajectories(pair),
        "errors": scenarios.errors(runs),
        "violations": scenarios.violations(sweep_b),
        "phases": phases(TIMES),
    } | {
        draw.__name__: draw(pair["RHE"])
        for draw in (scenarios.estimates, scenarios.speed, scenarios.yaw_rate, scenarios.kkt)
    }


def words(figure):
    return " ".join(
        text.get_text()
        for text in figure.findobj(
            lambda artist: hasattr(artist, "get_text") and artist.get_visible()
        )
    )


def test_axes_are_labelled_with_units(drawn):
    for name, figure in drawn.items():
        assert isinstance(figure, Figure)
        assert figure.get_figwidth() in (style.COLUMN_IN, style.DOUBLE_IN), name
        labels = [
            text for axes in figure.axes for text in (axes.get_xlabel(), axes.get_ylabel()) if text
        ]
        assert labels and all(re.search(r"\[.+\]", label) for label in labels), (name, labels)


def test_figures_say_which_process_noise_and_seeds(drawn):
    for name, figure in drawn.items():
        if name != "phases":
            assert re.search(r"seeds?", words(figure)), name
            noise = re.search("(printed|calibrated) process noise", words(figure))
            assert name == "slip_fields" or noise, name


def test_titles_and_legends_are_inside_the_figure_and_apart(drawn):
    for name, figure in drawn.items():
        figure.draw_without_rendering()
        boxes = [
            (text.get_text(), text.get_window_extent())
            for axes in figure.axes
            for text in (axes.title, axes._left_title)
            if text.get_text()
        ]
        for text, box in boxes:
            assert figure.bbox.x0 <= box.x0 and box.x1 <= figure.bbox.x1, (name, text)
        for (one, a), (other, b) in itertools.combinations(boxes, 2):
            assert not a.overlaps(b), (name, one, other)


def test_the_papers_numbers_stand_beside_ours(drawn, runs):
    errors = words(drawn["errors"])
    for pair in runs.values():
        for run in pair.values():
            assert f"mean {run.metrics['mean_error_m']:.4f} m" in errors
    assert "paper: 0.0423 m" in errors and "paper: 0.0514 m" in errors
    assert "paper: 0" in words(drawn["violations"]) and "paper: 17" in words(drawn["violations"])
    assert "9.5 µs, paper: 152 µs" in words(drawn["phases"])


def test_preparation_is_over_when_the_measurement_arrives(drawn):
    bars = {
        round(bar.get_y() + bar.get_height() / 2): (bar.get_x(), bar.get_x() + bar.get_width())
        for bar in drawn["phases"].axes[0].patches
    }
    assert [bars[place] for place in range(4)] == [(-9, -4), (-4, 0), (0, 6), (6, 9.5)]


def test_table_a_equals_the_logs(by_weight, sweep_a):
    table = scenario_a_table(sweep_a).set_index(["weight", "quantity"])
    for weight, of_seeds in by_weight.items():
        arrivals = [run.metrics["settling_time_s"] for run in of_seeds]
        assert table.loc[(weight, "settling time [s]"), "mean"] == pytest.approx(np.mean(arrivals))
        raw = [
            run.log.loc[run.log["t_s"] > arrival + 4.9, "error_m"].mean()
            for run, arrival in zip(of_seeds, arrivals)
        ]
        assert table.loc[(weight, "mean error, raw GNSS [m]"), "mean"] == pytest.approx(
            np.mean(raw)
        )
        assert (table.loc[weight, "n"] == len(SEEDS)).all()
    mean = table["mean"]
    assert mean["Q1 / Q3", "settling time, ratio"] == pytest.approx(
        mean["Q1", "settling time [s]"] / mean["Q3", "settling time [s]"]
    )
    assert mean["Q2 / Q3", "overshoot, ratio"] == pytest.approx(
        mean["Q2", "overshoot [m]"] / mean["Q3", "overshoot [m]"]
    )


def test_table_b_equals_the_logs(runs, sweep_b):
    first_seed = sweep_b[sweep_b["seed"] == 0].set_index(["process_noise", "estimator"])
    table = scenario_b_table(sweep_b).set_index(["process_noise", "estimator", "quantity"])
    for process_noise, pair in runs.items():
        for name, run in pair.items():
            log = run.log[run.log["t_s"] > run.metrics["settling_time_s"] + 4.9]
            assert (
                first_seed.loc[(process_noise, name.lower()), "violations"]
                == (log["on_straight"] & (log["error_m"] > 0.12)).sum()
            )
            row = table.loc[(process_noise, name, "violations on straights, raw GNSS")]
            of = sweep_b[
                (sweep_b["process_noise"] == process_noise) & (sweep_b["estimator"] == name.lower())
            ]
            assert row["mean"] == pytest.approx(of["violations"].mean())
            assert (
                of["violations"].min()
                <= row["low"]
                <= row["mean"]
                <= row["high"]
                <= of["violations"].max()
            )
            assert row["paper"] == {"RHE": 0, "EKF": 17}[name] and row["n"] == len(SEEDS)
        error = table.loc[process_noise].xs("mean error, raw GNSS [m]", level="quantity")
        assert error["mean"]["RHE - EKF"] == pytest.approx(
            error["mean"]["RHE"] - error["mean"]["EKF"]
        )
        assert list(error["paper"]) == [0.0423, 0.0514, -0.0091]


def test_at_most_none_includes_none_and_below_zero_does_not_include_zero(sweep_b):
    table = scenario_b_table(sweep_b.assign(violations=0))
    violations = table[table["quantity"] == "violations on straights, raw GNSS"]
    verdicts = violations.set_index("estimator")["verdict"]
    assert (verdicts["RHE"] == "holds").all() and (verdicts["RHE - EKF"] == "does not hold").all()


def test_runs_that_never_settle_are_counted(sweep_a):
    never = sweep_a.assign(
        settling_time_s=sweep_a["settling_time_s"].where(sweep_a["weight"] != "Q1")
    )
    table = scenario_a_table(never).set_index(["weight", "quantity"])
    assert (
        table.loc[("Q1", "settling time [s]"), "n"] == 0
        and table.loc[("Q1 / Q3", "settling time, ratio"), "verdict"] == "undecided"
    )
    assert "0 of 3 settle" in words(scenarios.weight_sweep(never))


def test_consistency_of_an_unknown_kind_of_estimator_is_drawn_in_grey():
    rng = np.random.default_rng(0)
    t_s, squared = np.arange(0, 40, 0.2), rng.chisquare(1, (5, 200))
    measured = Consistency(t_s, rng.normal(size=(5, 200, 4)), squared, squared, squared)
    names = ["RHE, calibrated", "dual, W by tracking", "particle filter"]
    figure = consistency.nees_over_time(dict.fromkeys(names, measured))
    shown = [axes for axes in figure.axes if axes.get_visible()]
    assert [axes._left_title.get_text().split(":")[0] for axes in shown] == names
    colours = [axes.lines[0].get_color() for axes in shown]
    assert colours == [style.COLOURS["RHE"], style.ORANGE, style.GREY]
    assert consistency.errors_over_sigma(dict.fromkeys(names, measured)).axes
