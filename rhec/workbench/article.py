"""`make article`: the article "[Re] …" as build/article.pdf, by Typst.

All its numbers come from the results in README.md and docs/, which `rhec.workbench.results` wrote
from the tables in figures/, and from `rhec.paper`.
"""

import json
import re
import sys
from pathlib import Path

import typst

from rhec import paper

__all__ = ["results_of", "write"]

ROOT = Path(__file__).resolve().parents[2]
_SOURCE = "docs/article/article.typ"
_PAGES = ("README.md", "docs/results.md", "docs/claims.md")
_BLOCK = re.compile(r"<!-- results (\w+) -->\n(.*?)<!-- end -->", re.DOTALL)


def results_of(text):
    """The results in a page of Markdown.

    Args:
        text: The page.

    Returns:
        {name: dict(table=[[text, …], …], rows={first cell: {column: text}})}; the first row of a
        table has the names of its columns.
    """
    results = {}
    for name, block in _BLOCK.findall(text):
        lines = [line for line in block.splitlines() if line.startswith("|")]
        table = [_cells(line) for line in lines]
        del table[1:2]  # the line below the names
        rows = {row[0]: dict(zip(table[0], row)) for row in table[1:]}
        results[name] = dict(table=table, rows=rows)
    return results


def _cells(line):
    """The cells of a line of a Markdown table."""
    return [cell.strip().replace("\\|", "|") for cell in re.split(r"(?<!\\)\|", line)[1:-1]]


def write(root=ROOT):
    """Write build/article.pdf; the same inputs give the same bytes.

    Args:
        root: Folder of the project, with the results of `make figures studies`.

    Returns:
        The path of the PDF.

    Raises:
        FileNotFoundError: If a figure is missing.
    """
    source = (root / _SOURCE).read_text(encoding="utf-8")
    for name in re.findall(r'#picture\("(\w+)"', source):
        if not (root / f"figures/{name}.pdf").exists():
            raise FileNotFoundError(f"figures/{name}.pdf is missing: make figures studies makes it")
    results = {}
    for page in _PAGES:
        results |= results_of((root / page).read_text(encoding="utf-8"))
    numbers = {name: value for name, value in vars(paper).items() if isinstance(value, int | float)}
    output = root / "build/article.pdf"
    output.parent.mkdir(exist_ok=True)
    inputs = dict(results=json.dumps(results), constants=json.dumps(numbers))
    typst.compile(root / _SOURCE, output=output, root=root, sys_inputs=inputs)
    return output


if __name__ == "__main__":
    try:
        print(f"article: {write().relative_to(ROOT)}")
    except FileNotFoundError as error:
        sys.exit(f"article: {error}")
