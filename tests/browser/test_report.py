"""The report of this project's own notebooks, opened from disk with the network cut."""

from pathlib import Path

import pytest

REPORT = Path(__file__).parents[2] / "build/report"
PAGES = sorted(file.name for file in REPORT.glob("*.html"))


@pytest.fixture
def offline(page):
    """A page whose failed requests and console errors fail the test."""
    page.context.set_offline(True)
    wrong = []
    page.on("requestfailed", lambda request: wrong.append(request.url))
    page.on(
        "console",
        lambda message: (
            wrong.append(message.text) if message.type in ("error", "warning") else None
        ),
    )
    yield page
    assert not wrong


def test_there_is_a_report():
    assert PAGES, "build/report is empty; make report makes it"


@pytest.mark.parametrize("name", PAGES)
def test_a_page_shows_all_it_has(offline, name):
    page = offline
    page.goto((REPORT / name).as_uri())
    page.evaluate("document.querySelectorAll('img').forEach(image => image.loading = 'eager')")
    page.wait_for_load_state("load")
    page.evaluate(
        "Promise.all([...document.images].map(image => image.decode()))"
    )  # throws for a broken one
    assert all(
        page.eval_on_selector_all(
            "article img",
            "images => images.map(image => image.getBoundingClientRect().width > 100)",
        )
    )
    formulas = page.eval_on_selector_all(
        "svg.formula path", "paths => paths.map(path => path.getBoundingClientRect().width)"
    )
    assert all(width > 1 for width in formulas)
    assert page.evaluate(
        "performance.getEntriesByType('resource').every(each => each.name.startsWith('file:'))"
    )
    assert page.locator("nav a[aria-current]").count() == (name != "index.html")
    for width, height in [(1366, 768), (2560, 1440), (390, 844)]:
        page.set_viewport_size({"width": width, "height": height})
        assert page.evaluate("document.documentElement.scrollWidth") <= width, (
            f"wider than {width} pixels"
        )


def test_all_pages_are_reached_from_the_first_by_clicks(offline):
    page = offline
    page.goto((REPORT / "index.html").as_uri())
    seen = {"index.html"}
    for place in range(page.locator("nav a:not(.brand)").count()):
        page.goto((REPORT / "index.html").as_uri())
        link = page.locator("nav a:not(.brand)").nth(place)
        target = link.get_attribute("href")
        link.click()
        page.wait_for_url(f"**/{target}")  # and until it is loaded
        seen.add(page.url.rpartition("/")[2])
        assert page.locator("h1").first.inner_text()
    assert seen == set(PAGES)


def test_code_unfolds_and_the_dark_page_is_dark(offline):
    page = offline
    story = next(name for name in PAGES if name.startswith("scenario"))
    page.goto((REPORT / story).as_uri())
    code = page.locator("details.input .highlight").first
    assert not code.is_visible()
    page.locator("details.input summary").first.click()
    assert code.is_visible()
    brightness = "eval(getComputedStyle(document.body).backgroundColor.replace('rgb', 'Math.max'))"
    assert page.evaluate(brightness) > 230
    page.emulate_media(color_scheme="dark")
    assert page.evaluate(brightness) < 60
