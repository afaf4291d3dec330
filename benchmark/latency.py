"""From a key on a slider of the explorer to the painted picture, in JupyterLab and Chromium."""

import contextlib
import re
import tempfile
from pathlib import Path

import numpy as np
import pandas as pd

from benchmark import browser

AGAINST = {2: "EKF", 1: "nothing"}  # {drives: what is chosen under "against"}
FIRST = 5  # moves of the slider that do not count: the first compile, and optimise beside
NEXT_MS = 250  # between a picture and the next key
# The clock of a move: from the key until the browser is through with the frame that follows the
# explorer's last drawing.
WATCH = """() => {
    window.pressed = window.took = 0
    document.addEventListener('keydown', () => window.pressed = performance.now(), true)
    const painted = () => window.took = performance.now() - pressed
    document.addEventListener('drawn', () => requestAnimationFrame(() => setTimeout(painted)))
}"""
OPTIMISED_MS = 15_000  # in which the compiler that runs beside the first moves is done


@contextlib.contextmanager
def opened():
    """A JupyterLab and an empty page of a Chromium, or None where one of them is missing."""
    try:
        from playwright import sync_api
    except ImportError:
        yield None
        return
    with contextlib.ExitStack() as stack:
        chromium = browser.launch(stack.enter_context(sync_api.sync_playwright()))
        if not chromium:
            yield None
            return
        stack.callback(chromium.close)
        home = stack.enter_context(tempfile.TemporaryDirectory())
        folder = stack.enter_context(tempfile.TemporaryDirectory())
        lab = stack.enter_context(browser.jupyter_lab(Path(home), Path(folder)))
        page = chromium.new_page(viewport=dict(width=1440, height=900))
        page.set_default_timeout(browser.PATIENCE_MS)
        yield lab, page


def measure(lab, page, moves=40):
    """Table of the times of moves of one slider, by the number of drives that are shown."""
    lab.open(page, "00_start.ipynb")
    lab.run(page)
    page.wait_for_selector(".rhec-canvas")
    page.evaluate("document.querySelector('.rhec').scrollIntoView()")
    page.evaluate(WATCH)
    page.locator(".rhec .lm-TabBar-tab", has_text="Controller").click()
    handle = page.locator(".rhec .widget-slider:visible .noUi-handle").first
    rows = []
    for drives, against in AGAINST.items():
        page.get_by_label("against", exact=True).select_option(label=against)
        handle.focus()
        moved(page, FIRST)
        page.wait_for_timeout(OPTIMISED_MS if moves > FIRST else 0)
        took_ms, ran_ms = np.transpose(moved(page, moves))
        low, median, high = 1e-3 * np.quantile(took_ms, (0.05, 0.5, 0.95))
        row = dict(drives=drives, moves=moves, picture_s_median=median)
        row |= dict(picture_s_low=low, picture_s_high=high)
        rows.append(row | dict(kernel_s_median=1e-3 * np.median(ran_ms)))
    return pd.DataFrame(rows)


def moved(page, moves):
    """[(time until the picture is painted, time in which the kernel drives)] of moves [ms]."""
    found = []
    for move in range(moves):
        page.evaluate("took = 0")
        page.keyboard.press(("ArrowRight", "ArrowLeft")[move % 2])
        page.wait_for_function("took")
        page.wait_for_timeout(NEXT_MS)
        status = page.inner_text(".rhec-status")
        found.append((page.evaluate("took"), float(re.search(r"in (\d+) ms", status)[1])))
    return found
