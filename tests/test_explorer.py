"""The explorer without a browser: controls to scenarios, changes to new pictures, and nothing but a
sentence where something cannot be.
"""

import asyncio
import re
import threading
import time
from dataclasses import fields, replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

import rhec
from rhec import paper
from rhec.plots import style
from rhec.workbench.explorer import controls, explorer, field_run
from rhec.workbench.explorer.robot_view import robot_view, seen_from
from rhec.workbench.explorer.snapshot import snapshot_at

SHORT = rhec.Scenario(process_noise="calibrated", duration_s=60.0)


@pytest.fixture
def made(tmp_path):
    return rhec.Explorer(SHORT, folder=tmp_path)


# Controls and scenarios

STARTS = [
    rhec.Scenario(),
    rhec.Scenario(
        estimator="ekf",
        process_noise="calibrated",
        q=paper.Q1,
        r=3.3,
        patches=((9.0, 1.0, 2.0, 0.6, 0.5),),
        seed=7,
    ),
    rhec.Scenario(sigma_w=(1e-3, 1e-3, 1e-3, 2e-3, 0.0034, 0.012)),
    rhec.Scenario(q=(100.0, 0.25, 1 / 3), r=0.007, speed_mps=0.123, gnss_sigma_m=0.0),
    rhec.Scenario(
        robust=True,
        faults=(
            rhec.Fault(kind="dead", channel="left", start_s=3.0),
            rhec.Fault(kind="latency", delay_s=0.4),
        ),
    ),
]


@pytest.mark.parametrize("start", STARTS)
def test_untouched_controls_give_the_start_scenario(start):
    assert controls.scenario_of(controls.values_of(start), start.estimator, start) == start


def test_every_field_with_a_control_is_a_field_of_scenario():
    assert {key if isinstance(key, str) else key[0] for key in controls.CONTROLS} <= {
        field.name for field in fields(rhec.Scenario)
    }


@pytest.mark.parametrize("start", STARTS)
def test_the_line_of_python_gives_the_scenario(start):
    assert eval(controls.line_of(start)) == start
    for field in fields(start):
        assert (f"{field.name}=" in controls.line_of(start)) == (
            getattr(start, field.name) != field.default
        )


def test_own_process_noise_has_the_size_each_estimator_takes():
    values = controls.values_of(SHORT) | {"process_noise": "own", ("sigma_w", 3): 0.5}
    assert controls.scenario_of(values, "rhe", SHORT).sigma_w == (
        0.001,
        0.001,
        0.001,
        0.5,
        0.0033,
        0.001,
    )
    assert controls.scenario_of(values, "ekf", SHORT).sigma_w == (0.001, 0.001, 0.001, 0.5)
    assert controls.scenario_of(values | {"speed_model": "input"}, "rhe", SHORT).sigma_w == (
        0.001,
        0.001,
        0.001,
        0.0033,
        0.001,
    )
    assert controls.scenario_of(values, "oracle", SHORT).sigma_w is None
    assert len(controls.scenario_of(values, "dual", SHORT).sigma_w) == 10
    assert controls.scenario_of(values | {"speed_model": "slipping"}, "rhe", SHORT).sigma_w == (
        0.0033,
        0.001,
    )


def test_robust_applies_to_estimators_with_gating():
    values = controls.values_of(SHORT) | {"robust": True}
    robust = {key for key in controls.ESTIMATORS if controls.scenario_of(values, key, SHORT).robust}
    assert robust == {"rhe", "dual"}


def test_explorer_and_its_notebook_offer_the_same_estimators(made):
    offered = list(controls.ESTIMATORS)
    assert [value for _, value in made.estimator.options] == offered
    assert [value for _, value in made.against.options] == [None, *offered]
    for estimator in offered:
        scenario = replace(SHORT, estimator=estimator)
        assert field_run.name_of(scenario) == controls.ESTIMATORS[estimator]
    notebook = (Path(__file__).parents[1] / "notebooks/explore.ipynb").read_text(encoding="utf-8")
    assert "estimator=tuple(controls.ESTIMATORS)" in notebook


# The widget


@pytest.mark.parametrize("start", STARTS)
def test_widgets_begin_at_the_start_scenario(start):
    assert rhec.Explorer(replace(start, duration_s=20.0), None).scenarios == [
        replace(start, duration_s=20.0)
    ]


def test_slider_steps_include_the_start_value():
    for start in STARTS:
        values = controls.values_of(start)
        for key, control in controls.CONTROLS.items():
            if isinstance(control, controls.Slider) and values[key] > 0:
                widget = explorer._input(control, values[key])
                np.testing.assert_allclose(widget.value, values[key], rtol=1e-12)
                steps = (
                    (np.log10(values[key]) if control.kind == "log" else values[key]) - widget.min
                ) / widget.step
                assert abs(steps - round(steps)) < 1e-6


@pytest.mark.parametrize(
    "key, value",
    [
        ("r", 30.0),
        (("q", 2), 5.0),
        ("speed_mps", 0.4),
        ("kappa_mean", 0.7),
        ("gnss_slow_share", 0.5),
        ("look_ahead_m", 0.5),
    ],
)
def test_a_changed_control_is_a_new_run_and_a_new_picture(made, key, value):
    picture, table, line = made.picture.value, made.table.value, made.line.value
    made.inputs[key].value = value
    assert [run.scenario for run in made.runs] == made.scenarios
    assert all(
        before != now
        for before, now in (
            (picture, made.picture.value),
            (table, made.table.value),
            (line, made.line.value),
        )
    )
    expected = rhec.simulate(made.scenarios[0])
    assert made.runs[0].metrics == expected.metrics
    made.reset.click()
    assert (made.picture.value, made.table.value, made.line.value) == (picture, table, line)


def test_both_estimators_run_at_the_same_seed(made):
    made.seed.value = 5
    assert [run.scenario.estimator for run in made.runs] == ["rhe", "ekf"]
    assert {run.scenario.seed for run in made.runs} == {5}
    np.testing.assert_array_equal(made.runs[0].terrain.kappa, made.runs[1].terrain.kappa)
    made.against.value = None
    assert len(made.runs) == 1


def test_the_papers_weights_are_one_run(made, monkeypatch):
    drawn = []
    monkeypatch.setattr(made, "_draw", lambda: drawn.append(made.runs[0].scenario.q))
    for button in made.weights:
        button.click()
    assert drawn == [paper.Q1, paper.Q2, paper.Q3]


def test_wet_patches_are_added_moved_and_removed(made):
    made.add_patch.click()
    made.patch[0].value = 20.0
    made.add_patch.click()
    assert made.runs[0].scenario.patches == ((20.0, *controls.NEW_PATCH[1:]), controls.NEW_PATCH)
    made.remove_patch.click()
    assert made.runs[0].scenario.patches == ((20.0, *controls.NEW_PATCH[1:]),)
    made.remove_patch.click()
    made.patch[0].value = 3.0  # without a patch it moves nothing
    assert made.runs[0].scenario == SHORT


def test_pinned_runs_stay(made):
    made.pin.click()
    pinned = made.runs
    assert "−" not in re.sub(r"− pinned", "", made.table.value)
    made.inputs["r"].value = 100.0
    assert made.pinned is pinned and made.runs is not pinned
    assert made.table.value.count("<tr>") == 5
    for run, before in zip(made.runs, pinned):
        difference = run.metrics["mean_error_m"] - before.metrics["mean_error_m"]
        assert explorer.change(difference, 4) in made.table.value
    made.unpin.click()
    assert made.table.value.count("<tr>") == 3


@pytest.mark.parametrize("view", ["field run", "robot view"])
@pytest.mark.parametrize("zoom", field_run.ZOOMS)
def test_every_view_is_well_formed_and_has_no_style_for_the_whole_page(made, view, zoom):
    from xml.etree import ElementTree

    made.pin.click()
    made.view.value, made.zoom.value, made.soil.value, made.moment.value = view, zoom, "mu", 100
    picture = made.picture.value.replace("xlink:href", "href")
    assert {element.tag for element in ElementTree.fromstring(picture).iter()} >= {
        "svg",
        "path",
        "g",
    }
    assert "<style" not in picture and "nan" not in picture and "#000000" not in picture


def test_unchanged_layers_are_not_drawn_again(made, monkeypatch):
    drawn = []
    draw_layer = made.field.draw_layer
    monkeypatch.setattr(
        made.field, "draw_layer", lambda *artists: drawn.extend(artists) or draw_layer(*artists)
    )
    made.inputs["q", 0].value = 1.5
    assert made.field.axes["map"] not in drawn and made.field.axes["yaw_rate"] not in drawn
    made.seed.value = 3
    assert made.field.axes["map"] in drawn
    drawn.clear()
    made.seed.value = 0
    assert made.field.axes["map"] not in drawn  # that picture is still known


# What cannot be


def test_an_impossible_setting_is_one_sentence(made, capsys):
    made.inputs["mu_mean"].value = 0.99
    picture = made.picture.value
    made.inputs["mu_deviation"].value = 0.3
    assert "mu_deviation was 0.3; with mu_mean 0.99 it should be below 0.0995" in made.status.value
    assert made.picture.value == picture
    made.inputs["mu_deviation"].value = 0.04
    assert "mu_deviation" not in made.status.value
    assert capsys.readouterr() == ("", "")


@pytest.mark.parametrize("name", ["../x", "", "a/b", ".hidden", "a" * 65, "x\n", "C:\\x"])
def test_a_file_name_cannot_leave_its_folder(made, name, tmp_path):
    made.name.value = name
    made.save.click()
    assert "name was " in made.status.value
    assert not [*tmp_path.iterdir()]


def test_callbacks_in_two_threads_do_not_overlap(made, monkeypatch):
    """As where a kernel answers a page's messages in its main thread and in a subshell's."""
    drawing, met = threading.Lock(), []

    def draw():
        if drawing.acquire(blocking=False):
            time.sleep(0.05)
            drawing.release()
        else:
            met.append(threading.current_thread().name)

    monkeypatch.setattr(made, "_draw", draw)
    threads = [
        threading.Thread(target=widget.set_trait, args=("value", value))
        for widget, value in ((made.inputs["r"], 20.0), (made.seed, 3))
    ]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert not met
    assert (
        [run.scenario for run in made.runs]
        == made.scenarios
        == [replace(SHORT, r=20.0, seed=3, estimator=name) for name in ("rhe", "ekf")]
    )


def test_an_internal_error_is_shown_in_the_status_line(made, monkeypatch, capsys):
    def broken(scenario, world):
        raise ZeroDivisionError("of all things")

    monkeypatch.setattr(explorer.simulation, "simulate_setup", broken)
    made.inputs["r"].value = 20.0
    assert "ZeroDivisionError: of all things" in made.status.value
    assert capsys.readouterr() == ("", "")


@pytest.mark.parametrize(
    "start, said", [(3, "start was 3; it should be a rhec.Scenario"), ("rhe", "start was 'rhe'")]
)
def test_it_begins_at_a_scenario(start, said):
    with pytest.raises(ValueError, match=said):
        rhec.Explorer(start)


def test_a_lost_robot_is_drawn():
    """Wherever it gets to, and however little is finite."""
    run = rhec.simulate(replace(SHORT, duration_s=20.0))
    columns = {
        name: np.full(len(values), np.nan)
        if name.endswith("_hat") or name.startswith("kkt")
        else values
        for name, values in run.columns.items()
    }
    columns |= {"error_true_m": 1e6 * run.columns["t_s"], "x_m": 1e6 * run.columns["t_s"]}
    lost = replace(run, columns=columns, metrics=run.metrics | {"settling_time_s": float("nan")})
    picture = field_run.FieldRun()
    for zoom in field_run.ZOOMS:
        picture.show([lost], (), zoom)
        assert "<svg" in picture.svg()
    assert "never" in explorer.metrics_table([lost])


# What is taken away


def test_runs_and_figure_are_saved(made, tmp_path):
    made.pin.click()
    made.name.value, made.folder.value = "wet_row-1", str(tmp_path / "deeper")
    made.save.click()
    assert "saved" in made.status.value
    assert sorted(path.name for path in (tmp_path / "deeper").iterdir()) == [
        "wet_row-1.pdf",
        "wet_row-1.png",
        "wet_row-1_1_rhe.csv",
        "wet_row-1_1_rhe.parquet",
        "wet_row-1_2_ekf.csv",
        "wet_row-1_2_ekf.parquet",
    ]
    for run, name in zip(made.runs, ("1_rhe", "2_ekf")):
        pd.testing.assert_frame_equal(
            pd.read_parquet(tmp_path / "deeper" / f"wet_row-1_{name}.parquet"), run.log
        )
        pd.testing.assert_frame_equal(
            pd.read_csv(tmp_path / "deeper" / f"wet_row-1_{name}.csv"), run.log
        )


def test_without_widgets_the_picture_and_the_table_stand_for_them(made):
    bundle = made._repr_mimebundle_()
    assert made.picture.value in bundle["text/html"] and made.table.value in bundle["text/html"]


# Compiling


def test_a_new_structure_compiles_in_the_background_then_the_newest_setting_runs(made, monkeypatch):
    at_hand, compiled = set(), []

    def compile_apart(structures):
        compiled.append([each.prediction_horizon for each in structures])
        at_hand.update(structures)

    monkeypatch.setattr(explorer, "compile_apart", compile_apart)
    monkeypatch.setattr(
        explorer.compiled, "is_compiled", lambda build, *structure: structure in at_hand
    )

    async def user():
        runs = made.runs
        made.against.value = None
        made.inputs["r"].value = 20.0
        made.inputs["r"].value = 30.0
        assert "compiling" in made.status.value and made.runs is runs
        await made.compiling

    asyncio.run(user())
    assert compiled == [[15]]
    assert made.runs[0].scenario.r == 30.0 and "compiling" not in made.status.value


def test_a_failed_compilation_is_said(made, monkeypatch):
    def compile_apart(structures):
        raise OSError("no space left")

    monkeypatch.setattr(explorer, "compile_apart", compile_apart)
    monkeypatch.setattr(explorer.compiled, "is_compiled", lambda build, *structure: False)

    async def user():
        made.inputs["r"].value = 20.0
        await made.compiling

    asyncio.run(user())
    assert "OSError: no space left" in made.status.value and made.compiling is None


def test_what_another_process_compiled_is_found_by_load():
    from rhec import simulation
    from rhec._casadi import compiled

    structure = simulation.set_up(rhec.Scenario(estimator="oracle", prediction_horizon=2)).structure
    explorer.compile_apart([structure])
    assert compiled.is_compiled(simulation.build_sample, *structure)


# The robot view


@pytest.mark.parametrize("k", [0, 5, 100, 299])
@pytest.mark.parametrize(
    "changed",
    [
        dict(),
        dict(speed_model="input"),
        dict(estimator="ekf"),
        dict(estimator="dual"),
        dict(robust=True, faults=(rhec.Fault(kind="jump", start_s=20.0, size_m=0.5),)),
    ],
)
def test_snapshot_equals_the_run(k, changed):
    run = rhec.simulate(replace(SHORT, **changed))
    at, row = snapshot_at(run.scenario, k), run.log.loc[k]
    np.testing.assert_array_equal(at.truth, row[["x_m", "y_m", "theta_rad"]])
    np.testing.assert_array_equal(
        at.estimate,
        row[["x_hat_m", "y_hat_m", "theta_hat_rad", "nu_hat_mps", "mu_hat", "kappa_hat"]],
    )
    assert at.omega_radps[0] == row["omega_cmd_radps"]
    np.testing.assert_allclose(at.plan[0], at.estimate[:3], atol=1e-12)
    if run.scenario.estimator in ("rhe", "dual"):
        assert len(at.window) == len(at.measured) == min(k, run.scenario.estimation_horizon) + 1
        if run.scenario.estimator == "rhe":
            np.testing.assert_allclose(at.window[-1], at.estimate[:3], atol=1e-9)
        believed = np.isfinite(
            at.measured
        )  # a robust estimator leaves out what it does not believe
        assert believed.all() or run.scenario.robust
        np.testing.assert_array_equal(
            at.measured[believed],
            run.log.loc[k - len(at.measured) + 1 : k, ["x_meas_m", "y_meas_m"]].to_numpy()[
                believed
            ],
        )
    else:
        assert len(at.window) == 0


def test_the_desired_points_are_on_the_path_a_sample_apart(run):
    at = snapshot_at(run.scenario, 200)
    distance, _ = run.path.project(at.desired[:, :2])
    np.testing.assert_allclose(distance, 0, atol=1e-9)
    steps = np.hypot(*np.diff(at.desired[:, :2], axis=0).T)
    np.testing.assert_allclose(
        steps, 0.2 * run.log.loc[200, "mu_hat"] * run.log.loc[200, "nu_hat_mps"], rtol=1e-3
    )


def test_seen_from_a_pose_what_is_ahead_is_ahead():
    np.testing.assert_allclose(
        seen_from((1, 2, np.pi / 2), np.array([[1.0, 5.0], [-1.0, 2.0]])),
        [[3, 0], [0, 2]],
        atol=1e-12,
    )


def test_the_figures_are_complete_without_an_explorer(run, tmp_path):
    for figure in (field_run.field_run([run]), robot_view(run, 50, snapshot_at(run.scenario, 50))):
        assert not figure.findobj(lambda artist: artist.get_animated())
        assert style.save(figure, "picture", run.scenario, tmp_path).stat().st_size > 10_000
