"""The reckoned table of docs/campaigns.md follows from the measured costs above it."""

import re
from pathlib import Path

import pytest

TEXT = (Path(__file__).parents[2] / "docs/campaigns.md").read_text(encoding="utf-8")
UNITS = dict(s=1, h=3600, bytes=1, MB=1e6, GB=1e9)
POWERS = dict(zip("⁰¹²³⁴⁵⁶⁷⁸⁹", range(10)))


def cost(what):
    """A measured cost of a drive, as a number without its unit."""
    return float(re.search(rf"^\| {what}[^|]*\| ([\d.,]+)", TEXT, re.M)[1].replace(",", ""))


def test_the_reckoned_table_follows_from_the_measured_costs():
    seconds = cost("processor time, own workers") / 1000
    costs = [seconds, seconds / 100, cost("bytes to a worker"), cost("bytes kept")]
    costs.append(cost("memory of the caller"))
    rows = re.findall(r"^\| 10([⁰-⁹¹²³]) \| (.*) \|$", TEXT, re.M)
    assert [POWERS[power] for power, _ in rows] == [4, 5, 6, 7, 8, 9]
    for power, cells in rows:
        for cell, each in zip(cells.split(" | "), costs, strict=True):
            number, unit = cell.split()
            shown = float(number.replace(",", "")) * UNITS[unit]
            assert shown == pytest.approx(each * 10 ** POWERS[power], rel=0.02), (power, cell)
