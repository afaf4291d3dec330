"""RHE and RHC sample by sample beside the code that the ACADO Toolkit generates, which the paper
used (docs/acado.md): 200 samples in each of four cases, of which ACADO's answers lie in
data/acado.npz.
"""

from pathlib import Path

import numpy as np
import pytest

import rhec

GIVEN = np.load(Path(__file__).parents[2] / "data" / "acado.npz")
CASES = sorted({name.split("/")[0] for name in GIVEN.files})
UPPER = np.triu_indices(6)
EVERY = 10  # of windows, plans and covariances, every tenth sample is stored


def case_of(name):
    """Inputs and ACADO's answers of a case, by name; all in double precision."""
    prefix = f"{name}/"
    names = [entry for entry in GIVEN.files if entry.startswith(prefix)]
    return {entry.removeprefix(prefix): GIVEN[entry].astype(float) for entry in names}


def estimator_of(name, given, arrival_mean=None):
    return rhec.RHE(
        sigma_v=tuple(np.sqrt(given["V"])),
        sigma_w=tuple(np.sqrt(given["W"])),
        guess=tuple(given["guess"]),
        arrival_mean=arrival_mean or ("smoothed" if "smoothed" in name else "filtered"),
    )


def estimated(rhe, given):
    """What the RHE answers at each sample, under the names of the file."""
    rows = {name: [] for name in ("estimate", "arrival_mean", "kkt_rhe", "covariance")}
    rows |= dict(window_x=[], window_omega=[], arrival_covariance=[])
    for k, z in enumerate(given["z"]):
        rhe.prepare()
        estimate = rhe.feedback(z)
        rows["estimate"].append(np.array(estimate[:6]))
        rows["arrival_mean"].append(rhe.iteration.current["m"].copy())
        rows["kkt_rhe"].append(rhe.kkt)
        if k % EVERY == 0:
            rows["covariance"].append(estimate.covariance[UPPER])
            rows["arrival_covariance"].append(rhe.iteration.current["P"].reshape(6, 6)[UPPER])
            rhe.iteration.expand()
            rows["window_x"].append(rhe.iteration.previous["s"].reshape(16, 6).copy())
            rows["window_omega"].append(rhe.iteration.previous["v"].copy())
    return {name: np.array(values) for name, values in rows.items()}


def planned(rhc, given):
    """What the RHC answers to ACADO's own estimates."""
    rows = dict(plan=[], kkt_rhc=[], plan_x=[])
    for k, estimate in enumerate(given["estimate"]):
        rhc.prepare()
        omega_ref = np.full(15, given["omega_ref"][k])
        rhc.feedback(estimate[:3], estimate[3:], given["xi_ref"][k], omega_ref)
        rows["plan"].append(rhc.omega_plan.copy())
        rows["kkt_rhc"].append(rhc.kkt)
        if k % EVERY == 0:
            rows["plan_x"].append(rhc.xi_plan.T.copy())
    return {name: np.array(values) for name, values in rows.items()}


def largest_difference(name, ours, theirs):
    """Absolute; of KKT tolerances and covariances relative, where ACADO gives one."""
    scale = np.ones_like(theirs)
    if name.startswith("kkt"):
        scale = np.maximum(theirs, 1e-3)
    if name.endswith("covariance"):
        rows, columns = UPPER
        on_diagonal = np.flatnonzero(rows == columns)
        scale = np.sqrt(ours[:, on_diagonal[rows]] * ours[:, on_diagonal[columns]])
    differences = np.abs(ours - theirs) / scale
    # ACADO's covariance has NaN where μ or κ is at a bound, which ours leaves aside.
    assert np.isfinite(differences).mean() > (0.1 if name == "covariance" else 0.99)
    return np.nanmax(differences)


@pytest.mark.parametrize("name", CASES)
def test_estimator_and_controller_equal_acados_generated_code(name):
    given = case_of(name)
    answers = estimated(estimator_of(name, given), given)
    answers |= planned(rhec.RHC(q=tuple(given["Q"])), given)
    tolerance = 1e-6 if "gaps" in name else 1e-7
    for entry, ours in answers.items():
        assert ours.shape == given[entry].shape, entry
        assert largest_difference(entry, ours, given[entry]) < tolerance, entry


def test_the_comparison_tells_one_arrival_mean_from_the_other():
    name = next(name for name in CASES if "filtered" in name)
    given = case_of(name)
    answers = estimated(estimator_of(name, given, "smoothed"), given)
    assert largest_difference("estimate", answers["estimate"], given["estimate"]) > 1e-3


def test_the_cases_reach_bends_bounds_and_gaps():
    """Without these the comparison would not see the bounded QPs and the missing measurements."""
    cases = [case_of(name) for name in CASES]
    assert sum(np.isnan(case["z"]).any() for case in cases) == 1
    assert any((np.abs(np.abs(case["plan"]) - 0.1) < 1e-9).any() for case in cases)
    assert any((case["estimate"][:, 4:] > 1 - 1e-9).any() for case in cases)
    assert all(np.ptp(case["omega_ref"]) > 0.05 for case in cases)
