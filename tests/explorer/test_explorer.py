"""The explorer without a browser: controls to scenarios, changes to new pictures, and nothing but a
sentence where something cannot be.
"""

import json
import re
import threading
from contextlib import nullcontext
from dataclasses import replace
from typing import get_args
from unittest import mock

import ipywidgets
import numpy as np
import pandas as pd
import pytest
from bs4 import BeautifulSoup
from PIL import Image

import rhec
from notebooks.rivals import RIVALS
from rhec import paper, style
from rhec.explorer import controls, explorer, field_run
from rhec.explorer.panels import figure_of, packed
from rhec.tracked_robot import tuning
from rhec.tracked_robot.path import Turns

SHORT = rhec.Scenario(process_noise="prediction", duration_s=60.0)


@pytest.fixture
def made(tmp_path):
    return rhec.Explorer(SHORT, folder=tmp_path)


def shown(made):
    """What stands on the screen."""
    screen = made.screen
    return screen.picture, screen.numbers, screen.table, screen.line


def drawn(made):
    """{panel: [(mark, its x, its y)]} as the page finds them in the buffer."""
    numbers = np.frombuffer(made.screen.numbers, dtype=np.float32)

    def column(first, n):
        return numbers[first : first + n]

    return {
        name: [(mark, column(*mark["x"]), column(*mark["y"])) for mark in panel["marks"]]
        for name, panel in made.screen.picture["panels"].items()
    }


def pictured(run, zoom="whole path"):
    """The Picture of a run alone."""
    return field_run.picture_of([run], (), zoom, "kappa")


# Controls and scenarios

OWN_DRIFT = rhec.Scenario(yaw_drift=True, sigma_w=(1e-3,) * 6 + (0.004,))
STARTS = [
    rhec.Scenario(),
    rhec.Scenario(estimator="ekf", process_noise="prediction", q=paper.Q1, r=3.3, seed=7),
    rhec.Scenario(sigma_w=(1e-3, 1e-3, 1e-3, 2e-3, 0.0034, 0.012)),
    rhec.Scenario(process_noise="tracking", sigma_v=(0.02, 0.02, 0.03, 0.05), turns="right"),
    rhec.Scenario(estimator="ekf", sigma_w=(1e-3, 2e-3, 3e-3, 4e-3)),
    rhec.Scenario(speed_model="slipping", sigma_w=(0.003, 0.02)),
    OWN_DRIFT,
    rhec.Scenario(process_noise="soft_soil"),
    rhec.Scenario(q=(100.0, 0.25, 1 / 3), r=0.007, speed_mps=0.123, gnss_sigma_m=0.0),
    rhec.Scenario(faults=(rhec.Fault(kind="dead", channel="left", start_s=3.0),)),
]


@pytest.mark.parametrize("start", STARTS)
def test_untouched_controls_give_the_start_scenario(start):
    values = controls.values_of(start)
    assert controls.scenario_of(values, start.estimator, start) == start
    # Sliders show its own W, of which another estimator takes what it has.
    shown = [values["sigma_w", place] for place in range(6)]
    assert {*(start.sigma_w or ())[:6]} <= {*shown}
    for_ekf = controls.scenario_of(values, "ekf", start).sigma_w
    assert for_ekf == (tuple(shown[:4]) if start.sigma_w else None)
    is_own = start.sigma_w or start.sigma_v or start.process_noise == "soft_soil"
    assert values["process_noise"] == ("custom" if is_own else start.process_noise or "prediction")
    # The rule that is the default, and was no other at the start, is not written.
    usual = controls.scenario_of(values | dict(process_noise="prediction"), "rhe", start)
    assert usual.process_noise == (
        start.process_noise if values["process_noise"] == "prediction" else None
    )


# Parameters for which the explorer has other means, and those that it leaves to Python: objects;
# what an estimator assumes of slip and sensors; a timing whose effect is too small to be seen; and
# a width that would be compiled anew for each value, for tracks that slip.
ELSEWHERE = {"estimator", "process_noise", "seed", "patches"}
IN_PYTHON = {"path", "terrain", "controller"}
IN_PYTHON |= {"slip", "sigma_gyro", "sigma_heading", "traction_timing", "track_width_m"}


def test_each_parameter_of_a_scenario_has_a_control_or_a_reason():
    controlled = {key if isinstance(key, str) else key[0] for key in controls.CONTROLS}
    forgotten = {*vars(rhec.Scenario())} - controlled - ELSEWHERE - IN_PYTHON
    assert not forgotten, (
        f"Scenario has {sorted(forgotten)}, for which the explorer has no control; "
        "rhec/explorer/controls.py should have one, or the sets above this test the name"
    )


SLIDERS = {k: each for k, each in controls.CONTROLS.items() if isinstance(each, controls.Slider)}
SLIDERS |= {each.key: each for each in controls.PATCH}


@pytest.mark.parametrize("key", SLIDERS)
def test_a_slider_goes_from_one_round_number_to_another_in_steps_that_all_may_be(key):
    """What it shows at first is one of them; of a logarithmic one the ends are powers of ten."""
    slider = SLIDERS[key]
    values = controls.values_of(SHORT)
    values |= dict(enumerate(controls.NEW_PATCH))
    widget = explorer._input(slider, values[key])
    assert slider.low <= widget.min < slider.low + slider.step and widget.max == slider.high
    assert float(format(widget.value, widget.readout_format)) == pytest.approx(values[key])
    for value in filter(None, (controls.values_of(start).get(key) for start in STARTS)):
        of_start = explorer._input(slider, value)
        assert of_start.value == pytest.approx(value, rel=1e-12)
        place = np.log10(value) if slider.kind == "log" else value
        steps = (place - of_start.min) / of_start.step
        assert steps == pytest.approx(round(steps), abs=1e-6)
    unit = isinstance(key, str) and rhec.Scenario.describe().loc[key, "unit"]
    assert slider.label.endswith(f" [{unit}]" if unit else slider.label[-1])
    assert "[" not in slider.label or unit or slider.kind == "whole" or not isinstance(key, str)
    if slider.kind != "log":
        steps_to_it = (values[key] - slider.low) / slider.step
        assert steps_to_it == pytest.approx(round(steps_to_it))
    steps = (slider.high - slider.low) / slider.step
    third = slider.low + 3 * slider.step
    third = 10**third if slider.kind == "log" else third
    tidied = controls.tidy(slider, third * (1 + 1e-13), values[key])
    assert tidied == pytest.approx(third, rel=1e-3)
    assert (type(tidied) is int) == (slider.kind == "whole")
    assert 38 <= steps <= 300 and float(f"{slider.step:.1g}") == slider.step
    assert f"{slider.step:e}"[0] in "125"
    # Soil that is half firm may vary most.
    values |= dict(process_noise="custom", mu_mean=0.5, kappa_mean=0.5)
    for end, place in ((slider.low, widget.min), (slider.high, widget.max)):
        is_near_a_limit = key in ("speed_mps", "mu_mean", "kappa_mean", "gyro_scale")
        assert is_near_a_limit or float(f"{end:.1g}") == end
        value = 10.0**place if slider.kind == "log" else place
        new = values | {key: value}
        patch = tuple(new.pop(place) for place in range(5))
        controls.scenario_of(new | dict(patches=(patch,)), "rhe", SHORT)


def test_what_may_be_chosen_is_what_its_name_says():
    """Faults have the numbers of their names; a new patch lies on the first row and slips."""
    for name, faults in controls.CONTROLS["faults"].options[1:]:
        (fault,) = faults
        numbers = {float(number) for number in re.findall(r"[\d.]+", name)}
        sizes = {fault.size_m, fault.delay_s, fault.duration_s} - {None}
        assert numbers == {size for size in sizes if size < 1e6}, name
        row_s = SHORT.row_length_m / SHORT.speed_mps
        assert fault.kind == "latency" or row_s / 2 < fault.start_s < row_s, name
        assert fault.channel in (*name.split(), "gnss"), name
    sensors = dict(controls.CONTROLS["sensors"].options)
    assert [*sensors] == ["none", "gyro", "heading", "gyro and heading"]
    assert all(name == " and ".join(of) for name, of in sensors.items() if of)
    path = rhec.Path.rows(SHORT.row_length_m, SHORT.headland_radius_m, SHORT.turns)
    assert path.project([controls.NEW_PATCH[:2]])[0] == pytest.approx(0)
    assert controls.NEW_PATCH[3] < SHORT.mu_mean and controls.NEW_PATCH[4] < SHORT.kappa_mean


def test_own_process_noise_has_the_size_each_estimator_takes():
    """The slider's entry stays, and what is not estimated falls out."""
    values = controls.values_of(SHORT) | {"process_noise": "custom", ("sigma_w", 3): 0.5}
    pose, traction = (
        tuning.NOISES["rhe"]["prediction"].sigma_w[part] for part in (slice(3), slice(4, 6))
    )
    expected = {
        "parameter": (*pose, 0.5, *traction),
        "input": (*pose, *traction),
        "slipping": traction,
    }
    for speed_model, sigma_w in expected.items():
        given = values | {"speed_model": speed_model}
        assert controls.scenario_of(given, "rhe", SHORT).sigma_w == sigma_w
    assert controls.scenario_of(values, "ekf", SHORT).sigma_w == (*pose, 0.5)
    assert controls.scenario_of(values, "oracle", SHORT).sigma_w is None
    tuned = tuning.NOISES["rhe_yaw_drift"]["prediction"].sigma_w[6]
    for start, of_drift in ((SHORT, tuned), (OWN_DRIFT, OWN_DRIFT.sigma_w[6])):
        drifting = controls.scenario_of(values | dict(yaw_drift=True), "rhe", start)
        assert drifting.sigma_w == (*pose, 0.5, *traction, of_drift)


def test_sensors_and_their_faults_apply_to_the_rhe_and_to_the_oracle_beside_it():
    """The oracle does not need them, but drives the same robot."""
    values = controls.values_of(SHORT)
    dead = (rhec.Fault(kind="dead", channel="gyro"),)
    values |= dict(sensors=("gyro",), faults=dead)
    for key in style.LABELS:
        scenario = controls.scenario_of(values, key, SHORT)
        assert (scenario.sensors, scenario.faults) == (
            (("gyro",), dead) if key in ("rhe", "oracle") else ((), ())
        )
    assert controls.scenario_of(values | dict(sensors=()), "rhe", SHORT).faults == ()
    drifts = [
        controls.scenario_of(controls.values_of(SHORT) | dict(yaw_drift=True), key, SHORT).yaw_drift
        for key in ("rhe", "ekf")
    ]
    assert drifts == [True, False]
    slipping = controls.values_of(SHORT) | dict(yaw_drift=True, speed_model="slipping")
    assert not controls.scenario_of(slipping, "rhe", SHORT).yaw_drift


# The widget


def test_a_start_is_a_scenario():
    with pytest.raises(ValueError, match="^start was 3; it should be a rhec.Scenario$"):
        rhec.Explorer(3)


def another(widget):
    """A value of a widget that it does not have."""
    if isinstance(widget, ipywidgets.Dropdown):
        return next(value for _, value in widget.options if value != widget.value)
    return widget.value + widget.step


def test_a_changed_control_is_a_new_run_and_a_new_picture(made):
    """Both estimators run it, on the same soil with the same noise. A reset is of all controls."""
    first = shown(made)
    for key, value in (("r", 30.0), (("q", 2), 5.0), ("kappa_mean", 0.7), ("look_ahead_m", 0.5)):
        before = shown(made)
        made.inputs[key].value = value
        assert [run.scenario for run in made.runs] == made.scenarios
        assert all(now != then for now, then in zip(shown(made)[1:], before[1:]))
    assert made.runs[0].metrics == rhec.simulate(made.scenarios[0]).metrics
    made.add_patch.click()
    with made._paused():
        for widget in (*made.inputs.values(), made.estimator, made.seed, made.process_noise):
            widget.value = another(widget)
    made.reset.click()
    assert shown(made) == first
    made.seed.value = 5
    assert [run.scenario.estimator for run in made.runs] == ["rhe", "ekf"]
    assert {run.scenario.seed for run in made.runs} == {5}
    np.testing.assert_array_equal(made.runs[0].terrain.kappa, made.runs[1].terrain.kappa)
    made.against.value = None
    assert len(made.runs) == 1
    title, error, line = repr(made).splitlines()
    assert title == "Explorer" and line.strip() == made.screen.line
    m = made.runs[0].metrics
    said = f"RHE: mean error {m['mean_error_m']:.4f} m, true {m['mean_error_true_m']:.4f} m"
    assert said in error


def test_an_estimator_of_ones_own_is_one_of_the_list_and_drives(tmp_path):
    own = RIVALS["traction_oracle"]
    made = rhec.Explorer(SHORT, against=own, folder=tmp_path)
    for several, none in ((made.estimator, 0), (made.against, 1)):
        assert [label for label, _ in several.options][-1] == own.label
        assert len(several.options) == len(style.LABELS) + 1 + none
    assert [run.scenario.estimator for run in made.runs] == ["rhe", own]
    # What is there already is there once.
    assert len(rhec.Explorer(SHORT, folder=tmp_path).estimator.options) == len(style.LABELS)


def test_a_start_with_a_fault_of_its_own_has_it_in_the_list():
    *_, own = STARTS
    options = explorer._input(controls.CONTROLS["faults"], own.faults).options
    assert options == (*controls.CONTROLS["faults"].options, ("as at the start", own.faults))
    usual = controls.CONTROLS["faults"].options
    assert all(explorer._input(controls.CONTROLS["faults"], of).options == usual for _, of in usual)


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
    assert not made.remove_patch.disabled and not made.patch[4].disabled
    made.remove_patch.click()
    made.patch[0].value = 3.0  # without a patch it moves nothing
    assert made.runs[0].scenario == SHORT
    assert made.remove_patch.disabled and all(slider.disabled for slider in made.patch)
    several = tuple((x_m, 1.0, 2.0, 0.6, 0.5) for x_m in (9.0, 3.0, 5.0))
    made = rhec.Explorer(replace(SHORT, patches=several))
    for patch in several[::-1]:
        assert tuple(slider.value for slider in made.patch) == patch
        made.remove_patch.click()


def test_the_sliders_of_a_sensor_are_there_with_the_sensor(made):
    def hidden():
        names = ("gyro_sigma_radps", "gyro_bias_radps", "heading_sigma_rad")
        return [made.inputs[name].layout.display == "none" for name in names]

    assert hidden() == [True, True, True]
    made.inputs["sensors"].value = ("gyro",)
    assert hidden() == [False, False, True]


METRIC_BELOW = {
    "mean error GNSS [m]": "mean_error_m",
    "mean error true [m]": "mean_error_true_m",
    "largest true [m]": "max_error_true_m",
    "violations GNSS": "violations",
    "violations true": "violations_true",
    "settling time [s]": "settling_time_s",
    "overshoot [m]": "overshoot_m",
    "RMS μ [-]": "rms_mu",
    "RMS κ [-]": "rms_kappa",
    "RMS yaw [rad]": "rms_yaw_rad",
}


def test_the_table_has_each_metric_under_its_heading(made):
    """With as many digits as tell two drives apart: 0.1 mm, 0.1 s, a thousandth of a share."""
    of_unit = {"[m]": 1e-3, "[rad]": 1e-4, "[s]": 0.1, "[-]": 1e-3, "GNSS": 1, "true": 1}
    table = BeautifulSoup(made.screen.table, "html.parser")
    headings = [" ".join(each.text.split()) for each in table.select("th")][1:]
    for row, run in zip(table.select("tr")[1:], made.runs, strict=True):
        name, *cells = (cell.text for cell in row.select("td"))
        assert name.split()[-1] == style.label_of(run.scenario.estimator)
        assert style.colour_of(run.scenario.estimator) in str(row)
        for cell, heading in zip(cells, headings, strict=True):
            step = 1e-4 if heading.startswith("mean") else of_unit[heading.split()[-1]]
            value = run.metrics[METRIC_BELOW[heading]]
            decimals = round(-np.log10(step))
            assert len(cell) == len(f"{value:.{decimals}f}"), heading
            assert abs(float(cell) - value) <= 0.51 * step, heading


def test_less_is_better_and_what_is_not_known_is_neither():
    assert explorer.change(-0.0123, 3) == '<span class="better">−0.012</span>'
    assert explorer.change(2.0, 0) == '<span class="worse">+2</span>'
    assert explorer.change(-1e-9, 3) == "0" and explorer.change(float("nan"), 3) == "–"


def test_pinned_runs_stay(made):
    made.pin.click()
    pinned = made.runs
    assert "−" not in re.sub(r"− pinned<", "", made.screen.table)
    one, other = pinned
    name = style.label_of(other.scenario.estimator)
    assert f"− pinned {name}<" in explorer.metrics_table([one], [other])
    made.inputs["r"].value = 100.0
    assert made.pinned is pinned and made.runs is not pinned
    assert made.screen.table.count("<tr>") == 5
    for run, before in zip(made.runs, pinned):
        difference = run.metrics["mean_error_m"] - before.metrics["mean_error_m"]
        assert explorer.change(difference, 4) in made.screen.table
    assert not made.unpin.disabled
    made.unpin.click()
    assert made.screen.table.count("<tr>") == 3 and made.unpin.disabled


def running_median(values, half=12):
    """The median of 25 samples around each, the first and the last one repeated at the ends."""
    padded = np.concatenate([[values[0]] * half, values, [values[-1]] * half])
    return np.array([np.median(padded[k : k + 2 * half + 1]) for k in range(len(values))])


def test_what_is_drawn_are_the_columns_of_the_runs(made):
    made.pin.click()
    made.inputs["omega_max_radps"].value = 0.25
    (_, *series), panels = field_run._SERIES, drawn(made)
    for run in (*made.runs, *made.pinned):
        for panel, x, y, look, _ in series:
            if run in made.runs or look == "bold":
                values = running_median(run.columns[y]) if panel == "kkt" else run.columns[y]
                wanted = run.columns[x].astype(np.float32), values.astype(np.float32)
                found = [each[1:] for each in panels[panel]]
                assert any(np.array_equal(each, wanted, equal_nan=True) for each in found), panel
    # On one field both truths are nearly the same: that of the second run says whose it is.
    truths = [mark for mark, *_ in panels["mu"] if mark["label"] == "truth"]
    assert [(mark["note"], bool(mark["dash"])) for mark in truths] == [
        ("of EKF", True),
        ("", False),
    ]
    levels = [{*y} for *_, y in panels["yaw_rate"] if len(y) == 2]
    assert {-0.25} in levels and {0.25} in levels  # the bounds of the first run
    labels = {mark["label"] for mark, *_ in panels["map"]} - {"", "path, and bounds"}
    assert labels == {"RHE", "EKF", "pinned RHE", "pinned EKF"}
    # The figure that is saved has the same lines and dots.
    figure = made.figure()
    saved = {axes.get_title("left"): axes for axes in figure.axes}
    for name, panel in made.screen.picture["panels"].items():
        axes = saved[panel["title"]]
        assert axes.get_yscale() == ("log" if name == "kkt" else "linear")
        assert axes.xaxis.get_label_text() == panel["across"]
        ends = (*axes.get_xlim(), *axes.get_ylim())
        assert ends == pytest.approx((*panel["xlim"], *panel["ylim"])) or name == "map"
        shown = [each for each in panels[name] if each[0]["kind"] in ("line", "dots")]
        for line, (mark, *x_y) in zip(axes.get_lines(), shown, strict=True):
            np.testing.assert_array_equal(np.float32(line.get_data()), x_y, panel["title"])
            assert bool(mark["dash"]) == line.is_dashed()
            assert (line.get_markerfacecolor() == "none") != mark["full"]
    names = [text.get_text() for text in figure.legends[0].texts]
    assert names[:2] == ["RHE", "EKF"]  # what is drawn on top comes first
    assert names == [mark["label"] for mark in made.screen.picture["legend"]]
    (image,) = saved[made.screen.picture["panels"]["map"]["title"]].images
    shades = image.norm(image.get_array())
    kappa = made.runs[0].terrain.kappa
    # White where nothing slips, and the darkest brown where κ is about 0.17.
    np.testing.assert_allclose(shades, np.sqrt(1 - kappa.T) / 0.91)
    left, right, bottom, top = image.get_extent()
    cell_m = np.array([right - left, top - bottom]) / kappa.shape
    first = np.array([left, bottom]) + cell_m / 2
    np.testing.assert_allclose(first, made.runs[0].terrain.origin_m)
    np.testing.assert_allclose(cell_m, made.runs[0].terrain.cell_m)
    assert image.origin == "lower"  # the first row is at the bottom


def test_each_panel_shows_nearly_all_of_its_lines_with_their_bounds():
    """And shades the time spent in curves."""
    run = rhec.simulate(replace(SHORT, duration_s=120.0))
    _, *panels = pictured(run).panels.items()
    areas = {}
    dashed = {}
    for name, panel in panels:
        y = np.concatenate([mark.y for mark in panel.marks if mark.label])
        inside = y[(panel.ylim[0] <= y) & (y <= panel.ylim[1])]
        assert len(inside) > (0.98 if name == "kkt" else 0.9) * len(y), name
        scale = np.log10 if panel.scale == "log" else np.asarray
        assert np.ptp(scale(inside)) > 0.2 * np.ptp(scale(panel.ylim)), name
        assert panel.xlim == pytest.approx((0, 120))
        areas[name] = [mark for mark in panel.marks if mark.kind == "area"]
        dashed[name] = [mark.y[0] for mark in panel.marks if mark.dash]
        curves_s = sum(np.ptp(mark.x) for mark in areas[name] if np.ptp(mark.x) < 120)
        assert curves_s == pytest.approx(paper.DT_S * (~run.columns["on_straight"]).sum())
    bound = paper.OMEGA_MAX_RADPS
    limit = dict(panels)["yaw_rate"].ylim[1]
    assert dashed["yaw_rate"] == [-bound, bound] and bound < limit < 1.3 * bound
    assert all(1 < dict(panels)[name].ylim[1] < 1.1 for name in ("mu", "kappa"))
    # Limits go in coarse steps, and cut off a hundredth below and a twentieth above.
    for name, columns, step in (
        ("kkt", ["kkt_rhe", "kkt_rhc"], 10),
        ("error", ["error_true_m"], 2),
    ):
        values = np.concatenate([run.columns[column] for column in columns])
        rare, usual = np.quantile(values[values > 0], [0.01, 0.95])
        low, high = dict(panels)[name].ylim
        assert low <= rare and high / step <= usual <= high
        assert name == "error" or rare < step * low
    *_, tolerance = areas["error"]
    assert (tolerance.y.min(), tolerance.y.max()) == (0, paper.TOLERANCE_M)


def test_a_large_field_is_drawn_coarsely_but_in_its_place(made):
    kappa = np.random.default_rng(0).uniform(0.2, 1, (700, 40))
    terrain = rhec.Terrain(mu=kappa, kappa=kappa, origin_m=(-10.0, 3.0), cell_m=0.5)
    (soil, *_) = pictured(replace(made.runs[0], terrain=terrain)).panels["map"].marks
    assert 200 < len(soil.x) <= 300
    i, j = ((at - first) / 0.5 for at, first in zip((soil.x, soil.y), terrain.origin_m))
    np.testing.assert_array_equal(soil.traction, kappa[np.ix_(i.astype(int), j.astype(int))])


def test_the_map_shows_the_first_row_wherever_it_lies_and_the_tolerance_around_it(made):
    path = rhec.Path.from_segments([(20.0, 0.0), (20.0, -0.05)], start=(3.0, -2.0, 2.0))
    begins_on_it = replace(SHORT, start_offset_m=0.0)
    run = replace(made.runs[0], path=path, scenario=begins_on_it)
    panel = pictured(run, "first row").panels["map"]
    ends = path.poses([0.0, 20.0])[0]
    for (low, high), at in zip((panel.xlim, panel.ylim), ends.T):
        assert low < min(at) and max(at) < high < max(at) + 2
    (way,) = [mark for mark in panel.marks if mark.label == "path, and bounds"]
    assert (way.x[0], way.y[0]) == (3.0, -2.0)
    (band,) = [mark for mark in panel.marks if mark.kind == "area"]
    distance, _ = path.project(np.column_stack([band.x, band.y]))
    np.testing.assert_allclose(distance, paper.TOLERANCE_M)


def test_a_ring_is_where_the_robot_was_farthest_off_once_it_had_settled(made):
    """Not where it was farthest off before, nor where a position of the GNSS was."""
    made.inputs["start_offset_m"].value = 0.5  # farther off than ever after
    made.seed.value = 1
    run = made.runs[0]
    c, is_settled = run.columns, run.columns["t_s"] >= run.metrics["settling_time_s"]
    k, of_gnss = (
        np.argmax(np.where(is_settled, c[name], 0.0)) for name in ("error_true_m", "error_m")
    )
    assert is_settled.any() and k not in (np.argmax(c["error_true_m"]), of_gnss)
    (ring,) = [place for mark, *place in drawn(made)["map"] if mark.get("full") is False]
    np.testing.assert_allclose(ring, [[c["x_m"][k]], [c["y_m"][k]]], rtol=1e-6)


@pytest.mark.parametrize("zoom", field_run.ZOOMS)
def test_every_picture_is_complete(made, zoom):
    """Each panel stands in the layout, has finite limits, and numbers for each mark.

    It shows all of the time, also where the pinned runs took longer.
    """
    made.pin.click()
    made.inputs["duration_s"].value = 40.0
    made.soil.value = "mu"
    made.zoom.value = zoom
    picture = made.screen.picture
    panels = picture["panels"]
    assert {*" ".join(picture["layout"]).split()} == {*panels}
    # A row is long and narrow, so that its y is stretched, which the title says.
    is_stretched = "y is stretched" in panels["map"]["title"]
    assert is_stretched == (zoom == "first row") != (panels["map"]["scale"] == "equal")
    for panel in panels.values():
        assert panel["title"] and np.isfinite([*panel["xlim"], *panel["ylim"]]).all()
    for name, marks in drawn(made).items():
        assert marks, name
        for mark, x, y in marks:
            at, n = mark.get("traction", (0, 0))
            assert n == (len(x) * len(y) if mark["kind"] == "soil" else 0)
            low, high = panels[name]["xlim"]
            assert name == "map" or low <= x.min() < x.max() <= high
            assert mark["kind"] == "soil" or len(x) == len(y)
            assert mark["colour"] != "#000000"  # it would not be seen on a dark page
    if zoom == "worst place":
        (ring,) = [place for mark, *place in drawn(made)["map"] if mark.get("full") is False]
        for (low, high), at in zip((panels["map"]["xlim"], panels["map"]["ylim"]), ring):
            assert low + 1 < at < high - 1 and high - low < 6
    labels = [mark["label"] for mark in picture["legend"]]
    assert labels and all(labels)


# What cannot be


@pytest.mark.parametrize(
    "error, status",
    [
        (ValueError("r was 20;\n it should be another"), "r was 20; it should be another"),
        (ZeroDivisionError("of all things"), "ZeroDivisionError: of all things"),
        (KeyboardInterrupt(), "interrupted: the picture is of the settings before"),
    ],
)
def test_what_cannot_be_run_is_one_sentence_beside_the_last_picture(
    made, monkeypatch, capsys, error, status
):
    """An interrupt is one for the kernel, too. The next move shows all settings."""
    before = shown(made)
    goes_on = pytest.raises(KeyboardInterrupt) if "interrupted" in status else nullcontext()
    with monkeypatch.context() as patch, goes_on:
        patch.setattr(explorer.closed_loop, "simulate_loaded", mock.Mock(side_effect=error))
        made.inputs["r"].value = 20.0
    assert made.screen.status == status and shown(made) == before
    made.inputs["qn_factor"].value = 30.0
    assert made.screen.status.startswith("2 runs of 60 s")
    assert (made.runs[0].scenario.r, made.runs[0].scenario.qn_factor) == (20.0, 30.0)
    assert capsys.readouterr() == ("", "")


def test_a_file_name_cannot_leave_its_folder(made, tmp_path):
    for name in ("../x", "", "a/b", ".hidden", "a" * 65, "x\n", "C:\\x"):
        made.name.value = name
        made.save.click()
        assert "name was " in made.screen.status
    assert not [*tmp_path.iterdir()]


def test_callbacks_in_two_threads_do_not_overlap(made):
    """As where a kernel answers a page's messages in its main thread and in a subshell's."""
    before = shown(made)
    other = threading.Thread(target=made.zoom.set_trait, args=("value", "first row"))
    with made.lock:
        other.start()
        other.join(timeout=0.5)
        assert other.is_alive() and shown(made) == before
    other.join()
    assert shown(made) != before


def test_a_lost_robot_is_drawn():
    """Wherever it gets to, and however little is finite."""
    run = rhec.simulate(replace(SHORT, duration_s=20.0))
    nan = np.full(len(run.columns["t_s"]), np.nan)
    unknown = [name for name in run.columns if name.endswith("_hat") or name.startswith("kkt")]
    columns = run.columns | dict.fromkeys(unknown, nan)
    columns |= dict.fromkeys(("error_true_m", "x_m"), 1e6 * run.columns["t_s"])
    columns["kkt_rhc"] = np.zeros(len(nan))
    lost = replace(run, columns=columns, metrics=run.metrics | {"settling_time_s": float("nan")})
    for zoom in field_run.ZOOMS:
        content, numbers = packed(pictured(lost, zoom))
        limits = [(*panel["xlim"], *panel["ylim"]) for panel in content["panels"].values()]
        assert len(numbers) and np.isfinite(limits).all()
    figure_of(pictured(lost))
    assert "never" in explorer.metrics_table([lost])


def test_a_page_gets_the_numbers_of_a_picture_row_by_row():
    picture = pictured(rhec.simulate(replace(SHORT, duration_s=4.0)))
    content, numbers = packed(picture)
    numbers = np.frombuffer(numbers, np.float32)
    for name, panel in picture.panels.items():
        for mark, described in zip(panel.marks, content["panels"][name]["marks"], strict=True):
            for array, place in ((mark.x, "x"), (mark.y, "y"), (mark.traction, "traction")):
                if array is not None:
                    first, length = described[place]
                    told = numbers[first : first + length].reshape(array.shape)
                    np.testing.assert_array_equal(told, array.astype(np.float32))


# What is taken away


def test_runs_and_figure_are_saved(made, tmp_path):
    """The figure says which scenarios it shows, not those that it began with."""
    made.pin.click()
    made.inputs["r"].value = 30.0
    made.name.value, made.folder.value = "wet_row-1", str(tmp_path / "deeper/still")
    made.save.click()
    assert "saved" in made.screen.status
    stem = tmp_path / "deeper/still/wet_row-1"
    files = {*stem.parent.iterdir()}
    for run, name in zip(made.runs, ("1_rhe", "2_ekf"), strict=True):
        csv, parquet = (stem.with_name(f"{stem.name}_{name}.{kind}") for kind in ("csv", "parquet"))
        pd.testing.assert_frame_equal(pd.read_csv(csv), run.log)
        pd.testing.assert_frame_equal(pd.read_parquet(parquet), run.log)
        files -= {csv, parquet}
    assert files == {stem.with_suffix(".pdf"), stem.with_suffix(".png")}
    shown = json.loads(Image.open(stem.with_suffix(".png")).text["Keywords"])
    assert [scenario["r"] for scenario in shown] == [30.0, 30.0]


def test_a_page_without_widgets_has_the_table_and_says_how_to_draw(made):
    html = made._repr_mimebundle_()["text/html"]
    assert made.screen.table in html and "figure()" in html and "<img" not in html


def test_sliders_of_noise_show_the_noise_in_use(made):
    entries = dict(sigma_w=6, sigma_v=4)
    sliders = {
        name: [made.inputs[name, place] for place in range(n)] for name, n in entries.items()
    }
    every = [*sliders["sigma_w"], *sliders["sigma_v"]]
    for rule in controls.RULES:
        made.process_noise.value = rule
        shown = {name: tuple(slider.value for slider in of) for name, of in sliders.items()}
        assert shown == tuning.NOISES["rhe"][rule]._asdict()
        assert all(slider.disabled for slider in every)
        assert {run.scenario.process_noise or "prediction" for run in made.runs} == {rule}
        assert {run.scenario.sigma_v for run in made.runs} == {None}  # each has its own
    made.process_noise.value = "custom"
    assert not any(slider.disabled for slider in every)
    for name, of in sliders.items():
        assert getattr(made.runs[0].scenario, name) == shown[name]
        of[-1].value = 0.1
        assert getattr(made.runs[0].scenario, name)[-1] == 0.1
    made.process_noise.value = "prediction"
    assert made.runs[0].scenario.sigma_v is made.runs[0].scenario.sigma_w is None


def test_a_choice_with_the_name_of_a_value_is_that_value(made):
    for name, control in made.inputs.items():
        options = [*getattr(control, "options", ())]
        values = [value for _, value in options]
        for label, value in options:
            named = label.replace(" ", "_")
            assert value == named or named not in values, (name, label)
    assert dict(made.inputs["turns"].options)["to alternate sides"] == "alternate"


def test_the_map_shows_the_whole_path_of_every_pattern_of_turns(made):
    """There is room for the ring around a place on it, and for new patches beside all of it."""
    across = {slider.key: slider for slider in controls.PATCH}
    for turns in get_args(Turns):
        made.inputs["turns"].value = turns
        panel = made.screen.picture["panels"]["map"]
        x_min, x_max, y_min, y_max = made.runs[0].path.box
        (low_x, high_x), (low_y, high_y) = panel["xlim"], panel["ylim"]
        assert low_x + 2 < x_min and x_max < high_x - 2
        assert low_y + 2 < y_min and y_max < high_y - 2
        assert across[0].low <= x_min and x_max <= across[0].high
        assert across[1].low <= y_min and y_max <= across[1].high


# Compiling, drawing


def test_every_widget_is_on_the_screen(made):
    def below(widget):
        return {
            widget,
            *(each for child in getattr(widget, "children", ()) for each in below(child)),
        }

    on_screen = below(made)
    own = [*made.inputs.values(), *made.patch, *made.weights]
    own += [each for each in vars(made).values() if isinstance(each, ipywidgets.DOMWidget)]
    assert {*own} <= on_screen and len(own) > 70
    assert "rhec" in made._dom_classes  # the styles are those of this class
    sent = {"status", "status_kind", "line", "table", "picture", "numbers"}
    assert sent <= {*made.screen.get_state()}


def test_loops_are_optimised_from_the_first_change_on(made, monkeypatch):
    optimised = []
    early = explorer.early
    monkeypatch.setattr(early, "optimise", lambda build, of: optimised.append(len(of)))
    rhec.Explorer(SHORT)
    assert optimised == []
    said = []
    monkeypatch.setattr(made, "_show_status", lambda text, *kind: said.append(text))
    made.inputs["r"].value = 20.0
    assert optimised == [2] and not [text for text in said if "compiling" in text]
    monkeypatch.setattr(early, "is_compiled", lambda *structure: False)
    sent = []
    monkeypatch.setattr(made.screen, "send_state", sent.append)
    made.inputs["r"].value = 30.0
    assert "compiling for the first time: the last picture stays" in said
    assert sent[0] == ["status", "status_kind"]  # before the kernel compiles
