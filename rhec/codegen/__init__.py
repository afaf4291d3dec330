"""The robot's own computer: the RHEC of a scenario as self-contained C99 (`make embedded`).

`phases` says which CasADi Functions it is made of, `writing` writes what depends on the scenario,
the folder `c` holds what does not; `machines` compiles and runs an export, here or, emulated, on
64-bit Arm, `instructions` counts what it executes there, `report` puts that into tables.
"""

import dataclasses
import json
import os
import tempfile
from pathlib import Path

import casadi as ca
import numpy as np

from rhec.codegen import c_writer, phases
from rhec.scenario import Scenario
from rhec.simulation import simulate

FOLDER = Path(__file__).resolve().parents[2] / "build" / "embedded"
WRITTEN_BY_HAND = sorted((Path(__file__).parent / "c").iterdir())
PLAIN = (
    "SXFunction",
    "MXFunction",
    "Switch",
    "Map",
    "MapSum",
)  # kinds of Functions of which CasADi makes C that needs nothing
MARK = "rhec_memory.h"  # a folder that holds it is an export
LOG_S = 60.0  # length of the log for the example, at most
LOG = [
    "x_meas_m",
    "y_meas_m",
    "nu_meas_mps",
    "omega_meas_radps",
    "x_hat_m",
    "y_hat_m",
    "theta_hat_rad",
    "nu_hat_mps",
    "mu_hat",
    "kappa_hat",
    "omega_cmd_radps",
]


def export(scenario, folder=FOLDER):
    """Write the RHEC of a rhec.Scenario as C99 into `folder`: new, empty, or an earlier export,
    whose files are replaced. Returns its Path.

    What the folder's README.txt says comes with it: a header, a CMake file, programs that replay a
    log, take times and fuzz, and a log to replay. The estimator must be one that a robot can run,
    "rhe", "ekf", "dual" or a Function of one's own; the RHC's QP must be solved without a library.
    """
    folder = Path(folder)
    check(scenario, folder)
    made = phases.export(scenario)
    log = simulate(dataclasses.replace(scenario, duration_s=min(scenario.duration_s, LOG_S))).log[
        LOG
    ]
    texts = (
        {MARK: c_writer.memory_header(made, scenario.estimation_horizon)}
        | {path.name: path.read_text(encoding="utf-8") for path in WRITTEN_BY_HAND}
        | {
            "rhec_phases.h": c_writer.phases_header(made),
            "rhec_functions.h": c_writer.functions_header(made),
            "rhec_scenario.c": c_writer.scenario_source(made),
            "scenario.json": describe(scenario),
            "log.csv": log.to_csv(index=False),
            "README.txt": c_writer.readme(made, log),
        }
    )

    folder.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(
        dir=folder.parent, prefix=".unfinished-"
    ) as unfinished:  # all is written before anything is replaced
        for name, text in texts.items():
            Path(unfinished, name).write_text(text, encoding="utf-8")
        for name in texts:
            os.replace(Path(unfinished, name), folder / name)
    return folder


def check(scenario, folder):
    """Refuse, in one sentence, what cannot be exported, and a folder that holds something else."""
    if not isinstance(scenario, Scenario):
        raise ValueError(f"scenario was {scenario!r}; it should be a rhec.Scenario")
    if isinstance(scenario.estimator, str) and "oracle" in scenario.estimator:
        raise ValueError(
            f"estimator was {scenario.estimator!r}, which knows the truth; to export, it should be 'rhe', 'ekf', 'dual' or a Function of your own"
        )
    if isinstance(scenario.estimator, ca.Function):
        for called in scenario.estimator.find_functions():
            if called.class_name() not in PLAIN:
                raise ValueError(
                    f"estimator was {scenario.estimator!r}, which calls {called.name()!r} ({called.class_name()}); to export, it should be "
                    "made of expressions alone"
                )
    if scenario.qp != "structured":
        raise ValueError(
            f"qp was {scenario.qp!r}, which needs a library; to export, it should be 'structured'"
        )
    if folder.exists() and not folder.is_dir():
        raise ValueError(
            f"folder was {str(folder)!r}, which is a file; it should be a new or empty folder or an earlier export"
        )
    if folder.exists() and any(folder.iterdir()) and not (folder / MARK).exists():
        raise ValueError(
            f"folder was {str(folder)!r}, which holds other files; it should be a new or empty folder or an earlier export"
        )


def describe(scenario):
    """Every field of the scenario, as JSON."""

    def plain(value):
        if dataclasses.is_dataclass(value):
            return {field.name: getattr(value, field.name) for field in dataclasses.fields(value)}
        if isinstance(value, np.ndarray):
            return value.tolist()
        return value.serialize() if isinstance(value, ca.Function) else str(value)

    return json.dumps(plain(scenario), default=plain, indent=1) + "\n"
