"""RHE or EKF in the posterior's worlds: files hold what is fitted and driven."""

import numpy as np
import pandas as pd

from notebooks.studies import order_in_worlds, which_worlds


def test_the_file_of_noises_holds_what_is_fitted(monkeypatch):
    """In the world whose drives are the shortest, for the EKF; the RHE takes seconds."""
    monkeypatch.setattr(order_in_worlds, "ESTIMATORS", ("ekf",))
    worlds = which_worlds.posterior_worlds()
    rows = order_in_worlds._TRAINING_ROWS
    numbered = min(enumerate(worlds), key=lambda each: which_worlds.duration_s(rows, each[1]))
    (found,) = order_in_worlds._fitted_in(numbered)
    stored = pd.read_csv(order_in_worlds.NOISES).set_index(["world", "estimator"])
    assert found == (numbered[0], "ekf", *stored.loc[(numbered[0], "ekf")])


def test_the_file_of_drives_holds_what_is_driven_by_each_rule(monkeypatch):
    """In the first of the worlds, on its own path and on another one.

    Where a sample is just accepted or just not, another compiler's rounding decides.
    """
    noises = pd.read_csv(order_in_worlds.NOISES).query("world == 0")
    worlds = order_in_worlds.with_noises(which_worlds.posterior_worlds()[:1], noises)
    monkeypatch.setattr(order_in_worlds, "PATTERNS", ("right",))
    now = order_in_worlds.drive_by_rule(worlds).astype(float)
    then = order_in_worlds.order_drives().loc[[0]]
    assert len(now.columns) == 40
    np.testing.assert_allclose(now, then[now.columns], rtol=0.02)
