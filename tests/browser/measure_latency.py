"""How long it takes from a key on a slider of the explorer to the painted picture, with the load.

    .venv/bin/python -m pytest -s tests/browser/measure_latency.py

It measures and asserts no time.
"""

import os

import numpy as np
import pytest

KEYS = 40
FIRST = 10  # keys that are not counted: the loop is compiled and optimised, and so is the page
# A frame is painted when the message that its first callback sends arrives.
WATCH = """() => {
    window.took = []
    let pressed = null
    document.addEventListener('keydown', () => { pressed = performance.now() }, true)
    document.addEventListener('drawn', () => requestAnimationFrame(() => {
        const { port1, port2 } = new MessageChannel()
        port1.onmessage = () => {
            if (pressed !== null) took.push(performance.now() - pressed)
            pressed = null
        }
        port2.postMessage(null)
    }))
}"""


@pytest.mark.parametrize("against", ["EKF", "nothing"])
def test_time_from_a_key_to_the_picture(lab, open_page, against):
    with open_page(1440, 900) as page:
        lab.open(page, "00_start.ipynb")
        lab.run(page)
        page.wait_for_selector(".rhec-canvas")
        page.locator(".rhec .widget-dropdown", has_text="against").locator("select").select_option(
            label=against
        )
        page.locator(".rhec .lm-TabBar-tab", has_text="Controller").click()
        slider = page.locator(".rhec .widget-slider:visible", has=page.get_by_text("R", exact=True))
        slider.locator(".noUi-handle").focus()
        page.evaluate(WATCH)
        for key in range(FIRST + KEYS):
            page.keyboard.press("ArrowRight" if key % 20 < 10 else "ArrowLeft")
            page.wait_for_function(f"took.length > {key}")
            page.wait_for_timeout(200)
        took = page.evaluate("took")[FIRST:]
        status = page.inner_text(".rhec-status")
        lab.close(page)
    load = os.getloadavg()[0]
    median, most = np.quantile(took, [0.5, 0.95])
    print(f"\n{status}: median {median:.0f} ms, 95 % below {most:.0f} ms, load {load:.1f}")
