"""The cards of the claims: they say what the ledger says, and their pictures are to scale."""

import itertools
import re
import tomllib
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from bs4 import BeautifulSoup

from docs.site import cards
from notebooks.studies.tables import interval_text, with_minus

ROOT = Path(__file__).parents[2]
CLAIMS_CSV = pd.read_csv(ROOT / "data/results/claims.csv")
ROWS = CLAIMS_CSV.astype(object).where(CLAIMS_CSV.notna(), "").to_dict("records")
ROUND = {"1.000", "2.000", "5.000"}
DRAWN = [row for row in ROWS if row["value"] != ""]
# Ratios that are all but alike, of the same order, and of several ones.
RATIO = next(row for row in DRAWN if row["unit"] == "ratio") | dict(paper="", other_n=0)
RATIOS = [
    RATIO | dict(id=f"ratio {high}", value=1.02, low=1.01, high=high, above=0.99, below=np.inf)
    for high in (1.04, 1.9, 7.0, 25.0, 40.0, 3000.0)
]


def number_of(text):
    """The number that a text with a minus shows."""
    return float(text.replace("−", "-"))


def parsed(live=False, claims=CLAIMS_CSV):
    """The page as HTML, {id: card}."""
    html = "".join(re.findall(r"```{raw} html\n(.*?)\n```", cards.page(claims, live), re.DOTALL))
    soup = BeautifulSoup(html, "html.parser")
    return soup, {card["id"]: card for card in soup.select("section.claim")}


@pytest.fixture(scope="module")
def page():
    return parsed()


def test_each_claim_has_a_card_with_all_that_the_ledger_says(page):
    _, all_cards = page
    assert [*all_cards] == [row["id"] for row in ROWS]
    for row in ROWS:
        text = " ".join(all_cards[row["id"]].get_text().split())
        said = [row["quote"], row["section"], row["verdict"], f"make claim ID={row['id']}"]
        ours = [row[name] for name in ("claim", "why", "beside", "paper")]
        said += [with_minus(str(each)) for each in (*ours, row["test"].removeprefix("-"))]
        said += ["by derivation"] if row["derived"] else []
        said += ["share of the posterior’s worlds"] if row["posterior_n"] else []
        if row["n"]:
            said += [interval_text(row["value"], row["low"], row["high"]), f"n = {row['n']}"]
        assert [part for part in said if " ".join(part.split()) not in text] == []
        has_unit = f"the paper{row['paper']} {row['unit']}" in text
        assert not (has_unit and row["unit"].startswith("share"))
        for prefix in ("", "other_"):
            if condition := row[f"{prefix}condition"]:
                number = interval_text(*(row[f"{prefix}{of}"] for of in ("value", "low", "high")))
                assert f"here, {condition}{number}" in text
        picture = all_cards[row["id"]].svg
        assert bool(picture) == (row["value"] != "")
        if picture:  # in words, for who does not see it
            label = picture["aria-label"]
            assert label.startswith(
                f"Interval: {interval_text(row['value'], row['low'], row['high'])}"
            )
            assert ("; the rule: " in label) == (row["bound"] != "") and "nan" not in label
            is_number = re.fullmatch(r"[-\d.e]+", str(row["paper"]))
            assert ("; the paper: " in label) == bool(is_number), row["id"]
            assert ("; under the other condition " in label) == bool(row["other_n"])
        shown = [item.get_text() for item in all_cards[row["id"]].select(".claim-conditions li")]
        expected = [part for part in row["conditions"].split("; ") if not part.startswith(":")]
        assert [text.partition(" ")[2] for text in shown] == expected


def test_the_overview_links_every_card_and_the_filter_counts_them(page):
    soup, all_cards = page
    links = [link["href"][1:] for link in soup.select(".claim-map a")]
    assert links == [*all_cards]
    for name in ("verdict", "section"):
        options = soup.select(f"select[name={name}] option")[1:]
        counts = {each["value"]: int(re.search(r"\((\d+)\)", each.text)[1]) for each in options}
        values = [card[f"data-{name}"] for card in all_cards.values()]
        assert counts == {value: values.count(value) for value in dict.fromkeys(values)}


def test_a_card_links_the_live_page_only_where_there_is_one(page):
    assert "live.html" not in str(page[0])
    scenes = tomllib.loads((ROOT / "docs/live/scenes.toml").read_text(encoding="utf-8"))
    wanted = {name for ids in cards.LIVE.values() for name in ids.split()}
    some = CLAIMS_CSV["id"].isin(wanted) | (CLAIMS_CSV.index < 5)
    _, all_cards = parsed(live=True, claims=CLAIMS_CSV[some])
    linked = {id_ for id_, card in all_cards.items() if "live.html" in str(card)}
    assert linked == wanted != {*all_cards}
    for address, ids in cards.LIVE.items():
        assert address.partition("&")[0] in scenes
        for name in ids.split():
            assert all_cards[name].select_one(f'a[href="live.html#{address}"]')


@pytest.mark.parametrize("row", [*DRAWN, *RATIOS], ids=lambda row: row["id"])
def test_places_on_the_scale_are_linear_in_the_numbers_and_fill_the_picture(row):
    """In their logarithms if they are ratios; shares go from 0 to 1, 14 px from the edges."""
    drawn = cards.interval(row)
    bounds = sorted({bound for bound in (row["above"], row["below"]) if np.isfinite(bound)})
    shown = []
    for kind, _, *places in drawn["rows"]:
        prefix = dict(here="", other="other_")[kind]
        value, *ends = (row[f"{prefix}{name}"] for name in ("value", "low", "high"))
        shown += zip([value, *(value if end == "" else end for end in ends)], places)
    shown += zip(bounds, drawn["limits"], strict=True)
    shown += [(float(row["paper"]), drawn["paper"])] if drawn["paper"] is not None else []
    ticks = [(number_of(text), at) for at, text in drawn["ticks"]]
    numbers, places = np.transpose([*shown, *ticks]).astype(float)
    is_ratio = row["unit"] == "ratio" and numbers.min() > 0
    numbers = np.log(numbers) if is_ratio else numbers
    line = np.polyfit(numbers, places, 1)
    np.testing.assert_allclose(np.polyval(line, numbers), places, atol=0.3)
    assert line[0] > 0
    if row["unit"].startswith("share"):
        np.testing.assert_allclose(np.polyval(line, [0, 1]), [14, 346], atol=0.1)
    else:  # a little room on both sides
        places = [at for _, at in shown]
        assert min(places) + max(places) == pytest.approx(360, abs=0.2)
        assert 26 < min(places) < 42
    # Where the claim holds reaches from bound to bound, or to an edge.
    (begin, width) = drawn["inside"]
    limits = dict(zip(bounds, drawn["limits"]))
    expected = limits.get(row["above"], 14), limits.get(row["below"], 346)
    assert (begin, begin + width) == pytest.approx(expected)
    # Ticks are round, and their characters, about 6 wide, stand apart.
    numbers = [number for number, _ in ticks]
    are_even = np.allclose(np.diff(numbers), numbers[1] - numbers[0])
    assert are_even or {f"{number:e}"[:5] for number in numbers} <= ROUND
    assert 1 < len(ticks) < 10
    for (at, text), (next_at, next_text) in itertools.pairwise(sorted(drawn["ticks"])):
        assert next_at - at > 6 * (len(text) + len(next_text)) / 2


def test_a_lost_rival_far_away_leaves_the_others_apart():
    """Our number and the paper's are as far apart as on a card without that rival."""
    row = next(row for row in DRAWN if row["id"] == "B5")
    rival = dict(other_n=9, other_low="", other_high="")
    alone = cards.interval(row | dict(other_n=0, other_value="")) | dict(words="")
    value = float(row["value"])
    reach = np.ptp([value, 0.0, float(row["paper"])])
    for times, is_beyond in ((3, False), (5, True)):
        drawn = cards.interval(row | rival | dict(other_value=value + times * reach))
        assert (drawn["beyond"] is not None) == is_beyond
        assert len(drawn["rows"]) == 2 - is_beyond
    for far, ends in ((-1e3, {}), (1e3, {}), (1e3, dict(other_low=900.0, other_high=1100.0))):
        drawn = cards.interval(row | rival | dict(other_value=far) | ends)
        assert drawn | dict(beyond=None, words="") == alone
        _, edge, side, number = drawn["beyond"]
        assert side == np.sign(far) and side * (edge - 180) > 160 and number_of(number) == far
        assert with_minus(str(int(far))) in drawn["words"]


def test_text_of_the_ledger_stays_text():
    claims = CLAIMS_CSV.head(3).assign(claim="<script>alert(1)</script>", why='"><img src=x>')
    soup, all_cards = parsed(claims=claims)
    assert [script["src"] for script in soup.select("script")] == ["_static/claims.js"]
    assert not soup.select("img")
