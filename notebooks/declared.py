"""What the cells of a notebook declare: its parameters, as text."""

import ast
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
DEFAULTS = ROOT / "notebooks/defaults.json"  # made by `python -m notebooks.parameter_table`


def declarations(source):
    """[(name, annotation, value, comment)] of a cell's annotated assignments; [] if no Python."""
    try:
        nodes = ast.parse(source).body
    except SyntaxError:
        return []
    lines = source.encode().splitlines()
    return [
        (
            *map(ast.unparse, (node.target, node.annotation, node.value)),
            lines[node.end_lineno - 1][node.end_col_offset :].decode().partition("#")[2].strip(),
        )
        for node in nodes
        if isinstance(node, ast.AnnAssign) and node.value
    ]
