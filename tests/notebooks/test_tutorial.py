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


def exact(xi, omega, p):  # no Runge-Kutta at all
    nu, mu, kappa = p
    radius = mu * nu / (kappa * omega)
    end = xi[2] + kappa * omega * DT
    x = xi[0] + radius * (np.sin(end) - np.sin(xi[2]))
    return x, xi[1] + radius * (np.cos(xi[2]) - np.cos(end)), end


def function_of(n_z=4, n_estimate=6, n_after=2):
    memory, z = ca.SX.sym("memory", 2), ca.SX.sym("z", n_z)
    return ca.Function("wrong", [memory, z], [ca.SX(n_after, 1), ca.SX(n_estimate, 1)])


PATH = rhec.Path.from_segments([(30.0, 0.0), (np.pi * 7.8, 1 / 7.8), (30.0, 0.0)])


def strip(mu=(0.6, 0.9), kappa=(0.5, 0.8), start=-10.0, end=46.0, cell=0.5, edges=(20, 25)):
    i, _ = np.mgrid[start:end:cell, -10:26:cell]
    wet = (i > edges[0]) & (i < edges[1])
    return rhec.Terrain(
        mu=np.where(wet, *mu), kappa=np.where(wet, *kappa), origin_m=(start, -10.0), cell_m=cell
    )


DRAW = np.random.default_rng(3)
HARD = DRAW.normal(size=40)
ONE = HARD + 0.1 * DRAW.normal(size=40)
OTHER = HARD + 0.1 + 0.1 * DRAW.normal(size=40)
GAIN = ONE - OTHER
MEAN = GAIN.mean()
HALF = 1.96 * GAIN.std(ddof=1) / np.sqrt(40)
APART = 1.96 * np.sqrt((ONE.var() + OTHER.var()) / 40)
SINGLE = 1.96 * GAIN.std()


def interval_about(mean, half):
    return mean, mean - half, mean + half


# An answer to an exercise, and what is said of a wrong one; None: it is right.
ANSWERS = [
    (tutorial_checks.interval, rk4, None),
    (tutorial_checks.interval, exact, None),
    (tutorial_checks.interval, lambda xi, omega, p: xi + DT * model.f(xi, omega, p), "an Euler"),
    (tutorial_checks.interval, lambda xi, omega, p: rk4(xi, omega, [p[0], 1, p[2]]), "μ = 1"),
    (tutorial_checks.interval, lambda xi, omega, p: rk4(xi, omega, [p[0], p[1], 1]), "κ = 1"),
    (tutorial_checks.interval, midpoint, "fourth order"),
    (tutorial_checks.interval, lambda xi, omega, p: [0, 0], "returned 2 numbers; it should ret"),
    (tutorial_checks.interval, lambda xi, omega: xi, "raised TypeError"),
    (tutorial_checks.interval, lambda xi, omega, p: [np.nan] * 3, "finite"),
    (tutorial_checks.interval, ..., "nothing here yet"),
    (tutorial_checks.weights, (1.0, 1.0, 0.3), None),
    (tutorial_checks.weights, paper.Q1, "never settles"),
    (tutorial_checks.weights, paper.Q2, "too far"),
    (tutorial_checks.weights, paper.Q3, "too slow"),
    (tutorial_checks.feedforward, lambda c, p: c * p[0] * p[1] / p[2], None),
    (tutorial_checks.feedforward, lambda c, p: c * p[0] * p[1], "what does κ do"),
    (tutorial_checks.feedforward, lambda c, p: c * p[0] / p[2], "what does μ do"),
    (tutorial_checks.feedforward, lambda c, p: -c * p[0] * p[1] / p[2], "off the circle"),
    (tutorial_checks.estimator, "rhe", "is a str"),
    (tutorial_checks.estimator, function_of(n_z=3), "z has 3 entries"),
    (tutorial_checks.estimator, function_of(n_estimate=5), "estimate has 5 entries"),
    (tutorial_checks.estimator, function_of(n_after=3), "as long as the one that goes in"),
    (tutorial_checks.terrain, strip(), None),
    (tutorial_checks.terrain, strip(cell=0.25), None),
    (tutorial_checks.terrain, strip(edges=(18, 25)), "outside the strip"),
    (tutorial_checks.terrain, strip(kappa=(0.8, 0.8)), "in the strip"),
    (tutorial_checks.terrain, strip(end=23.0), "outside the strip"),
    (tutorial_checks.terrain, strip(cell=1.0), "at most 0.5 m"),
    (tutorial_checks.difference, tutorial_checks.paired(ONE, OTHER), None),
    # The interval of the normal distribution is as good.
    (tutorial_checks.difference, interval_about(MEAN, HALF), None),
    (tutorial_checks.difference, interval_about(MEAN, APART), "taken apart"),
    (tutorial_checks.difference, interval_about(MEAN, SINGLE), "single seeds"),
    (tutorial_checks.difference, interval_about(-MEAN, HALF), "the mean difference is"),
    (tutorial_checks.difference, interval_about(MEAN, 0.0), "wide"),
    (tutorial_checks.difference, (MEAN, HALF), "2 numbers"),
]
GIVEN = dict(estimator=(function_of(),), terrain=(PATH,), difference=(ONE, OTHER))


@pytest.mark.parametrize("check, given, said", ANSWERS)
def test_a_wrong_answer_is_told_why_and_any_right_one_is_accepted(check, given, said):
    answer = check(given, *GIVEN.get(check.__name__, ()))
    assert answer.right == (said is None) and (said or "") in answer.sentence, answer


@pytest.mark.nightly
def test_an_estimator_that_is_no_better_than_the_first_has_not_learnt():
    memory = ca.SX.sym("memory", 6)
    z = ca.SX.sym("z", 4)
    estimate = ca.vertcat(z[:2], memory[2] + 0.8 * DT * z[3], z[2], 0.9, 0.8)
    first = ca.Function("first", [memory, z], [estimate, estimate])
    answer = tutorial_checks.estimator(first, first)
    assert not answer.right and "below zero" in answer.sentence
