"""The tutorial runs from any folder, its solutions are right, and its exercises tell wrong answers
from right ones.
"""

import re
from pathlib import Path

import casadi as ca
import nbformat
import numpy as np
import pytest
from nbclient import NotebookClient

import rhec
from notebooks import tutorial_checks
from rhec import paper
from rhec.core.model import robot_model
from rhec.tracked_robot import kinematics as model

TUTORIAL = Path(__file__).parents[2] / "notebooks/01_tutorial.ipynb"
DT = paper.DT_S


SOLUTION = re.compile(
    r"<details>\n<summary>Solution</summary>\n.*```python\n(.*)\n```\n\n</details>", re.DOTALL
)


def solutions(notebook):
    """The code of the solutions, which stand in Markdown so that "Run all" does not run them."""
    matches = [SOLUTION.fullmatch(cell.source) for cell in notebook.cells]
    return [match[1] for match in matches if match]


@pytest.fixture(scope="module")
def executed(tmp_path_factory):
    """The tutorial as it is, then its solutions, executed in a folder without the project."""
    notebook = nbformat.read(TUTORIAL, as_version=4)
    tagged = {"tags": ["solution"]}
    notebook.cells += [
        nbformat.v4.new_code_cell(code, metadata=tagged) for code in solutions(notebook)
    ]
    folder = str(tmp_path_factory.mktemp("elsewhere"))
    resources = {"metadata": {"path": folder}}
    return NotebookClient(notebook, timeout=300, resources=resources).execute()


def answers(notebook, tag):
    """The checks' answers in the cells with this tag."""
    by_cell = {
        cell["id"]: [
            text
            for output in cell.outputs
            if (text := output.get("data", {}).get("text/plain", "")).startswith(
                ("Right", "Not yet")
            )
        ]
        for cell in notebook.cells
        if tag in cell.metadata.get("tags", [])
    }
    assert by_cell and all(len(answers) == 1 for answers in by_cell.values()), by_cell
    return [answer for (answer,) in by_cell.values()]


@pytest.mark.nightly
def test_every_solution_is_right(executed):
    right = answers(executed, "solution")
    assert all(answer.startswith("Right: ") for answer in right), right


@pytest.mark.nightly
def test_no_exercise_is_solved_before_it_is_answered(executed):
    blank = answers(executed, "exercise")
    assert len(blank) == len(answers(executed, "solution")) == 6
    assert all(answer.startswith("Not yet: ") for answer in blank), blank


def test_an_answer_is_shown_with_its_mark_and_as_text():
    for right, mark in ((True, "✓ Right:"), (False, "✗ Not yet:")):
        shown = tutorial_checks.Answer(right, "a < b")._repr_html_()
        assert mark in shown and "a &lt; b" in shown and 'class="answer"' in shown


def rk4(xi, omega, p):
    return robot_model.rk4(model.f, ca.DM(xi), omega, ca.DM(p), DT)


def midpoint(xi, omega, p):
    k1 = model.f(xi, omega, p)
    return xi + DT * model.f(ca.DM(xi) + DT / 2 * k1, omega, p)


@pytest.mark.parametrize(
    "step, said",
    [
        (lambda xi, omega, p: xi + DT * model.f(xi, omega, p), "an Euler step"),
        (lambda xi, omega, p: rk4(xi, omega, [p[0], 1, p[2]]), "μ = 1"),
        (lambda xi, omega, p: rk4(xi, omega, [p[0], p[1], 1]), "κ = 1"),
        (midpoint, "fourth order"),
        (lambda xi, omega, p: [0, 0], "returned 2 numbers; it should return 3"),
        (lambda xi, omega: xi, "raised TypeError"),
        (lambda xi, omega, p: [np.nan] * 3, "finite"),
        (..., "nothing here yet"),
    ],
)
def test_a_wrong_interval_is_found_out(step, said):
    answer = tutorial_checks.interval(step)
    assert not answer.right and said in answer.sentence


def test_any_right_interval_is_accepted():
    def exact(xi, omega, p):  # no Runge-Kutta at all
        nu, mu, kappa = p
        radius = mu * nu / (kappa * omega)
        end = xi[2] + kappa * omega * DT
        return (
            xi[0] + radius * (np.sin(end) - np.sin(xi[2])),
            xi[1] + radius * (np.cos(xi[2]) - np.cos(end)),
            end,
        )

    assert tutorial_checks.interval(rk4).right
    assert tutorial_checks.interval(exact).right


@pytest.mark.parametrize(
    "q, said", [(paper.Q1, "never settles"), (paper.Q2, "too far"), (paper.Q3, "too slow")]
)
def test_weights_that_do_not_do_are_found_out(q, said):
    answer = tutorial_checks.weights(q)
    assert not answer.right and said in answer.sentence


def test_more_than_one_choice_of_weights_does():
    assert tutorial_checks.weights((10.0, 10.0, 10.0)).right
    assert tutorial_checks.weights((1.0, 1.0, 0.3)).right


@pytest.mark.parametrize(
    "turn, said",
    [
        (lambda c, p: c * p[0] * p[1], "what does κ do"),
        (lambda c, p: c * p[0] / p[2], "what does μ do"),
        (lambda c, p: -c * p[0] * p[1] / p[2], "off the circle"),
        (lambda c, p: c * p[0] * p[1] / p[2], None),
    ],
)
def test_the_right_turn_alone_is_accepted(turn, said):
    answer = tutorial_checks.feedforward(turn)
    assert answer.right == (said is None) and (said or "") in answer.sentence


def estimator(mu_next):
    memory, z = ca.SX.sym("memory", 6), ca.SX.sym("z", 4)
    x, y, theta, _, mu, _ = ca.vertsplit(memory)
    theta = theta + DT * 0.8 * z[3]
    x, y = x + DT * mu * z[2] * ca.cos(theta), y + DT * mu * z[2] * ca.sin(theta)
    ahead, side = (
        ca.cos(theta) * (z[0] - x) + ca.sin(theta) * (z[1] - y),
        ca.cos(theta) * (z[1] - y) - ca.sin(theta) * (z[0] - x),
    )
    new = ca.vertcat(
        x + 0.2 * (z[0] - x),
        y + 0.2 * (z[1] - y),
        theta + 0.1 * side,
        z[2],
        mu_next(mu, ahead),
        0.8,
    )
    return ca.Function("one", [memory, z], [new, new])


@pytest.mark.nightly
def test_an_estimator_must_learn():
    first = estimator(lambda mu, ahead: 0.9)
    assert tutorial_checks.estimator(
        estimator(lambda mu, ahead: ca.fmin(ca.fmax(mu + 0.1 * ahead, 0), 1)), first
    ).right
    backwards = estimator(lambda mu, ahead: ca.fmin(ca.fmax(mu - 0.1 * ahead, 0), 1))
    answer = tutorial_checks.estimator(backwards, first)
    assert not answer.right and "below zero" in answer.sentence


def function_of(n_z=4, n_estimate=6, n_after=2):
    memory, z = ca.SX.sym("memory", 2), ca.SX.sym("z", n_z)
    return ca.Function("wrong", [memory, z], [ca.SX(n_after, 1), ca.SX(n_estimate, 1)])


@pytest.mark.parametrize(
    "wrong, said",
    [
        ("rhe", "is a str"),
        (function_of(n_z=3), "z has 3 entries"),
        (function_of(n_estimate=5), "estimate has 5 entries"),
        (function_of(n_after=3), "as long as the one that goes in"),
    ],
)
def test_what_is_no_estimator_is_told_before_a_drive(wrong, said):
    answer = tutorial_checks.estimator(wrong, estimator(lambda mu, ahead: 0.9))
    assert not answer.right and said in answer.sentence


def strip(mu=(0.6, 0.9), kappa=(0.5, 0.8), start=-10.0, end=46.0, cell=0.5, edges=(20, 25)):
    i, _ = np.mgrid[start:end:cell, -10:26:cell]
    wet = (i > edges[0]) & (i < edges[1])
    return rhec.Terrain(
        mu=np.where(wet, *mu), kappa=np.where(wet, *kappa), origin_m=(start, -10.0), cell_m=cell
    )


PATH = rhec.Path.from_segments([(30.0, 0.0), (np.pi * 7.8, 1 / 7.8), (30.0, 0.0)])


def test_a_terrain_must_have_the_strip():
    assert tutorial_checks.terrain(strip(), PATH).right
    assert tutorial_checks.terrain(strip(cell=0.25), PATH).right
    for wrong, said in [
        (strip(edges=(18, 25)), "outside the strip"),
        (strip(kappa=(0.8, 0.8)), "in the strip"),
        (strip(end=23.0), "outside the strip"),
        (strip(cell=1.0), "at most 0.5 m"),
    ]:
        answer = tutorial_checks.terrain(wrong, PATH)
        assert not answer.right and said in answer.sentence, answer


def test_an_interval_must_be_of_the_paired_differences():
    draw = np.random.default_rng(3)
    hard = draw.normal(size=40)
    one, other = hard + 0.1 * draw.normal(size=40), hard + 0.1 + 0.1 * draw.normal(size=40)
    gain = one - other
    mean, half = gain.mean(), 1.96 * gain.std(ddof=1) / np.sqrt(40)
    assert tutorial_checks.difference(tutorial_checks.paired(one, other), one, other).right
    assert tutorial_checks.difference(
        (mean, mean - half, mean + half), one, other
    ).right  # the normal distribution's is as good
    apart = 1.96 * np.sqrt((one.var() + other.var()) / 40)
    for wrong, said in [
        ((mean, mean - apart, mean + apart), "taken apart"),
        ((mean, mean - 1.96 * gain.std(), mean + 1.96 * gain.std()), "single seeds"),
        ((-mean, -mean - half, -mean + half), "the mean difference is"),
        ((mean, mean, mean), "wide"),
        ((mean, half), "2 numbers"),
    ]:
        answer = tutorial_checks.difference(wrong, one, other)
        assert not answer.right and said in answer.sentence, answer
