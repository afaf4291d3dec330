"""A headless Chromium and a JupyterLab, for tests of what a page shows. Skipped, with the reason,
where there is no Chromium.
"""

import contextlib
import functools

import pytest

from benchmark import browser


@pytest.fixture(scope="session", autouse=True)
def unoptimised_processes():
    """None: pages compute with what users have."""


@pytest.fixture(scope="session")
def chromium():
    """A headless Chromium."""
    sync_api = pytest.importorskip("playwright.sync_api", reason="playwright is not installed")
    with sync_api.sync_playwright() as playwright:
        launched = browser.launch(playwright)
        if not launched:
            pytest.skip(
                "no Chromium: none on the PATH, and `playwright install chromium` left none"
            )
        yield launched
        launched.close()


LOCAL = tuple(
    f"{scheme}://{host}:" for scheme in ("http", "ws") for host in ("127.0.0.1", "localhost")
)
LOCAL += ("file:", "data:", "blob:", "about:")


@contextlib.contextmanager
def watched_page(chromium):
    """An empty page on a laptop's screen. What its scripts throw and what it asks of other machines
    fails the test.
    """
    page = chromium.new_page(viewport={"width": 1366, "height": 768})
    page.set_default_timeout(browser.PATIENCE_MS)
    thrown = []
    asked = []
    page.on("pageerror", lambda error: thrown.append(str(error)))
    page.on("request", lambda request: asked.append(request.url))
    yield page
    page.close()
    assert not thrown
    assert not [url for url in asked if not url.startswith(LOCAL)]


@pytest.fixture(scope="session")
def open_page(chromium):
    """A function that opens a watched page."""
    return functools.partial(watched_page, chromium)


@pytest.fixture
def page(chromium):
    """A watched page for one test."""
    with watched_page(chromium) as page:
        yield page


@pytest.fixture(scope="session")
def lab(tmp_path_factory):
    """JupyterLab on copies of this project's notebooks."""
    folders = (tmp_path_factory.mktemp(name) for name in ("jupyter", "notebooks"))
    with browser.jupyter_lab(*folders) as lab:
        yield lab
