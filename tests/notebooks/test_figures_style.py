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


def test_a_figure_made_again_is_the_same_bytes(tmp_path):
    first = style.save(parabola(), "parabola", Scenario(), tmp_path / "first")
    again = style.save(parabola(), "parabola", Scenario(), tmp_path / "again")
    for suffix in (".png", ".pdf"):
        assert first.with_suffix(suffix).read_bytes() == again.with_suffix(suffix).read_bytes()


def test_files_tell_version_scenario_and_notebook(tmp_path):
    png = style.save(parabola(), "parabola", Scenario(), tmp_path, notebook="03_scenario_a.ipynb")
    inside = Image.open(png).text
    assert inside["Title"] == "parabola"
    assert inside["Creator"] == f"rhec {rhec.__version__}"
    assert inside["Keywords"] == SCENARIO_JSON
    assert inside["Subject"] == "03_scenario_a.ipynb"
    pdf = png.with_suffix(".pdf").read_bytes()
    creator = f"/Creator (rhec {rhec.__version__}"
    for expected in ("/Title (parabola)", creator, SCENARIO_JSON, "/Subject (03_scenario_a.ipynb)"):
        assert expected.encode() in pdf
    assert b"CreationDate" not in pdf


def test_an_edit_of_the_source_leaves_a_picture_s_bytes_and_changes_its_source(
    tmp_path, monkeypatch
):
    """Pictures kept in git do not change unless they change on paper."""
    module = tmp_path / "rhec" / "unrelated.py"
    module.parent.mkdir()
    monkeypatch.setattr(style, "source", functools.partial(style.source, tmp_path))
    saved = []
    for text in ("before", "after"):
        module.write_text(text)
        png = style.save(parabola(), "parabola", Scenario(), tmp_path / text)
        saved.append((png.read_bytes(), style.source_of(png)))
        assert saved[-1][1] == f"rhec {rhec.__version__}, source {style.source()}"
    (bytes_before, source_before), (bytes_after, source_after) = saved
    assert bytes_before == bytes_after and source_before != source_after


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
