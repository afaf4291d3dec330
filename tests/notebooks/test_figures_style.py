"""Figures and tables: the same bytes again, and where they came from inside."""

import dataclasses
import functools

import matplotlib as mpl
import matplotlib.pyplot as plt
import numpy as np
import pandas as pd
from PIL import Image

import rhec
from rhec import style


@dataclasses.dataclass(frozen=True)
class Scenario:
    seed: int = 7
    q: tuple = (1, 1, 10)


SCENARIO_JSON = '{"seed": 7, "q": [1, 1, 10]}'


@style.styled
def parabola():
    figure, axes = plt.subplots()
    axes.plot([0, 1, 2], [0, 1, 4])
    axes.set_xlabel(r"$\hat\xi$ [m]")
    return figure


def test_a_figure_made_again_is_the_same_bytes_and_tells_its_source(tmp_path, monkeypatch):
    """After an edit of the source, pictures kept in git stay as they are, and PDFs name it."""
    module = tmp_path / "rhec" / "unrelated.py"
    module.parent.mkdir()
    kept_by_jupyterlab = tmp_path / "notebooks/.ipynb_checkpoints/03-checkpoint.ipynb"
    kept_by_jupyterlab.parent.mkdir(parents=True)
    monkeypatch.setattr(style, "source", functools.partial(style.source, tmp_path))
    png = {}
    pdf = {}
    sources = []
    for folder, text in (("first", "before"), ("again", "before"), ("edited", "after")):
        module.write_text(text)
        file = style.save(parabola(), "parabola", Scenario(), tmp_path / folder, "03.ipynb").png
        png[folder] = file.read_bytes()
        pdf[folder] = file.with_suffix(".pdf").read_bytes()
        sources.append(style.source_of(file))
        kept_by_jupyterlab.touch()
    assert png["first"] == png["again"] == png["edited"] and pdf["first"] == pdf["again"]
    assert (
        sources[0]
        == sources[1]
        != sources[2]
        == f"rhec {rhec.__version__}, source {style.source()}"
    )
    inside = Image.open(file).text
    assert inside["Title"] == "parabola" and inside["Keywords"] == SCENARIO_JSON
    assert inside["Creator"] == f"rhec {rhec.__version__}" and inside["Subject"] == "03.ipynb"
    for expected in ("/Title (parabola)", SCENARIO_JSON, "/Subject (03.ipynb)"):
        assert expected.encode() in pdf["first"]
    assert b"CreationDate" not in pdf["first"]


def test_what_other_parameters_made_says_so_and_lies_elsewhere(tmp_path, monkeypatch):
    """Above the figure, in its file, and in the table's caption; check-figures tells it, too."""
    for name in ("RHEC_FIGURES", "RHEC_NOTEBOOK", "JPY_SESSION_NAME"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setattr(style, "FOLDER", tmp_path)
    monkeypatch.setitem(style.RC, "savefig.dpi", 100)
    table = pd.DataFrame(dict(error_m=[0.0423]))
    own = style.save(parabola(), "parabola").png
    csv = style.save_table(table, "errors", "Errors")
    assert style.note_of(csv) == ""
    pixels = np.asarray(Image.open(own))
    try:
        folder = style.set_changed("04_scenario_b", dict(world="wet patches", seeds=3))
        assert folder == tmp_path / "04_scenario_b/world=wet_patches,seeds=3"
        note = "world = wet patches, seeds = 3"
        other = style.save(parabola(), "parabola").png
        assert other.parent == folder
        assert Image.open(other).text["Subject"] == f"04_scenario_b.ipynb, {note}"
        # The figure is as it was, below a line.
        shown = np.asarray(Image.open(other))
        more = len(shown) - len(pixels)
        assert 10 < more < 20 and (shown[more:] == pixels).mean() > 0.999
        assert (shown[:more] != 255).any()
        csv = style.save_table(table, "errors", "Errors")
        assert csv.parent == folder and style.note_of(csv) == note
        assert rf"Errors ({note})" in csv.with_suffix(".tex").read_text()
        # What has a folder of its own is none of the notebook's.
        mine = style.save(parabola(), "parabola", folder=tmp_path / "explored").png
        assert (np.asarray(Image.open(mine)) == pixels).all()
        assert len(style.set_changed("long", dict(log="/" + "a" * 999)).name) < 150
        # RHEC_FIGURES is where its user wants them, and they still say so.
        monkeypatch.setenv("RHEC_FIGURES", str(tmp_path))
        assert style.set_changed("04_scenario_b", dict(seeds=3)) == tmp_path
        assert style.note_of(style.save_table(table, "errors", "Errors")) == "seeds = 3"
    finally:
        assert style.set_changed("", {}) == tmp_path


def test_a_table_comes_back_as_it_went(tmp_path):
    table = pd.DataFrame(
        {"estimator": ["RHE", "EKF"], "error_m": [0.0423, 1 / 3], "violations": [0, 17]}
    )
    csv = style.save_table(table, "errors", "Errors", tmp_path, Scenario())
    pd.testing.assert_frame_equal(pd.read_csv(csv), table)
    tex = csv.with_suffix(".tex").read_text()
    assert f"% Keywords: {SCENARIO_JSON}\n" in tex
    assert r"\toprule" in tex and r"error\_m" in tex and "0.3333 &" in tex


def test_style_stays_inside_its_figures():
    before = dict(mpl.rcParams)
    figure = parabola()
    assert dict(mpl.rcParams) == before
    assert not plt.get_fignums()
    assert {tick.get_fontsize() for tick in figure.axes[0].get_xticklabels()} == {
        style.RC["xtick.labelsize"]
    }
