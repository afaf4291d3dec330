"""Names of log columns and metrics: docs/log_columns.md documents each."""

import itertools
import re
from pathlib import Path

import pytest

import rhec
from rhec.simulation import columns
from rhec.simulation.metrics import METRICS
from rhec.simulation.parts import row_of_log

pytestmark = pytest.mark.usefixtures("virtual_machine")
PAGE = (Path(__file__).parents[2] / "docs/log_columns.md").read_text(encoding="utf-8")
LISTS = [name for name in vars(columns) if name.isupper() and name != "LOG"]


def _columns_of(group):
    """Names in a constant of `columns`: one name, several, or the values of a dict."""
    if isinstance(group, str):
        return {group}
    return {*(group.values() if isinstance(group, dict) else group)}


def documented(title):
    """{name: (unit, meaning)} of the table below the heading that begins with a title."""
    (section,) = re.findall(rf"^## {title}.*?(?=^## |\Z)", PAGE, re.MULTILINE | re.DOTALL)
    rows = re.findall(r"^\| (`.*?`) \| (.*?) ?\| (.*) \|$", section, re.MULTILINE)
    return {
        name: (unit, text) for names, unit, text in rows for name in re.findall("`(.*?)`", names)
    }


def test_each_column_is_documented(run):
    of_run, of_recording, of_replay = map(documented, ("A run", "A recording", "A replay"))
    replayed = {*rhec.replay(run.log[:50], first_yaw_rad=0.0).columns}
    assert replayed <= of_run.keys() | of_replay.keys()
    assert {*columns.RECORDED.values(), *columns.RECORDED_TRUTH.values()} <= of_recording.keys()
    names = set().union(*(_columns_of(getattr(columns, name)) for name in LISTS))
    assert names <= of_run.keys() | of_recording.keys() | of_replay.keys()


def test_a_run_has_the_columns_that_the_page_says(run):
    described = documented("A run").keys()
    options = {*columns.SENSORS.values(), columns.YAW_DRIFT_HAT}
    assert {*run.log.columns} | options == described and not options & {*run.log.columns}
    fields = dict(sensors=(*columns.SENSORS,), yaw_drift=True)
    everything = rhec.simulate(rhec.Scenario(**fields, duration_s=1.0))
    assert {*everything.log.columns} == described


def test_a_flag_holds_where_both_that_it_stands_for_hold():
    """Both QPs are solved, or both entries of a measurement are taken."""
    row_of = row_of_log(4, has_yaw_drift=False)
    for flags in itertools.product((0, 1), repeat=6):
        row = row_of(ok_rhe=flags[0], ok_rhc=flags[1], accepted=flags[2:])["row"]
        found = dict(zip(columns.COLUMNS, row.full().ravel()))
        expected = [min(flags[place : place + 2]) for place in (0, 2, 4)]
        assert [found[name] for name in ("ok", *columns.GATE[:2])] == expected


def test_every_metric_is_documented_in_the_words_of_a_notebook(run):
    assert list(run.metrics) == list(METRICS)
    assert documented("Metrics") == METRICS
