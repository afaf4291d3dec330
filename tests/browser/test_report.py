"""The report of this project's own notebooks: its files, and its pages opened from disk with the
network cut.
"""

import re
from pathlib import Path
from urllib.parse import unquote

import pytest
from bs4 import BeautifulSoup
from helpers import wait_until

ROOT = Path(__file__).parents[2]
REPORT = ROOT / "build/report"
# The live page has a frame and tests of its own.
PAGES = sorted(
    file.relative_to(REPORT).as_posix()
    for file in REPORT.rglob("*.html")
    if file.name != "live.html" or file.parent != REPORT
)
# One of each kind.
SOME = ("index.html", "claims.html", "figures.html", "notebooks/03_scenario_a.html")
SOME += ("docs/reference/rhec.Scenario.html",)
SOME += ("live.html",) if (REPORT / "live.html").exists() else ()
AXE = ROOT / "build/axe/node_modules/axe-core/axe.min.js"  # npm install --prefix build/axe axe-core


@pytest.fixture
def offline(page):
    """A page whose failed requests and console errors fail the test."""
    page.context.set_offline(True)
    failed = []
    said = []
    page.on("requestfailed", lambda request: failed.append(request.url))
    page.on("console", lambda message: said.append((message.type, message.text)))
    yield page
    assert not failed
    assert not [text for kind, text in said if kind in ("error", "warning")]


@pytest.fixture(scope="module")
def soups():
    """{page: its HTML}."""
    assert PAGES, "build/report is empty; make report makes it"
    return {
        name: BeautifulSoup((REPORT / name).read_text("utf-8"), "html.parser") for name in PAGES
    }


def test_every_link_anchor_and_picture_is_there_and_every_page_is_reached(soups):
    ids = {name: {tag["id"] for tag in soup.select("[id]")} for name, soup in soups.items()}
    for name, soup in soups.items():
        for tag in soup.select("[href], [src]"):
            target = unquote(tag.get("href") or tag.get("src"))
            if target.startswith(("data:", "https://", "mailto:")):
                assert tag.name == "a" or target.startswith("data:"), f"{name} loads {target}"
                continue
            file, _, fragment = target.partition("#")
            place = (REPORT / name).parent / file.partition("?")[0] if file else REPORT / name
            assert place.is_file(), f"{name}: {target}"
            linked = place.resolve().relative_to(REPORT).as_posix()
            if fragment and linked in ids:
                assert fragment in ids[linked], f"{name}: {target}"
    links = soups["index.html"].select(".sidebar-tree a")
    reached = {link["href"].split("#")[0] for link in links} | {"index.html", "search.html"}
    assert {*soups} <= reached


def test_no_page_shows_a_path_a_warning_or_a_formula_as_text(soups):
    for name, soup in soups.items():
        text = soup.select_one("body").get_text()
        assert not re.search(r"Warning: |site-packages|Traceback \(most|/home/\w|/tmp/\w", text), (
            name
        )
        assert not soup.select(".stderr"), name
        assert not any("\\" in formula.get_text() for formula in soup.select("math")), name
        alternatives = [picture.get("alt") for picture in soup.select("article img")]
        assert all(alternatives), name
        # A formula is read aloud by its letters, not as "backslash hat".
        assert not any(re.search(r"[\\$]|mathrm|\bhat\w", text) for text in alternatives), name
        tables_as_text = [each for each in soup.select("p") if each.get_text().startswith("| ")]
        assert not tables_as_text, name


def test_no_file_names_the_machine_that_built_it():
    places = [str(ROOT).encode(), str(Path.home()).encode() + b"/"]
    for file in REPORT.rglob("*"):
        if file.suffix in (".html", ".js", ".css", ".txt", ".csv", ".svg"):
            content = file.read_bytes()
            assert not any(place in content for place in places), file


@pytest.mark.parametrize(
    "name",
    [pytest.param(name, marks=() if name in SOME else pytest.mark.nightly) for name in PAGES],
)
def test_a_page_shows_all_it_has(offline, name):
    page = offline
    page.goto((REPORT / name).as_uri())
    page.evaluate("document.querySelectorAll('img').forEach(image => image.loading = 'eager')")
    page.wait_for_load_state("load")
    page.evaluate(
        "Promise.all([...document.images].map(image => image.decode()))"
    )  # throws for a broken one
    for seen, least_px in (("article img", 100), ("math", 1)):
        widths = page.eval_on_selector_all(
            seen, "all => all.map(each => each.offsetWidth ?? each.getBoundingClientRect().width)"
        )
        assert all(width > least_px for width in widths)
    for width, height in [(1366, 768), (2560, 1440), (390, 844)]:
        page.set_viewport_size({"width": width, "height": height})
        assert page.evaluate("document.documentElement.scrollWidth") <= width, (
            f"wider than {width} pixels"
        )
    assert page.locator("h1").first.bounding_box()["y"] < 200  # on a phone, too


def test_the_search_finds_a_claim_and_a_function(offline):
    page = offline
    page.goto((REPORT / "search.html").as_uri() + "?q=simulate")
    page.wait_for_selector("#search-results li")
    links = page.eval_on_selector_all("#search-results li a", "all => all.map(a => a.href)")
    assert any("rhec.simulate.html" in link for link in links)


def shown(page):
    """Ids of the claims whose cards are visible."""
    return page.eval_on_selector_all(
        "section.claim", "all => all.filter(card => card.checkVisibility()).map(card => card.id)"
    )


def test_claims_are_filtered_and_searched_and_a_link_shows_its_card(offline):
    page = offline
    claims = (REPORT / "claims.html").as_uri()
    page.goto(claims)
    every = shown(page)
    for controls, expected in (
        (dict(section="IV-C EKF"), ["M7", "M8", "M9", "M12"]),
        (dict(section="IV-C EKF", words="CONSTRAINTS cannot"), ["M12"]),
        (dict(words="cannot constraints"), ["M12"]),
        (dict(section="IV-C EKF", verdict="does not hold"), ["M12"]),
        ({}, every),
    ):
        for name in ("section", "verdict"):
            page.select_option(f"select[name={name}]", controls.get(name, ""))
        page.fill("input[name=words]", controls.get("words", ""))
        assert shown(page) == expected
        assert page.inner_text(".claim-filter output") == f"{len(expected)} of {len(every)} claims"
    # The bar of verdicts leads here with one of them; a button unfolds what is shown.
    page.goto(claims + "?verdict=does+not+hold")
    refuted = shown(page)
    assert {"I2", "M12"} <= {*refuted} < {*every} and page.locator("h2:visible").count() < 12
    unfolded = "[...document.querySelectorAll('.claim details[open]')].map(e => e.parentElement.id)"
    for word, expected in (("Fold", refuted), ("Unfold", [])):
        page.click("button[name=unfold]")
        assert page.inner_text("button[name=unfold]") == word
        assert page.evaluate(unfolded) == expected
    page.evaluate("location.hash = 'B1'")  # which holds, and was hidden
    wait_until(page, "document.getElementById('B1').checkVisibility()")
    assert (shown(page), page.evaluate(unfolded)) == (every, ["B1"])


def test_all_claims_are_readable_without_scripts(chromium):
    context = chromium.new_context(java_script_enabled=False, offline=True)
    page = context.new_page()
    page.goto((REPORT / "claims.html").as_uri())
    cards = page.locator("section.claim")
    assert cards.count() and all(card.is_visible() for card in cards.all())
    assert not page.locator(".claim-filter").is_visible()
    context.close()


@pytest.mark.skipif(not AXE.exists(), reason="axe-core is not in build/axe")
@pytest.mark.nightly(keep=2)
@pytest.mark.parametrize("name", SOME)
def test_a_page_is_accessible(offline, name):
    """In the dark nothing but colours differ, so only contrasts are looked at again."""
    page = offline
    page.goto((REPORT / name).as_uri())
    page.evaluate(AXE.read_text())  # the page allows no other scripts than its own
    for scheme, options in (("light", {}), ("dark", {"runOnly": ["color-contrast"]})):
        page.emulate_media(color_scheme=scheme)
        found = page.evaluate(
            "options => axe.run(document, options).then(all => all.violations)",
            {"preload": False} | options,
        )
        grave = [
            (each["id"], [node["html"][:200] for node in each["nodes"][:3]], len(each["nodes"]))
            for each in found
            if each["impact"] in ("serious", "critical")
        ]
        assert not grave, scheme
