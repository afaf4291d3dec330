"""`rhec lab` for someone who never used Jupyter before: it asks nothing and speaks to nobody but
this machine.
"""

import os
import re
import signal
import socket
import subprocess
import sys
import time
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]


def answers(port):
    with socket.socket() as client:
        return client.connect_ex(("127.0.0.1", port)) == 0


@pytest.fixture
def address(tmp_path):
    """The address that `rhec lab` prints where there is no display, in a home that is empty."""
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    environment = {
        name: value
        for name, value in os.environ.items()
        if not name.startswith("JUPYTER") and name not in ("DISPLAY", "WAYLAND_DISPLAY")
    }
    said = tmp_path / "said"
    with said.open("w") as log:
        lab = subprocess.Popen(
            [sys.executable, "-m", "rhec", "lab"],
            cwd=ROOT,
            env=environment | {"HOME": str(tmp_path), "JUPYTER_PORT": str(port)},
            stdin=subprocess.DEVNULL,
            stdout=log,
            stderr=subprocess.STDOUT,
            start_new_session=True,
        )
    try:
        for _ in range(1200):
            found = re.search(rf"http://127\.0\.0\.1:{port}/lab\S*\n", said.read_text())
            if found and answers(port):  # it is printed a moment before
                break
            assert lab.poll() is None, said.read_text()
            time.sleep(0.1)
        else:
            pytest.fail(said.read_text())
        yield found[0].strip()
    finally:
        if lab.poll() is None:
            os.killpg(lab.pid, signal.SIGTERM)
        lab.wait()


def test_it_opens_on_the_first_notebook_and_asks_nothing(chromium, page, address):
    page.goto(address)
    page.wait_for_selector(".jp-DirListing-item[title*='01_tutorial.ipynb']")
    page.wait_for_selector(".jp-Notebook .jp-MarkdownOutput h1:has-text('Start here')")
    page.wait_for_timeout(3000)  # for what would be asked a moment later
    assert page.locator(".Toastify__toast, .jp-Dialog").count() == 0
