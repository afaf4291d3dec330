"""Figures and tables: the same bytes again, where they came from inside, no label cut off or on
another.
"""

import dataclasses
import functools

import matplotlib as mpl
import matplotlib.pyplot as plt
import pandas as pd
import pytest
from PIL import Image
from text_boxes import text_defects

import rhec
from notebooks.plots import robot_drawings
from rhec import style

DRAWINGS = [
    robot_drawings.robot_in_row,
    robot_drawings.robot_parts,
    robot_drawings.hardware_blocks,
    robot_drawings.schematic,
]


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


@pytest.mark.parametrize("draw", DRAWINGS)
def test_labels_of_a_drawing_are_whole_and_apart(draw):
    figure = draw()
    assert figure.get_figwidth() == style.COLUMN_IN
    assert text_defects(figure) == []
