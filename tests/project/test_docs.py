"""README and docs: what they name exists, their code runs, their tables are right."""

import re
import subprocess
from pathlib import Path

import pandas as pd
import pytest
from helpers import no_compiler

import rhec
from docs.site import results
from notebooks.studies import answer
from rhec.simulation import columns

ROOT = Path(__file__).parents[2]
DOCS = sorted((ROOT / "docs").glob("*.md"))
PAGES = [ROOT / "README.md", ROOT / "CONTRIBUTING.md", *DOCS]
TEXT = {page.name: page.read_text(encoding="utf-8") for page in PAGES}
MADE = ("figures/", "build/", ".venv")  # by make: not there in a fresh clone


def names():
    return pytest.mark.parametrize("name", TEXT)


def places(text):
    """Files and folders named in code or links, with what they should define."""
    code = re.findall(r"`([\w./-]+/[\w./-]*)(?::(\w+))?`", text)
    links = [(link, "") for link in re.findall(r"\]\(([^)#]+)", text) if "://" not in link]
    return [(path, defined) for path, defined in code + links if not path.startswith(MADE)]


@names()
def test_every_file_that_is_named_exists(name):
    folders = [ROOT, ROOT / "docs"]
    for path, defined in places(TEXT[name]):
        found = [folder / path for folder in folders if (folder / path).exists()]
        assert found, path
        if defined:
            source = found[0].read_text(encoding="utf-8")
            assert re.search(rf"^(def|class) {defined}\b", source, re.MULTILINE), (path, defined)


def test_pictures_and_links_of_the_readme_are_in_git():
    links = [link for link in re.findall(r"\]\(([^)#]+)", TEXT["README.md"]) if "://" not in link]
    tracked = subprocess.run(["git", "ls-files"], cwd=ROOT, capture_output=True, text=True)
    if tracked.returncode:
        pytest.skip("not a git checkout")
    assert set(links) <= set(tracked.stdout.splitlines())


@names()
def test_every_notebook_that_is_named_exists(name):
    named = re.findall(r"\b(\w+)\.ipynb", TEXT[name])
    rows = re.findall(r"^\| (?:II|III-A|III-B|IV|V) .*\| ([^|]+) \|$", TEXT[name], re.MULTILINE)
    named += [word for row in rows for word in re.findall(r"`(\w+)`", row)]
    assert set(named) <= {file.stem for file in (ROOT / "notebooks").rglob("*.ipynb")}


@names()
def test_every_make_target_that_is_named_exists(name):
    makefile = (ROOT / "Makefile").read_text(encoding="utf-8")
    named = re.findall(r"(?:`|^    )make ([a-z-]+)", TEXT[name], re.MULTILINE)
    assert [each for each in named if not re.search(rf"^{each}:", makefile, re.MULTILINE)] == []


@names()
def test_every_public_name_exists(name):
    named = set(re.findall(r"`rhec\.([A-Za-z]+)[`(]", TEXT[name]))
    assert named - {"paper"} <= set(rhec.__all__)


def test_the_worlds_are_named_and_the_default_one_has_its_values():
    assert [name for name in rhec.WORLDS if f"| `{name}` |" not in TEXT["world.md"]] == []
    rows = re.findall(r"^\| `(\w+)` \| ([^|]*) \| [^|]* \|$", TEXT["world.md"], re.MULTILINE)
    assert len(rows) > 10
    for field, value in rows:
        expected = getattr(rhec.Scenario(), field)
        assert type(expected)(value.strip('"')) == expected, field


def test_every_column_of_a_log_is_explained():
    named = [*columns.COLUMNS, *columns.LEVER_ARM, *columns.SIGMA, *columns.INNOVATION]
    named += [*columns.RECORDED.values(), *columns.RECORDED_TRUTH.values(), *columns.TRACKS]
    named += [*columns.GATE, *rhec.simulate(rhec.Scenario(duration_s=2.0)).log]
    assert [name for name in named if f"`{name}`" not in TEXT["log_columns.md"]] == []


def test_every_metric_is_explained():
    metrics = rhec.simulate(rhec.Scenario(duration_s=2.0)).metrics
    assert [name for name in metrics if f"`{name}`" not in TEXT["log_columns.md"]] == []


def test_the_code_of_the_readme_runs(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (code,) = re.findall(r"```python\n(.*?)```", TEXT["README.md"], re.DOTALL)
    exec(compile(code, "README.md", "exec"), there := {})
    assert len(there["table"]) == 6 and there["table"]["mean_error_m"].notna().all()
    assert len(there["estimates"]) == len(there["run"].log)


@pytest.mark.nightly
def test_the_code_for_extensions_runs(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    there = {}
    with no_compiler():  # compiling all of it takes longer
        for code in re.findall(r"```python\n(.*?)```", TEXT["extending.md"], re.DOTALL):
            exec(compile(code, "extending.md", "exec"), there)
    assert abs(there["u"]).max() <= 1 and there["run"].metrics["solver_ok"]


def test_the_results_in_the_readme_are_those_of_the_tables():
    assert results.rewrite(TEXT["README.md"]) == TEXT["README.md"]
    assert set(re.findall(r"<!-- results (\w+) -->", TEXT["README.md"])) == set(results.BLOCKS)


def test_the_readme_answers_first():
    """Both numbers of the paper, ours beside them, and a verdict in words, on the first screen."""
    first = "\n".join(TEXT["README.md"].splitlines()[:45])
    ours = pd.read_csv(answer.RESULTS / "table_scenario_b.csv").query("process_noise == 'printed'")
    mean = ours.set_index(["estimator", "quantity"])["mean"]["RHE", "mean error, raw GNSS [m]"]
    assert all(text in first for text in ("0.0423", "0.0514", f"{mean:.4f}"))
    assert re.search(r"\*\*RHE before EKF: (yes|no|it depends)", first)


def test_every_claim_is_counted_once():
    claims = pd.read_csv(answer.RESULTS / "claims.csv")
    counts = map(int, re.findall(r": (\d+)\]", answer.bar()))
    assert sum(counts) == len(claims)
