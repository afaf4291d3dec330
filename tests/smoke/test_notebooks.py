"""Every notebook by papermill with small parameters, and what its tables say then.

Few fields estimate the same quantities as many. Each value of a small run is therefore compared
with the committed one of the full run: the intervals of both, widened fourfold, must overlap.
Outputs stay in build/smoke/, of which the continuous integration makes a site.
"""

import base64
from pathlib import Path
from typing import NamedTuple

import nbformat
import numpy as np
import pandas as pd
import pytest
from helpers import NOTEBOOKS
from text_boxes import sizes_in_print

from notebooks import run
from rhec.style import SMALL_PT

ROOT = Path(__file__).parents[2]
OUTPUT = ROOT / "build/smoke"
FIGURES = OUTPUT / "figures"
# Columns of text that depend on the number of fields, or on the sentences of a verdict.
_NO_KEYS = ("verdict", "claim", "machine")
_WIDENED = 4.0  # some intervals are of two runs, and not normal


class Small(NamedTuple):
    """Parameters with which a notebook takes seconds, and the tables that it leaves."""

    parameters: dict
    tables: tuple = ()


SMALL = {
    "06_claims": Small(
        dict(looks=[10], posterior=3, world_fields=3), ("claims", "claims_coverage")
    ),
    "08_interpretations": Small(
        dict(paired_seeds=4, order_fields=4), ("audit_interpretations", "audit_order")
    ),
    "further/faults": Small(dict(seeds=2), ("table_faults",)),
    "further/recorded_logs": Small(dict(seeds=2), ("table_replay",)),
    "further/traction_worth": Small(
        dict(kappas=[0.8], map_fields=4, map_training=1, consistency_runs=4)
        | dict(unknown_fields=2, unknown_training=1, posterior_worlds=2),
        ("table_unknowns", "table_unknowns_by_rule", "table_consistency"),
    ),
    "01_tutorial": Small(dict(seeds=2)),
    "04_scenario_b": Small(dict(seeds=8, beside=4, fields=4), ("table_scenario_b",)),
    "03_scenario_a": Small(dict(seeds=4), ("table_scenario_a",)),
    "07_which_worlds": Small(
        dict(truths=20, draws=100), ("inverse_posterior", "inverse_statements")
    ),
    "further/your_robot": Small(dict(duration_s=20), ("table_your_robot",)),
    "00_start": Small(dict(seed=1)),
    "05_computation_times": Small(
        dict(duration_s=20), ("table1_computation_times", "table_embedded_sizes")
    ),
    "02_equations": Small(dict(intervals=8)),
}


def test_every_notebook_is_here():
    names = [str(path.relative_to(ROOT / "notebooks").with_suffix("")) for path in NOTEBOOKS]
    assert sorted(SMALL) == sorted(names)


@pytest.mark.parametrize("name", SMALL)
def test_a_small_run_says_what_the_full_one_does(name, monkeypatch):
    small = SMALL[name]
    monkeypatch.setenv("RHEC_FIGURES", str(FIGURES))
    monkeypatch.setenv("OPENBLAS_NUM_THREADS", "1")
    # With optimised code, as users have it; without, the claims' drives take longer than compiling
    # saves.
    monkeypatch.delenv("CC", raising=False)
    monkeypatch.delenv("CXX", raising=False)
    # In this process, which imports papermill once for all notebooks.
    run.run(ROOT / f"notebooks/{name}.ipynb", small.parameters, OUTPUT / f"{name}.ipynb")
    pictures = [
        output
        for cell in nbformat.read(OUTPUT / f"{name}.ipynb", 4).cells
        for output in cell.get("outputs", ())
        if "image/png" in output.get("data", {})
    ]
    for picture in pictures:
        assert picture.metadata["image/png"]["alt"]
        # A column of the paper is 900 pixels wide; a PNG says its width from its 17th byte on.
        png = base64.b64decode(picture.data["image/png"])
        assert int.from_bytes(png[16:20], "big") >= 900
    for pdf in FIGURES.glob("*.pdf"):
        assert min(sizes_in_print(pdf)) >= SMALL_PT, pdf.name
    for table in small.tables:
        check(table)


def check(table):
    """Compare a table of a small run with the committed one, if git holds it."""
    ours = pd.read_csv(FIGURES / f"{table}.csv")
    assert len(ours)
    committed = ROOT / f"data/results/{table}.csv"
    if not committed.exists():
        numbers = ours.select_dtypes("number")
        assert np.isfinite(numbers.to_numpy()).all()
        return
    full = pd.read_csv(committed)
    assert list(ours) == list(full)
    texts = full.select_dtypes(exclude=["number", "bool"])
    keys = ["id"] if "id" in full else [name for name in texts if name not in _NO_KEYS]
    for frame in (full, ours):
        frame[keys] = frame[keys].fillna("")
    both = full.merge(ours, on=keys, suffixes=("_full", "_small"), how="inner")
    new = ours[~ours[keys].apply(tuple, axis=1).isin(full[keys].apply(tuple, axis=1))]
    assert len(both) >= 0.8 * len(ours), (
        f"{committed.name} lacks rows such as {new[keys].head(3).to_dict('records')}; "
        "make figures studies, and commit the table that make check-figures names"
    )
    value = next((name for name in ("mean", "value", "median") if name in full), None)
    if value is None or "low" not in full:
        return
    gap = (both[f"{value}_small"] - both[f"{value}_full"]).abs()
    reach = sum(
        (both[f"high_{size}"] - both[f"low_{size}"]).fillna(np.inf) / 2
        for size in ("small", "full")
    )
    off = both[gap > _WIDENED * reach + 1e-9]
    assert off.empty, off[keys + [f"{value}_small", f"{value}_full"]].to_string()
