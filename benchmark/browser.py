"""JupyterLab and a headless Chromium, for the tests and the benchmark of what a page shows.

JupyterLab serves copies of the notebooks from a folder of its own, with settings of its own:
nothing of the user's is read or written.
"""

import contextlib
import json
import os
import secrets
import shutil
import subprocess
import sys
import time
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
QUIET = "--no-sandbox --disable-gpu --disable-quic --no-first-run --disable-background-networking"
QUIET += " --disable-component-update --disable-sync"
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


def launch(playwright):
    """A headless Chromium, the system's, else Playwright's own; None where there is neither."""
    names = ("chromium", "chromium-browser", "google-chrome")
    path = next(filter(None, map(shutil.which, names)), playwright.chromium.executable_path)
    if not Path(path).exists():
        return None
    return playwright.chromium.launch(executable_path=path, args=QUIET.split())


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


@contextlib.contextmanager
def jupyter_lab(home, folder):
    """A running JupyterLab on copies of this project's notebooks.

    Args:
        home, folder: Empty folders, of its settings and of the notebooks.
    """
    token = secrets.token_hex()
    for notebook in (ROOT / "notebooks").glob("*.ipynb"):
        shutil.copy(notebook, folder)
    overrides = home / "labconfig" / "default_setting_overrides.json"
    overrides.parent.mkdir()
    overrides.write_text(json.dumps(SETTINGS))
    names = "JUPYTER_DATA_DIR JUPYTER_RUNTIME_DIR JUPYTERLAB_SETTINGS_DIR"
    names += " JUPYTERLAB_WORKSPACES_DIR IPYTHONDIR"
    own = {name: str(home / name.lower()) for name in names.split()}
    paths = [str(ROOT), os.environ.get("PYTHONPATH", "")]
    own |= dict(JUPYTER_CONFIG_DIR=str(home), PYTHONPATH=os.pathsep.join(paths))
    own |= dict(JUPYTER_PATH=f"{sys.prefix}/share/jupyter")
    options = "--no-browser --ip=127.0.0.1 --port=0 --ServerApp.allow_root=True"
    options += " --expose-app-in-browser --LabApp.extension_manager=readonly --LabApp.news_url=None"
    options += " --LabApp.check_for_updates_class=jupyterlab.NeverCheckForUpdate"
    command = [sys.executable, "-m", "jupyter", "lab", *options.split()]
    command += [f"--IdentityProvider.token={token}", str(folder)]
    log = home / "log"
    with log.open("w") as written:
        server = subprocess.Popen(
            command, env=os.environ | own, stdout=written, stderr=subprocess.STDOUT
        )
    try:
        yield Lab(_address(server, Path(own["JUPYTER_RUNTIME_DIR"]), log), token, folder)
    finally:
        server.terminate()
        server.wait()


def _address(server, runtime, log):
    """Where the server answers, from the file it leaves once it does."""
    deadline = time.monotonic() + PATIENCE_MS / 1000
    while time.monotonic() < deadline:
        if server.poll() is not None:
            raise OSError(log.read_text())
        for file in runtime.glob(f"jpserver-{server.pid}.json"):
            with contextlib.suppress(json.JSONDecodeError):  # it is being written
                return json.loads(file.read_text())["url"].rstrip("/")
        time.sleep(0.1)
    raise TimeoutError(f"JupyterLab did not start:\n{log.read_text()}")
