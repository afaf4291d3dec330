"""The commands of `rhec`: for each its options and what it does."""

import importlib.util
import json
import os
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import numpy as np

from rhec.workbench.command_line import campaign_table
from rhec.workbench.command_line.options import add_keywords, add_scenario, keywords, scenario_of

__all__ = ["COMMANDS", "Command"]

_PROJECT = Path(__file__).resolve().parents[3]


class Command(NamedTuple):
    """One command.

    Attributes:
        text: What it does, one sentence.
        usage: What follows its name.
        add_options: Adds its options to an argparse.ArgumentParser.
        run: Runs it with the parsed options; returns an exit code, or None for 0.
    """

    text: str
    usage: str
    add_options: Callable
    run: Callable


def _refuse_existing(files, overwrite):
    """Raise a ValueError for files that are there already, before any work is done."""
    there = [str(file) for file in files if Path(file).exists()]
    if there and not overwrite:
        raise ValueError(f"{', '.join(there)} exists; give another name, or --overwrite")


def _add_overwrite(parser):
    parser.add_argument("--overwrite", action="store_true", help="replace files of these names")


# One run


def _simulate_options(parser):
    _add_world(parser)
    parser.add_argument("--log", type=Path, metavar="FILE", help="write the log: .csv or .parquet")
    parser.add_argument("--plot", type=Path, metavar="FILE", help="draw the run: .png, .pdf, .svg")
    parser.add_argument("--json", action="store_true", help="print the metrics as JSON")
    _add_overwrite(parser)
    add_scenario(parser)


def _add_world(parser):
    text = "name of a simulated world in rhec.WORLDS, whose fields the options below change"
    parser.add_argument("--world", default="default", help=text)


def _simulate(given):
    import rhec

    files = [file for file in (given.log, given.plot) if file]
    _refuse_existing(files, given.overwrite)
    if given.log and given.log.suffix not in (".csv", ".parquet"):
        raise ValueError(f"--log was {str(given.log)!r}; it should end in .csv or .parquet")
    run = rhec.simulate(scenario_of(given))
    print(json.dumps(_plain(run.metrics)) if given.json else run)
    if given.log and given.log.suffix == ".csv":
        run.log.to_csv(given.log, index=False)
    elif given.log:
        run.log.to_parquet(given.log)
    if given.plot:
        run.plot().savefig(given.plot)


def _plain(metrics):
    """Metrics as JSON has them: Python's numbers, and null for NaN."""
    numbers = {name: np.asarray(value).item() for name, value in metrics.items()}
    return {name: None if value != value else value for name, value in numbers.items()}


# A recorded log


def _log_options(parser):
    """The file of a log and the options that say how to read it."""
    from rhec.logs.reader import read

    parser.add_argument("file", help="a .csv, .parquet or bag of a recorded robot")
    reading = parser.add_argument_group("reading the file")
    columns = "columns whose names in the file differ, such as x_m=easting"
    reading.add_argument("--columns", nargs="+", default=(), metavar="OURS=THEIRS", help=columns)
    topics = "topics of a bag, with the positions, the speeds, and others"
    reading.add_argument("--topics", nargs="+", default=(), metavar="TOPIC", help=topics)
    add_keywords(reading, read, skipped=("columns", "topics"))


def _read(given):
    """The log of the command line; what the reader found in it is printed."""
    from rhec.logs.reader import found_lines, read

    wrong = [pair for pair in given.columns if "=" not in pair]
    if wrong:
        raise ValueError(f"--columns was {wrong[0]!r}; it should be OURS=THEIRS, as x_m=easting")
    columns = dict(pair.split("=", 1) for pair in given.columns)
    others = keywords(given, read, skipped=("columns", "topics"))
    topics = tuple(given.topics) or None
    log = read(given.file, columns=columns or None, topics=topics, **others)
    # Not to the standard output, which --json keeps for programs.
    print(*found_lines(log), sep="\n", file=sys.stderr)
    return log


def _replay_options(parser):
    from rhec.logs.replay import ESTIMATOR_FIELDS, replay

    _log_options(parser)
    parser.add_argument(
        "--folder", type=Path, help="of the tables (default: NAME-replay, of a file NAME.csv)"
    )
    calibrated = "first run rhec.calibrate on the log, and take what it finds"
    parser.add_argument("--calibrated", action="store_true", help=calibrated)
    _add_overwrite(parser)
    parser.add_argument("--estimator", help='"rhe" (default), "ekf", …: see help(rhec.replay)')
    add_keywords(parser.add_argument_group("the replay"), replay, skipped=("model",))
    add_scenario(parser, names=ESTIMATOR_FIELDS)


def _replay(given):
    from rhec.logs.calibration import calibrate
    from rhec.logs.outputs import FILES, write_estimates
    from rhec.logs.replay import ESTIMATOR_FIELDS, replay

    folder = given.folder or Path(f"{Path(given.file).stem}-replay")
    _refuse_existing([folder / name for name in FILES], given.overwrite)
    arguments = keywords(given, replay)
    arguments |= {name: value for name, value in vars(given).items() if name in ESTIMATOR_FIELDS}
    log = _read(given)
    if given.calibrated:
        of_log = keywords(given, calibrate)
        arguments = dict(calibrate(log, **of_log)) | arguments
    estimates = replay(log, given.estimator or "rhe", **arguments)
    write_estimates(estimates, folder)
    print(*estimates.attrs["remarks"], sep="\n")
    print(f"{len(estimates)} estimates in {folder}")


def _calibrate_options(parser):
    from rhec.logs.calibration import calibrate

    _log_options(parser)
    parser.add_argument("--yaml", type=Path, metavar="FILE", help="write what ROS takes")
    parser.add_argument("--json", action="store_true", help="print arguments of rhec.replay only")
    _add_overwrite(parser)
    robot = parser.add_argument_group("the robot")
    add_keywords(robot, calibrate, skipped=("model", "delays_s"))


def _calibrate(given):
    from rhec.logs.calibration import calibrate

    _refuse_existing([given.yaml] if given.yaml else [], given.overwrite)
    found = calibrate(_read(given), **keywords(given, calibrate))
    print(json.dumps(dict(found)) if given.json else found)
    print(*found.remarks, sep="\n", end="\n" if found.remarks else "", file=sys.stderr)
    if given.yaml:
        given.yaml.write_text(found.yaml, encoding="utf-8")


def _doctor_options(parser):
    from rhec.logs.doctor import doctor

    _log_options(parser)
    parser.add_argument("--json", action="store_true", help="print the findings as JSON")
    add_keywords(parser.add_argument_group("the robot"), doctor)


def _doctor(given):
    from rhec.logs.doctor import doctor

    diagnosis = doctor(_read(given), **keywords(given, doctor))
    print(diagnosis.to_json() if given.json else diagnosis)
    return 0 if diagnosis.ok else 1


# The paper, and the robot


def _claim_options(parser):
    from rhec.workbench.studies.claims import one

    parser.add_argument("id", help="of the claim, for example I2")
    text = f"simulated fields, at least 2 (default: {one.FIELDS})"
    parser.add_argument("--fields", type=int, default=one.FIELDS, help=text)


def _claim(given):
    from rhec.workbench.studies.claims import one

    if given.fields < 2:
        raise ValueError(f"--fields was {given.fields}; it should be 2 or more")
    print("\n".join(one.report_lines(given.id, given.fields)))


def _export_options(parser):
    parser.add_argument("folder", type=Path, help="a new or empty folder, or an earlier export")
    text = "write a ROS 2 package (ament) with a node around the C; its README.md says more"
    parser.add_argument("--ros2", action="store_true", help=text)
    _add_world(parser)
    add_scenario(parser)


def _export(given):
    from rhec.embedded import export

    folder = export(scenario_of(given), given.folder, ros2=given.ros2)
    print(f"{folder}: its README.{'md' if given.ros2 else 'txt'} says how to go on")


# The checkout


def _refuse_without_checkout(command):
    """Raise a ValueError where the notebooks are not there, as in an installed wheel."""
    if not (_PROJECT / "notebooks").is_dir():
        raise ValueError(
            f"rhec {command} needs the project's notebooks, which an installed package does not "
            "have; run it in a checkout of the repository"
        )


def _lab(_):
    _refuse_without_checkout("lab")
    # No news, no updates, no extensions from the network. What it logs are errors and its address,
    # which one opens where there is no display.
    options = [
        "--Application.log_level=ERROR",
        "--LabApp.default_url=/lab/tree/notebooks/00_start.ipynb",
        "--LabApp.extension_manager=readonly",
        "--LabApp.news_url=None",
        "--LabApp.check_for_updates_class=jupyterlab.NeverCheckForUpdate",
    ]
    has_display = sys.platform in ("darwin", "win32") or {"DISPLAY", "WAYLAND_DISPLAY"} & {
        *os.environ
    }
    options += [] if has_display else ["--no-browser"]
    is_root = hasattr(os, "getuid") and os.getuid() == 0
    options += ["--allow-root"] if is_root else []
    folders = [str(_PROJECT / ".jupyter"), os.environ.get("JUPYTER_CONFIG_PATH", "")]
    os.environ["JUPYTER_CONFIG_PATH"] = os.pathsep.join(folders)
    os.chdir(_PROJECT)
    try:
        from jupyterlab.labapp import main
    except ImportError:
        raise ImportError("JupyterLab is not installed: pip install 'rhec[lab]'") from None
    return main(options)


def _report(_):
    """Run the notebooks that have not been run yet, one by one, then build the site."""
    _refuse_without_checkout("report")
    executed = []
    for notebook in sorted((_PROJECT / "notebooks").glob("[0-9]*.ipynb")):
        executed.append(_PROJECT / "build/notebooks" / notebook.name)
        if not executed[-1].exists():
            _run_module("rhec.workbench.notebook", notebook)
    _run_module("rhec.workbench.results")
    live = ["--live"] if importlib.util.find_spec("ziglang") else []
    _run_module("rhec.workbench.report", *executed, *live)
    _run_module("rhec.workbench.live.page")


def _run_module(name, *words):
    """Run a module of the project as a program; raise a RuntimeError if it fails."""
    if subprocess.run([sys.executable, "-m", name, *map(str, words)], cwd=_PROJECT).returncode:
        raise RuntimeError(f"{name} failed: see above")


def _no_options(_):
    pass


def _completion_options(parser):
    parser.add_argument("shell", choices=("bash", "zsh"))


COMMANDS = {
    "simulate": Command(
        "Drive one simulated field.", "[--FIELD VALUE …]", _simulate_options, _simulate
    ),
    "campaign": Command(
        campaign_table.ABOUT,
        "[-p NAME VALUE [VALUE …] …] [--seeds N]",
        campaign_table.add_options,
        campaign_table.run,
    ),
    "replay": Command(
        "Run an estimator on a recorded log.", "FILE [OPTION …]", _replay_options, _replay
    ),
    "calibrate": Command(
        "Estimate noise, slip and lever arm from a recorded log.",
        "FILE [OPTION …]",
        _calibrate_options,
        _calibrate,
    ),
    "doctor": Command(
        "Find what is wrong with a recorded log.", "FILE [OPTION …]", _doctor_options, _doctor
    ),
    "export": Command(
        "Write estimator and controller as C99.",
        "FOLDER [--ros2] [--FIELD VALUE …]",
        _export_options,
        _export,
    ),
    "claim": Command("Judge one claim of the paper.", "ID [--fields N]", _claim_options, _claim),
    "report": Command(
        "Run the notebooks that have not been run, and build the report. `make report` runs two "
        "at a time, and again what changed.",
        "",
        _no_options,
        _report,
    ),
    "lab": Command("Open the notebooks in JupyterLab.", "", _no_options, _lab),
    "completion": Command(
        "Print the completion script of a shell.", "{bash,zsh}", _completion_options, _no_options
    ),
}
