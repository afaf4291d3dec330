"""The answer to "did it reproduce?": its words follow from tables, and can come out either way."""

import pandas as pd
import pytest

from notebooks.studies import answer
from notebooks.studies.scenario_tables import PROCESS_NOISES

ERROR = "mean error, raw GNSS [m]"
VIOLATIONS = "violations on straights, raw GNSS"
PAPER = {("RHE", ERROR): 0.0423, ("EKF", ERROR): 0.0514}
PAPER |= {("RHE", VIOLATIONS): 0, ("EKF", VIOLATIONS): 17}


def scenario_b(errors):
    """A table of Scenario B with these mean errors {process noise: (RHE, EKF)}."""
    rows = []
    for noise, pair in errors.items():
        for quantity, scale in ((ERROR, 1.0), (VIOLATIONS, 300.0)):
            means = dict(zip(("RHE", "EKF"), [scale * error for error in pair]))
            for name, mean in means.items():
                rows.append((noise, name, quantity, mean, 0.5 * mean, 1.5 * mean, ""))
            gain = means["RHE"] - means["EKF"]
            rows.append(
                (noise, "RHE - EKF", quantity, gain, 0, 0, "holds" if gain < 0 else "does not hold")
            )
    columns = ["process_noise", "estimator", "quantity", "mean", "p5", "p95", "verdict"]
    table = pd.DataFrame(rows, columns=columns).assign(n=10)
    table["low"] = table["mean"] - 0.001
    table["high"] = table["mean"] + 0.001
    keys = zip(table["estimator"], table["quantity"])
    return table.assign(paper=[PAPER.get(key, -0.0091) for key in keys])


AS_IN_THE_PAPER = dict.fromkeys(PROCESS_NOISES, (0.0423, 0.0514))


def lines(errors):
    said = answer.scenario_b_in_words(scenario_b(errors)).splitlines()
    return dict(line.removeprefix("- **").split(": ", 1) for line in said)


def test_the_papers_own_numbers_are_met_in_its_order_by_every_rule():
    said = lines(AS_IN_THE_PAPER)
    assert said["The RHE's mean error"].startswith("yes.")
    assert "0.0423 m, within" in said["The RHE's mean error"]
    assert said["The EKF's mean error"].startswith("as printed: met.")
    assert "0.0514 m as printed (met)" in said["The EKF's mean error"]
    assert said["RHE before EKF"].startswith("yes, by every rule")
    assert said["What decides it"].startswith("perhaps the traction")
    assert answer.in_short(scenario_b(AS_IN_THE_PAPER)).startswith("Yes.")


def test_other_numbers_are_answered_otherwise():
    other = dict(
        AS_IN_THE_PAPER, printed=(0.08, 1.3), likelihood=(0.06, 0.05), tracking=(0.02, 0.021)
    )
    said = lines(other)
    assert said["The RHE's mean error"].startswith("no.")
    assert said["The EKF's mean error"].startswith("not as printed.")
    assert "loses its heading" in said["The EKF's mean error"]
    assert said["RHE before EKF"].startswith("it depends on the rule")
    assert "by likelihood: does not hold, 0.0600 against 0.0500 m" in said["RHE before EKF"]
    assert "As printed: the EKF is lost;" in said["RHE before EKF"]
    assert said["What decides it"].startswith("W, more than the traction")
    assert answer.in_short(scenario_b(other)).startswith("In part.")
    reversed_ = {noise: (0.06, 0.05) for noise in PROCESS_NOISES}
    assert lines(reversed_)["RHE before EKF"].startswith("no, by none")
    assert answer.in_short(scenario_b(reversed_)).startswith("No.")


def test_the_table_names_what_is_met_possible_and_lost(tmp_path):
    errors = dict(
        AS_IN_THE_PAPER, printed=(0.0423, 1.3), likelihood=(0.0423, 0.06), consistent=(0.0423, 0.11)
    )
    scenario_b(errors).to_csv(tmp_path / "table_scenario_b.csv", index=False)
    table = answer.paper_beside_ours(tmp_path).set_index(
        answer.paper_beside_ours(tmp_path).columns[0]
    )
    assert len(table) == 6 and list(table["the paper"])[:2] == ["0.0423", "0.0514"]
    verdicts = table["verdict"]
    assert verdicts["Mean error, RHE [m]"] == "met"
    assert verdicts["Mean error, EKF [m]"] == (
        "lost: as printed; not met: consistent; possible: by likelihood"
    )
    smaller = verdicts["The RHE's error is the smaller: RHE − EKF [m]"]
    assert smaller == "the EKF is lost: as printed; holds: consistent, by likelihood"


@pytest.mark.parametrize("best, word", [("Q3", "yes"), ("Q2", "no")])
def test_the_best_of_the_weights_is_the_one_with_the_least_error(best, word):
    rows = [
        (name, "mean error, true [m]", 0.03 if name == best else 0.05, "")
        for name in ("Q1", "Q2", "Q3")
    ]
    rows += [("Q1 / Q3", "settling time, ratio", 6.0, "holds")]
    rows += [("Q2 / Q3", "overshoot, ratio", 1.9, "undecided")]
    table = pd.DataFrame(rows, columns=["weight", "quantity", "mean", "verdict"])
    said = answer.scenario_a_in_words(table)
    assert f"Q¹ slow: yes; Q² overshoots: undecided; Q³ the best of the three: {word}." in said


def test_the_bar_counts_every_claim_once(tmp_path):
    claims = pd.DataFrame(dict(verdict=["holds"] * 4 + ["does not hold"] * 3, derived=False))
    claims.to_csv(tmp_path / "claims.csv", index=False)
    said = answer.bar(tmp_path, link="there")
    assert "Of the 7 sentences" in said
    assert "[🟩🟩 holds: 4](there)" in said and "[🟥🟥 does not hold: 3](there)" in said
