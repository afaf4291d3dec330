"""The explorer: controls on the left, and on the right a run that follows the controls.

`controls` converts the values of the widgets to scenarios, `rhec.simulation.closed_loop` runs them,
`field_run` describes the picture, and the browser draws it (`screen`). A front end sends the next
value of a widget only after the reply to the last one, so that dragging skips frames instead of
queueing them.
"""

import functools
import math
import re
import threading
import time
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

import ipywidgets as widgets

from rhec import paper, style
from rhec.core._casadi import early
from rhec.explorer import controls, field_run
from rhec.explorer.field_run import ZOOMS
from rhec.explorer.panels import figure_of, packed
from rhec.explorer.screen import CSS, Screen
from rhec.files import replacing
from rhec.simulation import closed_loop
from rhec.simulation.scenario import Scenario
from rhec.tracked_robot import tuning
from rhec.tracked_robot.sensors import SENSORS

if TYPE_CHECKING:  # the browser draws the screen, so Matplotlib waits until a figure is asked for
    from matplotlib.figure import Figure

# Metrics of a run, all better if smaller: name, two lines of heading, digits.
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
_NO_WIDGETS = (
    "Controls and pictures need the widgets of Jupyter, which this page does not show. "
    "The method figure() of the explorer draws the picture."
)
_DRIVERS = ThreadPoolExecutor()  # each of two runs has a thread
_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9_-]{0,63}")


def _name_of(run):
    """What the run's estimator is called."""
    return style.label_of(run.scenario.estimator)


def metrics_table(runs, pinned=()):
    """An HTML table with the metrics of runs, and differences from the pinned runs."""
    rows = [_table_row(run, _name_of(run), _value, {}) for run in runs]
    for run, before in zip(runs, pinned):
        name = _name_of(run)
        pinned_name = _name_of(before)
        title = f"{name} − pinned" + ("" if pinned_name == name else f" {pinned_name}")
        rows.append(_table_row(run, title, change, before.metrics))
    head = "".join(f"<th>{heading} <br>{below}</th>" for _, heading, below, _ in METRICS)
    return f'<table class="rhec-table"><tr><th></th>{head}</tr>{"".join(rows)}</table>'


def _table_row(run, title, cell, subtracted):
    """The metrics of a run minus the subtracted ones, formatted by `cell`."""
    swatch = f'<span style="color: {style.colour_of(run.scenario.estimator)}">━</span>'
    cells = [
        cell(run.metrics[name] - subtracted.get(name, 0), digits) for name, _, _, digits in METRICS
    ]
    return f"<tr><td>{swatch}&nbsp;{title}</td>{''.join(f'<td>{text}</td>' for text in cells)}</tr>"


def _value(number, digits):
    return f"{number:.{digits}f}" if math.isfinite(number) else "never"


def change(difference, digits):
    """The change of a metric as HTML; smaller is better."""
    if not math.isfinite(difference):
        return "–"
    text = f"{difference:+.{digits}f}"
    if float(text) == 0:
        return "0"
    kind = "better" if difference < 0 else "worse"
    return f'<span class="{kind}">{text.replace("-", "−")}</span>'


def _safe_name(name):
    """The name if it is safe as a file name in a folder; otherwise raise a ValueError."""
    if not _NAME.fullmatch(name):
        rule = "up to 64 letters, digits, - and _, starting with a letter or digit"
        raise ValueError(f"name was {name!r}; it should be {rule}")
    return name


class Explorer(widgets.VBox):
    """The explorer as a widget for Jupyter.

    Args:
        start: The initial Scenario, by default the paper's.
        against: Estimator that drives the same field for comparison, or None.
        folder: Folder of saved runs and figures.

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
        self.is_paused = False
        # A kernel may process messages in its main thread and in the thread of a subshell.
        self.lock = threading.RLock()
        # The first loops compile while the widgets are made.
        setups = [
            closed_loop.set_up(each)
            for each in _scenarios(controls.values_of(start), (start.estimator, against), start)
        ]
        early.begin(closed_loop.build_sample, [setup.structure for setup in setups])
        self._make_inputs(against)
        self._make_outputs(folder)
        super().__init__(self._layout())
        self.add_class("rhec")
        self._connect_callbacks()
        self._refresh()

    # Widgets

    def _make_inputs(self, against):
        values = controls.values_of(self.start)
        estimators = [(name, key) for key, name in style.LABELS.items()]
        for own in (self.start.estimator, against):
            if own is not None and own not in [key for _, key in estimators]:
                estimators.append((style.label_of(own), own))
        self.inputs = {key: _input(one, values[key]) for key, one in controls.CONTROLS.items()}
        patch = self.patches[-1] if self.patches else controls.NEW_PATCH
        self.patch = [_input(slider, value) for slider, value in zip(controls.PATCH, patch)]
        self.estimator = _list(estimators, self.start.estimator, "run", "142px")
        self.against = _list([("nothing", None), *estimators], against, "against", "160px")
        tooltip = "noise W and V of the estimators, by a rule; the tab Estimator sets custom ones"
        noise = values["process_noise"]
        self.process_noise = _list(controls.PROCESS_NOISES, noise, "noise", "158px", tooltip)
        look = _look("seed", "determines soil and noise", "112px", "36px")
        self.seed = widgets.IntText(self.start.seed, **look)
        self.zoom = _list([(zoom, zoom) for zoom in ZOOMS], ZOOMS[0], "map", "142px")
        self.soil = _list([("of κ", "kappa"), ("of μ", "mu")], "kappa", "", "66px")
        self.weights = {
            _button(name, "the paper’s weights"): q
            for name, q in (("Q¹", paper.Q1), ("Q²", paper.Q2), ("Q³", paper.Q3))
        }
        self.pin = _button("pin", "keep these runs for comparison")
        self.unpin = _button("unpin", "remove the pinned runs")
        self.reset = _button("reset", "return to the initial scenario")
        self.add_patch = _button("add a wet patch", "add a disc with other traction")
        self.remove_patch = _button("remove the last", "remove the last wet patch")

    def _make_outputs(self, folder):
        self.screen = Screen()
        self.patch_count = widgets.HTML()
        self.folder, self.name = (
            widgets.Text(value, **_look(label, None, "96%", "50px"))
            for label, value in (("folder", str(folder)), ("name", "run"))
        )
        tooltip = "CSV and Parquet of each run, the figure as PNG and PDF"
        self.save = _button("save runs and figure", tooltip)

    def _layout(self):
        choices = [self.estimator, self.against, self.process_noise, self.seed]
        views = [self.pin, self.unpin, self.reset, self.zoom, self.soil]
        row = {"flex_flow": "row wrap", "align_items": "center"}
        bar = widgets.HBox([*choices, *views], layout=row)
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
        size = {"width": width, "max_width": "100%", "flex": f"0 0 {width}"}
        tabs = widgets.Tab(boxes, titles=[*groups], layout=size)
        size = {"flex": "1 1 480px", "min_width": "0"}
        right = widgets.VBox([self.screen], layout=size)
        return [bar, widgets.HBox([tabs, right], layout={"flex_flow": "row wrap"})]

    # Callbacks

    def _connect_callbacks(self):
        choices = (self.estimator, self.against, self.process_noise, self.seed)
        drawn = (self.zoom, self.soil)
        changed = ((*choices, *self.inputs.values()), self._refresh)
        for group, action in (changed, (self.patch, self._change_patch), (drawn, self._draw)):
            for widget in group:
                widget.observe(self._callback(action), "value")
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
            button.on_click(self._callback(action))

    def _callback(self, action):
        """A callback of a widget for an action; the status line reports errors."""

        def callback(_):
            # hold_sync: all changes are sent in one message.
            with self.lock, self.screen.hold_sync():
                if self.is_paused:
                    return
                try:
                    action()
                except Exception as error:
                    self._show_status(_message(error), "bad")
                except KeyboardInterrupt:
                    self._show_status("interrupted: the picture is of the settings before", "bad")
                    raise

        return callback

    @contextmanager
    def _paused(self):
        """A context for changes of controls that no run follows."""
        self.is_paused = True
        try:
            yield
        finally:
            self.is_paused = False

    @contextmanager
    def _single_refresh(self):
        """A context for changes of several controls, followed by one run."""
        with self._paused():
            yield
        self._refresh()

    def _set_weights(self, q):
        with self._single_refresh():
            for place, weight in enumerate(q):
                self.inputs["q", place].value = weight

    def _reset(self):
        with self._single_refresh():
            values = controls.values_of(self.start)
            self.patches = self.start.patches
            for key, widget in self.inputs.items():
                widget.value = values[key]
            self.estimator.value = self.start.estimator
            self.seed.value = self.start.seed
            self.process_noise.value = values["process_noise"]

    def _set_patches(self, patches):
        """Replace the wet patches; the sliders show the last one."""
        with self._single_refresh():
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
        """The scenarios of the controls: one, or two with the same seed for comparison."""
        values = controls.values_of(self.start)
        for key, widget in self.inputs.items():
            values[key] = controls.tidy(controls.CONTROLS[key], widget.value, values[key])
        values["process_noise"] = self.process_noise.value
        values["seed"] = self.seed.value
        values["patches"] = self.patches
        return _scenarios(values, (self.estimator.value, self.against.value), self.start)

    def _refresh(self):
        """Run the scenarios of the controls and draw them, or first compile them."""
        started = time.perf_counter()
        scenarios = self.scenarios
        setups = [closed_loop.set_up(scenario) for scenario in scenarios]
        structures = dict.fromkeys(setup.structure for setup in setups)
        missing = [
            each for each in structures if not early.is_compiled(closed_loop.build_sample, *each)
        ]
        if missing and self.runs:
            self._show_status("compiling for the first time: the last picture stays", "wait")
            self.screen.send_state(["status", "status_kind"])
        early.begin(closed_loop.build_sample, missing)
        if self.runs:  # who moves one control moves it on: a first view alone is not worth it
            early.optimise(closed_loop.build_sample, structures)
        # CasADi makes Functions in one thread alone; it evaluates them in several at a time.
        functions = [early.load(closed_loop.build_sample, *each.structure) for each in setups]
        self.runs = tuple(_DRIVERS.map(closed_loop.simulate_loaded, functions, scenarios, setups))
        ran = time.perf_counter()
        self._draw()
        runs = f"{len(self.runs)} runs" if len(self.runs) > 1 else "1 run"
        self._show_status(
            f"{runs} of {scenarios[0].duration_s:g} s in {1000 * (ran - started):.0f} ms"
        )

    def _draw(self):
        """Draw the runs, their metrics, and the scenario as a line."""
        self.unpin.disabled = not self.pinned
        self._show_process_noise()
        self._fold_sensors()
        self.remove_patch.disabled = not self.patches
        for widget in self.patch:
            widget.disabled = not self.patches
        self.patch_count.value = f"{len(self.patches)} now"
        self.screen.picture, self.screen.numbers = packed(self._picture())
        self.screen.table = metrics_table(self.runs, self.pinned)
        self.screen.line = repr(self.runs[0].scenario)

    def _picture(self):
        return field_run.picture_of(self.runs, self.pinned, self.zoom.value, self.soil.value)

    def _show_process_noise(self):
        """Set the sliders of σ_W and σ_V to the noise in use; a custom one enables them."""
        rule = self.process_noise.value
        # As the entries of a Noise are called, so are the sliders.
        for key, slider in self.inputs.items():
            if key[0] in tuning.Noise._fields:
                slider.disabled = rule != "custom"
                if slider.disabled:
                    with self._paused():
                        slider.value = getattr(tuning.NOISES["rhe"][rule], key[0])[key[1]]

    def _fold_sensors(self):
        """Hide the sliders of sensors that the robot does not have."""
        used = self.inputs["sensors"].value
        for name, sensor in SENSORS.items():
            for setting in sensor.settings.values():
                widget = self.inputs[setting.parameter]
                widget.layout.display = None if name in used else "none"

    def _show_status(self, message, kind=""):
        self.screen.status = message
        self.screen.status_kind = kind

    # Figures, files and texts

    def __repr__(self) -> str:
        """The estimators with their errors, and the scenario as Python."""
        errors = [
            f"{_name_of(run)}: mean error {run.metrics['mean_error_m']:.4f} m, "
            f"true {run.metrics['mean_error_true_m']:.4f} m"
            for run in self.runs
        ]
        return "\n  ".join(["Explorer", *errors, repr(self.runs[0].scenario)])

    def figure(self) -> "Figure":
        """The field run as a matplotlib figure."""
        with self.lock:
            return figure_of(self._picture())

    def _save(self):
        name = _safe_name(self.name.value)
        folder = Path(self.folder.value).expanduser()
        folder.mkdir(parents=True, exist_ok=True)
        for place, run in enumerate(self.runs, 1):
            estimator = _name_of(run).lower().replace(" ", "_")
            file = _safe_name(f"{name}_{place}_{estimator}")
            with replacing(folder / f"{file}.csv") as unfinished:
                run.log.to_csv(unfinished, index=False)
            with replacing(folder / f"{file}.parquet") as unfinished:
                run.log.to_parquet(unfinished, index=False)
        scenarios = [run.scenario for run in self.runs]
        style.save(self.figure(), name, scenarios, folder=folder)
        files = "CSV and Parquet of each run, the figure as PNG and PDF"
        self._show_status(f"saved under the name {name} in {folder}: {files}")

    def _repr_mimebundle_(self, **formats):
        """Add the table as HTML, for pages without widgets."""
        html = f"<p>{_NO_WIDGETS}</p>{self.screen.table}"
        html = f'<style>\n{CSS}</style><div class="rhec">{html}</div>'
        return super()._repr_mimebundle_(**formats) | {"text/html": html}


def _scenarios(values, estimators, start):
    """The scenarios of the controls' values, one for each estimator that is not None."""
    return [
        controls.scenario_of(values, estimator, start)
        for estimator in estimators
        if estimator is not None
    ]


def _input(control, value):
    """The widget of a control, with a range that includes its initial value."""
    look = _look(control.label, control.tooltip, "98%", "126px")
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
        readout = f".{max(1, _decimals(control.step), _decimals(value))}f"
    # A front end rounds to whole steps from the lowest value, so the initial value must be one.
    steps = math.floor((place - control.low) / control.step + 1e-9)
    low = round(place - control.step * steps, 12)
    return kind(
        value,
        min=min(low, place),
        max=max(control.high, place),
        step=control.step,
        readout_format=readout,
        continuous_update=control.kind != "whole",  # a new integer may need compilation
        **look,
    )


def _decimals(number):
    """How many digits of a number stand after the point, up to six."""
    return len(f"{number:.6f}".rstrip("0").partition(".")[2])


def _look(label, tooltip, width, label_width="initial"):
    """A widget's label, tooltip and widths."""
    layout = {"width": width}
    style = {"description_width": label_width}
    return {"description": label, "tooltip": tooltip, "layout": layout, "style": style}


def _list(options, value, label, width, tooltip=""):
    look = _look(label, tooltip, width)
    # A list that is told the value None shows nothing, though an option has it.
    place = [option for _, option in options].index(value)
    return widgets.Dropdown(options=options, index=place, **look)


def _button(text, tooltip):
    return widgets.Button(description=text, tooltip=tooltip, layout={"width": "auto"})


def _message(error):
    """An error in one line, without the name of its type for a ValueError."""
    text = " ".join(str(error).split())
    return text if isinstance(error, ValueError) and text else f"{type(error).__name__}: {text}"
