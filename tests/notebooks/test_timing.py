"""Computation times: those of a clock, and their table."""

from types import SimpleNamespace

import numpy as np
import pytest

import rhec
from notebooks.studies import timing
from rhec import paper


def test_each_phase_has_the_time_that_it_took(monkeypatch):
    """Of a clock on which a call takes as many µs as its place, and the references 9."""
    now_us = [0]

    def takes(us, answer=None):
        def call(*_, **__):
            now_us[0] += us
            return answer

        return call

    estimate = SimpleNamespace(pose=None, p=None)
    rhe = SimpleNamespace(prepare=takes(1), feedback=takes(2, estimate))
    rhc = SimpleNamespace(prepare=takes(3), feedback=takes(4))
    monkeypatch.setattr(timing.time, "perf_counter_ns", lambda: 1000 * now_us[0])
    monkeypatch.setattr(timing.rhec, "RHE", lambda **_: rhe)
    tracker = SimpleNamespace(references=takes(9, (None, None)))
    monkeypatch.setattr(timing, "PathTracker", lambda path: tracker)
    taken = timing.phases(rhec.Scenario(duration_s=2.0), lambda **_: rhc)
    np.testing.assert_array_equal(taken, [[1.0, 2.0, 3.0, 4.0]] * 9)


def test_table_1_is_the_papers_form_in_milliseconds():
    times = timing.table(np.array([[400.0, 60.0, 300.0, 20.0], [600.0, 80.0, 500.0, 40.0]]))
    shown = timing.as_in_the_paper(times)
    ours, papers = (shown[whose] for whose in shown.columns.levels[0])
    assert list(ours.loc[("RHE", "overall")]) == [0.46, 0.57, 0.68]
    for place, expected in paper.TABLE_1_MS.items():
        assert list(papers.loc[place]) == pytest.approx(expected)
    skewed = timing.table(np.array([[1.0, 2.0, 3.0, 4.0]] * 2 + [[9.0, 9.0, 9.0, 9.0]]))
    assert timing.feedback_over_preparation(skewed)["ratio"].to_dict() == dict(RHE=2, RHC=4 / 3)
