"""The comparison of tables finds what differs; codecheck.yml names what the notebooks make."""

import re
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
import yaml

from docs.site import check_figures
from docs.site.check_figures import difference
from notebooks.studies.answer import RESULTS
from rhec import style

ROOT = Path(__file__).parents[2]
TABLE = pd.DataFrame(dict(name=["RHE", "EKF"], mean=[0.04, 1.3], low=[np.nan, 1.0], n=[3, 4]))
TABLE = TABLE.assign(kkt=[1e-9, 1e-12], beside=["a share on this machine: 0.6", "0.1"])


MADE = dict(
    same=(TABLE, False),
    rounding=(TABLE.assign(mean=TABLE["mean"] * (1 + 1e-8), n=[3.0, 4.0]), False),
    time=(TABLE.assign(beside=["a share on this machine: 0.7", "0.1"]), False),
    number=(TABLE.assign(mean=TABLE["mean"] * (1 + 1e-5)), True),
    small=(TABLE.assign(kkt=[1e-9, 2e-12]), True),
    text=(TABLE.assign(name=["RHE", "ekf"]), True),
    other_text=(TABLE.assign(beside=["a share on this machine: 0.6", "0.2"]), True),
    missing=(TABLE.assign(low=[0.0, 1.0]), True),
    row=(TABLE.head(1), True),
    column=(TABLE.rename(columns={"n": "fields"}), True),
)


@pytest.mark.parametrize("made, is_told", MADE.values(), ids=MADE)
def test_a_table_that_differs_is_told_but_for_rounding_and_times(made, is_told):
    """However small a number is; in parts, none of which is empty."""
    found = difference(made, TABLE)
    assert bool(found) == is_told and all(found.split("; ")) == is_told


def test_a_table_of_other_parameters_is_another_world_and_not_for_publication(
    tmp_path, monkeypatch, capsys
):
    file = tmp_path / "results/table_faults.csv"
    file.parent.mkdir()
    for name in ("a_table_not_made", "table_faults", "table_that_is_right"):
        TABLE.to_csv(file.with_stem(name), index=False)
    monkeypatch.setattr(check_figures, "ROOT", tmp_path)
    monkeypatch.setattr(check_figures, "RESULTS", file.parent)
    try:
        for changed, is_right in ((dict(world="soft"), False), ({}, False), ({}, True)):
            style.set_changed("faults", changed)
            monkeypatch.setattr(style, "FOLDER", tmp_path / "figures")
            monkeypatch.setenv("RHEC_FIGURES", str(tmp_path / "figures"))
            made = TABLE if is_right else TABLE.assign(mean=0.5)
            style.save_table(made, "table_faults", "Faults")
            TABLE.to_csv(tmp_path / "figures/table_that_is_right.csv", index=False)
            assert check_figures.main() == 1 - is_right
            said = capsys.readouterr().out
            assert ("cp figures/table_faults.csv" in said) == (not changed and not is_right)
            assert "a_table_not_made: not made yet\n" in said
            assert "table_that_is_right: the same\n" in said
            assert ("table_faults: another world (world = soft)" in said) == bool(changed)
    finally:
        style.set_changed("", {})


def test_each_file_for_a_codecheck_is_saved_by_the_notebook_that_it_names():
    content = yaml.safe_load((ROOT / "codecheck.yml").read_text(encoding="utf-8"))
    assert len(content["manifest"]) == 14  # 13 figures and a table
    for item in content["manifest"]:
        notebook = ROOT / item["comment"].partition(", by ")[2]
        assert Path(item["file"]).stem in notebook.read_text(encoding="utf-8")


@pytest.mark.parametrize("file", sorted(RESULTS.rglob("*.csv")), ids=lambda file: file.stem)
def test_only_a_difference_or_a_place_has_an_interval_that_goes_below_zero(file):
    """Errors, counts and shares have none, neither in columns nor in words."""
    if file.stem == "audit_order":
        return  # each of its intervals is of a difference
    table = pd.read_csv(file)
    words = [" ".join(map(str, row)) for row in table.itertuples(index=False)]
    signed = np.array([bool(re.search(" - |difference|rotation_centre", row)) for row in words])
    for name in table.columns:
        if re.search("(^|[_ ])(low|p5)$", name) and not re.search("change|drift", name):
            assert not (table[name] < 0)[~signed].any(), name
    assert not re.search(r"(mean|share|violations)[^;]*: [^;]* \[[-−]", ";".join(words))
