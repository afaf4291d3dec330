"""Export: a scenario's estimator and controller as self-contained C99 (`make embedded`).

`phases` names the CasADi Functions that it is made of, `c_writer` writes the files that depend on
the scenario; the folder `c` holds those that do not. `rhec.studies.embedded` compiles and runs an
export, here or, emulated, on 64-bit Arm.
"""

import dataclasses
import json
import os
import tempfile
from pathlib import Path

import casadi as ca
import numpy as np

from rhec._casadi.validation import shown
from rhec.codegen import c_writer, phases
from rhec.columns import COMMAND, ESTIMATE, MEASUREMENTS
from rhec.scenario import Scenario
from rhec.simulation import simulate
from rhec.tracked_robot.estimators import NAMES, estimator_of

__all__ = ["FOLDER", "LOG", "export"]

FOLDER = Path(__file__).resolve().parents[2] / "build" / "embedded"
LOG = [*MEASUREMENTS, *ESTIMATE, *COMMAND]  # columns of the example log
_LOG_S = 60.0  # length of the example log, at most
_WRITTEN_BY_HAND = sorted((Path(__file__).parent / "c").iterdir())
_PLAIN = "SXFunction", "MXFunction", "Switch", "Map", "MapSum"  # their C needs no library
_EXPORTED = "nothing", "field mean"  # that estimators may be given
_MARK = "rhec_memory.h"  # a folder that holds it is an export


def export(scenario, folder=FOLDER):
    """Write a scenario's estimator and controller as self-contained C99.

    The folder gets a header, a CMake file, programs that replay a log, take times and fuzz, and an
    example log with Python's answers; its README.txt says how to call it.

    Args:
        scenario: rhec.Scenario. Its estimator must be one that a robot can run: not an oracle; a
            CasADi Function of one's own if it is made of expressions alone. Its qp must be
            "structured".
        folder: Where to write: a new or empty folder, or an earlier export, whose files are
            replaced.

    Returns:
        The folder's Path.

    Raises:
        ValueError: For a scenario that cannot be exported, or a folder that holds other files.
    """
    folder = Path(folder)
    _check(scenario, folder)
    made = phases.export(scenario)
    shorter = dataclasses.replace(scenario, duration_s=min(scenario.duration_s, _LOG_S))
    log = simulate(shorter).log[LOG]
    texts = {_MARK: c_writer.memory_header(made, scenario.estimation_horizon)}
    texts |= {path.name: path.read_text(encoding="utf-8") for path in _WRITTEN_BY_HAND}
    texts |= {
        "rhec_phases.h": c_writer.phases_header(made),
        "rhec_functions.h": c_writer.functions_header(made),
        "rhec_scenario.c": c_writer.scenario_source(made),
        "scenario.json": _as_json(scenario),
        "log.csv": log.to_csv(index=False),
        "README.txt": c_writer.readme(made, log),
    }

    folder.mkdir(parents=True, exist_ok=True)
    # All is written before anything is replaced.
    with tempfile.TemporaryDirectory(dir=folder.parent, prefix=".unfinished-") as unfinished:
        for name, text in texts.items():
            Path(unfinished, name).write_text(text, encoding="utf-8")
        for name in texts:
            os.replace(Path(unfinished, name), folder / name)
    return folder


def _check(scenario, folder):
    """Refuse, in one sentence, a scenario that cannot be exported and a folder with other files."""
    if not isinstance(scenario, Scenario):
        raise ValueError(f"scenario was {shown(scenario)}; it should be a rhec.Scenario")
    estimator = scenario.estimator
    given = estimator_of(estimator, scenario.robust).given
    if given not in _EXPORTED:
        names = [repr(name) for name in NAMES if estimator_of(name).given in _EXPORTED]
        raise ValueError(
            f"estimator was {estimator!r}, which is given the {given}; to export, it should be one "
            f"of {', '.join(names)} or a Function of your own"
        )
    if isinstance(estimator, ca.Function):
        for called in estimator.find_functions():
            if called.class_name() not in _PLAIN:
                raise ValueError(
                    f"estimator was {shown(estimator)}, which calls {called.name()!r} "
                    f"({called.class_name()}); to export, it should be made of expressions alone"
                )
    if scenario.qp != "structured":
        raise ValueError(
            f"qp was {scenario.qp!r}, which needs a library; to export, it should be 'structured'"
        )
    reason = None
    if folder.exists() and not folder.is_dir():
        reason = "is a file"
    elif folder.exists() and any(folder.iterdir()) and not (folder / _MARK).exists():
        reason = "holds other files"
    if reason:
        raise ValueError(
            f"folder was {str(folder)!r}, which {reason}; it should be a new or empty folder or an "
            "earlier export"
        )


def _as_json(scenario):
    """Every field of the scenario, as JSON."""

    def plain(value):
        if dataclasses.is_dataclass(value):
            return {field.name: getattr(value, field.name) for field in dataclasses.fields(value)}
        if isinstance(value, np.ndarray):
            return value.tolist()
        return value.serialize() if isinstance(value, ca.Function) else str(value)

    return json.dumps(plain(scenario), default=plain, indent=1) + "\n"
