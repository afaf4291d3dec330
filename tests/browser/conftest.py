"""JupyterLab and a headless Chromium, for tests of what a page shows. Skipped, with the reason,
where there is no Chromium.

JupyterLab serves copies of the notebooks from a folder of its own, with settings of its own:
nothing of the user's is read or written.
"""

import contextlib
import functools
import json
import os
import secrets
import shutil
import subprocess
import sys
import time
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
QUIET = [
    "--no-sandbox",
    "--disable-gpu",
    "--disable-quic",
    "--no-first-run",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
]
PATIENCE_MS = 180_000  # a first run may compile

# As defaults of a fresh JupyterLab: no question about news, every output in the page and not only
# what is in view.
SETTINGS = {
    "@jupyterlab/apputils-extension:notification": {
        "fetchNews": "false",
        "checkForUpdates": False,
        "doNotDisturbMode": True,
    },
    "@jupyterlab/notebook-extension:tracker": {"windowingMode": "none"},
}


@pytest.fixture(scope="session", autouse=True)
def unoptimised_processes():
    """None: pages compute with what users have, and `timed` tests measure it."""


@pytest.fixture(scope="session")
def chromium():
    """A headless Chromium: the system's, else Playwright's own."""
    sync_api = pytest.importorskip("playwright.sync_api", reason="playwright is not installed")
    with sync_api.sync_playwright() as playwright:
        path = (
            shutil.which("chromium")
            or shutil.which("chromium-browser")
            or shutil.which("google-chrome")
            or playwright.chromium.executable_path
        )
        if not Path(path).exists():
            pytest.skip(
                "no Chromium found: neither on the PATH nor one that "
                "`playwright install chromium` leaves"
            )
        browser = playwright.chromium.launch(executable_path=path, args=QUIET)
        yield browser
        browser.close()


LOCAL = (
    "http://127.0.0.1:",
    "http://localhost:",
    "ws://127.0.0.1:",
    "ws://localhost:",
    "file:",
    "data:",
    "blob:",
    "about:",
)


@contextlib.contextmanager
def watched_page(chromium, width=1366, height=768):
    """An empty page, on a laptop's screen unless told. What its scripts throw and what it asks of
    other machines fails the test.
    """
    page = chromium.new_page(viewport={"width": width, "height": height})
    page.set_default_timeout(PATIENCE_MS)
    thrown, outside = [], []
    page.on("pageerror", lambda error: thrown.append(str(error)))
    page.on(
        "request",
        lambda request: outside.append(request.url) if not request.url.startswith(LOCAL) else None,
    )
    yield page
    page.close()
    assert not thrown
    assert not outside


@pytest.fixture(scope="session")
def open_page(chromium):
    """A function that opens a watched page of the given width and height."""
    return functools.partial(watched_page, chromium)


@pytest.fixture
def page(chromium):
    """A watched page for one test."""
    with watched_page(chromium) as page:
        yield page


class Lab:
    """A running JupyterLab. `open` shows a notebook, `run` executes all of it, `outputs` are those
    of its cells.
    """

    def __init__(self, url, token, folder):
        self.url, self.token, self.folder = url, token, folder

    def open(self, page, notebook):
        """The notebook alone in the page, its kernel ready."""
        page.goto(f"{self.url}/lab/tree/{notebook}?reset&token={self.token}")
        page.wait_for_selector(".jp-Notebook .jp-Cell")
        page.evaluate("""async () => {
            const context = jupyterapp.shell.currentWidget.context.sessionContext
            await context.ready
            jupyterapp.shell.collapseLeft()
            jupyterapp.shell.collapseRight()
        }""")
        page.wait_for_function(
            "jupyterapp.shell.currentWidget.context.sessionContext"
            ".session?.kernel?.status == 'idle'"
        )

    def run(self, page):
        """Run all cells. Raises what the first failing cell says."""
        page.evaluate("jupyterapp.commands.execute('notebook:run-all-cells')")
        for output in self.outputs(page):
            assert output["output_type"] != "error", "\n".join(output["traceback"])

    @staticmethod
    def outputs(page):
        """The outputs of all cells, as nbformat has them."""
        cells = page.evaluate("jupyterapp.shell.currentWidget.content.model.toJSON().cells")
        return [output for cell in cells for output in cell.get("outputs", [])]

    @staticmethod
    def close(page):
        """Shut the page's kernel down, so that tests do not pile them up."""
        page.evaluate("jupyterapp.shell.currentWidget.context.sessionContext.shutdown()")


@pytest.fixture(scope="session")
def lab(tmp_path_factory):
    """JupyterLab on copies of this project's notebooks."""
    home, folder, token = (
        tmp_path_factory.mktemp("jupyter"),
        tmp_path_factory.mktemp("notebooks"),
        secrets.token_hex(),
    )
    for notebook in (ROOT / "notebooks").glob("*.ipynb"):
        shutil.copy(notebook, folder)
    overrides = home / "labconfig" / "default_setting_overrides.json"
    overrides.parent.mkdir()
    overrides.write_text(json.dumps(SETTINGS))
    places = {
        name: str(home / name.lower())
        for name in (
            "JUPYTER_DATA_DIR",
            "JUPYTER_RUNTIME_DIR",
            "JUPYTERLAB_SETTINGS_DIR",
            "JUPYTERLAB_WORKSPACES_DIR",
            "IPYTHONDIR",
        )
    }
    environment = (
        os.environ
        | places
        | {
            "JUPYTER_CONFIG_DIR": str(home),
            "JUPYTER_PATH": f"{sys.prefix}/share/jupyter",
            "PYTHONPATH": os.pathsep.join([str(ROOT), os.environ.get("PYTHONPATH", "")]),
        }
    )
    log = home / "log"
    with log.open("w") as written:
        server = subprocess.Popen(
            [
                sys.executable,
                "-m",
                "jupyter",
                "lab",
                "--no-browser",
                "--ip=127.0.0.1",
                "--port=0",
                f"--IdentityProvider.token={token}",
                "--ServerApp.allow_root=True",
                "--expose-app-in-browser",
                "--LabApp.extension_manager=readonly",
                "--LabApp.news_url=None",
                "--LabApp.check_for_updates_class=jupyterlab.NeverCheckForUpdate",
                str(folder),
            ],
            env=environment,
            stdout=written,
            stderr=subprocess.STDOUT,
        )
    try:
        yield Lab(_address(server, Path(places["JUPYTER_RUNTIME_DIR"]), log), token, folder)
    finally:
        server.terminate()
        server.wait()


def _address(server, runtime, log):
    """Where the server answers, from the file it leaves once it does."""
    deadline = time.monotonic() + PATIENCE_MS / 1000
    while time.monotonic() < deadline:
        assert server.poll() is None, log.read_text()
        for file in runtime.glob(f"jpserver-{server.pid}.json"):
            return json.loads(file.read_text())["url"].rstrip("/")
        time.sleep(0.1)
    pytest.fail(f"JupyterLab did not start:\n{log.read_text()}")
