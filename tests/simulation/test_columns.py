"""Names of log columns: each is documented, once, where all of them are."""

import re

import rhec
from rhec.simulation import columns


def _documented(name):
    return re.search(rf"(?<!\w){name}(?!\w)", columns.__doc__)


def test_each_column_is_documented(run):
    named = [getattr(columns, name) for name in columns.__all__ if name != "LOG"]
    names = {column for group in named for column in group} | set(run.log.columns)
    names |= {*columns.RECORDED.values(), *columns.RECORDED_TRUTH.values()}
    names |= set(rhec.replay(run.log[:50], robust=True, first_yaw_rad=0.0).columns)
    assert not [name for name in names if not _documented(name)]


def test_a_run_has_its_columns_in_this_order(run):
    made = [column for column in run.log.columns if column in columns.COLUMNS]
    assert made == columns.COLUMNS == [name for group in columns.LOG.values() for name in group]
