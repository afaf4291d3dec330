"""How long the report's live page takes from a key on a slider to the picture painted.

    cd tests && python -m benchmark.live

It opens build/report/live.html in a headless Chromium, presses arrow keys on a slider of each
scene, and prints medians and 95th percentiles [ms].
"""

import shutil
from pathlib import Path

import numpy as np
from playwright.sync_api import sync_playwright

PAGE = Path(__file__).parents[2] / "build/report/live.html"
PRESSES = 100
# A key press counts from its event to the frame after which nothing is left to paint.
WATCH = """() => {
    window.taken = []
    let pressed = 0
    document.addEventListener('input', event => { pressed = event.timeStamp }, true)
    document.addEventListener('drawn', () => requestAnimationFrame(() =>
        setTimeout(() => taken.push(performance.now() - pressed))))
}"""


def main():
    with sync_playwright() as playwright:
        path = shutil.which("chromium") or playwright.chromium.executable_path
        browser = playwright.chromium.launch(executable_path=path, args=["--no-sandbox"])
        for scene, runs in {"a": "three runs of 120 s", "b": "two runs of 240 s"}.items():
            page = browser.new_page(viewport={"width": 1366, "height": 900})
            page.goto(f"{PAGE.as_uri()}#{scene}")
            page.wait_for_function("page.loops?.length && !asked")
            loaded = page.evaluate("performance.now()")
            page.evaluate(WATCH)
            page.locator("#sliders input[data-field=speed_mps]").focus()
            for number in range(PRESSES):
                page.keyboard.press("ArrowLeft" if number % 2 else "ArrowRight")
                page.wait_for_function(f"taken.length > {number}", polling=20)
            taken = np.array(page.evaluate("taken"))[10:]  # the first are compiled on the way
            half, most = np.percentile(taken, [50, 95])
            print(f"{runs}: {half:.0f} ms, 95 % within {most:.0f} ms, n = {len(taken)}", end="; ")
            print(f"shown {loaded:.0f} ms after it was opened")
            page.close()
        browser.close()


if __name__ == "__main__":
    main()
