"""Export: an estimator and a controller as self-contained C99 (`rhec export`, `rhec log`).

`phases` selects the CasADi Functions that become C; `c_writer` writes the generated files;
`recorded` takes the estimator that was judged on a log. The folder `c` contains the files that are
the same in all exports: the interface rhec.h and rhec.c, replay.c of a Scenario and of a log,
times.c and fuzz.c of a Scenario, and search.h, search.c of a log.
`notebooks/studies/exported_c.py` measures an export on this machine and, emulated, on 64-bit Arm.
"""

import contextlib
import dataclasses
import json
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np

from rhec.core._casadi.validation import shown
from rhec.core.controller.rhc import RHC
from rhec.core.estimator.rhe import RHE
from rhec.embedded import c_writer, exported_functions, recorded
from rhec.files import UNFINISHED, replacing
from rhec.logs.summary import Summary
from rhec.simulation.columns import COMMAND, ESTIMATE, MEASUREMENTS, measured_of
from rhec.simulation.scenario import Scenario
from rhec.simulation.simulate import simulate
from rhec.tracked_robot import own_loop
from rhec.tracked_robot.estimators import NAMES, estimator_of
from rhec.tracked_robot.paper_rhe import SIGMA_START

__all__ = ["FOLDER", "LOG", "export"]

FOLDER = Path("build", "embedded")
LOG = [*MEASUREMENTS, *ESTIMATE, *COMMAND]  # columns of the example log, without sensors
_LOG_S = 60.0  # length of the example log, at most
_PLAIN = "SXFunction", "MXFunction", "Switch", "Map", "MapSum"  # Functions without a library in C
# Of what an estimator may be told, what no robot can know.
_TRUTHS = dict(traction="true traction", yaw_drift="true yaw drift", truth="truth")
_EXPORTED_VALUES = dict(controller="rhc", traction_timing="feedback")
_OF_SCENARIO = "replay.c", "times.c", "fuzz.c"  # the last two need its controller
_OF_LOG = "search.h", "search.c", "replay.c"
_MARK = "rhec_memory.h"  # a folder that holds it is an export


def export(scenario: Any, folder: str | Path = FOLDER, *, estimator_only: bool = False) -> Path:
    """Write an estimator and a controller as self-contained C99.

    The folder contains a header, a CMake file, and a README.txt that describes the calls. The
    export of a Scenario or a log also has programs and an example log with Python's results.

    Args:
        scenario: rhec.Scenario with an estimator that needs no truth; a CasADi Function must
            consist of expressions. Or the rhec.RHE, the rhec.RHC, or a tuple of both, of a
            rhec.Model. Or what `rhec.log` returns of a log: then it is the estimator that was
            judged, with its noise, its place of the antenna and its unknown first yaw.
        folder: A new or empty folder, or an earlier export, whose files are replaced.
        estimator_only: Whether to leave out the controller and the path of a Scenario.

    Returns:
        The Path of the folder.

    Raises:
        ValueError: If the scenario cannot be exported, or if the folder contains other files.
    """
    if not isinstance(folder, str | Path):
        raise ValueError(f"folder was {shown(folder)}; it should be a path")
    folder = Path(folder)
    check_folder(folder)
    parts = scenario if isinstance(scenario, tuple) else (scenario,)
    if isinstance(scenario, Summary):
        if scenario.judged is None:
            raise ValueError(f"the log has no estimator to export. {scenario.verdict}")
        texts = _of_log(scenario.judged)
    elif parts and all(isinstance(part, RHE | RHC) for part in parts):
        texts = _of_model(parts)
    else:
        _check(scenario, estimator_only)
        texts = _of_scenario(scenario, estimator_only)
    _refuse_folders(folder, texts)
    _write(folder, texts)
    return folder


def _write(folder, texts):
    """Write files into a folder; all are written before the first one is replaced."""
    folder.mkdir(parents=True, exist_ok=True)
    with contextlib.ExitStack() as files:
        # The stack replaces the last file first: that is to be the first one of `texts`.
        for name, text in reversed(texts.items()):
            unfinished = files.enter_context(replacing(folder / name))
            unfinished.write(text.encode())
            unfinished.flush()


def _of_model(parts):
    """{file: text} of the export of a Model's RHE, RHC or both."""
    of_model = [part for part in parts if not isinstance(part, own_loop.RHE | own_loop.RHC)]
    by_name = {
        made.__name__.lower(): part
        for made in (RHE, RHC)
        for part in of_model
        if isinstance(part, made)
    }
    if len(by_name) < len(parts):
        raise ValueError(
            f"scenario was {shown(parts)}; for a Model it should be a RHE, a RHC or one of each, "
            "for the paper's robot a Scenario"
        )
    if len(by_name) == 2:
        rhe = by_name["rhe"].window
        rhc = by_name["rhc"].stages
        if (rhe.model, rhe.dt_s) != (rhc.model, rhc.dt_s):
            raise ValueError("RHE and RHC differ; both should have the same model and dt")
    export = exported_functions.export_model(**by_name)
    texts = _common_files()
    readme = c_writer.readme(export, texts["README.txt"])
    return texts | _generated(export) | {"README.txt": readme}


def _of_scenario(scenario, estimator_only):
    """{file: text} of the export of a Scenario."""
    export = exported_functions.export(scenario, estimator_only)
    texts = _common_files(*(_OF_SCENARIO[:1] if estimator_only else _OF_SCENARIO))
    shorter = dataclasses.replace(scenario, duration_s=min(scenario.duration_s, _LOG_S))
    columns = log_columns(scenario)
    log = simulate(shorter).log[columns[: -len(COMMAND)] if estimator_only else columns]
    readme = c_writer.readme(export, texts["README.txt"], samples=len(log), **SIGMA_START)
    example = {"scenario.json": _as_json(scenario), "log.csv": log.to_csv(index=False)}
    return texts | _generated(export) | example | {"README.txt": readme}


def _of_log(judged):
    """{file: text} of the export of the estimator that was judged on a log."""
    export = exported_functions.export_recorded(recorded.recorded_of(judged))
    texts = _common_files(*_OF_LOG)
    log = recorded.example_of(judged)
    readme = c_writer.readme(
        export, texts["README.txt"], samples=len(log), inflation=judged.inflation
    )
    example = {"scenario.json": _as_json(judged.scenario), "log.csv": log.to_csv(index=False)}
    return texts | _generated(export) | example | {"README.txt": readme}


def log_columns(scenario):
    """Columns of the example log of a scenario: LOG, with its sensors after the encoders."""
    return [*measured_of(scenario.sensors), *ESTIMATE, *COMMAND]


def _common_files(*programs):
    """{file: text} of the files that are the same in all exports, and of these programs."""
    left_out = {*_OF_SCENARIO, *_OF_LOG} - {*programs}
    # `_write` replaces files in this order, which is not left to the file system.
    files = sorted(Path(__file__).with_name("c").iterdir())
    texts = {
        file.name: file.read_text(encoding="utf-8") for file in files if file.name not in left_out
    }
    # The mark comes first, so that an interrupted export is still recognised as an export.
    return {_MARK: ""} | texts


def _generated(export):
    """{file: text} of the generated files."""
    return {
        _MARK: c_writer.memory_header(export),
        "rhec_phases.h": c_writer.phases_header(export),
        "rhec_functions.h": c_writer.functions_header(export),
        "rhec_scenario.c": c_writer.scenario_source(export),
    }


def _check(scenario, estimator_only):
    """Raise a ValueError for a scenario that cannot be exported."""
    if not isinstance(scenario, Scenario):
        raise ValueError(f"scenario was {shown(scenario)}; it should be a rhec.Scenario")
    estimator = scenario.estimator
    obstacle = _obstacle(estimator)
    if obstacle:
        names = [repr(name) for name in NAMES if not _obstacle(name)]
        raise ValueError(
            f"estimator was {estimator!r}, {obstacle}; to export, it should be one of "
            f"{', '.join(names)} or a CasADi Function"
        )
    if not isinstance(estimator, str):
        for called in estimator.step.find_functions():
            if called.class_name() not in _PLAIN:
                raise ValueError(
                    f"estimator was {shown(estimator)}, which calls {called.name()!r} "
                    f"({called.class_name()}); to export, it should consist of expressions"
                )
    if not estimator_only:
        _check_controller(scenario)


def _obstacle(estimator):
    """Why an estimator cannot be exported; "" if it can."""
    described = estimator_of(estimator)
    unknown = [_TRUTHS[name] for name in described.told if name in _TRUTHS]
    return f"which needs the {' and the '.join(unknown)}" if unknown else ""


def _check_controller(scenario):
    """Raise a ValueError for a controller that is not the RHC as it is."""
    for name, exported in _EXPORTED_VALUES.items():
        value = getattr(scenario, name)
        if value != exported:
            raise ValueError(f"{name} was {value!r}; to export, it should be {exported!r}")


def check_folder(folder):
    """Raise a ValueError for a folder with other files."""
    reason = None
    if folder.exists() and not folder.is_dir():
        reason = "is a file"
    elif folder.exists() and not (folder / _MARK).exists() and _has_other_files(folder):
        reason = "contains other files"
    if reason:
        raise ValueError(
            f"folder was {str(folder)!r}, which {reason}; it should be a new or empty folder or an "
            "earlier export"
        )


def _has_other_files(folder):
    # The root of a file system may have a folder for what its repair finds.
    names = {file.name for file in folder.iterdir()} - {"lost+found"}
    return any(not name.startswith(UNFINISHED) for name in names)


def _refuse_folders(folder, names):
    """Refuse, before anything is replaced, a folder in which a file's name is that of a folder."""
    for name in names:
        if (folder / name).is_dir():
            raise ValueError(f"folder was {str(folder)!r}, in which {name} is a folder, not a file")


def _as_json(scenario):
    """All parameters of the scenario as JSON."""

    def plain(value):
        if dataclasses.is_dataclass(value):
            return {field.name: getattr(value, field.name) for field in dataclasses.fields(value)}
        if isinstance(value, np.ndarray):
            return value.tolist()
        return value.serialize() if isinstance(value, ca.Function) else str(value)

    return json.dumps(plain(scenario), default=plain, indent=1) + "\n"
