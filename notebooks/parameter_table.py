"""What a notebook's parameters are, as papermill reads them from its cell tagged `parameters`.

    python -m notebooks.parameter_table

writes those of all notebooks into notebooks/defaults.json, by which a notebook that runs knows
whether it was changed.
"""

import ast
import json
import re
from typing import NamedTuple

import nbformat
from papermill.translators import PythonTranslator

from notebooks.run import DEFAULTS, ROOT, declarations

_WORDS = {
    "bool": "True or False",
    "dict": "dict",
    "float": "number",
    "int": "whole number",
    "real": "number",
    "str": "text",
    "whole": "whole number",
}


class _Translator(PythonTranslator):
    # Papermill's own pattern knows no annotation with parentheses or quotes, such as whole(2, 9).
    PARAMETER_PATTERN = re.compile(
        r"(?P<target>\w+)\s*:\s*(?P<annotation>[^=#]+?)\s*=\s*(?P<value>.*?)"
        r"(?P<type_comment>(?!))?(\s*#\s*(?P<help>.*))?$"
    )


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
    cells = nbformat.read(notebook, 4).cells
    tagged = [cell for cell in cells if "parameters" in cell.metadata.get("tags", ())]
    return [_parameter(found) for cell in tagged for found in _Translator.inspect(cell)]


def _parameter(found):
    """A Parameter of what papermill found: the comment begins with the unit in brackets."""
    _, unit, meaning = re.fullmatch(r"(\[(.*?)\] )?(.*)", found.help).groups()
    kind = _in_words(ast.parse(found.inferred_type_name, mode="eval").body)
    default = _value(ast.parse(found.default, mode="eval").body)
    return Parameter(found.name, kind, unit or "", str(default), meaning)


def _in_words(annotation):
    """The syntax tree of an annotation in words."""
    match annotation:
        case ast.Call(ast.Name(name), [low, high]):
            return f"{_WORDS[name]}, {_value(low):.10g} to {_value(high):.10g}"
        case ast.Subscript(ast.Name("Literal"), ast.Tuple(values)):
            *others, last = map(_value, values)
            return f"{', '.join(others)} or {last}"
        case ast.Subscript(ast.Name("list"), entry):
            return f"list of: {_in_words(entry)}"
    return _WORDS[ast.unparse(annotation)]


def _value(tree):
    """The value of an expression, by its syntax tree."""
    return eval(compile(ast.Expression(tree), "parameter", "eval"), {})


def as_text(parameters):
    """Parameters for a terminal, two lines each."""
    lines = []
    for name, kind, unit, default, meaning in parameters:
        unit = f" [{unit}]" if unit else ""
        lines += [f"  {name}{unit}: {kind} (default: {default})", f"      {meaning}"]
    return "\n".join(lines)


def own_parameters():
    """{notebook: {"name: annotation": value}} of all notebooks, as DEFAULTS has them."""
    found = {}
    for path in sorted((ROOT / "notebooks").rglob("*.ipynb")):
        if ".ipynb_checkpoints" not in path.parts:
            cells = nbformat.read(path, 4).cells
            tagged = [cell for cell in cells if "parameters" in cell.metadata.get("tags", ())]
            found[path.stem] = {
                f"{name}: {annotation}": _value(ast.parse(value, mode="eval").body)
                for cell in tagged
                for name, annotation, value in declarations(cell.source)
            }
    return found


if __name__ == "__main__":
    DEFAULTS.write_text(f"{json.dumps(own_parameters(), indent=1)}\n", encoding="utf-8")
