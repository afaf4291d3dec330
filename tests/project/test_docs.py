"""README and docs: their prose, what they name, the code in them, and the results written into
them."""

import re
import subprocess
from pathlib import Path

import pandas as pd
import pytest
from helpers import no_compiler

import rhec
from rhec.simulation import columns
from rhec.workbench import results
from rhec.workbench.studies import ranking, seven_worlds
from rhec.workbench.studies.claims import summary

ROOT = Path(__file__).parents[2]
DOCS = sorted((ROOT / "docs").glob("*.md"))
PAGES = [ROOT / "README.md", ROOT / "CONTRIBUTING.md", *DOCS]
TEXT = {page.name: page.read_text(encoding="utf-8") for page in PAGES}
RESULT = re.compile(r"<!-- results (\w+) -->\n(.*?)<!-- end -->", re.DOTALL)
OF_CLAIMS = ("verdicts", "failed", "departures", "worlds", "multiplicity", "changes")
MADE = ("figures/", "build/", ".venv")  # by make: not there in a fresh clone


def names():
    return pytest.mark.parametrize("name", TEXT)


@names()
def test_the_prose_of_a_page_is_narrow(name):
    lines = [line for line in TEXT[name].splitlines() if not line.startswith("|")]
    assert [line for line in lines if len(line) > 100] == []


def sentences(text):
    """The sentences of a page's prose: of its paragraphs and of the entries of its lists."""
    text = re.sub(r"```.*?```|<!--.*?-->", "", text, flags=re.DOTALL)
    text = re.sub(r"^(\||#|    \S).*$", "", text, flags=re.MULTILINE)  # tables, headings, code
    for paragraph in re.split(r"\n\s*\n|\n(?=\s*(?:[-*]|\d+\.) )", text):
        yield from re.split(r"(?<=[.!?:])\**\s+", " ".join(paragraph.split()))


@names()
def test_a_sentence_has_thirty_words_at_most(name):
    prose = RESULT.sub("", TEXT[name])
    assert [text for text in sentences(prose) if len(text.split()) > 30] == []


def test_pages_are_these():
    expected = [
        "acado",
        "architecture",
        "claims",
        "closer_to_the_limit",
        "embedded",
        "extending",
        "index",
        "interpretations",
        "live",
        "log_columns",
        "naming",
        "recorded_robots",
        "reference",
        "results",
        "shared_computers",
        "soil_map",
        "tested_systems",
        "threat_model",
        "world",
        "your_log",
    ]
    assert [page.stem for page in DOCS] == expected


def test_the_readme_uses_the_words_of_the_field():
    for words in ("moving horizon", "MHE", "model predictive", "MPC", "real-time iteration"):
        assert words in TEXT["README.md"]


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
    assert [each for each in named if not (ROOT / f"notebooks/{each}.ipynb").exists()] == []


@names()
def test_every_make_target_that_is_named_exists(name):
    makefile = (ROOT / "Makefile").read_text(encoding="utf-8")
    named = re.findall(r"(?:`|^    )make ([a-z-]+)", TEXT[name], re.MULTILINE)
    assert [each for each in named if not re.search(rf"^{each}:", makefile, re.MULTILINE)] == []


@names()
def test_every_public_name_exists(name):
    named = set(re.findall(r"`rhec\.([A-Za-z]+)[`(]", TEXT[name]))
    assert named - {"paper"} <= set(rhec.__all__)


def test_the_table_of_worlds_has_their_values():
    rows = re.findall(r"^\| `(\w+)` \| ([^|]*) \| ([^|]*) \|", TEXT["world.md"], re.MULTILINE)
    for place, world in ((1, "former"), (2, "default")):
        expected = rhec.WORLDS[world]
        found = {row[0]: type(expected[row[0]])(row[place].strip('"')) for row in rows}
        assert found == expected, world


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


def test_the_code_for_extensions_runs(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    there = {}
    with no_compiler():  # compiling all of it takes longer
        for code in re.findall(r"```python\n(.*?)```", TEXT["extending.md"], re.DOTALL):
            exec(compile(code, "extending.md", "exec"), there)
    assert abs(there["u"]).max() <= 1 and there["run"].metrics["all_ok"]


# The results that are written into the pages


def interval(mean, verdict=None, **names):
    return names | dict(mean=mean, low=mean - 0.0207, high=mean + 0.0309, n=20, verdict=verdict)


def fake_tables():
    """Small tables in which no two numbers are alike."""
    error, limit = "mean error, raw GNSS [m]", "violations on straights, raw GNSS"
    scenario_b = [
        interval(
            0.111 * k + 0.0013 * j,
            "holds" if estimator == "RHE - EKF" else None,
            process_noise=noise,
            estimator=estimator,
            quantity=quantity,
            paper=None if "true" in quantity else 0.077 + 0.005 * k,
        )
        for j, noise in enumerate(("printed", "calibrated"))
        for k, (estimator, quantity) in enumerate(
            [
                ("RHE", error),
                ("EKF", error),
                ("RHE - EKF", error),
                ("RHE", limit),
                ("RHE", "violations on straights, true"),
            ],
            1,
        )
    ]
    scenario_a = [
        interval(31.7, weight="Q1", quantity="settling time [s]", claim=None),
        interval(3.21, "holds", weight="Q1 / Q3", quantity="settling time, ratio", claim="2 times"),
    ]
    statement = {"statement": "all of them"}
    for k, when in enumerate(("prior", "posterior")):
        share = 0.0414 + 0.0301 * k
        drives = dict(zip(("", "_low", "_high"), (share, share - 0.0107, share + 0.0119)))
        statement |= {f"{when} drives{end}": value for end, value in drives.items()}
    verdicts = ["holds", "holds", "does not hold", "holds only as printed", "undecided"]
    claims = [
        dict(id=f"B{i}", claim=f"sentence {i}", verdict=verdict, basis=summary.TESTED)
        | dict(where_accuracy=0.917, posterior=0.43, posterior_low=0.31, posterior_high=0.56)
        | dict(p=0.01 * (i + 1), p_adjusted=0.03 * (i + 1))
        for i, verdict in enumerate(verdicts)
    ]
    claims.append(claims[2] | dict(id="B5", claim="sentence 5", basis=summary.BY_DERIVATION))
    claims.append(claims[0] | dict(id="B6", verdict="holds where the speed is above 0.4"))
    before = [
        dict(id="B0", before="holds", reason=""),
        dict(id="B1", before="undecided", reason="so"),
    ]
    world = dict(id="B5 p", claim="RHE's error is below", holds=0.612, low=0.533, high=0.714)
    faults = dict(handling="on", n=7, back=7, recovery_s_largest=17.3, verdict="holds")
    late = faults | dict(back=6, recovery_s_largest=33.1, verdict="does not hold")
    error_m = ranking.QUANTITIES["mean_error_true_m"]
    ratio = f"true error, ratio to {ranking.PAPERS}"
    here = dict(world="default", contestant="observer")
    early = dict(world="default", contestant="slow")
    return {
        name: pd.DataFrame(rows)
        for name, rows in dict(
            table_scenario_a=scenario_a,
            table_scenario_b=scenario_b,
            inverse_statements=[statement],
            claims=claims,
            claims_before=before,
            multiverse=[world],
            table_faults=[faults, faults, late],
            table_beyond=[
                interval(0.0243, **here, quantity=error_m, claim=""),
                interval(0.0571, **early, quantity=error_m, claim="") | dict(n=8),
                interval(0.683, "holds", **here, quantity=ratio, claim="at most 0.70"),
            ],
            table_worth=[
                interval(0.773, "pays", world="default", quantity="a gyro") | dict(n=8),
                interval(0.873, "pays", world="default", quantity="a window"),
            ],
            table_consistency=[interval(1.87, estimator="RHE", quantity="NEES, mean")],
            table_replay=[interval(0.0391, estimator="RHE", quantity="RMS error of yaw [rad]")],
        ).items()
    }


def written(name):
    """Each result of a page, written from the small tables."""
    return dict(RESULT.findall(results.rewrite(TEXT[name], fake_tables())))


def test_results_are_written_as_the_tables_have_them():
    readme, docs, claims = map(written, ("README.md", "results.md", "claims.md"))
    rows = [row.replace("  ", " ") for row in readme["summary"].splitlines()]
    error = "| 0.111 [0.0903, 0.142] | 0.112 [0.0916, 0.143] | 0.082 | |"
    assert f"| Mean error with the RHE [m] {error}" in rows
    assert (
        "| Settling time with Q¹ over that with Q³ | | 3.21 [3.19, 3.24] | | 2 times: holds |"
        in (row.replace("| |", "| |") for row in rows)
    )
    statement = "| all of them | 0.0414 [0.0307, 0.0533] | 0.0715 [0.0608, 0.0834] |\n"
    assert readme["inverse"].endswith(statement)
    counts = summary.verdict_counts(fake_tables()["claims"])
    cells = [row.strip("| ").split(" | ") for row in readme["verdicts"].splitlines()[2:]]
    assert {row[0]: list(map(int, row[1:])) for row in cells} == counts.T.to_dict("list")
    assert counts["claims"].sum() == 7
    assert claims["failed"].splitlines()[2:] == [
        "| B2 | sentence 2 | tested |",
        "| B5 | sentence 5 | by derivation |",
    ]
    assert claims["worlds"].splitlines()[2:] == [
        "| B6 | sentence 0 | holds where the speed is above 0.4 | 0.917 | 0.43 [0.31, 0.56] |"
    ]
    assert claims["departures"].splitlines()[2:] == ["| B3 | sentence 3 | holds only as printed |"]
    assert "5 verdicts" in claims["multiplicity"] and "2 remain." in claims["multiplicity"]
    assert "B1, B2, B3." in claims["multiplicity"]
    assert "| B1 | undecided | holds | so |" in claims["changes"]
    assert "| B0 |" not in claims["changes"] and "| B5 | – | does not hold |" in claims["changes"]
    worlds = "| B5 | printed | RHE's error is below | 0.612 [0.533, 0.714] |\n"
    assert docs["multiverse"].endswith(worlds)
    assert docs["faults"].endswith("| on | 3 | 2 | 2 | 33.1 |\n")
    ranked = "| observer | 0.0243 [0.0036, 0.0552] |\n| slow | excluded after 8 fields |\n"
    assert docs["beyond"].endswith(ranked)
    assert docs["targets"].endswith("| 0.683 [0.662, 0.714] | at most 0.70 | holds |\n")
    assert "| a gyro | pays after 8 fields |\n" in docs["worth"]
    assert docs["worth"].endswith("| a window | 0.873 [0.852, 0.904] |\n")
    assert docs["replay"].endswith("| RHE | 0.0391 [0.0184, 0.07] |\n")


def test_results_are_tables_with_headings():
    for name in ("README.md", "results.md", "claims.md"):
        for result, text in written(name).items():
            if result != "multiplicity":  # a sentence
                table = [line for line in text.splitlines() if line]
                assert sum(line.startswith("|") for line in table) >= 3, result
                heads = table[[line.startswith("|") for line in table].index(True)]
                assert all(heads.strip("| ").split(" | ")), result
                assert not re.search(r"; .*; ", text), result


def test_the_results_of_the_seven_worlds_are_those_of_their_laps():
    laps = pd.read_parquet(seven_worlds.LAPS)
    text = TEXT["closer_to_the_limit.md"]
    assert results.rewrite(text, dict(seven_worlds=laps)) == text
    of_one = laps[(laps["loop"] == "speed RHC") & (laps["world"] == "wet patches")]
    share = of_one.loc[of_one["base"] == "former", "whole"].mean()
    (row,) = re.findall(r"^\| former, wet patches \| (\S+) \[", text, re.MULTILINE)
    assert row == results.format_number(share)
    n = of_one["seed"].nunique()
    assert f"Of {n} fields each, seeds 0 to {n - 1}:" in text


def numbers(text):
    return set(re.findall(r"(?<![\w.])-?\d+(?:\.\d+)?(?:e-?\d+)?(?![\w.]*\d)", text))


@pytest.mark.parametrize("name", ["README.md", "results.md", "claims.md"])
def test_every_number_of_a_result_comes_from_a_table(name):
    values = set()
    counts = {"1", "2", "3", "0", "20", "95"}
    for table in fake_tables().values():
        for value in table.to_numpy().ravel():
            if value is not None:
                values |= numbers(value) if isinstance(value, str) else {f"{value:.3g}"}
    for result, text in written(name).items():
        assert numbers(text) <= values | counts, result


def test_no_number_stands_beside_the_results():
    section = TEXT["README.md"].partition("## What came out")[2].partition("\n## ")[0]
    for text in (section, TEXT["results.md"]):
        beside = numbers(re.sub(r"\w+\.ipynb", "", RESULT.sub("", text)))
        assert beside <= {"0.12", "5", "95", "1"}  # the tolerance, settling, intervals, consistent


@pytest.mark.parametrize("name", ["README.md", "results.md", "claims.md"])
def test_results_whose_table_was_not_made_stay(name):
    assert results.rewrite(TEXT[name], {}) == TEXT[name]
    tables = fake_tables()
    del tables["claims"]
    before, after = (dict(RESULT.findall(results.rewrite(TEXT[name], t))) for t in ({}, tables))
    for result, text in after.items():
        assert (text == before[result]) == (result in OF_CLAIMS), result


def test_an_unknown_result_is_refused():
    with pytest.raises(KeyError, match="weather"):
        results.rewrite("<!-- results weather -->\n<!-- end -->\n", {})


def test_a_page_is_written_only_when_its_results_changed(tmp_path, capsys):
    (tmp_path / "docs").mkdir()
    (tmp_path / "figures").mkdir()
    pages = {tmp_path / "README.md": "README.md"}
    of_docs = ("results.md", "claims.md", "closer_to_the_limit.md")
    pages |= {tmp_path / f"docs/{name}": name for name in of_docs}
    for page, name in pages.items():
        page.write_text(TEXT[name], encoding="utf-8")
    (tmp_path / "data").mkdir()
    for name, table in fake_tables().items():
        folder = "data" if name == "claims_before" else "figures"
        table.to_csv(tmp_path / f"{folder}/{name}.csv", index=False)
    results.main(tmp_path)
    assert capsys.readouterr().out.count("updated") == 3
    first = {page: (page.read_text(encoding="utf-8"), page.stat().st_mtime_ns) for page in pages}
    for page, name in pages.items():
        assert first[page][0] == results.rewrite(TEXT[name], fake_tables())
    results.main(tmp_path)
    assert capsys.readouterr().out == ""
    assert {p: (p.read_text(encoding="utf-8"), p.stat().st_mtime_ns) for p in pages} == first
