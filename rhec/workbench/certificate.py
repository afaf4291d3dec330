"""What a person who certifies this reproduction needs: a manifest, and a comparison of tables.

`python -m rhec.workbench.certificate` writes, after `make figures`, which file is which figure of
the paper: `figures/manifest.csv` with sizes and times, and `codecheck.yml` by the rules of
CODECHECK (configuration 2.0, codecheck.org.uk). `python -m rhec.workbench.certificate --check`
compares the tables in `figures/` with those in `data/results`, which were made by the commit that
is checked out; `--accept` puts the present ones there.
"""

import argparse
import re
import shutil
import sys
from pathlib import Path

import nbformat
import numpy as np
import pandas as pd
import yaml

__all__ = ["check", "compare", "manifest", "write"]

ROOT = Path(__file__).resolve().parents[2]
EXPECTED = "data/results"
TOLERANCE = 1e-6  # relative: more than compilers differ by, less than any conclusion needs
# Tables of what a machine does, which no other machine repeats.
_TIMES = ("table1_computation_times", "table_embedded", "table_your_robot", "bench_", "manifest")
_SPECIFICATION = "https://codecheck.org.uk/spec/config/2.0/"
_NEEDS_A_PERSON = """---
# Written by `make figures`. What a person must add before a certificate is issued: the ORCID of
# each author, codechecker (name and ORCID), summary, certificate (YYYY-NNN), report (a DOI), and
# a public repository.
"""


def manifest(root=ROOT, notebooks=None):
    """The files that executed notebooks made.

    Args:
        root: Folder of the project.
        notebooks: Names of notebooks. By default those of the paper's figures and tables.

    Returns:
        DataFrame with the columns file, what, notebook, seconds (of the whole notebook) and bytes.
    """
    rows = []
    for name in notebooks or _of_the_paper(root):
        rules = root / f"build/notebooks/{name}.d"
        if not rules.exists():
            continue
        executed = nbformat.read(rules.with_suffix(".ipynb"), as_version=4)
        seconds = executed.metadata.get("papermill", {}).get("duration")
        made = re.search(r"(?m)^MADE \+=(.*)$", rules.read_text(encoding="utf-8"))
        for file in sorted(made[1].split()):
            if (root / file).exists():
                rows.append(
                    dict(
                        file=file,
                        what=_what(file),
                        notebook=f"notebooks/{name}.ipynb",
                        seconds=seconds,
                        bytes=(root / file).stat().st_size,
                    )
                )
    return pd.DataFrame(rows, columns=["file", "what", "notebook", "seconds", "bytes"])


def _of_the_paper(root):
    """Names of the notebooks that the Makefile lists as FIGURES."""
    text = (root / "Makefile").read_text(encoding="utf-8")
    return re.search(r"(?m)^FIGURES := (.*)$", text)[1].split()


def _what(file):
    """Which figure or table of the paper a file is."""
    number = re.match(r"(fig|table)0?(\d+)_", Path(file).name)
    if number is None:
        return "beside the paper's figures and tables"
    return f"{dict(fig='Figure', table='Table')[number[1]]} {number[2]} of the paper"


def write(root=ROOT):
    """Write figures/manifest.csv, and codecheck.yml where it changed."""
    table = manifest(root)
    table.to_csv(root / "figures/manifest.csv", index=False)
    citation = yaml.safe_load((root / "CITATION.cff").read_text(encoding="utf-8"))
    (paper,) = citation["references"]
    authors = [f"{author['given-names']} {author['family-names']}" for author in paper["authors"]]
    items = [
        dict(file=row.file, comment=f"{row.what}, by {row.notebook}") for row in table.itertuples()
    ]
    content = dict(
        version=_SPECIFICATION,
        paper=dict(
            title=paper["title"],
            authors=[dict(name=author) for author in authors],
            reference=f"https://doi.org/{paper['doi']}",
        ),
        manifest=items,
    )
    text = _NEEDS_A_PERSON + yaml.safe_dump(content, sort_keys=False, width=100)
    file = root / "codecheck.yml"
    if not file.exists() or file.read_text(encoding="utf-8") != text:
        file.write_text(text, encoding="utf-8")


def compare(ours, theirs):
    """How two tables differ.

    Args:
        ours: DataFrame.
        theirs: DataFrame.

    Returns:
        (sentence, difference): what differs most, and by how much: 0 for equal tables, relative to
        the larger of two numbers, infinite where a text, a column or a row differs.
    """
    if list(ours) != list(theirs) or len(ours) != len(theirs):
        return f"{ours.shape} rows and columns, there {theirs.shape}, or other names", np.inf
    worst = ("the same", 0.0)
    for name in ours:
        difference = _difference(ours[name], theirs[name])
        place = int(difference.argmax()) if len(difference) else 0
        if len(difference) and difference[place] > worst[1]:
            a = ours[name].iloc[place]
            b = theirs[name].iloc[place]
            worst = (f"{name}, row {place}: {a} here, {b} there", difference[place])
    return worst


def _difference(ours, theirs):
    """The difference of two columns by rows, relative to the larger value of each row."""
    if not all(pd.api.types.is_numeric_dtype(column) for column in (ours, theirs)):
        same = (ours == theirs) | (ours.isna() & theirs.isna())
        return np.where(same | (_is_time(ours) & _is_time(theirs)), 0.0, np.inf)
    a = ours.to_numpy(float)
    b = theirs.to_numpy(float)
    same = (a == b) | (np.isnan(a) & np.isnan(b))
    with np.errstate(invalid="ignore"):
        relative = np.abs(a - b) / np.maximum(np.abs(a), np.abs(b))
    return np.where(same, 0.0, np.nan_to_num(relative, nan=np.inf))


def _is_time(column):
    """Which texts of a column tell a computation time, which each machine has its own of."""
    return column.astype(str).str.contains("on this machine", regex=False)


def check(root=ROOT):
    """Compare all tables.

    Args:
        root: Folder of the project.

    Returns:
        DataFrame: table, result (a sentence) and difference; NaN for a table that was not made.
    """
    rows = []
    for file in sorted((root / EXPECTED).glob("*.csv")):
        made = root / "figures" / file.name
        if not made.exists():
            rows.append((file.stem, "not made yet", np.nan))
            continue
        rows.append((file.stem, *compare(pd.read_csv(made), pd.read_csv(file))))
    return pd.DataFrame(rows, columns=["table", "result", "difference"])


def accept(root=ROOT):
    """Put the tables of `figures/` into the folder of those that are expected."""
    folder = root / EXPECTED
    folder.mkdir(exist_ok=True)
    for file in sorted((root / "figures").glob("*.csv")):
        if not file.name.startswith(_TIMES):
            shutil.copy(file, folder)


def _main():
    parser = argparse.ArgumentParser("python -m rhec.workbench.certificate", description=__doc__)
    parser.add_argument("--check", action="store_true", help="compare the tables in figures/")
    parser.add_argument("--accept", action="store_true", help="keep those in figures/")
    given = parser.parse_args()
    if given.accept:
        accept()
    elif given.check:
        table = check()
        print(table.to_string(index=False, float_format="%.2g"))
        return int((table["difference"] > TOLERANCE).any())
    else:
        write()
    return 0


if __name__ == "__main__":
    sys.exit(_main())
