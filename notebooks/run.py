"""Strict parameters for notebooks, and a runner on top of papermill.

python -m notebooks.run notebooks/03_scenario_a.ipynb -p seed 7
python -m notebooks.run notebooks/03_scenario_a.ipynb --help
"""

import argparse
import ast
import contextlib
import difflib
import errno
import html
import json
import logging
import os
import reprlib
import sys
import threading
import time
from pathlib import Path
from typing import Annotated, get_type_hints

from notebooks import captions
from notebooks.declared import DEFAULTS, ROOT, declarations
from rhec import style
from rhec.files import replacing

ROWS = ROOT / "build/campaign/notebooks"  # finished runs, which notebooks share
_PLAIN_DATA = (bool, int, float, str, list, tuple, set, dict, type(None))
_CHECKED = "_parameters_checked"  # in a notebook's namespace once its parameters were checked
# Dots per inch of a figure: a column of the paper, 3.4 in, is 900 pixels wide.
_DPI = 265
_TELL_S = 30  # a notebook that runs says so often where it is
_STARTS = 3  # of a kernel, before it is given up


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
    """Check a notebook's parameters, and make its figures large.

    The cell tagged `parameters` declares each of them as `name: type = default  # [unit] meaning`.
    The type is `int`, `float`, `bool`, `str`, `whole(1, 9)`, `real(0, 1)`, a `Literal` or a
    `list[...]`. Of a parameter named like one of `rhec.Scenario`, a plain type means the
    values that it takes there.

    Args:
        namespace: The notebook's `globals()`, right after that cell.

    Raises:
        ParameterError: If a parameter is unknown or invalid; the message is one sentence.
    """
    from rhec.core._casadi.validation import validated

    types = {}
    for source in namespace["In"]:
        for name, annotation, *_ in declarations(source):
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
    _tell_changed(namespace)
    if "get_ipython" in namespace:
        from matplotlib_inline.backend_inline import set_matplotlib_formats

        # With tight boxes it would draw each figure twice.
        set_matplotlib_formats("png", dpi=_DPI, bbox_inches=None)


def _tell_changed(namespace):
    """Let figures and tables of changed parameters go into a folder of their own."""
    notebook, own = _own_parameters(namespace["In"])
    changed = {}
    for name, default in own.items():
        value = namespace.get(name, default)
        value = list(value) if isinstance(value, tuple) else value
        if value != default:
            changed[name] = value
    folder = style.set_changed(notebook, changed)
    if changed:
        given = ", ".join(f"{name} = {value}" for name, value in changed.items())
        # No page of a site should show where its checkout stands.
        shown = folder.relative_to(ROOT) if folder.is_relative_to(ROOT) else folder
        print(f"With {given}: figures and tables go to {shown}")


def _own_parameters(sources):
    """The name of the notebook that runs, and {name: value} of its own parameters.

    They are those of DEFAULTS, since a cell may have been edited before it ran. A notebook is known
    by what it declares, because only JupyterLab tells its name.
    """
    declared = [each for source in sources for each in declarations(source)]
    wanted = {f"{name}: {annotation}" for name, annotation, *_ in declared}
    name = Path(style.running_notebook() or "notebook").stem
    for notebook, defaults in json.loads(DEFAULTS.read_text(encoding="utf-8")).items():
        if {*defaults} == wanted or notebook == name:
            return notebook, {key.split(":")[0]: value for key, value in defaults.items()}
    values = {}  # of another notebook, as they stand in its cells
    for parameter, _, value, _ in declared:
        with contextlib.suppress(ValueError):  # it is computed
            values[parameter] = ast.literal_eval(value)
    return name, values


def _strict(name, annotation):
    """The type that pydantic checks for a parameter with this annotation."""
    from rhec.core._casadi import validation
    from rhec.simulation.scenario import Scenario

    plain = {int: validation.Whole, float: validation.Real, bool: validation.Flag, str: str}
    if annotation not in plain:
        return annotation
    return get_type_hints(Scenario, include_extras=True).get(name, plain[annotation])


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


def run(notebook, values, output):
    """Execute a notebook; its output is written whole or not at all.

    Args:
        notebook: Path of the notebook.
        values: {name: value} of its parameters. With any, its figures and tables go into a folder
            beside the output and of its name, or the one that RHEC_FIGURES names; else into
            figures/.
        output: Path of the executed notebook.

    Raises:
        ParameterError: If it has no such parameter.
        PapermillExecutionError: If a cell fails.
        RuntimeError: If its kernel dies.
    """
    import nbformat  # not imported above: every notebook imports this module, and none needs it

    from notebooks.parameter_table import parameters_of

    # A name that the notebook itself uses (rhec) would be overwritten before it is checked.
    declared = [parameter.name for parameter in parameters_of(notebook)]
    for name in values.keys() - declared:
        raise _no_such_parameter(name, values[name], declared)
    logging.getLogger("papermill").setLevel(logging.ERROR)  # `parameters` refuses unknown names
    logging.getLogger("asyncio").setLevel(logging.CRITICAL)  # a kernel that dies by Ctrl-C
    output.parent.mkdir(parents=True, exist_ok=True)
    started_ns = time.time_ns()
    with _environment(notebook, values, output), _telling(notebook.stem) as on_cell_start:
        executed = _executed(notebook, values, on_cell_start)
    _describe_pictures(executed)
    with replacing(output) as unfinished:
        unfinished.write(f"{nbformat.writes(executed)}\n".encode())
    # For make, what is edited during the run is newer than its output.
    os.utime(output, ns=(started_ns, started_ns))


def _executed(notebook, values, on_cell_start):
    """The executed notebook; `on_cell_start` is called with each cell and its place before it runs.

    A kernel is told its ports before it takes them. If another program takes one of them first, the
    kernel dies before the first cell, and another kernel is started.
    """
    import papermill

    begun = False

    def on_start(cell, cell_index):
        nonlocal begun
        begun = True
        on_cell_start(cell, cell_index)

    for starts_left in reversed(range(_STARTS)):
        try:
            return papermill.execute_notebook(
                str(notebook),
                None,
                values,
                kernel_name="python3",
                language="python",
                cwd=notebook.parent,
                progress_bar=False,
                on_cell_start=on_start,
                extra_arguments=[
                    "--IPKernelApp.log_level=CRITICAL",
                    # Without it, a tenth of the time to draw goes into looking for garbage.
                    "--IPKernelApp.exec_lines=__import__('gc').set_threshold(50_000)",
                ],
            )
        except RuntimeError:
            if begun or not starts_left:
                raise
            print(f"{notebook.stem}: its kernel did not start, so another one does", flush=True)


def _describe_pictures(notebook):
    """Give the pictures of an executed notebook the captions above them as alternative texts.

    A cell that shows several may describe each of them itself.
    """
    for cell, caption in captions.with_captions(notebook):
        for output in cell.outputs:
            png = output.get("data", {}).get("image/png")
            if png:
                picture = output.metadata.setdefault("image/png", {})
                alt = picture.setdefault("alt", captions.alternative_text(caption))
                # JupyterLab and nbconvert show no `alt` of a PNG; both prefer HTML to it.
                output.data["text/html"] = (
                    f'<img alt="{html.escape(alt)}" style="max-width: 100%" '
                    f'src="data:image/png;base64,{"".join(png.split())}">'
                )


@contextlib.contextmanager
def _telling(name):
    """A context in which a notebook says every half minute below which heading it is.

    Its value is what nbclient calls with each cell before it runs.
    """
    started_s = time.monotonic()
    heading = ""
    ended = threading.Event()

    def on_cell_start(cell, cell_index):
        nonlocal heading
        if cell.cell_type == "markdown":
            titles = [line for line in cell.source.splitlines() if line.startswith("#")]
            heading = titles[-1].lstrip("# ") if titles else heading

    def tell():
        while not ended.wait(_TELL_S):
            print(f"{name}: {time.monotonic() - started_s:.0f} s, at “{heading}”", flush=True)

    telling = threading.Thread(target=tell, daemon=True)
    telling.start()
    try:
        yield on_cell_start
    finally:
        ended.set()
        telling.join()


@contextlib.contextmanager
def _environment(notebook, values, output):
    """A context with the environment that a notebook's kernel inherits; see `run`."""
    before = dict(os.environ)
    # A linked or copied .venv finds the package of the checkout that it was made in.
    paths = [str(ROOT), *filter(None, [os.environ.get("PYTHONPATH")])]
    os.environ["PYTHONPATH"] = os.pathsep.join(paths)
    os.environ["JUPYTER_PATH"] = f"{sys.prefix}/share/jupyter"  # this interpreter's own kernel
    os.environ["RHEC_NOTEBOOK"] = notebook.name  # for the figures' and tables' files
    os.environ["RHEC_UNATTENDED"] = "1"  # its outputs hold results, and no progress
    if values:
        os.environ.setdefault("RHEC_FIGURES", str(output.with_suffix("")))
    elif "RHEC_FIGURES" not in os.environ:
        made = ROOT / "build/made"  # the list of these files, for `make clean`
        made.parent.mkdir(exist_ok=True)
        os.environ["RHEC_MADE"] = str(made)
    try:
        yield
    finally:
        os.environ.clear()
        os.environ.update(before)


def main():
    """Run a notebook from the command line."""
    parser, args = _arguments()
    if args.notebook is None:
        parser.print_help()
        return
    notebook = next(
        (p.resolve() for p in (args.notebook, ROOT / args.notebook) if p.is_file()), None
    )
    if notebook is None or notebook.suffix != ".ipynb":
        parser.exit(2, f"NOTEBOOK was {args.notebook}; it must be an existing .ipynb file\n")
    if args.help:
        print(_help_of(notebook, parser))
        return
    values = {name: _value(text) for name, text in args.p}
    output = args.output or _output(notebook, values)
    if output.suffix != ".ipynb":
        parser.exit(2, f"--output was {output}; it must be a file's name that ends with .ipynb\n")
    if args.if_edited and _has_cells_of(notebook, output):
        output.touch()
        return
    interrupted = f"{notebook.stem}: interrupted\n"

    started_s = time.monotonic()
    try:
        # Importing it takes a second, in which Ctrl-C may come.
        from papermill.exceptions import PapermillExecutionError

        run(notebook, values, output)
    except KeyboardInterrupt:
        parser.exit(130, interrupted)
    except ParameterError as error:
        parser.exit(2, f"{error}\n")
    # A folder that cannot be written to, a full disk; a kernel that was killed.
    except (OSError, RuntimeError) as error:
        parser.exit(1, f"{notebook.stem}: {error}\n")
    except PapermillExecutionError as error:
        # Ctrl-C reaches the kernel, too, and its cell may fail first.
        if error.ename == KeyboardInterrupt.__name__:
            parser.exit(130, interrupted)
        if error.ename in (ParameterError.__name__, ValueError.__name__ if args.p else None):
            parser.exit(2, f"{error.evalue}\n")
        if error.evalue.startswith(f"[Errno {errno.ENOSPC}]"):
            parser.exit(1, f"{notebook.stem}: {error.evalue}\n")
        parser.exit(1, str(error))
    seconds = time.monotonic() - started_s
    print(f"{notebook.stem}: done in {seconds:.0f} s, see {os.path.relpath(output)}")


def _arguments():
    """The parser and the arguments of the command line."""
    parser = argparse.ArgumentParser(
        prog="python -m notebooks.run",
        description="Run a notebook, such as notebooks/03_scenario_a.ipynb, with papermill.",
        epilog="With --help, NOTEBOOK shows its parameters.",
        add_help=False,
    )
    value = "a parameter and its value: a number, a word or a list such as [1,2]"
    output = "the executed .ipynb, by default in build/notebooks; its figures go beside it"
    edited = "only if its cells are not those of the output, as after a run in JupyterLab"
    parser.add_argument("notebook", metavar="NOTEBOOK", type=Path, nargs="?")
    parser.add_argument(
        "-p", nargs=2, action="append", default=[], metavar=("NAME", "VALUE"), help=value
    )
    parser.add_argument("--output", type=Path, help=output)
    parser.add_argument("--if-edited", action="store_true", help=edited)
    parser.add_argument("-h", "--help", action="store_true", help="show this help")
    return parser, parser.parse_args()


def _help_of(notebook, parser):
    """The help with the parameters of a notebook, and an example that sets the first of them."""
    from notebooks.parameter_table import as_text, parameters_of

    parameters = parameters_of(notebook)
    parser.epilog = None
    lines = [parser.format_help(), f"parameters of {notebook.stem}:", as_text(parameters)]
    if parameters:
        first = parameters[0]
        path = os.path.relpath(notebook)
        lines += ["", f"example: {parser.prog} {path} -p {first.name} {first.default}"]
    return "\n".join(lines)


def _has_cells_of(notebook, output):
    """Whether an executed notebook has the cells of this one, whatever either has as outputs."""
    import nbformat

    one, other = (
        [(cell.cell_type, cell.source) for cell in nbformat.read(path, 4).cells]
        for path in (notebook, output)
    )
    return one == other


def _output(notebook, values):
    """Where the executed notebook goes."""
    stem = f"{notebook.stem}-custom" if values else notebook.stem
    # Those of notebooks/further/ go into a folder of the same name, as the Makefile's rule says.
    ours = ROOT / "notebooks"
    folder = notebook.parent.relative_to(ours) if notebook.is_relative_to(ours) else ""
    return ROOT / "build/notebooks" / folder / f"{stem}.ipynb"


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
