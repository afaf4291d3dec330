"""The explorer: controls on the left; on the right the field, driven again when a control moves.

`controls` turns the widgets' values into scenarios, `rhec.simulation.closed_loop` runs them,
`field_run` and `robot_view` describe the pictures, and the browser draws them (`screen`). A front
end sends a widget's next value only when the last one was answered: dragging drops frames and
never queues them.
"""

import asyncio
import base64
import functools
import io
import math
import multiprocessing
import re
import threading
import time
from concurrent.futures import ProcessPoolExecutor
from contextlib import contextmanager
from pathlib import Path

import ipywidgets as widgets
from matplotlib.figure import Figure

from rhec import paper
from rhec.core._casadi import compiled
from rhec.simulation import closed_loop
from rhec.simulation.scenario import Scenario
from rhec.tracked_robot import tuning
from rhec.workbench.explorer import controls, field_run, robot_view
from rhec.workbench.explorer.field_run import ZOOMS, colour_of, name_of
from rhec.workbench.explorer.panels import packed
from rhec.workbench.explorer.screen import CSS, Screen
from rhec.workbench.explorer.snapshot import snapshot_at
from rhec.workbench.plots import style

# Metrics of a run, the smaller the better: name, two lines of heading, digits.
METRICS = (
    ("mean_error_m", "mean error", "GNSS [m]", 4),
    ("mean_error_true_m", "mean error", "true [m]", 4),
    ("max_error_true_m", "largest", "true [m]", 3),
    ("violations", "violations", "GNSS", 0),
    ("violations_true", "violations", "true", 0),
    ("settling_time_s", "settling time", "[s]", 1),
    ("overshoot_m", "overshoot", "[m]", 3),
    ("rms_mu", "RMS μ", "[-]", 3),
    ("rms_kappa", "RMS κ", "[-]", 3),
    ("rms_yaw_rad", "RMS yaw", "[rad]", 4),
)
_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9_-]{0,63}")


def metrics_table(runs, pinned=()):
    """The metrics of runs as an HTML table: a row per run, then differences to the pinned runs."""
    rows = [_table_row(run, name_of(run.scenario), _value, {}) for run in runs]
    for run, before in zip(runs, pinned):
        name = name_of(run.scenario)
        pinned_name = name_of(before.scenario)
        title = f"{name} − pinned" + ("" if pinned_name == name else f" {pinned_name}")
        rows.append(_table_row(run, title, change, before.metrics))
    head = "".join(f"<th>{heading}<br>{below}</th>" for _, heading, below, _ in METRICS)
    return f'<table class="rhec-table"><tr><th></th>{head}</tr>{"".join(rows)}</table>'


def _table_row(run, title, cell, subtracted):
    """A run's metrics, less the subtracted ones, each as `cell` writes it."""
    swatch = f'<span style="color: {colour_of(run.scenario)}">━</span>'
    cells = [
        cell(run.metrics[name] - subtracted.get(name, 0), digits) for name, _, _, digits in METRICS
    ]
    return f"<tr><td>{swatch} {title}</td>{''.join(f'<td>{text}</td>' for text in cells)}</tr>"


def _value(number, digits):
    return f"{number:.{digits}f}" if math.isfinite(number) else "never"


def change(difference, digits):
    """The change of a metric as HTML: less is better."""
    if not math.isfinite(difference):
        return "–"
    text = f"{difference:+.{digits}f}"
    if float(text) == 0:
        return "0"
    kind = "better" if difference < 0 else "worse"
    return f'<span class="{kind}">{text.replace("-", "−")}</span>'


def _safe_name(name):
    """A file name that cannot leave its folder."""
    if not _NAME.fullmatch(name):
        rule = "letters, digits, - and _, beginning with a letter or digit, at most 64 of them"
        raise ValueError(f"name was {name!r}; it should be {rule}")
    return name


def compile_apart(structures):
    """Compile these closed loops in another process; `compiled.load` then finds them."""
    load = functools.partial(compiled.load, closed_loop.build_sample)
    with ProcessPoolExecutor(1, multiprocessing.get_context("spawn")) as pool:
        list(pool.map(load, *zip(*structures)))


class Explorer(widgets.VBox):
    """The explorer as a widget for Jupyter.

    Args:
        start: The Scenario that it begins with, by default the paper's.
        against: Estimator that drives the same field to compare with, or None.
        folder: Where runs and figures are saved.

    Raises:
        ValueError: If start is not a Scenario.
    """

    def __init__(
        self,
        start: Scenario | None = None,
        against: str | None = "ekf",
        folder: Path | str = style.FOLDER / "explored",
    ):
        start = Scenario() if start is None else start
        if not isinstance(start, Scenario):
            raise ValueError(f"start was {start!r}; it should be a rhec.Scenario")
        self.start = start
        self.patches = start.patches
        self.runs = ()
        self.pinned = ()
        self.compiling = None
        self.held = False
        self.loaded = set()  # structures whose compiled loop is in memory
        # A kernel may answer a page's messages in its main thread and in a subshell's.
        self.one_at_a_time = threading.RLock()
        self._make_inputs(against)
        self._make_outputs(folder)
        super().__init__(self._arranged())
        self.add_class("rhec")
        self._watch()
        self._refresh()

    # What is on the screen

    def _make_inputs(self, against):
        values = controls.values_of(self.start)
        estimators = [(name, key) for key, name in controls.ESTIMATORS.items()]
        if not isinstance(self.start.estimator, str):
            estimators.append(("own", self.start.estimator))
        self.inputs = {key: _input(one, values[key]) for key, one in controls.CONTROLS.items()}
        patch = self.patches[-1] if self.patches else controls.NEW_PATCH
        self.patch = [_input(slider, value) for slider, value in zip(controls.PATCH, patch)]
        self.estimator = _list(estimators, self.start.estimator, "run", 142)
        self.against = _list([("nothing", None), *estimators], against, "against", 160)
        about = "process noise W of the estimators; “own W” is set in the tab Estimator"
        noise = values["process_noise"]
        self.process_noise = _list(controls.PROCESS_NOISES, noise, "W", 122, about)
        look = _look("seed", "fixes soil and noise together", "112px", "36px")
        self.seed = widgets.BoundedIntText(self.start.seed, min=0, max=10**9, **look)
        self.zoom = _list([(zoom, zoom) for zoom in ZOOMS], ZOOMS[0], "map", 142)
        self.soil = _list([("of κ", "kappa"), ("of μ", "mu")], "kappa", "", 66)
        views = ["Field run", "Robot view"]
        width = {"button_width": "96px"}
        self.view = widgets.ToggleButtons(options=views, style=width)
        self.weights = {
            _button(name, "the paper’s weights"): q
            for name, q in (("Q¹", paper.Q1), ("Q²", paper.Q2), ("Q³", paper.Q3))
        }
        self.pin = _button("pin", "keep these runs to compare with")
        self.unpin = _button("unpin", "forget the pinned runs")
        self.reset = _button("reset", "back to the first scenario")
        self.add_patch = _button("add a wet patch", "a disc of sudden change")
        self.remove_patch = _button("remove the last", "remove the wet patch that was added last")

    def _make_outputs(self, folder):
        self.screen = Screen()
        self.patch_count = widgets.HTML()
        self.folder, self.name = (
            widgets.Text(value, continuous_update=False, **_look(label, None, "96%", "50px"))
            for label, value in (("folder", str(folder)), ("name", "run"))
        )
        about = "CSV and Parquet of each run, the figure as PNG and PDF"
        self.save = _button("save runs and figure", about)
        self.play = widgets.Play(100, min=0, max=100, interval=100, show_repeat=False)
        look = _look("sample", None, None, "50px") | {"layout": {"flex": "1 1 auto"}}
        self.sample = widgets.IntSlider(100, 0, 100, **look)
        self.link = widgets.jslink((self.play, "value"), (self.sample, "value"))
        self.time = widgets.HBox([self.play, self.sample], layout={"display": "none"})

    def _arranged(self):
        what = [self.estimator, self.against, self.process_noise, self.seed]
        how = [self.pin, self.unpin, self.reset, self.zoom, self.soil, self.view]
        row = {"flex_flow": "row wrap", "align_items": "center"}
        bar = widgets.HBox([*what, *how], layout=row)
        groups = {
            name: [self.inputs[control.key] for control in group]
            for name, group in controls.GROUPS.items()
        }
        groups["Controller"].insert(0, widgets.HBox([widgets.Label("the paper’s"), *self.weights]))
        patches = widgets.HBox([self.add_patch, self.remove_patch, self.patch_count])
        groups["Soil"] += [patches, *self.patch]
        groups["Save"] = [self.folder, self.name, self.save]
        boxes = [widgets.VBox(group) for group in groups.values()]
        width = "344px"
        size = {"width": width, "flex": f"0 0 {width}"}
        tabs = widgets.Tab(boxes, titles=[*groups], layout=size)
        size = {"flex": "1 1 480px", "min_width": "0"}
        shown = widgets.VBox([self.screen, self.time], layout=size)
        return [bar, widgets.HBox([tabs, shown], layout={"flex_flow": "row wrap"})]

    # What happens when

    def _watch(self):
        choices = (self.estimator, self.against, self.process_noise, self.seed)
        drawn = (self.zoom, self.soil, self.view, self.sample)
        changed = ((*choices, *self.inputs.values()), self._refresh)
        for those, action in (changed, (self.patch, self._change_patch), (drawn, self._draw)):
            for widget in those:
                widget.observe(self._answer(action), "value")
        clicked = {
            self.pin: lambda: self._pin(self.runs),
            self.unpin: lambda: self._pin(()),
            self.reset: self._reset,
            self.add_patch: lambda: self._set_patches((*self.patches, controls.NEW_PATCH)),
            self.remove_patch: lambda: self._set_patches(self.patches[:-1]),
            self.save: self._save,
        }
        for button, q in self.weights.items():
            clicked[button] = functools.partial(self._set_weights, q)
        for button, action in clicked.items():
            button.on_click(self._answer(action))

    def _answer(self, action):
        """The action as a widget's callback; an error becomes a sentence in the status line."""

        def callback(_):
            # hold_sync: everything that the action changes is sent in one message.
            with self.one_at_a_time, self.screen.hold_sync():
                if self.held:
                    return
                try:
                    action()
                except Exception as error:
                    self._show_status(_sentence(error), "bad")

        return callback

    @contextmanager
    def _together(self):
        """Change several controls, then run once."""
        self.held = True
        try:
            yield
        finally:
            self.held = False
        self._refresh()

    def _set_weights(self, q):
        with self._together():
            for place, weight in enumerate(q):
                self.inputs["q", place].value = weight

    def _reset(self):
        with self._together():
            values = controls.values_of(self.start)
            self.patches = self.start.patches
            for key, widget in self.inputs.items():
                widget.value = values[key]
            self.estimator.value = self.start.estimator
            self.seed.value = self.start.seed
            self.process_noise.value = values["process_noise"]

    def _set_patches(self, patches):
        """Replace the wet patches; the sliders show the last one."""
        with self._together():
            self.patches = patches
            for widget, value in zip(self.patch, patches[-1] if patches else controls.NEW_PATCH):
                widget.value = value

    def _change_patch(self):
        if self.patches:
            values = (widget.value for widget in self.patch)
            patch = tuple(map(controls.tidy, controls.PATCH, values, self.patches[-1]))
            self.patches = (*self.patches[:-1], patch)
            self._refresh()

    def _pin(self, runs):
        self.pinned = runs
        self._draw()

    # From the controls to the picture

    @property
    def scenarios(self):
        """The scenarios of the controls: one, or two with the same seed."""
        values = controls.values_of(self.start)
        for key, widget in self.inputs.items():
            values[key] = controls.tidy(controls.CONTROLS[key], widget.value, values[key])
        values["process_noise"] = self.process_noise.value
        values["seed"] = self.seed.value
        values["patches"] = self.patches
        return [
            controls.scenario_of(values, estimator, self.start)
            for estimator in (self.estimator.value, self.against.value)
            if estimator is not None
        ]

    def _refresh(self):
        """Run the scenarios of the controls and show them, or first compile them elsewhere."""
        started = time.perf_counter()
        scenarios = self.scenarios
        setups = [closed_loop.set_up(scenario) for scenario in scenarios]
        missing = [
            structure
            for structure in {setup.structure for setup in setups} - self.loaded
            if not compiled.is_compiled(closed_loop.build_sample, *structure)
        ]
        # The first runs are waited for: without them there is nothing to see.
        if missing and self.runs and _running_loop():
            self._compile(missing)
            return
        self.runs = tuple(map(closed_loop.simulate_setup, scenarios, setups))
        self.loaded |= {setup.structure for setup in setups}
        ran = time.perf_counter()
        self._draw()
        runs = f"{len(self.runs)} runs" if len(self.runs) > 1 else "1 run"
        self._show_status(
            f"{runs} of {scenarios[0].duration_s:g} s in {1000 * (ran - started):.0f} ms"
        )

    def _compile(self, structures):
        """Compile elsewhere, then run the newest state of the controls."""
        horizons = {
            f"{structure.estimator.estimation_horizon} and {structure.prediction_horizon} intervals"
            for structure in structures
        }
        which = f"compiling window and horizon of {', '.join(sorted(horizons))} for the first time"
        self._show_status(f"{which}: a few seconds; the picture is the one before", "wait")
        if not self.compiling:
            self.compiling = _running_loop().create_task(self._compiled(structures))

    async def _compiled(self, structures):
        try:
            await asyncio.to_thread(compile_apart, structures)
        except Exception as error:
            self._show_status(_sentence(error), "bad")
            return
        finally:
            self.compiling = None
        self._answer(self._refresh)(None)

    def _draw(self):
        """Show the chosen view of the runs, their metrics, and the scenario as a line."""
        field = self.view.value == "Field run"
        self.time.layout.display = "none" if field else "flex"
        self.unpin.disabled = not self.pinned
        self._show_process_noise()
        self.remove_patch.disabled = not self.patches
        for widget in self.patch:
            widget.disabled = not self.patches
        self.patch_count.value = f"{len(self.patches)} now"
        if field:
            picture = field_run.picture_of(
                self.runs, self.pinned, zoom=self.zoom.value, soil=self.soil.value
            )
        else:
            run = self.runs[0]
            k = self.sample.value
            self.sample.max = self.play.max = len(run.columns["t_s"]) - 1
            picture = robot_view.picture_of(run, k, snapshot_at(run.scenario, k))
        self.screen.picture, self.screen.numbers = packed(picture)
        self.screen.table = metrics_table(self.runs, self.pinned)
        self.screen.line = controls.line_of(self.runs[0].scenario)

    def _show_process_noise(self):
        """Show the W in use on the sliders of σ_W; they can be moved where W is "own"."""
        noise = self.process_noise.value
        for place in range(6):
            slider = self.inputs["sigma_w", place]
            slider.disabled = noise != "own"
            if slider.disabled:
                self.held = True  # this moves sliders, but no run follows
                slider.value = tuning.SIGMA_W["rhe"][noise][place]
                self.held = False

    def _show_status(self, sentence, how=""):
        self.screen.status = sentence
        self.screen.how = how

    # Figures, files and texts

    def __repr__(self) -> str:
        """The estimators with their errors, and the scenario as Python."""
        errors = [
            f"{name_of(run.scenario)}: mean error {run.metrics['mean_error_m']:.4f} m, "
            f"true {run.metrics['mean_error_true_m']:.4f} m"
            for run in self.runs
        ]
        return "\n  ".join(["Explorer", *errors, controls.line_of(self.runs[0].scenario)])

    def figure(self) -> Figure:
        """The field run as a matplotlib figure, as it is saved."""
        with self.one_at_a_time:
            return field_run.field_run(self.runs, self.pinned, self.zoom.value, self.soil.value)

    def _save(self):
        name = _safe_name(self.name.value)
        folder = Path(self.folder.value).expanduser()
        folder.mkdir(parents=True, exist_ok=True)
        for place, run in enumerate(self.runs, 1):
            estimator = name_of(run.scenario).lower().replace(" ", "_")
            file = folder / _safe_name(f"{name}_{place}_{estimator}")
            run.log.to_csv(f"{file}.csv", index=False)
            run.log.to_parquet(f"{file}.parquet", index=False)
        scenarios = [run.scenario for run in self.runs]
        style.save(self.figure(), name, scenarios, folder=folder)
        files = "CSV and Parquet of each run, the figure as PNG and PDF"
        self._show_status(f"saved under the name {name} in {folder}: {files}")

    def _repr_mimebundle_(self, **formats):
        """Add picture and table as HTML, for pages without widgets."""
        self.figure().savefig(file := io.BytesIO(), format="png")
        picture = f"data:image/png;base64,{base64.b64encode(file.getvalue()).decode()}"
        shown = f'<img alt="field run" src="{picture}">{self.screen.table}'
        shown = f'<style>\n{CSS}</style><div class="rhec">{shown}</div>'
        return super()._repr_mimebundle_(**formats) | {"text/html": shown}


def _input(control, value):
    """The widget of a control; its range is widened to include its first value."""
    look = _look(control.label, control.about, "98%", "126px")
    if isinstance(control, controls.Selection):
        options = control.options
        if not any(value == option for _, option in options):
            options = (*options, ("as at the start", value))
        return widgets.Dropdown(options=options, value=value, **look)
    place = value
    kind = widgets.FloatSlider
    if control.kind == "log":
        place = math.log10(value) if value > 0 else control.low
        kind = widgets.FloatLogSlider
        readout = ".3g"
    elif control.kind == "whole":
        kind = widgets.IntSlider
        readout = "d"
    else:
        readout = f".{max(1, -math.floor(math.log10(control.step) + 1e-9))}f"
    # A front end rounds to whole steps above the lowest value: the first value must be one.
    low = round(place - control.step * math.ceil((place - control.low) / control.step - 1e-9), 12)
    return kind(
        value,
        min=min(low, place),
        max=max(control.high, place),
        step=control.step,
        readout_format=readout,
        continuous_update=control.kind != "whole",  # whose first use compiles
        **look,
    )


def _look(label, about, width, label_width="initial"):
    """A widget's label, tooltip and widths."""
    layout = {"width": width}
    style = {"description_width": label_width}
    return {"description": label, "tooltip": about, "layout": layout, "style": style}


def _list(options, value, label, width_px, about=""):
    look = _look(label, about, f"{width_px}px")
    return widgets.Dropdown(options=options, value=value, **look)


def _button(text, about):
    return widgets.Button(description=text, tooltip=about, layout={"width": "auto"})


def _sentence(error):
    """An error in one line; a ValueError of this package needs no name of its type."""
    text = " ".join(str(error).split())
    return text if isinstance(error, ValueError) and text else f"{type(error).__name__}: {text}"


def _running_loop():
    try:
        return asyncio.get_running_loop()
    except RuntimeError:
        return None
