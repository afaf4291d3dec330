"""The manifest lists what the notebooks made; the comparison of tables finds what differs."""

import nbformat
import numpy as np
import pandas as pd
import pytest
import yaml

from rhec.workbench import certificate


@pytest.fixture
def project(tmp_path):
    """A project in which one notebook made a figure and a table."""
    for folder in ("build/notebooks", "figures", "data"):
        (tmp_path / folder).mkdir(parents=True)
    (tmp_path / "Makefile").write_text("FIGURES := 00_start 04_scenario_b\n")
    (tmp_path / "CITATION.cff").write_text((certificate.ROOT / "CITATION.cff").read_text())
    notebook = nbformat.v4.new_notebook(metadata=dict(papermill=dict(duration=7.5)))
    nbformat.write(notebook, tmp_path / "build/notebooks/04_scenario_b.ipynb")
    made = "figures/fig08_errors.png figures/table_scenario_b.csv figures/gone.png"
    (tmp_path / "build/notebooks/04_scenario_b.d").write_text(f"x: y\nMADE += {made}\n")
    (tmp_path / "figures/fig08_errors.png").write_bytes(b"12345")
    table = pd.DataFrame(dict(name=["RHE", "EKF"], mean=[0.04, 1.3], low=[np.nan, 1.0]))
    table.to_csv(tmp_path / "figures/table_scenario_b.csv", index=False)
    return tmp_path


def test_the_manifest_says_which_file_is_which_figure(project):
    certificate.write(project)
    table = pd.read_csv(project / "figures/manifest.csv")
    assert table["what"].tolist()[0] == "Figure 8 of the paper"
    assert table["seconds"].tolist() == [7.5, 7.5] and table["bytes"].iloc[0] == 5
    text = (project / "codecheck.yml").read_text()
    assert text.startswith("---\n")
    content = yaml.safe_load(text)
    assert [item["file"] for item in content["manifest"]] == table["file"].tolist()
    assert content["paper"]["reference"] == "https://doi.org/10.1002/rob.21794"
    assert len(content["paper"]["authors"]) == 4


def test_tables_that_are_equal_and_tables_that_differ(project):
    certificate.accept(project)
    result = certificate.check(project)
    assert result["difference"].tolist() == [0.0]
    file = project / "figures/table_scenario_b.csv"
    table = pd.read_csv(file)
    table.loc[1, "mean"] *= 1.001
    table.to_csv(file, index=False)
    (row,) = certificate.check(project).itertuples()
    assert row.difference == pytest.approx(1e-3, rel=0.01) and row.result.startswith("mean, row 1")
    table.assign(name=["RHE", "ekf"]).to_csv(file, index=False)
    assert np.isinf(certificate.check(project)["difference"].iloc[0])
    table.head(1).to_csv(file, index=False)
    assert np.isinf(certificate.check(project)["difference"].iloc[0])
    file.unlink()
    assert certificate.check(project)["result"].tolist() == ["not made yet"]


def test_tables_of_times_are_not_expected(project):
    (project / "figures/table1_computation_times.csv").write_text("a\n1\n")
    certificate.accept(project)
    names = {file.name for file in (project / certificate.EXPECTED).iterdir()}
    assert names == {"table_scenario_b.csv"}


def test_a_computation_time_may_differ_and_nothing_beside_it():
    ours = pd.DataFrame(dict(beside=["share on this machine: 0.6", "0.1"], n=[3, 4]))
    theirs = pd.DataFrame(dict(beside=["share on this machine: 0.7", "0.1"], n=[3, 4]))
    assert certificate.compare(ours, theirs) == ("the same", 0.0)
    theirs.loc[1, "beside"] = "0.2"
    assert certificate.compare(ours, theirs)[1] == np.inf
