"""The live page: the closed loop in the reader's browser, from files alone.

`build` writes what the page needs beside its script: the world (fields, noise, controls) and one
module of WebAssembly for each structure of the loop, each loaded when it is asked for.
"""

import base64
import gzip
import json
import multiprocessing
import shutil
import tomllib
from concurrent.futures import ProcessPoolExecutor
from dataclasses import fields
from pathlib import Path

import numpy as np

from rhec import paper
from rhec.core._casadi.build import packed_size
from rhec.simulation import closed_loop, faults
from rhec.simulation.columns import COLUMNS
from rhec.simulation.scenario import Scenario
from rhec.tracked_robot import plant, tuning
from rhec.tracked_robot.choice import Choice
from rhec.tracked_robot.estimators import estimator_of
from rhec.workbench.explorer.controls import CONTROLS, NEW_PATCH, PATCH, line_of
from rhec.workbench.explorer.explorer import METRICS
from rhec.workbench.live import functions, texts, wasm

__all__ = ["FAULTS", "LEADS", "SCENES", "STRUCTURES", "build"]

HERE = Path(__file__).parent
FAULTS = {name: of for name, of in CONTROLS["faults"].options if of}
_FAULTY = next(iter(FAULTS.values()))
# What each compiled module is a loop of: fields of Scenario.
STRUCTURES = {
    "rhe": {},
    "ekf": dict(estimator="ekf"),
    "dual": dict(estimator="dual"),
    "dual_cautious": dict(estimator="dual", cautious=True),
    "rhe_faulty": dict(faults=_FAULTY),
    "rhe_robust": dict(faults=_FAULTY, robust=True),
} | {f"rhe_{n}": dict(estimation_horizon=n) for n in (5, 10, 30)}


SCENES = tomllib.loads((HERE / "scenes.toml").read_text(encoding="utf-8"))
_GROUPS = {  # of controls, by field
    "Controller": ("q", "r", "look_ahead_m", "omega_max_radps"),
    "Noise assumed": ("sigma_w", "sigma_v"),
    "Start and drive": ("start_offset_m", "start_yaw_rad", "speed_mps", "duration_s"),
    "Sensors": ("gnss_sigma_m", "encoder_sigma_mps", "speed_sigma_mps", "bump_sigma_radps"),
}
# The scene that shows what a notebook does.
LEADS = {scene["notebook"]: name for name, scene in SCENES.items()}


def build(folder):
    """Write what the live page needs into a new folder: its script, the world, and the modules.

    Returns the world: what its template needs to know.
    """
    folder.mkdir()
    for file in ("live.js", "plot.js", "page.js", "live.css"):
        shutil.copy(HERE / file, folder)
    written = dict(world=_world(), faults=_fault_streams())
    context = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(2, context) as pool:  # each takes seconds, the first time
        written |= dict(zip(STRUCTURES, pool.map(_module, STRUCTURES.values())))
    for name, content in written.items():
        text = json.dumps(content, allow_nan=False, separators=(",", ":"), ensure_ascii=False)
        (folder / f"{name}.js").write_text(f"live.arrived({name!r}, {text})\n", encoding="utf-8")
    return written["world"]


def _packed(values):
    """Bytes or an array, compressed, as text."""
    return base64.b64encode(gzip.compress(bytes(values), 9, mtime=0)).decode()


def _module(own):
    """A structure's module, and all that the script must know to call it."""
    scenario = Scenario(**own)
    setup = closed_loop.set_up(scenario)
    choice = Choice.of(scenario)
    made = functions.build_live(own)
    at = 0
    places = {}
    for name, shape in setup.layout.items():
        inner = shape.items() if isinstance(shape, dict) else [("", shape)]
        for piece, (rows, columns) in inner:
            places[f"{name}.{piece}".rstrip(".")] = at, rows, columns
            at += rows * columns
    estimator = estimator_of(choice.estimator, choice.robust)
    tuned = tuning.SIGMA_W.get(scenario.estimator) or dict.fromkeys(
        ("printed", "calibrated"), tuning.SIGMA_W_TRACKING[scenario.estimator]
    )
    return dict(
        given={name: made["start"].nnz_in(name) for name in made["start"].name_in()},
        n=len(setup.memory),
        places=places,
        states=estimator.states(choice),
        sigma_w={name: tuned[name] for name in ("printed", "calibrated")},
        line={name: value for name, value in own.items() if name != "faults"},
        faulty=bool(scenario.faults),
        wasm=_packed(wasm.module_of(texts.loop_text(made, places["s"][0]))),
    )


def _world():
    """All that the runs have in common, and the controls."""
    start = Scenario()
    # A line of Python leaves these out.
    defaults = {each.name: getattr(start, each.name) for each in fields(start)}
    defaults |= dict(sigma_v=paper.SIGMA_V, faults=())
    path = closed_loop.set_up(start).path
    points = path.poses(np.arange(0, path.length_m, 0.5))[0][:, :2]
    return dict(
        dt_s=paper.DT_S,
        most=texts.MOST,
        tolerance_m=paper.TOLERANCE_M,
        columns=COLUMNS,
        metrics=functions.METRICS,
        shown=METRICS,
        robot_m=(paper.ROBOT_LENGTH_M, paper.ROBOT_WIDTH_M),
        noise=packed_size(plant.NOISE),
        fault=packed_size(faults.STREAM),
        wasm=_packed(wasm.module_of(texts.world_text(), whole_numbers=True)),
        seeds=[*texts.SEEDS],
        soils=texts.SOILS,
        cell_m=texts.CELL_M,
        grid=closed_loop.set_up(start).structure.terrain_shape,
        lowest=points.min(axis=0).tolist(),
        highest=points.max(axis=0).tolist(),
        faults={name: f"({', '.join(map(line_of, of))},)" for name, of in FAULTS.items()},
        path=np.round(points, 3).tolist(),
        windows=[5, 10, 15, 30],
        new_patch=NEW_PATCH,
        scenes={name: _scene(scene, defaults) for name, scene in SCENES.items()},
        defaults=defaults,
    )


def _scene(scene, defaults):
    """A scene with its runs and controls in full."""
    runs = [
        (name, module, {field: getattr(paper, number) for field, number in own.items()})
        for name, module, own in scene["runs"]
    ]
    values = defaults | dict(
        duration_s=scene["duration_s"], sigma_w=tuning.SIGMA_W["rhe"]["calibrated"]
    )
    groups = {title: _controls(_GROUPS[title], values) for title in scene["groups"]}
    patch = [slider._replace(key=("patch", slider.key)) for slider in PATCH]
    groups["Last wet patch"] = [_as_dict(slider, dict(patch=NEW_PATCH)) for slider in patch]
    return scene | dict(runs=runs, groups=groups)


def _controls(fields, values):
    """The explorer's sliders of these fields of Scenario."""
    keys = [key for key in CONTROLS if (key[0] if isinstance(key, tuple) else key) in fields]
    return [_as_dict(CONTROLS[key], values) for key in keys]


def _as_dict(slider, values):
    """A Slider as the script reads it: field and place, range and value."""
    field, place = slider.key if isinstance(slider.key, tuple) else (slider.key, None)
    value = values[field] if place is None else values[field][place]
    high = texts.MOST * paper.DT_S if field == "duration_s" else slider.high
    return slider._asdict() | dict(field=field, place=place, high=high, value=value)


def _fault_streams():
    """The sensors' faults as the loop reads them, {fault: one stream for each seed}."""
    return {
        name: [_packed(faults.stream(of, texts.MOST, paper.DT_S, seed)) for seed in texts.SEEDS]
        for name, of in FAULTS.items()
    }
