"""The tutorial as a student meets it in JupyterLab."""

import pytest

SOLUTION = """def step(xi, omega, p, h=0.2):
    k1 = f(xi, omega, p)
    k2 = f(xi + h / 2 * k1, omega, p)
    k3 = f(xi + h / 2 * k2, omega, p)
    k4 = f(xi + h * k3, omega, p)
    return xi + h / 6 * (k1 + 2 * k2 + 2 * k3 + k4)


tutorial_checks.interval(step)"""
EULER = "tutorial_checks.interval(lambda xi, omega, p: xi + 0.2 * f(xi, omega, p))"

EXERCISE = """[...jupyterapp.shell.currentWidget.content.widgets]
    .findIndex(cell => (cell.model.getMetadata('tags') ?? []).includes('exercise'))"""


@pytest.fixture
def tutorial(lab, page):
    """The tutorial, run from top to bottom."""
    lab.open(page, "01_tutorial.ipynb")
    lab.run(page)
    yield page
    lab.close(page)


def answers(page, tag):
    """The text of what the checks say in the cells with this tag, as the page shows it."""
    return page.evaluate(
        """tag => jupyterapp.shell.currentWidget.content.widgets
        .filter(cell => (cell.model.getMetadata('tags') ?? []).includes(tag))
        .map(cell => [...cell.node.querySelectorAll('.answer')]
            .map(answer => answer.innerText).join())""",
        tag,
    )


def test_a_student_runs_it_answers_wrongly_then_rightly(lab, tutorial):
    page = tutorial
    blank = answers(page, "exercise")
    assert len(blank) == 6 and all(text.startswith("✗ Not yet:") for text in blank), blank
    solutions = page.locator(".jp-MarkdownOutput details")
    assert solutions.count() == 6
    assert not any(solutions.evaluate_all("all => all.map(each => each.open)"))
    solutions.first.locator("summary").click()
    assert "def rk4" in solutions.first.inner_text()

    page.evaluate(
        "document.querySelectorAll('.jp-OutputArea img').forEach(image => image.scrollIntoView())"
    )
    pictures = page.eval_on_selector_all(
        ".jp-OutputArea img", "images => images.map(image => image.naturalWidth)"
    )
    assert len(pictures) >= 4 and all(width >= 900 for width in pictures)
    assert page.locator("mjx-container").count() > 20  # formulas
    assert page.locator("mjx-merror").count() == 0
    assert page.locator(".Toastify__toast").count() == 0

    for source, said in [(EULER, "an Euler step"), (SOLUTION, "✓ Right:")]:
        page.evaluate(
            f"""async source => {{
            const notebook = jupyterapp.shell.currentWidget.content
            notebook.activeCellIndex = {EXERCISE}
            notebook.deselectAll()
            notebook.activeCell.model.sharedModel.setSource(source)
            await jupyterapp.commands.execute('notebook:run-cell')
        }}""",
            source,
        )
        assert said in answers(page, "exercise")[0]
