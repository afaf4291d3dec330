"""The live page in Firefox, where it is installed: the same runs there."""

import base64
import json
import re
import shutil
import subprocess
import time

import numpy as np
import pytest
from helpers import LIVE_PAGE, needs_live_page

import rhec
from rhec.simulation.columns import COLUMNS
from rhec.workbench.live.page import SCENES

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


def settled(firefox):
    """Wait until the page has drawn all that was asked for. Returns its pictures."""
    firefox.evaluate(
        """(async () => {
            while (!page.busy || asked) await new Promise(done => setTimeout(done, 20))
            await page.busy
        })()"""
    )
    said = firefox.evaluate("document.getElementById('said').textContent")
    assert re.match(r"\d runs of", said), said
    return firefox.evaluate(
        "[...document.querySelectorAll('#pictures canvas')].map(c => c.toDataURL())"
    )


def test_workers_drive_ten_fields_for_a_challenge(firefox):
    firefox.open("about:blank")
    firefox.open(f"{LIVE_PAGE.as_uri()}#a")
    settled(firefox)
    firefox.evaluate("($('challenge').value = 'settle', $('challenge').onchange(), 0)")
    score = firefox.evaluate(
        """(async () => {
            while (!$("score").textContent) await new Promise(done => setTimeout(done, 50))
            return $("score").textContent
        })()"""
    )
    assert re.match(r"\d+ of 10 fields: ", score), score


@pytest.mark.parametrize("scene", SCENES)
def test_a_scene_follows_a_slider_within_a_millimetre_of_its_lines_of_python(firefox, scene):
    firefox.open("about:blank")  # another fragment alone would not load it anew
    firefox.open(f"{LIVE_PAGE.as_uri()}#{scene}")
    before = settled(firefox)
    firefox.evaluate(
        """(input => (input.value = 0.44, input.dispatchEvent(new Event('input', {bubbles: true})),
        0))(document.querySelector('#sliders input[data-field=speed_mps]'))"""
    )
    assert settled(firefox) != before
    lines = firefox.evaluate("document.getElementById('line').textContent").splitlines()
    assert len(lines) == len(SCENES[scene]["runs"]) and "speed_mps=0.44" in lines[0]
    for i, line in enumerate(lines):
        bits = firefox.evaluate(
            f"""(loop => btoa(Array.from(new Uint8Array(
            loop.at_row.slice(0, loop.samples * loop.world.columns.length).buffer),
            byte => String.fromCharCode(byte)).join("")))(page.loops[{i}])"""
        )
        rows = np.frombuffer(base64.b64decode(bits)).reshape(-1, len(COLUMNS))
        native = eval(line, dict(rhec=rhec)).columns
        before_the_fault = slice(None, 195 if scene == "faults" else None)
        for name in ("x_m", "y_m"):
            found = rows[before_the_fault, COLUMNS.index(name)]
            np.testing.assert_allclose(found, native[name][before_the_fault], atol=1e-3)


def test_the_story_checks_an_answer(firefox):
    """At the address of a step, with the reader's choice in it."""
    said = []
    for choice in ("true", "false"):
        firefox.open("about:blank")
        firefox.open(f"{LIVE_PAGE.as_uri()}#step-kalman?bounds={choice}")
        firefox.evaluate(
            """(async () => {
                while (!story.busy || story.wanted.size)
                    await new Promise(done => setTimeout(done, 20))
                await story.busy
            })()"""
        )
        said.append(
            firefox.evaluate("document.querySelector('#step-kalman .answer').textContent")[:7]
        )
    assert said[0] == "Not yet" and said[1].startswith("✓ Yes")
