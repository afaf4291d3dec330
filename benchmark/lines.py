"""How many lines a user writes for a task: lines that hold code, without comments, docstrings and
blank lines, in the same style for all (that of `ruff format`).
"""

import ast
import io
import tokenize
from pathlib import Path

import pandas as pd

FOLDER = Path(__file__).parent / "tutorials"
TASKS = {"mpc": "bring to rest (MPC)", "mhe": "estimate an inertia (MHE)"}
TOOLS = {"do_mpc": "do-mpc", "rhec": "rhec"}
_SILENT = {
    tokenize.COMMENT,
    tokenize.NL,
    tokenize.NEWLINE,
    tokenize.INDENT,
    tokenize.DEDENT,
    tokenize.ENCODING,
    tokenize.ENDMARKER,
}


def count(text):
    """The lines of a Python text that hold code."""
    tokens = tokenize.generate_tokens(io.StringIO(text).readline)
    spans = (range(t.start[0], t.end[0] + 1) for t in tokens if t.type not in _SILENT)
    held = {line for span in spans for line in span}
    for node in ast.walk(ast.parse(text)):
        body = getattr(node, "body", None)
        first = body[0] if isinstance(body, list) and body else None
        if isinstance(first, ast.Expr) and isinstance(first.value, ast.Constant):
            held -= set(range(first.lineno, first.end_lineno + 1))
    return len(held)


def measure():
    """Table by task and tool."""
    rows = []
    for task, label in TASKS.items():
        for tool, name in TOOLS.items():
            text = (FOLDER / f"{task}_{tool}.py").read_text(encoding="utf-8")
            rows.append(dict(task=label, contestant=name, lines=count(text)))
    return pd.DataFrame(rows)
