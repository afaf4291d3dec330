"""README and docs: what they name exists, their code runs, their tables are right."""

import importlib.util
import json
import re
from pathlib import Path

import pandas as pd
import pytest
from helpers import NOTEBOOKS, no_compiler

import rhec
from docs.site import results
from notebooks.further import transfer
from notebooks.further.recorded import scores, verdicts
from notebooks.studies import answer
from rhec.logs.course import UNSURE_YAW_RAD

ROOT = Path(__file__).parents[2]
DOCS = sorted((ROOT / "docs").glob("*.md"))
PAGES = [ROOT / "README.md", ROOT / "CONTRIBUTING.md", *DOCS]
TEXT = {page.name: page.read_text(encoding="utf-8") for page in PAGES}
# By make, not there in a fresh clone; and pages of the site, whose links its own tests follow.
MADE = ("figures/", "build/", ".venv", "/")


def markdown_of(notebook):
    cells = json.loads(notebook.read_text(encoding="utf-8"))["cells"]
    return "\n\n".join("".join(cell["source"]) for cell in cells if cell["cell_type"] == "markdown")


BENCHMARK = ROOT / "benchmark/README.md"
# {page: text} of all that is written for readers
WRITTEN = {page: TEXT[page.name] for page in PAGES}
WRITTEN |= {BENCHMARK: BENCHMARK.read_text(encoding="utf-8")}
WRITTEN |= {notebook: markdown_of(notebook) for notebook in NOTEBOOKS}


def places(text):
    """Files and folders named in code or links, with what they should define."""
    code = re.findall(r"`([\w./-]+/[\w./-]*)(?::(\w+))?`", text)
    links = [(link, "") for link in re.findall(r"\]\(([^)#]+)", text) if "://" not in link]
    return [(path, defined) for path, defined in code + links if not path.startswith(MADE)]


def test_every_file_that_is_named_exists():
    for page, text in WRITTEN.items():
        folders = [ROOT, ROOT / "docs", page.parent]
        for path, defined in places(text):
            found = [folder / path for folder in folders if (folder / path).exists()]
            assert found, (page, path)
            if defined:
                source = found[0].read_text(encoding="utf-8")
                assert re.search(rf"^(def|class) {defined}\b", source, re.M), (path, defined)


def test_every_program_that_is_named_exists():
    text = "\n".join(WRITTEN.values())
    modules = re.findall(r"python -m ((?:benchmark|docs|notebooks)[\w.]*)", text)
    files = re.findall(r"python (\w+/[\w./]*)", text)
    assert "notebooks.studies.calibration" in modules and "tests/engine_costs.py" in files
    assert [each for each in modules if importlib.util.find_spec(each) is None] == []
    assert [each for each in files if not (ROOT / each).exists()] == []


def test_every_notebook_make_target_and_public_name_that_is_named_exists():
    makefile = (ROOT / "Makefile").read_text(encoding="utf-8")
    targets = {*re.findall(r"^([a-z-]+):", makefile, re.MULTILINE)}
    notebooks = {file.stem for file in NOTEBOOKS}
    for name, text in WRITTEN.items():
        rows = re.findall(r"^\| (?:II|III-A|III-B|IV|V) .*\| ([^|]+) \|$", text, re.MULTILINE)
        named = re.findall(r"\b(\w+)\.ipynb", text)
        named += [word for row in rows for word in re.findall(r"`(\w+)`", row)]
        assert {*named} <= notebooks, name
        assert {*re.findall(r"(?:`|^    )make ([a-z-]+)", text, re.MULTILINE)} <= targets, name
        assert {*re.findall(r"`rhec\.([A-Za-z]+)[`(]", text)} <= {*rhec.__all__, "paper"}, name


def test_the_worlds_are_named_and_the_default_one_has_its_values():
    assert [name for name in rhec.WORLDS if f"| `{name}` |" not in TEXT["world.md"]] == []
    rows = re.findall(r"^\| `(\w+)` \| ([^|]*) \| [^|]* \|$", TEXT["world.md"], re.MULTILINE)
    assert len(rows) > 10
    for field, value in rows:
        expected = getattr(rhec.Scenario(), field)
        assert type(expected)(value.strip('"')) == expected, field


def test_the_default_world_is_beside_the_posterior_where_its_page_says():
    text = TEXT["world.md"]
    posterior = pd.read_csv(answer.RESULTS / "inverse_default.csv").set_index("field")
    ranges = re.findall(r"^\| `(\w+)` \|.*?([\d.]+) to ([\d.]+)", text, re.MULTILINE)
    assert len(ranges) == 5
    for field, *ends in ranges:
        decimals = len(ends[0].partition(".")[2])
        found = posterior.loc[field, ["p5", "p95"]]
        assert [f"{end:.{decimals}f}" for end in found] == ends, field
    near = posterior["quantile"].between(0.35, 0.65)
    assert near.index[~near].tolist() == ["speed_mps"]
    stated = pd.read_csv(answer.RESULTS / "inverse_statements.csv").set_index("statement")
    share = stated.loc["mean error with the RHE 0.0423 m", "prior drives"]
    assert f" {100 * share:.0f} % of the drives in worlds of the prior" in text


def test_the_code_of_the_readme_runs(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (code,) = re.findall(r"```python\n(.*?)```", TEXT["README.md"], re.DOTALL)
    exec(compile(code, "README.md", "exec"), there := {})
    assert len(there["table"]) == 4 and there["table"]["mean_error_m"].notna().all()


@pytest.mark.nightly
def test_the_code_for_extensions_runs(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    there = {}
    with no_compiler():  # compiling all of it takes longer
        for code in re.findall(r"```python\n(.*?)```", TEXT["extending.md"], re.DOTALL):
            exec(compile(code, "extending.md", "exec"), there)
    assert abs(there["u"]).max() <= 1 and there["run"].metrics["solver_ok"]


def test_an_address_in_results_is_not_broken(monkeypatch):
    address = f"[it](https://example.org/{'long-' * 25}name)"
    monkeypatch.setitem(results.BLOCKS, "bar", lambda: f"{'word ' * 30}{address}")
    assert address in results.rewrite("<!-- results bar -->\nold\n<!-- end -->").splitlines()


def test_the_results_in_readme_and_docs_are_those_of_the_tables(tmp_path):
    texts = [(ROOT / page).read_text(encoding="utf-8") for page in results.PAGES]
    (tmp_path / "docs").mkdir()
    for page, text in zip(results.PAGES, texts):
        old = re.sub(r"(<!-- results \w+ -->\n).*?(?=<!-- end -->)", r"\1old\n", text, flags=re.S)
        (tmp_path / page).write_text(old, encoding="utf-8")
    results.write(tmp_path)
    for page, text in zip(results.PAGES, texts):
        written = (tmp_path / page).read_text(encoding="utf-8")
        assert written == text, f"{page}: python -m docs.site.results writes it"
    used = [name for text in texts for name in re.findall(r"<!-- results (\w+) -->", text)]
    assert sorted(used) == sorted(results.BLOCKS)


def test_no_result_on_recorded_robots_is_written_by_hand():
    """Its decimals outside of tables that are made are parameters of the code that makes them."""
    page = re.sub(r"<!-- results .*?<!-- end -->", "", TEXT["recorded_robots.md"], flags=re.DOTALL)
    of_code = {transfer.NOISE_M, transfer.YAW_ERROR_RAD, scores.Z_95, UNSURE_YAW_RAD}
    of_code |= {scores.BAD_RAD, scores.GOOD_RAD, verdicts.FAR_KAPPA}
    assert {float(number) for number in re.findall(r"\d+\.\d+", page)} <= of_code


def test_the_readme_is_short_and_has_its_caveat_before_its_answer():
    assert len(TEXT["README.md"].splitlines()) <= 100
    before = " ".join(TEXT["README.md"].partition("<!-- results answer -->")[0].split())
    assert "field data of the paper were never published" in before
