"""The story of the live page: its numbers are Python's, its questions have answers, and an address
holds what the reader chose.
"""

import random
import re

import numpy as np
import pytest
from helpers import LIVE_PAGE, needs_live_page, wait_until

import rhec
from rhec import paper
from rhec.simulation.columns import COLUMNS, MEASUREMENTS
from rhec.tracked_robot import tuning
from rhec.workbench.live.page import SCENES, SEEDS, SOILS, STORY

pytestmark = needs_live_page

# What a reader does to answer the question of each step.
ANSWERS = dict(
    encoders="time=18",
    filter="soil=firm",
    window="arrival=false",
    kalman="bounds=false",
    row="time=61",
    noise="sigma=0.0101",
)
HELD_BY_A_BOUND_S = 65.0


class Story:
    """The page, opened at an address, with all of its steps drawn."""

    def __init__(self, page):
        self.page = page

    def open(self, address=""):
        self.page.goto("about:blank")
        self.page.goto(LIVE_PAGE.as_uri() + address)
        self.settled()
        return self

    def settled(self):
        wait_until(
            self.page,
            "Object.keys(story.steps).length && page.busy && !asked && !story.wanted.size",
        )
        self.page.evaluate("Promise.all([story.busy, page.busy])")
        assert "live/" not in self.page.inner_text("#said")

    def answer(self, step):
        return self.page.inner_text(f"#step-{step} .answer")

    def sample(self, time_s, arrival=True):
        """Memories, estimates and costs of a sample of step 3, as numbers."""
        return self.page.evaluate(
            """([k, arrival]) => {
                const { loop, tools } = story.steps.window
                const { shifted, bounded, free } = take_sample(loop, tools, k, arrival)
                const names = ["s", "v", "z", "m", "P"]
                const after = (k + 1) * loop.data.memory.length + tools.data.first
                const size = bounded.memory.length
                const plain = value => ArrayBuffer.isView(value) ? [...value].map(String) : value
                const all = of => Object.fromEntries(
                    Object.entries(of).map(([name, value]) => [name, plain(value)]))
                return {
                    loop: plain(loop.at_memory.slice(after, after + size)),
                    row: plain(loop.at_row.subarray(0, loop.samples * WIDE)),
                    pieces: Object.fromEntries(names.map(name =>
                        [name, piece_of(tools, bounded.memory, name).map(c => c.map(String))])),
                    bounded: all(bounded), free: all(free), noises: all(noises(loop)),
                    costs: costs_of(tools, bounded.memory, noises(loop).V),
                }
            }""".replace("WIDE", str(len(COLUMNS))),
            [round(time_s / paper.DT_S), arrival],
        )


def floats(texts):
    """An array of numbers that came as text, which keeps their NaN."""
    return np.array(texts, dtype=float)


@pytest.fixture
def story(page):
    return Story(page)


@pytest.mark.parametrize("time_s", [0.6, 20.0, HELD_BY_A_BOUND_S])
def test_the_window_taken_apart_is_the_loops_own(story, time_s):
    """Shift and solve, on the memory before a sample, give the loop's memory after it."""
    seen = story.open().sample(time_s)
    np.testing.assert_allclose(floats(seen["bounded"]["memory"]), floats(seen["loop"]), atol=1e-9)


def test_window_and_costs_are_those_of_python(story):
    """The public RHE on the page's measurements, and the cost of its fit with plain matrices."""
    seen = story.open().sample(HELD_BY_A_BOUND_S)
    rows = floats(seen["row"]).reshape(-1, len(COLUMNS))
    z = rows[:, [COLUMNS.index(name) for name in MEASUREMENTS]]
    first = rows[0]
    guess = (0.0, paper.START_OFFSET_M, 0.0, paper.SPEED_MPS, 1.0, 1.0)
    mhe = rhec.RHE(process_noise="calibrated", guess=guess)
    last = round(HELD_BY_A_BOUND_S / paper.DT_S)
    assert np.all(np.isfinite(first[:3]))
    for z_N in z[: last + 1]:
        mhe.prepare()
        estimate = mhe.feedback(z_N)
    s, v, m, P = (floats(seen["pieces"][name]) for name in ("s", "v", "m", "P"))
    np.testing.assert_allclose(s[:, :3], mhe.x_window.T, atol=1e-6)
    np.testing.assert_allclose(v, mhe.u_window.T, atol=1e-6)
    np.testing.assert_allclose(floats(seen["bounded"]["estimate"]), estimate[:6], atol=1e-6)
    assert estimate.kappa == 1 and float(seen["free"]["estimate"][5]) > 1.02
    V = np.square(paper.SIGMA_V)
    window = z[last - 15 : last + 1]
    fitted = np.column_stack([s[:, :2], s[:, 3], np.append(window[0, 3], v[:, 0])])
    half = (window - fitted) ** 2 / V / 2
    nodes = np.column_stack([half[:, 0] + half[:, 1], half[:, 2], half[:, 3]])
    np.testing.assert_allclose(seen["costs"]["nodes"], nodes, atol=1e-9)
    gap = s[0] - m[0]
    np.testing.assert_allclose(seen["costs"]["arrival"], gap @ np.linalg.inv(P) @ gap / 2, 1e-6)


def test_the_filter_of_step_4_is_the_public_ekf(story):
    """And the window of one interval agrees with it to a fifth of a millimetre without bounds."""
    both, rows = story.open().page.evaluate(
        """() => {
            const { loop, tools } = story.steps.kalman
            return [compare(loop, tools, false), loop.samples && [...loop.at_row.subarray(
                0, loop.samples * WIDE)].map(String)]
        }""".replace("WIDE", str(len(COLUMNS)))
    )
    z = floats(rows).reshape(-1, len(COLUMNS))[:, [COLUMNS.index(name) for name in MEASUREMENTS]]
    one, kalman = np.swapaxes(np.array(both), 0, 1)
    ekf = rhec.EKF(
        model=rhec.RHE().model,
        dt=paper.DT_S,
        sigma_v=paper.SIGMA_V,
        sigma_w=tuning.SIGMA_W["rhe"]["calibrated"],
        guess=(0.0, paper.START_OFFSET_M, 0.0, paper.SPEED_MPS, 1.0, 1.0),
        sigma_guess=paper.SIGMA_W_RHE,
    )
    for k, z_N in enumerate(z):
        estimate = ekf.feedback(z_N)
        np.testing.assert_allclose(kalman[k], [*estimate.x, *estimate.p], atol=1e-6)
    gap_m = np.linalg.norm(one[25:, :2] - kalman[25:, :2], axis=1)
    assert 1e-6 < gap_m.max() < 2e-4


def test_dead_reckoning_starts_true_and_ends_wrong(story):
    found = story.open().page.evaluate(
        """() => {
            const { loop, tools } = story.steps.encoders
            return reckon(loop, tools).map((pose, k) => far(pose, pose_of(loop, k)))
        }"""
    )
    assert found[0] == 0 and found[5] < 0.1 and max(found) > 3


@pytest.mark.parametrize("step", ANSWERS)
def test_a_question_is_open_until_the_reader_does_it(story, step):
    assert story.open().answer(step).startswith("Not yet")
    address = f"#step-{step}?{ANSWERS[step]}"
    assert story.open(address).answer(step).startswith("✓"), story.answer(step)
    assert story.page.get_attribute(f"#step-{step} .here", "href") == address


def test_the_last_question_is_about_the_sandbox(story):
    assert story.open().answer("sandbox").startswith("Not yet")
    story.open("#b")
    assert re.match(r"Not yet: \d", story.answer("sandbox"))
    story.open("#b?patches=34,1.5,4,0.5,0.35")
    assert story.answer("sandbox").startswith("✓")


def test_preparation_and_feedback_are_two_steps_of_a_sample(story):
    story.open()
    told = story.page.locator("#step-window .told")
    button = story.page.locator("#step-window button")
    said = []
    for _ in range(3):
        said.append(told.inner_text().partition(":")[0])
        button.press("Enter")
        story.settled()
    assert said == [
        "Feedback at 50.0 s",
        "Preparation (no bounds yet) at 50.2 s",
        "Feedback at 50.2 s",
    ]


@pytest.mark.parametrize("scene", SCENES)
def test_an_address_holds_all_of_the_sandbox(story, scene):
    """Lists, sliders, patches, the followed run and the moment come back from a link."""
    story.open(f"#{scene}")
    chance = random.Random(scene)
    page = story.page
    page.select_option("#seed", str(chance.choice(SEEDS)))
    page.select_option("#soil", chance.choice([*SOILS]))
    page.locator(f"[name=run-{scene}][value='1']").check()
    page.click("#patch")
    story.settled()
    for slider in page.locator("#sliders input[type=range]:enabled, #moment").all():
        if chance.random() < 0.5:
            slider.fill(slider.get_attribute("max"))
    story.settled()
    state = "[page.followed, $('moment').value, $('line').textContent, page.patches]"
    before = page.evaluate(state)
    # The address is written a moment after the last change.
    wait_until(page, "location.hash === address_of_sandbox()")
    address = page.evaluate("location.hash")
    assert address.startswith(f"#{scene}?")
    story.open(address)
    assert page.evaluate(state) == before
    page.evaluate(f"location.hash = '{scene}'")
    page.wait_for_timeout(100)
    story.settled()
    assert page.evaluate("page.patches") == [] and page.evaluate("page.followed") == 0


def test_an_absurd_address_does_no_harm(story):
    story.open("#b?seed=99&q=1&gnss_sigma_m=x&patches=1,2;a&moment=?&follow=7&9.q=1&__proto__=1")
    assert story.page.evaluate("page.scene") == "b"
    assert story.page.evaluate("page.patches.length") == 0
    story.open("#step-nowhere?time=1")
    story.open("#step-window?time=never&soil=moon&arrival=maybe&next=1")


def test_without_scripts_the_story_is_text_and_still_pictures(chromium):
    context = chromium.new_context(java_script_enabled=False)
    page = context.new_page()
    page.goto(LIVE_PAGE.as_uri())
    for step, words in STORY.items():
        section = page.locator(f"#step-{step}")
        assert words["title"] in section.inner_text() and words["question"] in section.inner_text()
        stills = section.locator("svg.still")
        assert stills.count() == bool(words["captions"])
        for still in stills.all():
            assert still.bounding_box()["height"] > 100
            assert still.locator("polyline").count() >= 1
        assert not any(canvas.is_visible() for canvas in section.locator("canvas").all())
    context.close()


@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_every_canvas_of_the_story_has_ink(story, scheme):
    story.page.emulate_media(color_scheme=scheme)
    inks = story.open().page.evaluate(
        """() => Object.values(story.steps).flatMap(({ canvases }) => canvases.map(canvas => {
            const { data } = canvas.getContext("2d")
                .getImageData(0, 0, canvas.width, canvas.height)
            let found = 0 // of colour, which neither grid nor words have
            for (let i = 0; i < data.length; i += 4) found += data[i + 3] > 60
                && Math.max(...data.slice(i, i + 3)) - Math.min(...data.slice(i, i + 3)) > 60
            return found
        }))"""
    )
    assert len(inks) == sum(len(step["captions"]) for step in STORY.values())
    assert min(inks) > 50, inks
