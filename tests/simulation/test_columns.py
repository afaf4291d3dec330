"""Names of log columns: each is documented, once, where all of them are."""

import re
import runpy
from pathlib import Path

import rhec
from rhec.simulation import columns, log_page

LISTS = [name for name in vars(columns) if name.isupper() and name != "LOG"]


def _columns_of(group):
    """Names in a constant of `columns`: one name, several, or the values of a dict."""
    if isinstance(group, str):
        return {group}
    return {*(group.values() if isinstance(group, dict) else group)}


def _documented(name):
    return re.search(rf"(?<!\w){name}(?!\w)", log_page.__doc__)


def test_each_column_is_documented(run):
    names = set(run.log.columns).union(*(_columns_of(getattr(columns, name)) for name in LISTS))
    names |= {*columns.RECORDED.values(), *columns.RECORDED_TRUTH.values()}
    names |= set(rhec.replay(run.log[:50], first_yaw_rad=0.0).columns)
    assert not [name for name in names if not _documented(name)]
    assert not names - log_page.COLUMNS_BY_NAME.keys()


def test_a_run_has_the_columns_that_the_table_says(run):
    described = [n for n, column in log_page.COLUMNS_BY_NAME.items() if "run" in column.tables]
    sensors = {*columns.SENSORS.values()}
    assert {*run.log.columns} | sensors == {*described} and not sensors & {*run.log.columns}
    both = rhec.simulate(rhec.Scenario(sensors=(*columns.SENSORS,), duration_s=1.0))
    assert {*both.log.columns} == {*described}


def test_a_run_has_its_columns_in_this_order(run):
    made = [column for column in run.log.columns if column in columns.COLUMNS]
    assert made == columns.COLUMNS == [name for group in columns.LOG.values() for name in group]


def test_every_metric_is_documented(run):
    assert list(run.metrics) == list(log_page.METRICS)


def test_the_page_of_columns_is_the_one_that_the_tables_make(capsys):
    page = Path(__file__).parents[2] / "docs" / "log_columns.md"
    runpy.run_path(log_page.__file__, run_name="log_page")
    assert capsys.readouterr().out == ""
    runpy.run_path(log_page.__file__, run_name="__main__")
    assert page.read_text(encoding="utf-8") == capsys.readouterr().out, (
        "python -m rhec.simulation.log_page > docs/log_columns.md makes it anew"
    )
