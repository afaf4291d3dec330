"""Strict parameters for notebooks, and a runner that records what a notebook used and made.

python -m rhec.workbench.notebook notebooks/03_scenario_a.ipynb -p seed 7
"""

import argparse
import ast
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
from typing import Annotated, get_type_hints

__all__ = ["ParameterError", "main", "parameters", "real", "record", "run", "whole"]

ROOT = Path(__file__).resolve().parents[2]
_PLAIN_DATA = (bool, int, float, str, list, tuple, set, dict, type(None))
_CHECKED = "_parameters_checked"  # in a notebook's namespace once its parameters were checked
# Dots per inch of a figure in JupyterLab: a column of the paper, 3.4 in, is 900 pixels wide.
_DPI = 265


class ParameterError(ValueError):
    """A notebook was given an unknown or invalid parameter."""

    def _render_traceback_(self):
        """Lines that Jupyter shows instead of a traceback."""
        return [f"{type(self).__name__}: {self}"]


def whole(lowest, highest):
    """Annotation of a notebook's parameter that is a whole number from `lowest` to `highest`."""
    from pydantic import Field

    from rhec.core._casadi import validation

    return Annotated[validation.Whole, Field(ge=lowest, le=highest)]


def real(lowest, highest):
    """Annotation of a notebook's parameter that is a number from `lowest` to `highest`."""
    from pydantic import Field

    from rhec.core._casadi import validation

    return Annotated[validation.Real, Field(ge=lowest, le=highest)]


def parameters(namespace):
    """Check a notebook's parameters, and make its figures large in JupyterLab.

    The cell tagged `parameters` declares each of them as `name: type = default  # [unit] meaning`.
    The type is `int`, `float`, `bool`, `str`, `whole(1, 9)`, `real(0, 1)`, a `Literal` or a
    `list[...]`. Of a parameter named like a field of `rhec.Scenario`, a plain type means the
    values that the field takes.

    Args:
        namespace: The notebook's `globals()`, right after that cell.

    Raises:
        ParameterError: If a parameter is unknown or invalid; the message is one sentence.
    """
    from rhec.simulation.validated import validated

    types = {}
    for source in namespace["In"]:
        for name, annotation in _declared(source).items():
            types[name] = _strict(name, eval(annotation, namespace))
    # The first time, all plain data are parameters; later the notebook has data of its own.
    if _CHECKED not in namespace or namespace[_CHECKED] is not parameters:
        _refuse_unknown(namespace, types)
    notebook = validated(type("the notebook", (), {"__annotations__": types}))
    try:
        notebook(**{name: namespace[name] for name in types if name in namespace})
    except ValueError as error:
        raise ParameterError(str(error)) from None
    namespace[_CHECKED] = parameters
    # The report shows them at the size of the paper.
    if "get_ipython" in namespace and "RHEC_UNATTENDED" not in os.environ:
        from matplotlib_inline.backend_inline import set_matplotlib_formats

        set_matplotlib_formats("png", dpi=_DPI, bbox_inches=None)


def _declared(source):
    """{name: annotation} of the annotated assignments in a cell; {} if it is no Python."""
    try:
        nodes = ast.parse(source).body
    except SyntaxError:
        return {}
    nodes = [node for node in nodes if isinstance(node, ast.AnnAssign)]
    return {ast.unparse(node.target): ast.unparse(node.annotation) for node in nodes}


def _strict(name, annotation):
    """The type that pydantic checks for a parameter with this annotation."""
    from rhec.core._casadi import validation
    from rhec.simulation.scenario import Scenario
    from rhec.simulation.scenario_fields import FIELDS

    plain = {int: validation.Whole, float: validation.Real, bool: validation.Flag, str: str}
    if annotation not in plain:
        return annotation
    if name in FIELDS:
        return get_type_hints(Scenario, include_extras=True)[name]
    return plain[annotation]


def _refuse_unknown(namespace, types):
    # Papermill makes a misspelt parameter a new global, next to the untouched one that was meant.
    ipython = namespace.get("get_ipython")
    known = types.keys() | (ipython().user_ns_hidden if ipython else {"In"})
    for name, value in list(namespace.items()):
        private = name.startswith("_") and name != _CHECKED
        if isinstance(value, _PLAIN_DATA) and not private and name not in known:
            del namespace[name]  # so that the cells, once corrected, can be run again
            raise _no_such_parameter(name, value, types)


def _no_such_parameter(name, value, names):
    close = " or ".join(difflib.get_close_matches(name, names, n=1) or names)
    unknown = f"{name} was {reprlib.repr(value)}, but there is no such parameter"
    return ParameterError(f"{unknown}; did you mean {close}?" if close else unknown)


def record(listing):
    """Append to a file what this process, or a fork of it, opens in the project.

    A module counts when it is imported, which always tries to open its bytecode first. It does not
    count when its source is merely read, as it is to name the compiled libraries. Nor does a
    notebook, which is read for the digest in a figure's file: make knows the one that runs.

    Args:
        listing: Path of an existing file, which gets lines "used PATH" and "made PATH".
    """
    log = os.open(listing, os.O_WRONLY | os.O_APPEND)

    def note(event, args):
        if event == "open" and not isinstance(args[0], int):
            path = args[0]
            is_written = args[2] & (os.O_WRONLY | os.O_RDWR)
        elif event == "os.rename":
            path = args[1]
            is_written = True
        else:
            return
        path = os.path.realpath(os.fsdecode(path))
        if path.endswith((".py", ".ipynb")):
            return
        if path.endswith(".pyc") and not is_written:
            with contextlib.suppress(ValueError):  # bytecode without a source
                path = importlib.util.source_from_cache(path)
        if path.startswith(f"{ROOT}{os.sep}"):
            os.write(log, f"{'made' if is_written else 'used'} {path}\n".encode())

    sys.addaudithook(note)


def run(notebook, values, output):
    """Execute a notebook and write beside it, for make, what it used and made.

    Args:
        notebook: Path of the notebook.
        values: {name: value} of its parameters.
        output: Path of the executed notebook.

    Raises:
        ParameterError: If it has no such parameter.
        PapermillExecutionError: If a cell fails. Only the files that the cells before it made, and
            their list, are written then.
    """
    # Not imported above: every notebook imports this module, and none needs it.
    import nbformat

    # A name that the notebook itself uses (rhec) would be overwritten before it is checked.
    cells = nbformat.read(notebook, 4).cells
    tagged = (cell for cell in cells if "parameters" in cell.metadata.get("tags", ()))
    declared = [name for cell in tagged for name in _declared(cell.source)]
    for name in values.keys() - declared:
        raise _no_such_parameter(name, values[name], declared)
    started_ns = time.time_ns()
    with tempfile.NamedTemporaryFile("r") as listing:
        try:
            executed = _execute(notebook, values, listing.name)
        except BaseException:
            # `make clean` has to know what was made until the interruption or failure.
            _write_rules(output, listing, started_ns, only_if_made=True)
            raise
        _write_rules(output, listing, started_ns)
    _write(output, nbformat.writes(executed), started_ns)


def _execute(notebook, values, listing):
    """The executed notebook; `listing` gets what its kernel opens."""
    import papermill

    logging.getLogger("papermill").setLevel(logging.ERROR)  # `parameters` refuses unknown names
    logging.getLogger("asyncio").setLevel(logging.CRITICAL)  # a kernel that dies by Ctrl-C
    os.environ["JUPYTER_PATH"] = f"{sys.prefix}/share/jupyter"  # this interpreter's own kernel
    os.environ["RHEC_NOTEBOOK"] = notebook.name  # for the figures' and tables' files
    os.environ["RHEC_UNATTENDED"] = "1"  # its outputs hold results, and no progress
    this = "rhec.workbench.notebook"
    return papermill.execute_notebook(
        str(notebook),
        None,
        values,
        kernel_name="python3",
        language="python",
        cwd=notebook.parent,
        progress_bar={"desc": notebook.stem, "leave": False, "disable": None},
        extra_arguments=[
            "--IPKernelApp.log_level=CRITICAL",
            "--InlineBackend.figure_formats=retina",  # sharp in the report
            "--InlineBackend.print_figure_kwargs={'bbox_inches': None}",  # else it draws twice
            # Without it, a tenth of the time to draw goes into looking for garbage.
            "--IPKernelApp.exec_lines=__import__('gc').set_threshold(50_000);"
            f"__import__('importlib').import_module({this!r}).record({listing!r})",
        ],
    )


def _write_rules(output, listing, started_ns, only_if_made=False):
    """Write beside the output, for make, what the notebook used and made.

    Args:
        output: Path of the executed notebook.
        listing: The open file that `record` wrote.
        started_ns: When the notebook was started [ns].
        only_if_made: Whether to write nothing if the notebook made nothing.
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
        os.utime(ROOT / path, ns=(started_ns, started_ns))
    output.parent.mkdir(parents=True, exist_ok=True)
    rules = output.with_suffix(".d")
    _write(rules, _rules(output, rules, used, made), started_ns)


def _rules(output, rules, used, made):
    """Text for make: the files that the executed notebook depends on, and MADE.

    `make clean` removes what MADE lists and no other files: what this run made, and what earlier
    ones did.
    """
    files = " ".join(sorted(used | made))
    before = rules.read_text(encoding="utf-8") if rules.exists() else ""
    before = re.sub("(?m)^(?!MADE).*", "", before).split()
    made_ever = made | _in_project(ROOT / file for file in before)
    depends = f"{os.path.relpath(output, ROOT)}: {files}\n{files}:\n"
    return f"{depends}MADE += {' '.join(sorted(made_ever))}\n"


def _in_project(paths):
    """Those paths that still exist, from the project's folder, without caches and build/."""
    paths = {Path(path).resolve().relative_to(ROOT) for path in paths if os.path.isfile(path)}
    return {
        str(path)
        for path in paths
        if not any(part in {"build", "__pycache__"} or part[0] == "." for part in path.parts)
    }


def _write(path, text, date_ns):
    """Write a file with a date, whole or not at all."""
    unfinished = path.with_name(f"{path.name}.unfinished")
    unfinished.write_text(text, encoding="utf-8")
    os.utime(unfinished, ns=(date_ns, date_ns))
    unfinished.replace(path)


def main():
    """Run a notebook from the command line."""
    parser, args = _arguments()
    notebook = next(
        (p.resolve() for p in (args.notebook, ROOT / args.notebook) if p.is_file()), None
    )
    if notebook is None or notebook.suffix != ".ipynb":
        parser.exit(2, f"NOTEBOOK was {args.notebook}; it must be an existing .ipynb file\n")
    for name, _ in args.p:
        if not name.isidentifier() or keyword.iskeyword(name):
            parser.exit(2, f"NAME was {name!r}; it must be a name as in Python, such as seed\n")
    values = {name: _value(text) for name, text in args.p}
    output = args.output or _output(notebook, values)
    interrupted = f"{notebook.stem}: interrupted, and nothing half-made left behind\n"

    started_s = time.monotonic()
    try:
        # Importing it takes a second, in which Ctrl-C may come.
        from papermill.exceptions import PapermillExecutionError

        run(notebook, values, output)
    except KeyboardInterrupt:
        parser.exit(130, interrupted)
    except ParameterError as error:
        parser.exit(2, f"{error}\n")
    except OSError as error:  # a folder that cannot be written to, a full disk
        parser.exit(1, f"{notebook.stem}: {error}\n")
    except PapermillExecutionError as error:
        # Ctrl-C reaches the kernel, too, and its cell may fail first.
        if error.ename == KeyboardInterrupt.__name__:
            parser.exit(130, interrupted)
        if error.ename in (ParameterError.__name__, ValueError.__name__ if args.p else None):
            parser.exit(2, f"{error.evalue}\n")
        parser.exit(1, str(error))
    seconds = time.monotonic() - started_s
    scores = output.with_name("scores.txt")
    if "log" in values and scores.exists():
        print(scores.read_text(encoding="utf-8"), end="")
    print(f"{notebook.stem}: done in {seconds:.0f} s, see {os.path.relpath(output)}")


def _arguments():
    """The parser and the arguments of the command line."""
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
    return parser, parser.parse_args()


def _output(notebook, values):
    """Where the executed notebook goes: for a user's log, beside its pictures."""
    if isinstance(values.get("log"), str):
        from rhec.workbench.plots.replay import replay_folder  # importing it takes a second

        folder = replay_folder(ROOT / values["log"])
        if folder.is_relative_to(ROOT / "build"):
            return folder / notebook.name
    stem = f"{notebook.stem}-custom" if values else notebook.stem
    return ROOT / f"build/notebooks/{stem}.ipynb"


def _value(text):
    """A parameter's value: what its JSON says, or else the text itself."""
    try:
        return json.loads(text)
    except (ValueError, RecursionError):
        return text


if __name__ == "__main__":
    # With more, threads wait for one another for half a second; the kernel inherits it.
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    # Papermill would import them, which takes 1.7 s, and uses none of them here.
    for unused in ("rfc3987_syntax", "isoduration", "pyarrow"):
        sys.modules.setdefault(unused, None)
    main()
