"""The live page in Firefox, where it is installed."""

import json
import shutil
import subprocess
import time

import pytest
from helpers import LIVE_PAGE, needs_live_page

websocket = pytest.importorskip("websocket", reason="websocket-client is not installed")
pytestmark = needs_live_page
PATIENCE_S = 180


class Firefox:
    """A page in a headless Firefox, asked by WebDriver BiDi."""

    def __init__(self, process, folder):
        told, begun = folder / "WebDriverBiDiServer.json", time.monotonic()
        while not (told.exists() and told.stat().st_size):
            assert process.poll() is None and time.monotonic() < begun + PATIENCE_S
            time.sleep(0.1)
        url = "ws://{ws_host}:{ws_port}/session".format(**json.loads(told.read_text()))
        self._socket = websocket.create_connection(url, timeout=PATIENCE_S, suppress_origin=True)
        self._ask("session.new", capabilities={})
        (tab,) = self._ask("browsingContext.getTree")["contexts"]
        self._tab = tab["context"]

    def _ask(self, method, **params):
        self._socket.send(json.dumps(dict(id=1, method=method, params=params)))
        while "id" not in (answer := json.loads(self._socket.recv())):
            pass  # an event
        assert answer["type"] == "success", answer
        return answer["result"]

    def open(self, url):
        self._ask("browsingContext.navigate", context=self._tab, url=url, wait="complete")

    def evaluate(self, expression):
        """The value of a JavaScript expression, or of its promise."""
        asked = f"Promise.resolve({expression}).then(value => JSON.stringify(value) ?? 'null')"
        found = self._ask(
            "script.evaluate", expression=asked, awaitPromise=True, target=dict(context=self._tab)
        )
        assert found["type"] == "success", found
        return json.loads(found["result"]["value"])


@pytest.fixture(scope="module")
def firefox(tmp_path_factory):
    path = shutil.which("firefox") or shutil.which("firefox-esr")
    if not path:
        pytest.skip("no Firefox found on the PATH")
    folder = tmp_path_factory.mktemp("profile")
    command = [path, "--headless", "--no-remote", "--profile", folder, "--remote-debugging-port=0"]
    with subprocess.Popen(command, stderr=subprocess.DEVNULL) as process:
        try:
            yield Firefox(process, folder)
        finally:
            process.terminate()


def test_the_page_opens_and_drives(firefox):
    firefox.open(f"{LIVE_PAGE.as_uri()}#b")
    firefox.evaluate(
        """(async () => {
            while (!page.busy || asked || !story.busy || story.wanted.size)
                await new Promise(done => setTimeout(done, 20))
            await Promise.all([story.busy, page.busy])
        })()"""
    )
    said = firefox.evaluate("document.getElementById('said').textContent")
    assert said.startswith("2 runs of"), said
    answer = firefox.evaluate("document.querySelector('#step-kalman .answer').textContent")
    assert answer.startswith("Not yet: ")
