"""The command `rhec`: the functions of the package from a shell.

Its options are made of signatures and docstrings, and of the parameters of a Scenario, so each text
stands once. A mistake in an argument gives one sentence and exit code 2, a failure of the system
one sentence and 1, Ctrl-C one line and 130; `rhec log` returns 1 for a log that is refused, and
with --check where it found something.
"""

import contextlib
import functools
import inspect
import io
import itertools
import json
import os
import shlex
import sys
import tempfile
import warnings
from collections.abc import Sequence
from contextvars import copy_context
from pathlib import Path
from typing import Annotated, Any, Literal, get_args, get_origin

import docstring_parser
import numpy as np
from cyclopts import App, CycloptsError, Group, Parameter

import rhec
from rhec.files import replacing

__all__ = ["main"]

_ABOUT = (
    "Receding horizon estimation and control of a tracked field robot with unknown traction, and "
    "of any robot."
)
_PROJECT = Path(__file__).resolve().parents[1]
# Parameters of a Scenario whose values are objects, which a shell cannot write.
_OBJECTS = ("terrain", "path", "faults", "controller")
_ROBOT = Group("the robot", sort_key=1)
# What commands of an earlier version are called now.
_NOW = {
    "doctor": "rhec log FILE --check",
    "calibrate": "rhec log FILE --calibrate",
    "replay": "rhec log FILE --output FOLDER",
}
# The metrics with printed means.
_PRINTED = ["settling_time_s", "mean_error_m", "mean_error_true_m", "violations", "violations_true"]
_INSTALL_COMPLETION = "--install-completion"
_Flag = Annotated[bool, Parameter(negative=(), show_default=False)]
_Json = Annotated[_Flag, Parameter("--json")]
_World = Annotated[str, Parameter(choices=tuple(rhec.WORLDS))]


def main(words: Sequence[str] | None = None) -> int:
    """Run the command line.

    Args:
        words: Its words after `rhec`; those of the process, by default.

    Returns:
        The exit code.
    """
    words = sys.argv[1:] if words is None else list(words)
    if isinstance(sys.stdout, io.TextIOWrapper):
        sys.stdout.reconfigure(errors="replace")  # its encoding may lack letters of the help
    if words and words[0] in _NOW:
        return _said(f"{words[0]} is no command; it is now {_NOW[words[0]]}", 2)
    with warnings.catch_warnings():
        # A warning is a sentence for the user, who has no use for its place in the source.
        warnings.simplefilter("ignore", RuntimeWarning)  # of NumPy about numbers that are missing
        warnings.showwarning = lambda message, *_: print(f"warning: {message}", file=sys.stderr)
        try:
            # How a command words its messages ends with it.
            return copy_context().run(_app(words), words) or 0
        except CycloptsError as error:
            command = [each.__name__ for each in _COMMANDS if each.__name__ in words[:1]]
            return _said(f"{error} See: {' '.join(('rhec', *command, '--help'))}", 2)
        except ValueError as error:
            return _said(error, 2)
        except BrokenPipeError:
            # What reads the output has ended, as in `rhec … | head`; nothing more can be printed.
            os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
            return 0
        except (ImportError, OSError, RuntimeError) as error:
            return _said(error, 1)
        except MemoryError as error:
            return _said(f"there was not enough memory {error}".rstrip(), 1)
        except KeyboardInterrupt as error:
            return _said(error.args[0] if error.args else "interrupted", 130)


def _said(error, code):
    print(f"rhec: {error}", file=sys.stderr)
    return code


def _app(words):
    """The App, in which the command that is named has its options.

    The options of a command import what it needs, which takes time.
    """
    app = App(
        "rhec",
        help=_ABOUT,
        version=rhec.__version__,
        help_format="plaintext",
        default_parameter=Parameter(negative_iterable=()),
        print_error=False,
        exit_on_error=False,
        suppress_keyboard_interrupt=False,
        result_action="return_value",
    )
    for place, (command, options_of) in enumerate(_COMMANDS.items()):
        is_needed = command.__name__ in words[:1] or _INSTALL_COMPLETION in words
        app.command(_with(command, options_of()) if is_needed else command, sort_key=place)
    app.register_install_completion_command(_INSTALL_COMPLETION)
    return app


# Options that are made of functions and of Scenario


def _with(command, options):
    """The command with options in the place of its `**given`."""
    own = inspect.signature(command)
    named = [each for each in own.parameters.values() if each.kind is not each.VAR_KEYWORD]

    @functools.wraps(command)
    def run(*arguments, **given):
        return command(*arguments, **given)

    run.__signature__ = own.replace(parameters=[*named, *options])
    return run


def _keywords(function):
    """{name: parameter} of what is passed to a function by its name."""
    parameters = inspect.signature(function).parameters
    return {name: each for name, each in parameters.items() if each.kind is each.KEYWORD_ONLY}


def _options_of(function, group, skipped=(), with_defaults=True, is_shown=lambda name: True):
    """Options for what is passed to a function by its name, with the texts of its docstring.

    group: Of all options, or a function from a name to the group.
    is_shown: Whether the help has an option of this name; without, it is taken all the same.
    """
    texts = {
        each.arg_name: each.description for each in docstring_parser.parse(function.__doc__).params
    }
    options = []
    for name, each in _keywords(function).items():
        if name in skipped:
            continue
        has_default = with_defaults and each.default not in (None, ())
        look = Parameter(
            help=" ".join(texts[name].split()),
            group=group(name) if callable(group) else group,
            show_default=_shown if has_default else False,
            show=is_shown(name),
            choices=_choices_of(each.annotation),
            show_choices=False,  # the text names them
        )
        # The function itself checks the values; only flags have none.
        is_flag = bool in (each.annotation, *get_args(each.annotation))
        taken = Annotated[each.annotation, look] if is_flag else Annotated[Any, _VALUE, look]
        options.append(each.replace(annotation=taken))
    return options


def _choices_of(annotation):
    """The values of a choice of a few, as the words that a shell completes; else None."""
    if get_origin(annotation) is tuple:
        return None  # its words are lists
    literals = [part for part in (annotation, *get_args(annotation)) if get_origin(part) is Literal]
    return [str(value) for part in literals for value in get_args(part)] or None


def _shown(default):
    """A default as a shell takes it."""
    if isinstance(default, float):
        return f"{default:g}"
    return list(default) if isinstance(default, tuple) else default


def _value_of(_, tokens):
    """A value of the command line: JSON, or numbers with commas, or a string; a list is a tuple."""
    text = tokens[0].value
    for written in (text, f"[{text}]") if "," in text else (text,):
        try:
            value = json.loads(written)
        except (ValueError, RecursionError):
            continue
        return tuple(value) if isinstance(value, list) else value
    return text


_VALUE = Parameter(converter=_value_of, n_tokens=1, metavar="VALUE")


def _given_to(function, given):
    """{name: value} of those options that a function takes."""
    return {name: given[name] for name in _keywords(function) if name in given}


def _fields():
    """The options of a Scenario's parameters, by groups."""
    return _options_of(rhec.Scenario, _group_of, _OBJECTS)


def _group_of(field):
    """The group of options of a Scenario's parameter."""
    from rhec.simulation.scenario_fields import fields_of, groups_of

    group = fields_of(rhec.Scenario)[field].group
    return Group(group, sort_key=groups_of(rhec.Scenario).index(group) + 2)


def _is_in_code(field):
    """Whether a parameter of a Scenario changes what is exported, and not its example log alone."""
    return field in ("sensors", "track_width_m") or _group_of(field).name not in (
        "the soil",
        "the sensors",
    )


def _scenario_of(world, fields):
    """The Scenario of the given fields, in the world of this name."""
    return rhec.Scenario(**rhec.WORLDS[world] | fields)


def _refuse_output(option, file, overwrite, suffixes=()):
    """Raise a ValueError for a file that cannot be written, before any work is done."""
    if suffixes and file.suffix not in suffixes:
        raise ValueError(f"--{option} was {str(file)!r}; it should end in {' or '.join(suffixes)}")
    if not file.parent.is_dir():
        raise ValueError(f"--{option} was {str(file)!r}; there is no folder {str(file.parent)!r}")
    # Also a link that leads nowhere, and what is no file, such as a folder or a device.
    if os.path.lexists(file) and not (overwrite and file.is_file()):
        raise ValueError(f"{file} exists; give another name, or --overwrite if it is a file")


# One run, and many


def simulate(
    *,
    world: _World = "default",
    log: Path | None = None,
    plot: Path | None = None,
    as_json: _Json = False,
    overwrite: _Flag = False,
    **given: Any,
):
    """Drive one simulated field.

    For example: rhec simulate --estimator ekf --seed 3 --q 1,1,0 --plot run.png

    Args:
        world: Name of a simulated world in rhec.WORLDS, whose parameters the options below change.
        log: Write the log: .csv or .parquet.
        plot: Draw the run: .png, .pdf, .svg.
        as_json: Print the metrics as JSON.
        overwrite: Replace files of these names.
    """
    if log:
        _refuse_output("log", log, overwrite, (".csv", ".parquet"))
    if plot:
        _refuse_output("plot", plot, overwrite, (".png", ".pdf", ".svg"))
    run = rhec.simulate(_scenario_of(world, given))
    print(json.dumps(_plain(run.metrics)) if as_json else run)
    if log:
        with replacing(log) as unfinished:
            if log.suffix == ".csv":
                run.log.to_csv(unfinished, index=False)
            else:
                run.log.to_parquet(unfinished)
    if plot:
        with replacing(plot) as unfinished:
            run.plot().savefig(unfinished, format=plot.suffix[1:])


def _plain(metrics):
    """Metrics as JSON has them: Python's numbers, and null for NaN."""
    numbers = {name: np.asarray(value).item() for name, value in metrics.items()}
    return {name: None if value != value else value for name, value in numbers.items()}


def _values_by_name(_, tokens):
    """[(parameter, its values)] of each `-p NAME VALUE …`, which counts its words anew."""
    values = []
    for token in tokens:
        if token.index == 0:
            values.append((token.value, []))
        else:
            values[-1][1].append(_value_of(None, [token]))
    return values


_SWEEP = Parameter("-p", consume_multiple=True, converter=_values_by_name)
_Sweep = Annotated[list, _SWEEP, Parameter(metavar="NAME VALUE [VALUE …]")]


def campaign(
    *,
    p: _Sweep = (),
    seeds: int = 250,
    folder: Path = Path("build/campaign"),
    workers: int | None = None,
):
    """Run every combination of parameter values on many seeds.

    For example: rhec campaign -p estimator rhe ekf -p r 5 10 --seeds 20

    Args:
        p: A parameter of rhec.Scenario and its values: numbers, words or lists like [1,1,0]. By
            default both estimators with both W.
        seeds: Number of seeds, from 0.
        folder: Folder of the table campaign.parquet, and of the rows of finished runs, with which
            the same command continues.
        workers: Number of processes; by default one per core if that pays.
    """
    if seeds < 1:
        raise ValueError(f"--seeds was {seeds}; it should be at least 1")
    for name, entries in p:
        if not entries:
            raise ValueError(f"-p {name} had no value; it should have at least one")
    values = dict(p) or dict(estimator=["rhe", "ekf"], process_noise=["printed", "prediction"])
    values |= dict(seed=values.get("seed", range(seeds)))
    combinations = itertools.product(*values.values())
    scenarios = [rhec.Scenario(**dict(zip(values, combination))) for combination in combinations]
    table = rhec.campaign(scenarios, folder, workers)
    file = folder / "campaign.parquet"
    with replacing(file) as unfinished:
        table.to_parquet(unfinished)
    varied = [name for name in values if name != "seed" and name in table]
    groups = table.groupby(varied, sort=False, dropna=False) if varied else table
    if len(table):
        print(groups[_PRINTED].mean().to_string())
    errors = table.loc[table["error"] != "", "error"]
    first = f", the first with {errors.iloc[0]}" if len(errors) else ""
    print(f"{len(table)} runs, {len(errors)} failed{first}; the table is {file}")


# A recorded log


def _reading():
    """The options that say how to read a file."""
    group = Group("reading the file", sort_key=0)
    texts = dict(
        columns="Columns whose names in the file differ, such as x_m=easting.",
        topics="Topics of a bag, with the positions, the speeds, and others.",
    )
    options = _options_of(rhec.logs.read, group, skipped=texts)
    for name, text in texts.items():
        words = Parameter(help=text, group=group, consume_multiple=True, show_default=False)
        kind = Annotated[tuple[str, ...], words]
        option = inspect.Parameter(
            name, inspect.Parameter.KEYWORD_ONLY, default=(), annotation=kind
        )
        options.append(option)
    return options


def _as_option(argument, value=None):
    """An argument of a function as a shell takes it, or an entry of it, as `columns['x_m']`."""
    name, _, entry = argument.partition("[")
    words = [f"--{name.replace('_', '-')}", *([entry[1:-2]] if entry else [])]
    if isinstance(value, dict):
        words += [f"{ours}={theirs}" for ours, theirs in value.items()]
    elif isinstance(value, tuple):
        words += value
    elif value is not None and value is not True:
        words.append(str(value))
    return shlex.join(words)


def _renamed(pair):
    """Column of a recording and name in the file of a pair OURS=THEIRS."""
    from rhec.logs.column_names import KNOWN

    ours, equals, theirs = pair.partition("=")
    if not equals:
        raise ValueError(f"--columns was {pair!r}; it should be OURS=THEIRS, as x_m=easting")
    if ours not in KNOWN:
        helps = f"OURS should be one of {', '.join(KNOWN)}"
        if theirs in KNOWN:
            helps = f"write {theirs}={ours}"
        raise ValueError(f"--columns was {pair!r}; it should be OURS=THEIRS: {helps}")
    return ours, theirs


def _log_of(files, given):
    """The log of the command line."""
    columns = dict(map(_renamed, given.get("columns", ()))) or None
    path = files[0] if len(files) == 1 else list(files)
    return rhec.logs.read(path, **_given_to(rhec.logs.read, given) | dict(columns=columns))


def log(
    *files: str,
    check: _Flag = False,
    details: _Flag = False,
    as_json: _Json = False,
    output: Path | None = None,
    overwrite: _Flag = False,
    **given: Any,
):
    """Say what a recorded log tells of its robot, and whether to trust it.

    For example: rhec log drive.csv --calibrate --output drive

    Args:
        files: A .csv, .parquet or bag of a recorded robot; or several of one drive by one clock,
            such as one of the positions and one of the wheels.
        check: Only find what is wrong with the log; the exit code is 1 where something is.
        details: Print all else that is known: what was taken for what, parameters, calibration.
        as_json: Print all of it as JSON.
        output: Folder for the page, log.png, robot.yaml for ROS, tables and paths of the estimates,
            and the estimator that was judged as C in the folder C.
        overwrite: Replace files of these names.
    """
    from rhec.logs.finding import PASSED
    from rhec.logs.outputs import FILES, write_summary

    PASSED.set(_as_option)
    if not files:
        raise ValueError("rhec log had no file; it should be rhec log FILE")
    if output:
        _refuse_tables("output", output, overwrite, FILES)
        from rhec.embedded import check_folder

        check_folder(output / "C")
        _refuse_unwritable("output", output)
    recorded = _log_of(files, given)
    if check:
        diagnosis = rhec.doctor(recorded, **_given_to(rhec.doctor, given))
        print(diagnosis.to_json() if as_json else diagnosis)
        return 0 if diagnosis.ok else 1
    print(f"{len(recorded)} rows are read; judging them takes a while …", file=sys.stderr)
    summary = rhec.log(recorded, **_given_to(rhec.log, given))
    print(summary.to_json() if as_json else summary)
    if details and not as_json:
        print(f"\n{summary.details}")
    if summary.samples is None:
        return 1
    if output:
        write_summary(summary, output)
        rhec.export(summary, output / "C")
        written = ", ".join([*FILES, "C/README.txt"])
        print(f"Written: {output}/ ({written})", file=sys.stderr if as_json else sys.stdout)
    return 0


def _refuse_tables(option, folder, overwrite, files):
    """Raise a ValueError if files of these names cannot be written into this folder."""
    if folder.is_dir():
        for name in files:
            _refuse_output(option, folder / name, overwrite)
    elif os.path.lexists(folder):
        raise ValueError(f"--{option} was {str(folder)!r}, which is no folder")


def _refuse_unwritable(option, folder):
    """Raise a ValueError for a folder in which nothing can be written.

    It is made to see that, and removed again if it was not there.
    """
    missing = [each for each in (folder, *folder.parents) if not each.exists()]
    try:
        folder.mkdir(parents=True, exist_ok=True)
        tempfile.TemporaryFile(dir=folder).close()
    except OSError as error:
        raise ValueError(
            f"--{option} was {str(folder)!r}, where nothing can be written ({error.strerror}); "
            "name a folder of your own, such as drive"
        ) from None
    finally:
        for each in missing:
            with contextlib.suppress(OSError):
                each.rmdir()


# The robot, and the checkout


def export(
    folder: Path, /, *, world: _World = "default", estimator_only: _Flag = False, **given: Any
):
    """Write estimator and controller as C99; of a recorded log it is rhec log FILE --output FOLDER.

    For example: rhec export code --prediction-horizon 10

    Args:
        folder: A new or empty folder, or an earlier export.
        estimator_only: Leave out the controller and its path.
        world: Name of a simulated world in rhec.WORLDS, whose parameters the options below change.
    """
    folder = rhec.export(_scenario_of(world, given), folder, estimator_only=estimator_only)
    print(f"{folder}: its README.txt says how to go on")


def lab():
    """Open the notebooks in JupyterLab."""
    if not (_PROJECT / "notebooks").is_dir():
        raise ValueError(
            "rhec lab needs the project's notebooks, which an installed package does not have; "
            "run it in a checkout of the repository"
        )
    here = Path.cwd()
    if here != _PROJECT and (here / "notebooks/00_start.ipynb").exists():
        raise ValueError(
            f"this rhec is that of {_PROJECT}, not of the checkout {here}; delete .venv here, and "
            "let make set up one"
        )
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
        from jupyterlab.labapp import main as open_lab
    except ImportError:
        raise ImportError("JupyterLab is not installed: pip install 'rhec[lab]'") from None
    return open_lab(options)


# Each command, in the order of use, and what makes its further options.
_COMMANDS = {
    lab: list,
    log: lambda: [*_reading(), *_options_of(rhec.log, _ROBOT)],
    simulate: _fields,
    campaign: list,
    export: lambda: _options_of(rhec.Scenario, _group_of, _OBJECTS, is_shown=_is_in_code),
}
