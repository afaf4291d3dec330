"""Write the live page: the closed loop in the reader's browser, from files alone.

`docs.site.report` adds live.html and live/ to the site. Noise, soils and sensor faults of each seed
are data that Python computes here; the loop is WebAssembly, one module per structure of the loop.
The page loads seeds and modules when they are first needed.
"""

import base64
import functools
import gzip
import json
import multiprocessing
import shutil
import tomllib
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path

import jinja2
import numpy as np

from docs.live import functions, wasm, window
from docs.live.plants import plants_of
from docs.site.content_policy import live_policy
from rhec import paper
from rhec.core._casadi.build import packed_size
from rhec.explorer.controls import CONTROLS, GROUPS, NEW_PATCH, PATCH, RULES
from rhec.explorer.explorer import METRICS
from rhec.simulation import closed_loop, fault_signals, faults
from rhec.simulation.columns import COLUMNS
from rhec.simulation.scenario import Scenario
from rhec.simulation.worlds import WORLDS
from rhec.tracked_robot import plant, terrain, tuning
from rhec.tracked_robot.estimators import Choice, estimator_of
from rhec.tracked_robot.references import padded_segments
from rhec.tracked_robot.sensors import SENSORS

HERE = Path(__file__).parent
SEEDS = range(10)
NOISE_STEP = 1 / 4096  # of 16 bits with sign: up to eight standard deviations
TRACTION_STEP = 1 / 65535  # of 16 bits without sign: up to 1
_FARTHEST_START_M = CONTROLS["start_offset_m"].high
SOILS = {  # of the project's worlds, and one of the story's that is the same everywhere
    "default": WORLDS["default"],
    "soft": WORLDS["soft"],
    "even": dict(mu_deviation=0.0, kappa_deviation=0.0),
}
TURNS = dict(CONTROLS["turns"].options)  # {label: value in Scenario}
FAULTS = {  # the page's robots have GNSS and encoders alone
    name: of
    for name, of in CONTROLS["faults"].options
    if of and not any(fault.channel in SENSORS for fault in of)
}
_ANY_FAULT = next(iter(FAULTS.values()))
# The compiled modules: parameters of Scenario that decide the structure of the loop.
STRUCTURES = {
    "rhe": {},
    "ekf": dict(estimator="ekf"),
    "rhe_faulty": dict(faults=_ANY_FAULT),
    "ekf_faulty": dict(estimator="ekf", faults=_ANY_FAULT),
} | {f"rhe_{n}": dict(estimation_horizon=n) for n in (5, 10, 30)}
WINDOWS = {Scenario(**own).estimation_horizon for own in STRUCTURES.values()}
SCENES = tomllib.loads((HERE / "scenes.toml").read_text(encoding="utf-8"))
STORY = tomllib.loads((HERE / "story.toml").read_text(encoding="utf-8"))
# What scripts need of a step of the story; its template has the rest.
_TOLD = ("told", "right", "wrong", "idle", "run")
# Parameters of Scenario that have sliders; none of them changes the structure of the loop.
_FIELDS = set(
    "q r look_ahead_m omega_max_radps sigma_w sigma_v duration_s start_offset_m start_yaw_rad "
    "speed_mps rotation_centre_m gnss_sigma_m gnss_slow_share gnss_slow_time_s encoder_sigma_mps "
    "speed_sigma_mps bump_sigma_radps rut_length_m slip_difference".split()
)
# Parameters of Scenario in which the loop's first memory is affine.
_START = dict(start_offset_m=0.0, start_yaw_rad=0.0, guess_yaw_rad=0.0, speed_mps=paper.SPEED_MPS)
# Settings of the loop that come with the soil.
_OF_THE_SOIL = ("origin_m", "cell_m", "slip", "mean_traction")
_OF_THE_PATH = ("padded_segments", "period_m")


def write(folder):
    """Write live.html and what it loads into a folder; it links the notebooks' pages there."""
    files = folder / "live"
    files.mkdir()
    for file in (*HERE.glob("*.js"), *HERE.glob("*.css")):
        shutil.copy(file, files)
    for name in ("plot.js", "view.js", "view.css"):
        shutil.copy(HERE.parents[1] / "rhec/explorer" / name, files)
    world = _world()
    data = dict(world=world) | {f"seed_{seed}": seed_data(seed) for seed in SEEDS}
    with ProcessPoolExecutor(mp_context=multiprocessing.get_context("spawn")) as pool:
        # Tracing a loop takes seconds; its compiled module is cached.
        tools = pool.submit(_tools)
        data |= dict(zip(STRUCTURES, pool.map(_module, STRUCTURES.values())))
        data["tools"] = tools.result()
    for name, content in data.items():
        text = json.dumps(content, separators=(",", ":"))
        (files / f"{name}.js").write_text(f"live.arrived({name!r}, {text})\n", encoding="utf-8")
    environment = jinja2.Environment(
        loader=jinja2.FileSystemLoader(HERE), undefined=jinja2.StrictUndefined, autoescape=True
    )
    pages = {file.stem: file.relative_to(folder).as_posix() for file in folder.rglob("*.html")}
    given = dict(story=STORY, world=world, pages=pages, policy=live_policy())
    html = environment.get_template("live.html.j2").render(**given)
    (folder / "live.html").write_text(html, encoding="utf-8")


def _packed(values):
    """An array or bytes, compressed, as text."""
    return base64.b64encode(gzip.compress(bytes(values), 9, mtime=0)).decode()


def seed_data(seed):
    """Noise, soils and sensor faults of a seed, each array compressed, as text.

    noise: (MAX_SAMPLES, n) in steps of NOISE_STEP; soils: {name: (2, n_x, n_y)} in steps of
    TRACTION_STEP, on a grid as large as any path needs, of which each reads the beginning, as
    differences along both axes, which take half of the room; faults: {name: (MAX_SAMPLES, n)}.
    """
    noise = plant.draw_noise(seed, functions.MAX_SAMPLES) / NOISE_STEP
    n_x, n_y = _soil_shape()
    box = 0.0, (n_x - 1) * _cell_m(), 0.0, (n_y - 1) * _cell_m()
    soils = {}
    for name, statistics in SOILS.items():
        of = Scenario(seed=seed, **statistics)
        means = of.mu_mean, of.kappa_mean
        deviations = of.mu_deviation, of.kappa_deviation
        soil = terrain.Terrain.random(seed, box, means, deviations, of.correlation_length_m)
        steps = np.round(np.stack([soil.mu, soil.kappa]) / TRACTION_STEP)
        # Differences and their sums are modulo 2^16.
        apart = np.diff(np.diff(steps.astype(np.uint16), axis=1, prepend=0), axis=2, prepend=0)
        soils[name] = _packed(apart.astype(np.uint16))
    streams = {
        name: _packed(fault_signals.stream(fault, functions.MAX_SAMPLES, paper.DT_S, seed, ()))
        for name, fault in FAULTS.items()
    }
    return dict(noise=_packed(np.round(noise).astype(np.int16)), soils=soils, faults=streams)


def affine_memory(own):
    """The loop's first memory m = m_0 + Σ value · direction, for the structure of Scenario(**own).

    It consists of constants and copies of pose, guess and speed, which are affine in the parameters
    of _START. Returns m_0 (n,) and {field: direction (n,)}.
    """

    def memory(**start):
        return closed_loop.set_up(Scenario(**own, **(_START | start))).memory

    middle = memory()
    directions = {name: 2 * (memory(**{name: at + 0.5}) - middle) for name, at in _START.items()}
    # A gap in the estimator's window is NaN whatever the start.
    directions = {name: np.nan_to_num(slope) for name, slope in directions.items()}
    return middle - sum(at * directions[name] for name, at in _START.items()), directions


def _module(own):
    """A structure's module, and what the script must know to call it."""
    scenario = Scenario(**own)
    setup = closed_loop.set_up(scenario)
    choice = Choice.of(scenario)
    memory, directions = affine_memory(own)
    built = functions_of(scenario)
    text = functions.c_text(built)
    return dict(
        memory=_without_nan(memory),
        directions={name: slope.tolist() for name, slope in directions.items()},
        settings={
            name: np.ravel(value, order="F").astype(float).tolist()
            for name, value in setup.settings.items()
            if name in built["sample"].name_in() and name not in _OF_THE_SOIL + _OF_THE_PATH
        },
        places=_places(setup),
        states=estimator_of(choice.estimator).states(choice),
        noises={rule: tuning.NOISES[scenario.estimator][rule]._asdict() for rule in RULES},
        line={name: value for name, value in own.items() if name != "faults"},
        faulty=bool(scenario.faults),
        wasm=_packed(wasm.module_of(text)),
    )


def _without_nan(memory):
    """A memory (n,) as a list, with None in place of NaN, for which JSON has no word."""
    return [None if np.isnan(value) else value for value in memory.tolist()]


def _tools():
    """The module of the story's Functions, and where the loop's memory holds the estimator's."""
    scenario = Scenario()
    setup = closed_loop.set_up(scenario)
    tools = window.build_tools(scenario)
    place = setup.unpack(np.arange(len(setup.memory)))["estimator"]
    first = min(int(np.min(piece)) for piece in place.values())
    names = ("s", "v", "z", "age", "m", "P")
    places = {name: (np.atleast_2d(place[name].T) - first).tolist() for name in names}
    memories = window.first_memories(scenario, setup.guess)
    return dict(
        order=[*tools],
        results={
            name: {of: function.nnz_out(of) for of in function.name_out()}
            for name, function in tools.items()
        },
        first=first,
        places=places,
        P_0=setup.settings["P_0"].tolist(),
        first_memories={name: _without_nan(memory) for name, memory in memories.items()},
        wasm=_packed(wasm.module_of(window.c_text(tools))),
    )


def _places(setup):
    """{piece of the memory: indices of its columns}: the plan, and the window of an RHE."""
    pieces = setup.unpack(np.arange(len(setup.memory)))
    window = pieces["estimator"]
    names = ("s", "z", "age") if "age" in window else ()
    places = {name: window[name].T.tolist() for name in names}
    return places | dict(plan=pieces["controller"]["s"].T.tolist())


def _world():
    """What all runs have in common, and the controls."""
    defaults = vars(Scenario())  # the line of Python leaves them out
    return dict(
        fields=fields_of_turns(),
        turns=TURNS,
        cell_m=_cell_m(),
        traction_step=TRACTION_STEP,
        soil_shape=_soil_shape(),
        rules=RULES,
        default_rule=tuning.DEFAULT_RULE,
        dt_s=paper.DT_S,
        max_samples=functions.MAX_SAMPLES,
        tolerance_m=paper.TOLERANCE_M,
        robot_m=(paper.ROBOT_LENGTH_M, paper.ROBOT_WIDTH_M),
        track_width_m=paper.TRACK_WIDTH_M,
        columns=COLUMNS,
        errors=functions.ERRORS,
        metrics=METRICS,
        noise=dict(n=packed_size(plant.NOISE), step=NOISE_STEP),
        n_fault=packed_size(faults.stream_shapes(0)),
        faults={name: f"({', '.join(map(repr, fault))},)" for name, fault in FAULTS.items()},
        shaded={name: [(of.start_s, of.end_s) for of in fault] for name, fault in FAULTS.items()},
        seeds=[*SEEDS],
        soils=SOILS,
        windows=sorted(WINDOWS),
        new_patch=NEW_PATCH,
        groups=_sliders(),
        scenes={name: _scene(scene, defaults) for name, scene in SCENES.items()},
        story={id: {key: of.get(key) for key in _TOLD} for id, of in STORY.items()},
        defaults=defaults,
    )


@functools.cache
def _setups():
    """{turns: Setup} of the drives that need the most soil."""
    drives = [Scenario(turns=of, start_offset_m=_FARTHEST_START_M) for of in TURNS.values()]
    return {drive.turns: closed_loop.set_up(drive) for drive in drives}


def _soil_shape():
    """The shape of the smallest grid that has room for each path's soil."""
    shapes = [setup.terrain.mu.shape for setup in _setups().values()]
    return tuple(np.max(shapes, axis=0).tolist())


def _cell_m():
    return next(iter(_setups().values())).terrain.cell_m


def functions_of(scenario):
    """The Functions of a Scenario's module, which fit each of TURNS."""
    return functions.build_functions(scenario, _soil_shape())


def fields_of_turns():
    """{turns: path, plants, and where the soil lies}, as the page draws and drives them."""
    return {turns: _field(setup) for turns, setup in _setups().items()}


def _field(setup):
    path = setup.path
    # Equal steps of about half a metre: the last point is one step before the first.
    path_step_m = path.length_m / np.ceil(2 * path.length_m)
    line = path.poses(np.arange(0, path.length_m - 1e-9, path_step_m))[0][:, :2]
    return dict(
        path=np.round(line, 3).tolist(),
        path_step_m=path_step_m,
        segments=padded_segments(path).ravel().tolist(),  # as CasADi stores their transpose
        period_m=path.period_m,
        length_m=path.length_m,
        plants=np.round(plants_of(path), 3).tolist(),
        lowest=path.box[::2],
        highest=path.box[1::2],
        # A random field reaches so far beyond the path, and farther by the start's offset.
        margin_m=path.box[0] - setup.terrain.origin_m[0] - _FARTHEST_START_M,
    )


def _scene(scene, defaults):
    """A scene with its runs and the sliders' first values in full."""
    runs = [
        (name, module, {field: getattr(paper, constant) for field, constant in own.items()})
        for name, module, own in scene["runs"]
    ]
    own = tuning.NOISES["rhe"][tuning.DEFAULT_RULE]._asdict()
    own |= dict(duration_s=scene["duration_s"])
    values = {name: value for name, value in (defaults | own).items() if name in _FIELDS}
    return dict(fault=next(iter(FAULTS))) | scene | dict(runs=runs, values=values)


def _sliders():
    """{group: sliders} of the explorer that the page has, and those of the last wet patch."""
    groups = {}
    for title, controls in GROUPS.items():
        for control in controls:
            field, place = control.key if isinstance(control.key, tuple) else (control.key, None)
            if field in _FIELDS:
                slider = control._asdict() | dict(field=field, place=place)
                groups.setdefault(title, []).append(slider)
    patch = [slider._asdict() | dict(field="patch", place=slider.key) for slider in PATCH]
    return groups | {"Last wet patch": patch}
