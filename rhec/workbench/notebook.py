"""Strict parameters for notebooks, and a runner that records what a notebook used and made.

python -m rhec.workbench.notebook notebooks/03_scenario_a.ipynb -p seed 7
"""

import argparse
import contextlib
import difflib
import importlib.util
import json
import keyword
import logging
import os
import re
import reprlib
import sys
import tempfile
import time
from pathlib import Path

__all__ = ["ParameterError", "main", "parameters", "record", "run"]

ROOT = Path(__file__).resolve().parents[2]
_PLAIN_DATA = (bool, int, float, str, list, tuple, set, dict, type(None))
_CHECKED = "_parameters_checked"  # says in a notebook's namespace that its parameters were checked


class ParameterError(ValueError):
    """A notebook was given a parameter that it does not take."""


def parameters(namespace, **allowed):
    """Refuse, in one sentence, what a notebook's parameters may not be.

    Args:
        namespace: the notebook's `globals()`, right after the cell tagged `parameters`.
        **allowed: what each parameter may be: a number `(type, lowest, highest)`, a choice
            `("one", "other")`, any text but an empty one, `str`, or a list, `[(float, 0, 100)]`.

    Raises:
        ParameterError: if one is missing, is not what it may be, or is not known.
    """
    # The first time, all data found here was given as a parameter; later the notebook has its own.
    if namespace.get(_CHECKED) is not parameters:
        _refuse_unknown(namespace, allowed)
    for name, spec in allowed.items():
        if name not in namespace:
            raise ParameterError(f"{name} was not given; it must be {_wanted(spec)}")
        value = namespace[name]
        if not _fits(value, spec):
            was = f"{reprlib.repr(value)} ({type(value).__name__})"
            raise ParameterError(f"{name} was {was}; it must be {_wanted(spec)}")
    namespace[_CHECKED] = parameters


def _refuse_unknown(namespace, allowed):
    # Papermill makes a misspelt parameter a new global, next to the untouched one that was meant.
    ipython = namespace.get("get_ipython")
    known = allowed.keys() | (ipython().user_ns_hidden if ipython else ())
    for name, value in list(namespace.items()):
        private = name.startswith("_") and name != _CHECKED
        if isinstance(value, _PLAIN_DATA) and not private and name not in known:
            del namespace[name]  # so that the cells, once corrected, can be run again
            raise _no_such_parameter(name, value, allowed)


def _no_such_parameter(name, value, allowed):
    meant = " or ".join(difflib.get_close_matches(name, allowed, n=1) or allowed)
    was = f"{name} was {reprlib.repr(value)}, but there is no such parameter"
    return ParameterError(f"{was}; did you mean {meant}?" if meant else was)


def _fits(value, spec):
    if spec is str:
        return isinstance(value, str) and value != ""
    if isinstance(spec, list):
        some = isinstance(value, list | tuple) and (value or spec[-1] is ...)
        return some and all(_fits(v, spec[0]) for v in value)
    if isinstance(spec[0], type):
        kind, lowest, highest = spec
        return type(value) in {int, kind} and lowest <= value <= highest
    return type(value) in map(type, spec) and value in spec


def _wanted(spec):
    if spec is str:
        return "a text"
    if isinstance(spec, list):
        least = "any number of items" if spec[-1] is ... else "at least one item"
        return f"a list of {least}, each {_wanted(spec[0])}"
    if isinstance(spec[0], type):
        kind, lowest, highest = spec
        return f"{'an int' if kind is int else 'a number'} from {lowest} to {highest}"
    return " or ".join(map(repr, spec))


def record(listing):
    """Append to the file `listing` what this process, or a fork of it, opens in the project.

    A module counts when it is imported, which always tries to open its bytecode first, and not
    when its source is merely read, as it is to name the compiled libraries; nor does a notebook,
    read for the digest in a figure's file: make itself knows the one that runs.

    Args:
        listing: path of an existing file, which gets lines "used PATH" and "made PATH".
    """
    log = os.open(listing, os.O_WRONLY | os.O_APPEND)

    def note(event, args):
        if event == "open" and not isinstance(args[0], int):
            path = args[0]
            written = args[2] & (os.O_WRONLY | os.O_RDWR)
        elif event == "os.rename":
            path = args[1]
            written = True
        else:
            return
        path = os.path.realpath(os.fsdecode(path))
        if path.endswith((".py", ".ipynb")):
            return
        if path.endswith(".pyc") and not written:
            with contextlib.suppress(ValueError):  # bytecode without a source
                path = importlib.util.source_from_cache(path)
        if path.startswith(f"{ROOT}{os.sep}"):
            os.write(log, f"{'made' if written else 'used'} {path}\n".encode())

    sys.addaudithook(note)


def run(notebook, given, output):
    """Execute a notebook and write beside it, for make, what it used and made.

    Args:
        notebook: path of the notebook.
        given: its parameters, by name.
        output: path of the executed notebook.

    Raises:
        ParameterError: if it has no such parameter.
        PapermillExecutionError: if a cell fails; then only the files that the cells before it made
            and their list are written.
    """
    # Not imported above: every notebook imports this module, and none needs these.
    import nbformat
    import papermill
    from papermill.translators import PythonTranslator

    logging.getLogger("papermill").setLevel(logging.ERROR)  # `parameters` refuses unknown names
    # A name that the notebook itself uses (rhec) would be overwritten before it is checked.
    cells = nbformat.read(notebook, 4).cells
    tagged = (cell for cell in cells if "parameters" in cell.metadata.get("tags", ()))
    known = [each.name for cell in tagged for each in PythonTranslator.inspect(cell)]
    for name in given.keys() - known:
        raise _no_such_parameter(name, given[name], known)
    os.environ["JUPYTER_PATH"] = f"{sys.prefix}/share/jupyter"  # this interpreter's own kernel
    os.environ["RHEC_UNATTENDED"] = "1"  # its outputs are the results, not what was waited for
    this = "rhec.workbench.notebook"
    with tempfile.NamedTemporaryFile("r") as listing:
        started = time.time_ns()
        try:
            executed = papermill.execute_notebook(
                str(notebook),
                None,
                given,
                kernel_name="python3",
                language="python",
                cwd=notebook.parent,
                progress_bar={"desc": notebook.stem, "leave": False, "disable": None},
                extra_arguments=[
                    "--IPKernelApp.log_level=CRITICAL",
                    "--InlineBackend.figure_formats=retina",  # sharp in the report
                    "--InlineBackend.print_figure_kwargs={'bbox_inches': None}",  # else drawn twice
                    # Without it, a tenth of the time to draw goes into looking for garbage.
                    "--IPKernelApp.exec_lines=__import__('gc').set_threshold(50_000);"
                    f"__import__('importlib').import_module({this!r}).record({listing.name!r})",
                ],
            )
        except BaseException:
            # `make clean` has to know what was made until the interruption or failure.
            _write_rules(output, listing, started, only_if_made=True)
            raise
        _write_rules(output, listing, started)
    _write(output, nbformat.writes(executed), started)


def _write_rules(output, listing, started, only_if_made=False):
    """Write beside the output, for make, what the notebook used and made.

    Args:
        output: path of the executed notebook.
        listing: the open file that `record` wrote.
        started: when the notebook was started [ns].
        only_if_made: whether to write nothing if the notebook made nothing.
    """
    opened = [line.rstrip("\n").split(" ", 1) for line in listing]
    written = [path for verb, path in opened if verb == "made"]
    for path in written:  # by a kernel that was killed on the way
        if path.endswith(".unfinished"):
            Path(path).unlink(missing_ok=True)
    made = _in_project(written)
    if only_if_made and not made:
        return
    used = _in_project([__file__, ROOT / "rhec/__init__.py", *(path for _, path in opened)]) - made

    # All are dated to the start, so that whatever is edited during the run counts as newer.
    for path in made:
        os.utime(ROOT / path, ns=(started, started))
    output.parent.mkdir(parents=True, exist_ok=True)
    files = " ".join(sorted(used | made))
    rules = output.with_suffix(".d")
    before = rules.read_text(encoding="utf-8") if rules.exists() else ""
    before = _in_project(ROOT / file for file in re.sub("(?m)^(?!MADE).*", "", before).split())
    rule = f"{os.path.relpath(output, ROOT)}: {files}\n{files}:\n"
    # For `make clean`, which removes these and no other files.
    rule += f"MADE += {' '.join(sorted(made | before))}\n"
    _write(rules, rule, started)


def _in_project(paths):
    """Those paths that still exist, from the project's folder, without caches and build/."""
    paths = {Path(path).resolve().relative_to(ROOT) for path in paths if os.path.isfile(path)}
    return {
        str(path)
        for path in paths
        if not any(part in {"build", "__pycache__"} or part[0] == "." for part in path.parts)
    }


def _write(path, text, date):
    unfinished = path.with_name(f"{path.name}.unfinished")
    unfinished.write_text(text, encoding="utf-8")
    os.utime(unfinished, ns=(date, date))
    unfinished.replace(path)


def main():
    """Run a notebook from the command line."""
    parser = argparse.ArgumentParser(
        prog="python -m rhec.workbench.notebook",
        description="Run a notebook, such as notebooks/03_scenario_a.ipynb.",
    )
    value = "a parameter and its value: a number, a word or a list such as [1,2]"
    output = "the executed notebook, by default in build/notebooks"
    parser.add_argument("notebook", metavar="NOTEBOOK", type=Path)
    parser.add_argument(
        "-p", nargs=2, action="append", default=[], metavar=("NAME", "VALUE"), help=value
    )
    parser.add_argument("--output", type=Path, help=output)
    args = parser.parse_args()

    places = (args.notebook, ROOT / args.notebook)
    notebook = next((path.resolve() for path in places if path.is_file()), None)
    if notebook is None or notebook.suffix != ".ipynb":
        parser.exit(2, f"NOTEBOOK was {args.notebook}; it must be an existing .ipynb file\n")
    for name, _ in args.p:
        if not name.isidentifier() or keyword.iskeyword(name):
            parser.exit(2, f"NAME was {name!r}; it must be a name as in Python, such as seed\n")
    given = {name: _value(text) for name, text in args.p}
    output = args.output or _output(notebook, given)

    started = time.monotonic()
    try:
        # takes a second, in which a person may change their mind
        from papermill.exceptions import PapermillExecutionError

        run(notebook, given, output)
    except KeyboardInterrupt:
        # Else the kernel's client reports, on several lines, that it was interrupted.
        logging.getLogger("asyncio").setLevel(logging.CRITICAL)
        parser.exit(130, f"{notebook.stem}: interrupted, and nothing half-made left behind\n")
    except ParameterError as error:
        parser.exit(2, f"{error}\n")
    except OSError as error:  # a folder that cannot be written to, a full disk
        parser.exit(1, f"{notebook.stem}: {error}\n")
    except PapermillExecutionError as error:
        if error.ename in (ParameterError.__name__, ValueError.__name__ if args.p else None):
            parser.exit(2, f"{error.evalue}\n")
        parser.exit(1, str(error))
    seconds = time.monotonic() - started
    scores = output.with_name("scores.txt")
    if "log" in given and scores.exists():
        print(scores.read_text(encoding="utf-8"), end="")
    print(f"{notebook.stem}: done in {seconds:.0f} s, see {os.path.relpath(output)}")


def _output(notebook, given):
    """Where the executed notebook goes: beside the pictures of a log of one's own."""
    if isinstance(given.get("log"), str):
        from rhec.workbench.plots.replay import replay_folder  # takes a second

        folder = replay_folder(ROOT / given["log"])
        if folder.is_relative_to(ROOT / "build"):
            return folder / notebook.name
    stem = f"{notebook.stem}-custom" if given else notebook.stem
    return ROOT / f"build/notebooks/{stem}.ipynb"


def _value(text):
    try:
        return json.loads(text)
    except (ValueError, RecursionError):
        return text


if __name__ == "__main__":
    # Half a second of threads that only wait for one another; the kernel inherits it.
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    # Papermill would first load, for 1.7 s, what addresses, durations and Hadoop need.
    for unused in ("rfc3987_syntax", "isoduration", "pyarrow"):
        sys.modules.setdefault(unused, None)
    main()
