"""The explorer: controls on the left, and the whole field run again at once on the right, whenever
one of them moves.

The widgets are glue. `controls` turns their values into scenarios, `closed_loop` runs them,
`panels` and `robots_eye` draw. A front end holds a widget's newest value back until the one before
has been answered, so that dragging drops frames and never queues them.
"""

import asyncio
import functools
import html
import math
import multiprocessing
import re
import threading
import time
from concurrent.futures import ProcessPoolExecutor
from contextlib import contextmanager
from pathlib import Path

import ipywidgets as widgets

from rhec import paper, simulation
from rhec._casadi import compiled
from rhec.plots import style
from rhec.scenario import Scenario
from rhec.workbench.explorer import controls
from rhec.workbench.explorer.field_run import ZOOMS, FieldRun, colour_of, field_run, name_of
from rhec.workbench.explorer.robot_view import RobotsEye
from rhec.workbench.explorer.snapshot import horizons_at

# What is told of a run, all of it better small: metric, two lines of heading, digits.
METRICS = (
    ("mean_error_m", "mean error", "GNSS [m]", 4),
    ("mean_error_true_m", "mean error", "true [m]", 4),
    ("max_error_true_m", "largest", "true [m]", 3),
    ("violations", "violations", "GNSS", 0),
    ("violations_true", "violations", "true", 0),
    ("settling_time_s", "arrival", "[s]", 1),
    ("overshoot_m", "overshoot", "[m]", 3),
    ("rms_mu", "RMS μ", "[-]", 3),
    ("rms_kappa", "RMS κ", "[-]", 3),
    ("rms_yaw_rad", "RMS yaw", "[rad]", 4),
)
NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9_-]{0,63}")

STYLE = """<style>
.rhec { color: var(--jp-ui-font-color1, var(--vscode-foreground, inherit)); font-family: var(--jp-ui-font-family, sans-serif); overflow: hidden; }
.rhec .widget-html-content, .rhec .widget-html > .widget-html-content { line-height: 1.35; overflow: hidden; }
.rhec .rhec-picture { display: block; width: 100%; max-height: calc(100vh - 310px); }
.rhec .rhec-eye .rhec-picture { max-height: calc(100vh - 350px); }
.rhec .widget-tab, .rhec .jupyter-widget-tab { margin: 0; }
.rhec .lm-TabBar-tab { min-width: 0 !important; flex: 1 1 auto !important; padding: 0 5px !important; text-align: center; }
.rhec .lm-TabBar-tabLabel { font-size: 12px; }
.rhec .widget-tab-contents { padding: 5px 6px 6px 2px !important; max-height: calc(100vh - 225px); overflow: hidden auto !important; }
.rhec .widget-inline-hbox .widget-readout { min-width: 48px; max-width: 52px; font-size: 12px; padding: 1px 2px; }
.rhec .widget-label { font-size: 12px; }
.rhec .widget-slider { height: 25px; }
.rhec .rhec-status, .rhec .rhec-code { margin: 0 2px; min-width: 0; font-size: 12.5px; }
.rhec-status { flex: 0 1 auto; } .rhec-code { flex: 0 1 auto; }
.rhec-status .bad { color: var(--jp-error-color1, #d32f2f); font-weight: 600; }
.rhec-status .wait { color: var(--jp-warn-color0, #e65100); font-weight: 600; }
.rhec-table { border-collapse: collapse; font-size: 12px; font-variant-numeric: tabular-nums; width: 100%; }
.rhec-table th { font-weight: 400; opacity: .72; text-align: right; padding: 1px 7px; line-height: 1.15; vertical-align: bottom; }
.rhec-table td { text-align: right; padding: 2px 7px; border-top: 1px solid var(--jp-border-color2, #8884); white-space: nowrap; }
.rhec-table td:first-child { text-align: left; }
.rhec-table .better { color: color-mix(in srgb, #009E73 80%, currentColor); } .rhec-table .worse { color: color-mix(in srgb, #D55E00 85%, currentColor); }
.rhec-line { font-family: var(--jp-code-font-family, monospace); font-size: 12px; user-select: all; cursor: copy; overflow-wrap: anywhere; }
.rhec-line:hover { background: var(--jp-layout-color2, #8882); }
</style>"""


def metrics_table(runs, pinned=()):
    """The metrics of runs as HTML, a row each, and what became of them since the pinned runs at the
    same places.
    """
    head = "".join(f"<th>{heading}<br>{below}</th>" for _, heading, below, _ in METRICS)
    rows = [
        (
            run,
            name_of(run.scenario),
            [
                f"{run.metrics[metric]:.{digits}f}"
                if math.isfinite(run.metrics[metric])
                else "never"
                for metric, _, _, digits in METRICS
            ],
        )
        for run in runs
    ]
    rows += [
        (
            run,
            f"{name_of(run.scenario)} − pinned{'' if run.scenario.estimator == before.scenario.estimator else ' ' + name_of(before.scenario)}",
            [
                change(run.metrics[metric] - before.metrics[metric], digits)
                for metric, _, _, digits in METRICS
            ],
        )
        for run, before in zip(runs, pinned)
    ]
    body = "".join(
        f'<tr><td><span style="color: {colour_of(run.scenario)}">━</span> {name}</td>{"".join(f"<td>{cell}</td>" for cell in cells)}</tr>'
        for run, name, cells in rows
    )
    return f'<table class="rhec-table"><tr><th></th>{head}</tr>{body}</table>'


def change(difference, digits):
    """What became of a metric, all of which are better small, as HTML."""
    if not math.isfinite(difference):
        return "–"
    text = f"{difference:+.{digits}f}"
    if float(text) == 0:
        return "0"
    return (
        f'<span class="{"better" if difference < 0 else "worse"}">{text.replace("-", "−")}</span>'
    )


def safe_name(name):
    """A file name that cannot leave its folder."""
    if not NAME.fullmatch(name):
        raise ValueError(
            f"name was {name!r}; it should be letters, digits, - and _, beginning with a letter or digit, at most 64 of them"
        )
    return name


def save_run(run, folder, name):
    """A run's log as folder/name.csv and .parquet. Returns both paths."""
    folder = Path(folder)
    folder.mkdir(parents=True, exist_ok=True)
    csv, parquet = (folder / f"{safe_name(name)}.{kind}" for kind in ("csv", "parquet"))
    run.log.to_csv(csv, index=False)
    run.log.to_parquet(parquet, index=False)
    return csv, parquet


def compile_apart(structures):
    """Compile the closed loops of these structures in a process of their own, which leaves them
    where `compiled.load` finds them.
    """
    with ProcessPoolExecutor(1, multiprocessing.get_context("spawn")) as pool:
        list(pool.map(functools.partial(compiled.load, simulation.build_sample), *zip(*structures)))


class Explorer(widgets.VBox):
    """The explorer as a widget, beginning at a scenario; `against` is the estimator compared at the
    same seed, or None; `folder` is where it saves.
    """

    def __init__(self, start=None, against="ekf", folder=style.FOLDER / "explored"):
        start = Scenario() if start is None else start
        if not isinstance(start, Scenario):
            raise ValueError(f"start was {start!r}; it should be a rhec.Scenario")
        self.start, self.patches = start, start.patches
        self.runs, self.pinned, self.compiling, self.held = (), (), None, False
        self.one_at_a_time = (
            threading.RLock()
        )  # a kernel may answer a page's messages in two threads, its main one and a subshell's
        self.field, self.eye = FieldRun(), RobotsEye()
        self._make_inputs(against)
        self._make_outputs(folder)
        super().__init__(self._laid_out())
        self.add_class("rhec")
        self._watch()
        self._refresh()

    # What is on the screen

    def _make_inputs(self, against):
        values = controls.values_of(self.start)
        estimators = [
            *controls.ESTIMATORS,
            *([] if isinstance(self.start.estimator, str) else [("own", self.start.estimator)]),
        ]
        self.inputs = {
            key: _input(control, values[key]) for key, control in controls.CONTROLS.items()
        }
        self.patch = [
            _input(slider, value)
            for slider, value in zip(
                controls.PATCH, self.patches[-1] if self.patches else controls.NEW_PATCH
            )
        ]
        self.estimator, self.against = (
            _list(estimators, self.start.estimator, "run", 142),
            _list([("nothing", None), *estimators], against, "against", 160),
        )
        self.process_noise = _list(
            controls.READINGS,
            values["process_noise"],
            "W",
            122,
            "process noise: the paper’s reading, or one’s own in the tab Estimator",
        )
        self.seed = widgets.BoundedIntText(
            self.start.seed,
            min=0,
            max=10**9,
            description="seed",
            layout={"width": "112px"},
            style={"description_width": "36px"},
            tooltip="fixes terrain and noise together",
        )
        self.zoom, self.soil = (
            _list([(zoom, zoom) for zoom in ZOOMS], ZOOMS[0], "map", 142),
            _list([("of κ", "kappa"), ("of μ", "mu")], "kappa", "", 66),
        )
        self.view = widgets.ToggleButtons(
            options=["field run", "robot’s eye"], style={"button_width": "96px"}
        )
        self.weights = {
            _button(name, "the paper’s weights"): q
            for name, q in (("Q¹", paper.Q1), ("Q²", paper.Q2), ("Q³", paper.Q3))
        }
        self.pin, self.unpin = (
            _button("pin", "keep these runs, to compare with"),
            _button("unpin", "let go of the kept runs"),
        )
        self.reset = _button("reset", "back to the scenario it began with")
        self.add_patch, self.remove_patch = (
            _button("add a wet patch", "a disc of sudden change"),
            _button("remove the last", "of the wet patches"),
        )

    def _make_outputs(self, folder):
        self.status, self.picture, self.table, self.line, self.patch_count = (
            widgets.HTML() for _ in range(5)
        )
        self.status.add_class("rhec-status")
        self.line.add_class("rhec-code")
        wide = {
            "layout": {"width": "96%"},
            "style": {"description_width": "50px"},
            "continuous_update": False,
        }
        self.folder, self.name = (
            widgets.Text(str(folder), description="folder", **wide),
            widgets.Text("run", description="name", **wide),
        )
        self.save = _button(
            "save runs and figure", "CSV and Parquet of each run, the figure as PNG and PDF"
        )
        self.play = widgets.Play(100, min=0, max=100, interval=100, show_repeat=False)
        self.moment = widgets.IntSlider(
            100,
            0,
            100,
            description="sample",
            layout={"flex": "1 1 auto"},
            style={"description_width": "50px"},
        )
        self.link = widgets.jslink((self.play, "value"), (self.moment, "value"))
        self.time = widgets.HBox([self.play, self.moment], layout={"display": "none"})

    def _laid_out(self):
        bar = widgets.HBox(
            [
                self.estimator,
                self.against,
                self.process_noise,
                self.seed,
                self.pin,
                self.unpin,
                self.reset,
                self.zoom,
                self.soil,
                self.view,
            ],
            layout={"flex_flow": "row wrap", "align_items": "center"},
        )
        groups = {
            name: [self.inputs[control.key] for control in group]
            for name, group in controls.GROUPS.items()
        }
        groups["Controller"].insert(0, widgets.HBox([widgets.Label("the paper’s"), *self.weights]))
        groups["Soil"] += [
            widgets.HBox([self.add_patch, self.remove_patch, self.patch_count]),
            *self.patch,
        ]
        groups["Save"] = [self.folder, self.name, self.save]
        tabs = widgets.Tab(
            [widgets.VBox(group) for group in groups.values()],
            titles=[*groups],
            layout={"width": "344px", "flex": "0 0 344px"},
        )
        pictures = widgets.VBox(
            [self.picture, self.time, self.table], layout={"flex": "1 1 auto", "min_width": "0"}
        )
        said = widgets.HBox(
            [self.status, self.line],
            layout={"justify_content": "space-between", "align_items": "baseline"},
        )
        return [
            widgets.HTML(STYLE),
            bar,
            said,
            widgets.HBox([tabs, pictures], layout={"width": "100%"}),
        ]

    # What happens when

    def _watch(self):
        for widget in (
            self.estimator,
            self.against,
            self.process_noise,
            self.seed,
            *self.inputs.values(),
        ):
            widget.observe(self._answer(self._refresh), "value")
        for widget in self.patch:
            widget.observe(self._answer(self._change_patch), "value")
        for widget in (self.zoom, self.soil, self.view, self.moment):
            widget.observe(self._answer(self._draw), "value")
        for button, q in self.weights.items():
            button.on_click(self._answer(functools.partial(self._set_weights, q)))
        for button, action in (
            (self.pin, self._pin),
            (self.unpin, self._unpin),
            (self.reset, self._reset),
            (self.add_patch, self._add_patch),
            (self.remove_patch, self._remove_patch),
            (self.save, self._save),
        ):
            button.on_click(self._answer(action))

    def _answer(self, action):
        """The action as a widget's callback: what goes wrong is one sentence in the status line."""

        def callback(_):
            with self.one_at_a_time:
                if self.held:
                    return
                try:
                    action()
                except Exception as error:
                    self._say(_sentence(error), "bad")

        return callback

    @contextmanager
    def _together(self):
        """Several controls change, one run follows."""
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
            values, self.patches = controls.values_of(self.start), self.start.patches
            for key, widget in self.inputs.items():
                widget.value = values[key]
            self.estimator.value, self.process_noise.value, self.seed.value = (
                self.start.estimator,
                values["process_noise"],
                self.start.seed,
            )

    def _add_patch(self):
        with self._together():
            self.patches += (controls.NEW_PATCH,)
            self._show_patch()

    def _remove_patch(self):
        with self._together():
            self.patches = self.patches[:-1]
            self._show_patch()

    def _change_patch(self):
        if self.patches:
            patch = tuple(
                controls.tidy(slider, widget.value, now)
                for slider, widget, now in zip(controls.PATCH, self.patch, self.patches[-1])
            )
            self.patches = (*self.patches[:-1], patch)
            self._refresh()

    def _show_patch(self):
        """The last wet patch on its sliders."""
        for widget, value in zip(
            self.patch, self.patches[-1] if self.patches else controls.NEW_PATCH
        ):
            widget.value = value

    def _pin(self):
        self.pinned = self.runs
        self._draw()

    def _unpin(self):
        self.pinned = ()
        self._draw()

    # From the controls to the picture

    @property
    def scenarios(self):
        """What the controls ask for: one scenario, or two at the same seed."""
        values = controls.values_of(self.start)
        values |= {
            key: controls.tidy(controls.CONTROLS[key], widget.value, values[key])
            for key, widget in self.inputs.items()
        }
        values |= {
            "process_noise": self.process_noise.value,
            "seed": self.seed.value,
            "patches": self.patches,
        }
        estimators = [
            self.estimator.value,
            *([] if self.against.value is None else [self.against.value]),
        ]
        return [controls.scenario_of(values, estimator, self.start) for estimator in estimators]

    def _refresh(self):
        """Run what the controls ask for and show it, or first compile it elsewhere."""
        started = time.perf_counter()
        scenarios = self.scenarios
        worlds = [simulation.set_up(scenario) for scenario in scenarios]
        missing = [
            world.structure
            for world in worlds
            if not compiled.is_compiled(simulation.build_sample, *world.structure)
        ]
        if (
            missing and self.runs and _running_loop()
        ):  # the first runs are waited for: without them there is nothing to see
            self._compile(missing)
            return
        self.runs = tuple(map(simulation.simulate_setup, scenarios, worlds))
        ran = time.perf_counter()
        self._draw()
        drawn = time.perf_counter()
        runs = f"{len(self.runs)} runs" if len(self.runs) > 1 else "1 run"
        self._say(
            f"{runs} of {scenarios[0].duration_s:g} s in {1000 * (ran - started):.0f} ms, drawn in {1000 * (drawn - ran):.0f} ms"
        )

    def _compile(self, structures):
        """The newest state of the controls is run when it is done; until then the picture stays as
        it is, and all else can be used.
        """
        horizons = ", ".join(
            sorted(
                {
                    f"{each.estimation_horizon} and {each.prediction_horizon} intervals"
                    for each in structures
                }
            )
        )
        self._say(
            f"compiling window and horizon of {horizons} for the first time: a few seconds; the picture is that of before",
            "wait",
        )
        if not self.compiling:
            self.compiling = _running_loop().create_task(self._compiled(structures))

    async def _compiled(self, structures):
        try:
            await asyncio.to_thread(compile_apart, structures)
        except Exception as error:
            self._say(_sentence(error), "bad")
            return
        finally:
            self.compiling = None
        self._answer(self._refresh)(None)

    def _draw(self):
        """The chosen view of the runs there are, their metrics, and the scenario as a line."""
        field = self.view.value == "field run"
        self.time.layout.display = "none" if field else "flex"
        (self.picture.remove_class if field else self.picture.add_class)("rhec-eye")
        self.unpin.disabled, self.remove_patch.disabled = not self.pinned, not self.patches
        for widget in self.patch:
            widget.disabled = not self.patches
        self.patch_count.value = f"{len(self.patches)} now"
        if field:
            self.field.show(self.runs, self.pinned, self.zoom.value, self.soil.value)
            self.picture.value = self.field.svg()
        else:
            run = self.runs[0]
            self.moment.max = self.play.max = len(run.columns["t_s"]) - 1
            self.eye.show(run, self.moment.value, horizons_at(run.scenario, self.moment.value))
            self.picture.value = self.eye.svg()
        self.table.value = metrics_table(self.runs, self.pinned)
        line = html.escape(controls.line_of(self.runs[0].scenario))
        self.line.value = f'<span class="rhec-line" title="click to copy" onclick="navigator.clipboard?.writeText(this.innerText)">{line}</span>'

    def _say(self, sentence, how=""):
        self.status.value = f'<span role="status" class="{how}">{html.escape(sentence)}</span>'

    # What is taken away

    def figure(self):
        """The field run as a matplotlib figure, as it is saved."""
        with self.one_at_a_time:
            return field_run(self.runs, self.pinned, self.zoom.value, self.soil.value)

    def _save(self):
        name, folder = safe_name(self.name.value), Path(self.folder.value).expanduser()
        for place, run in enumerate(self.runs):
            save_run(
                run, folder, f"{name}_{place + 1}_{name_of(run.scenario).lower().replace(' ', '_')}"
            )
        style.save(
            self.figure(),
            name,
            [run.scenario for run in self.runs],
            folder=folder,
            notebook="explore.ipynb",
        )
        self._say(
            f"saved under the name {name} in {folder}: CSV and Parquet of each run, the figure as PNG and PDF"
        )

    def _repr_mimebundle_(self, **given):
        """Where there are no widgets, the picture and the table stand for them."""
        bundle = super()._repr_mimebundle_(**given)
        return bundle | {
            "text/html": f'{STYLE}<div class="rhec">{self.picture.value}{self.table.value}</div>'
        }


def _input(control, value):
    """The widget of a control. Its range takes in the value it begins with."""
    look = {
        "description": control.label,
        "tooltip": control.about,
        "layout": {"width": "98%"},
        "style": {"description_width": "116px"},
    }
    if isinstance(control, controls.Choice):
        known = any(value == option for _, option in control.options)
        return widgets.Dropdown(
            options=control.options if known else (*control.options, ("as it began", value)),
            value=value,
            **look,
        )
    log, whole = control.kind == "log", control.kind == "whole"
    place = (math.log10(value) if value > 0 else control.low) if log else value
    # steps count from the lowest end: the value it begins with must be one of them, or the front
    # end changes it
    low = round(place - control.step * math.ceil((place - control.low) / control.step - 1e-9), 12)
    kind = widgets.FloatLogSlider if log else widgets.IntSlider if whole else widgets.FloatSlider
    readout = (
        ".3g"
        if log
        else "d"
        if whole
        else f".{max(1, -math.floor(math.log10(control.step) + 1e-9))}f"
    )
    return kind(
        value,
        min=min(low, place),
        max=max(control.high, place),
        step=control.step,
        readout_format=readout,
        continuous_update=not control.slow,
        **look,
    )


def _list(options, value, label, width_px, about=""):
    return widgets.Dropdown(
        options=options,
        value=value,
        description=label,
        tooltip=about,
        layout={"width": f"{width_px}px"},
        style={"description_width": "initial"},
    )


def _button(text, about):
    return widgets.Button(description=text, tooltip=about, layout={"width": "auto"})


def _sentence(error):
    """What went wrong, in one line. A ValueError of this package speaks for itself."""
    text = " ".join(str(error).split())
    return text if isinstance(error, ValueError) and text else f"{type(error).__name__}: {text}"


def _running_loop():
    try:
        return asyncio.get_running_loop()
    except RuntimeError:
        return None
