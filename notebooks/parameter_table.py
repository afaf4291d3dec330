"""What a notebook's parameters are, by its cell tagged `parameters`.

    python -m notebooks.parameter_table

writes those of all notebooks into notebooks/defaults.json, by which a notebook that runs knows
whether it was changed.
"""

import ast
import json
import re
from typing import NamedTuple

import nbformat

from notebooks.declared import DEFAULTS, ROOT, declarations

_WORDS = {
    "bool": "True or False",
    "dict": "dict",
    "float": "number",
    "int": "whole number",
    "real": "number",
    "str": "text",
    "whole": "whole number",
}


class Parameter(NamedTuple):
    """A parameter of a notebook.

    Attributes:
        name: Its name, as after `-p`.
        type: What it may be, in words.
        unit: Its unit, "" where it has none.
        default: Its value in the notebook.
        meaning: What it is.
    """

    name: str
    type: str
    unit: str
    default: str
    meaning: str


def parameters_of(notebook):
    """The Parameters of a notebook.

    Args:
        notebook: Path of the notebook.

    Returns:
        A list of Parameters, in the order of the cells tagged `parameters`.
    """
    return [_parameter(*found) for found in _declared(notebook)]


def _declared(notebook):
    """The `declarations` in the cells tagged `parameters` of a notebook."""
    cells = nbformat.read(notebook, 4).cells
    tagged = [cell for cell in cells if "parameters" in cell.metadata.get("tags", ())]
    return [found for cell in tagged for found in declarations(cell.source)]


def _parameter(name, annotation, value, comment):
    """A Parameter; the comment begins with the unit in brackets."""
    _, unit, meaning = re.fullmatch(r"(\[(.*?)\] )?(.*)", comment).groups()
    kind = _in_words(ast.parse(annotation, mode="eval").body)
    return Parameter(name, kind, unit or "", str(_value(value)), meaning)


def _in_words(annotation):
    """The syntax tree of an annotation in words."""
    match annotation:
        case ast.Call(ast.Name(name), [low, high]):
            ends = [f"{_value(ast.unparse(end)):.10g}" for end in (low, high)]
            return f"{_WORDS[name]}, {' to '.join(ends)}"
        case ast.Subscript(ast.Name("Literal"), ast.Tuple(values)):
            *others, last = map(ast.literal_eval, values)
            return f"{', '.join(others)} or {last}"
        case ast.Subscript(ast.Name("list"), entry):
            return f"list of: {_in_words(entry)}"
    return _WORDS[ast.unparse(annotation)]


def _value(text):
    """The value of an expression."""
    return eval(text, {})


def as_text(parameters):
    """Parameters for a terminal, two lines each."""
    lines = []
    for name, kind, unit, default, meaning in parameters:
        unit = f" [{unit}]" if unit else ""
        lines += [f"  {name}{unit}: {kind} (default: {default})", f"      {meaning}"]
    return "\n".join(lines)


def own_parameters():
    """{notebook: {"name: annotation": value}} of all notebooks, as DEFAULTS has them."""
    return {
        path.stem: {
            f"{name}: {annotation}": _value(value) for name, annotation, value, _ in _declared(path)
        }
        for path in sorted((ROOT / "notebooks").rglob("*.ipynb"))
        if ".ipynb_checkpoints" not in path.parts
    }


if __name__ == "__main__":
    DEFAULTS.write_text(f"{json.dumps(own_parameters(), indent=1)}\n", encoding="utf-8")
