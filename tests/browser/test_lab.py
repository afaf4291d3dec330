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
    own = ("JUPYTER", "DISPLAY", "WAYLAND_DISPLAY")
    others = {name: value for name, value in os.environ.items() if not name.startswith(own)}
    lab = subprocess.Popen(
        [sys.executable, "-m", "rhec", "lab"],
        cwd=ROOT,
        env=others | {"HOME": str(tmp_path), "JUPYTER_PORT": str(port)},
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        start_new_session=True,
    )
    found = (re.search(rf"http://127\.0\.0\.1:{port}/lab\S*", line) for line in lab.stdout)
    printed = next(filter(None, found))[0]
    while not answers(port):  # it is printed a moment before
        time.sleep(0.1)
    yield printed
    os.killpg(lab.pid, signal.SIGTERM)
    lab.communicate()


def test_it_opens_on_the_first_notebook_and_asks_nothing(page, address):
    page.goto(address)
    page.wait_for_selector(".jp-DirListing-item[title*='01_tutorial.ipynb']")
    page.wait_for_selector(".jp-Notebook .jp-MarkdownOutput h1:has-text('Start here')")
    page.wait_for_timeout(3000)  # for what would be asked a moment later
    assert page.locator(".Toastify__toast, .jp-Dialog").count() == 0
