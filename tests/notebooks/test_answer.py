"""The answer to "did it reproduce?": its words follow from tables, and can come out either way."""

import pandas as pd
import pytest

from notebooks.studies import answer
from notebooks.studies.scenario_tables import PROCESS_NOISES
from notebooks.studies.statistics import (
    FAILS,
    HOLDS,
    LOST,
    LOST_ITSELF,
    MET,
    NOT_MET,
    POSSIBLE,
    UNDECIDED,
)

ERROR = "mean error, raw GNSS [m]"
VIOLATIONS = "violations on straights, raw GNSS"
CLEAN = "share of drives without a violation"
TURNS = ("alternate", "left", "right", "figure_of_eight")
PAPER = {("RHE", ERROR): 0.0423, ("EKF", ERROR): 0.0514}
PAPER |= {("RHE", VIOLATIONS): 0, ("EKF", VIOLATIONS): 17}
AS_IN_THE_PAPER = dict.fromkeys(PROCESS_NOISES, (0.0423, 0.0514))


def rows_of(turns, noise, errors, clean):
    """The rows of a table of Scenario B on one pattern of turns and one rule for W."""
    about = dict(turns=turns, process_noise=noise, n=10)
    for quantity, scale in ((ERROR, 1.0), (VIOLATIONS, 17 / 0.0514)):
        means = dict(zip(("RHE", "EKF"), [scale * error for error in errors]))
        half = 0.01 * scale * 0.05
        for name, mean in means.items():
            single = dict(p5=0.8 * mean, p95=1.2 * mean, paper=PAPER[name, quantity])
            interval = dict(mean=mean, low=mean - half, high=mean + half)
            yield about | interval | single | dict(estimator=name, quantity=quantity)
        gain = means["RHE"] - means["EKF"]
        interval = dict(mean=gain, low=gain - half, high=gain + half)
        yield about | interval | dict(estimator="RHE - EKF", quantity=quantity, paper=-0.0091)
        share = dict(mean=float(gain < 0), low=0.0, high=1.0)
        yield about | share | dict(estimator="P(RHE < EKF)", quantity=quantity)
    for name in ("RHE", "EKF"):
        share = dict(mean=clean, low=clean - 0.02, high=clean + 0.02)
        yield about | share | dict(estimator=name, quantity=CLEAN)


def scenario_b(errors, clean=0.5, turns=TURNS, instead=None):
    """A table of Scenario B with these mean errors {process noise: (RHE, EKF)}.

    `instead` has others, {(turns, process noise): (RHE, EKF)}.
    """
    rows = []
    for pattern in turns:
        for noise, pair in errors.items():
            pair = (instead or {}).get((pattern, noise), pair)
            rows += rows_of(pattern, noise, pair, clean)
    return pd.DataFrame(rows)


def mirrored(table):
    """The table of a world in which RHE and EKF have changed places."""
    names = {"RHE": "EKF", "EKF": "RHE"}
    other = table.replace(dict(estimator=names))
    gains = other["estimator"] == "RHE - EKF"
    other.loc[gains, ["mean", "low", "high"]] = -other.loc[
        gains, ["mean", "high", "low"]
    ].to_numpy()
    shares = other["estimator"] == "P(RHE < EKF)"
    other.loc[shares, "mean"] = 1 - other.loc[shares, "mean"]
    keys = zip(other["estimator"], other["quantity"])
    return other.assign(paper=[PAPER.get(key, -0.0091) for key in keys])


def test_the_papers_own_numbers_are_met_in_its_order_whichever_way_the_path_turns():
    said = answer.in_short(scenario_b(AS_IN_THE_PAPER, clean=0.99))
    assert said.startswith("Yes: the RHE is better than the EKF by every rule")
    assert "whichever way the path turns" in said
    assert said.endswith("is that of the paper (0.0423 for 0.0423 m).")


def test_a_world_with_the_signs_reversed_gives_the_other_sentence():
    """Who is worse here is better there, and nothing but the table says so."""
    table = scenario_b(dict.fromkeys(PROCESS_NOISES, (0.03, 0.07)))
    said, other = answer.in_short(table), answer.in_short(mirrored(table))
    assert "the RHE is better than the EKF by every rule" in said
    assert "the RHE is worse than the EKF by every rule" in other
    assert "smaller than the paper's (0.0300 for 0.0423 m)" in said
    assert "larger than the paper's (0.0700 for 0.0423 m)" in other
    assert said.startswith("In part:") and other.startswith("No:")
    # Each verdict on the order turns with it.
    first, back = (answer.Numbers(each) for each in (table, mirrored(table)))
    for rule in PROCESS_NOISES:
        assert (first.order(ERROR, rule), back.order(ERROR, rule)) == (HOLDS, FAILS)
        assert first.order(VIOLATIONS, rule) == HOLDS and back.order(VIOLATIONS, rule) == FAILS


def test_an_order_that_turns_with_the_path_is_said_with_the_cases_in_which_it_does():
    """The one that nobody had looked at: the other hand of the path."""
    errors = AS_IN_THE_PAPER | dict(printed=(0.0423, 1.3))
    said = answer.in_short(scenario_b(errors, instead={("left", "prediction"): (0.0462, 0.0431)}))
    assert said.startswith("In part: the RHE is better than the EKF in 11 of 12 cases")
    assert "but not in 1 of the 3 with turns to the left alone;" in said
    assert "with W as printed the EKF is lost" in said
    many = {(turns, "tracking"): (0.05, 0.04) for turns in TURNS}
    said = answer.in_short(scenario_b(errors, instead=many))
    assert "in 8 of 12 cases of rule and turns;" in said and "tracking" not in said


def test_without_an_ekf_that_drives_there_is_no_order():
    said = answer.in_short(scenario_b(dict.fromkeys(PROCESS_NOISES, (0.08, 1.3))))
    assert said.startswith("No: which is better cannot be judged") and "EKF is lost" in said


def test_a_table_of_one_pattern_says_nothing_of_others():
    said = answer.in_short(scenario_b(AS_IN_THE_PAPER, turns=("right",)))
    assert "better than the EKF" in said and "whichever" not in said


@pytest.mark.parametrize(
    "error, single, word",
    [
        (0.0423, None, MET),
        (0.047, (0.04, 0.05), POSSIBLE),
        (0.047, (0.045, 0.05), NOT_MET),
        (0.13, (0.01, 0.2), LOST_ITSELF),
    ],
)
def test_each_word_on_a_number_is_reached(error, single, word):
    table = scenario_b(dict.fromkeys(PROCESS_NOISES, (error, 0.05)))
    if single:
        of_rhe = (table["estimator"] == "RHE") & (table["quantity"] == ERROR)
        table.loc[of_rhe, ["p5", "p95"]] = single
    assert answer.Numbers(table).number("RHE", ERROR, "printed") == word
    shown = "larger" if word == NOT_MET else word
    assert answer.scenario_b_in_words(table).count(f"as printed {shown} (") >= 1


def test_a_number_that_is_not_met_is_smaller_or_larger_than_the_papers():
    """An error below the paper's is no failure, and its cell has another colour."""
    for error, word in ((0.03, "smaller"), (0.06, "larger")):
        table = scenario_b(dict.fromkeys(PROCESS_NOISES, (error, 0.05)))
        assert answer.Numbers(table).number("RHE", ERROR, "printed") == NOT_MET
        assert f"RHE: as printed {word} (" in answer.scenario_b_in_words(table)
    assert answer.VERDICTS["smaller"] != answer.VERDICTS["larger"] == FAILS


@pytest.mark.parametrize("clean, word", [(0.99, HOLDS), (0.95, UNDECIDED), (0.8, FAILS)])
def test_never_is_judged_by_the_share_of_drives_without_a_violation(clean, word):
    table = scenario_b(AS_IN_THE_PAPER, clean)
    assert answer.Numbers(table).never("printed") == word
    assert f"Drives without a violation: RHE: as printed {100 * clean:.0f} %" in (
        answer.scenario_b_in_words(table)
    )


@pytest.fixture
def folder(tmp_path):
    """Tables of results in which one number of each kind is known."""
    errors = AS_IN_THE_PAPER | dict(printed=(0.0423, 1.3), consistent=(0.0423, 0.06))
    scenario_b(errors).to_csv(tmp_path / "table_scenario_b.csv", index=False)
    conditions = "as printed: holds; W by prediction: does not hold"
    claims = dict(id=["B6", "B7"], verdict="holds only as printed", conditions=conditions)
    claims |= dict(claim="A sentence", value=0.5, low=0.4, high=0.6, unit="m")
    pd.DataFrame(claims | dict(derived=False)).to_csv(tmp_path / "claims.csv", index=False)
    return tmp_path


def test_the_first_table_has_a_verdict_in_each_cell_and_the_printed_w_first(folder):
    rules = ["printed", "consistent", "prediction", "tracking"]
    worlds = {"rule for W": rules * 2, "turns": ["own"] * 4 + ["left"] * 4}
    worlds |= {"EKF [m]": [0.538, 0.06, 0.0497, 0.03] * 2}
    worlds |= {"RHE better": [0.5, 0.8, 0.92, 0.7] + [0.1] * 4}
    worlds |= dict(low=[0.4, 0.7, 0.87, 0.6] * 2, high=[0.6, 0.9, 0.95, 0.8] * 2)
    pd.DataFrame(worlds).to_csv(folder / "inverse_rules.csv", index=False)
    table = answer.paper_beside_ours(folder)
    first, *columns = table
    assert columns[:2] == ["the paper", "W as printed"] and columns[3] == "W by prediction"
    table = table.set_index(first)
    assert len(table) <= 7
    words = table[columns[1:]].map(lambda text: text.partition(":")[0])
    assert [*words.loc["Mean error, RHE [m]"]] == [MET] * 4
    assert [*words.loc["Mean error, EKF [m]"]] == [LOST_ITSELF, POSSIBLE, MET, MET]
    ekf = table.loc["Mean error, EKF [m]", "W consistent"]
    assert ekf == "possible: 0.0600 (drives: 0.0480 to 0.0720)"
    order = [*table.loc["RHE − EKF [mm]; share of fields with less"]]
    assert order[:3] == ["−9.1", "EKF lost", "holds: −17.7; 100 %"]
    assert [*words.loc["EKF: violations in a drive"]] == [LOST_ITSELF, MET, MET, MET]
    # "Never" has the ledger's verdict, which leaves out drives in which the oracle fails.
    never = [*table.loc["RHE: drives without a violation"]]
    assert never == ["all", "holds: 50 %", "50 %", "does not hold: 50 %", "50 %"]
    benefits = [*table.loc["The RHE benefits from its traction estimates"]]
    assert benefits == ["yes", HOLDS, "–", FAILS, "–"]
    possible = [*table.loc["Share of worlds that fit the paper in which the RHE's error is less"]]
    shares = ["80 % [70, 90]", "92 % [87, 95]", "70 % [60, 80]"]
    assert possible == ["–", "EKF lost", *shares]
    assert set(words.to_numpy().ravel()) <= {*answer.VERDICTS, "–", "50 %", *shares}


def test_without_worlds_their_row_is_empty(folder):
    row = answer.paper_beside_ours(folder).iloc[-1]
    assert set(row.iloc[1:]) == {"–"}


def test_the_numbers_of_every_pattern_of_turns_are_told(folder):
    numbers = answer.scenario_b_numbers(folder)
    assert numbers.set_index(numbers.columns[0]).loc["Mean error, RHE [m]", "W as printed"] == (
        "0.0423 [0.0418, 0.0428]"
    )
    told = answer.by_turns(folder)
    assert len(told) == len(TURNS) * len(PROCESS_NOISES)
    assert set(told["RHE is better"]) == {HOLDS, "EKF lost"}
    assert LOST not in set(told["RHE is better"])
    assert set(told["RHE [m]"]) == {"0.0423 [0.0418, 0.0428]"}


@pytest.mark.parametrize("low, shown", [(-0.1, "[0, 0.500]"), (0.05, "[0.0500, 0.500]")])
def test_a_count_is_not_negative_and_may_be_small(folder, low, shown):
    table = pd.read_csv(folder / "table_scenario_b.csv")
    of_rhe = (table["estimator"] == "RHE") & (table["quantity"] == VIOLATIONS)
    table.loc[of_rhe, ["mean", "low", "high"]] = 0.2, low, 0.5
    table.to_csv(folder / "table_scenario_b.csv", index=False)
    assert shown in answer.scenario_b_numbers(folder).to_string()


@pytest.mark.parametrize("verdict", [HOLDS, FAILS, UNDECIDED])
def test_the_weights_are_told_by_their_table(verdict):
    rows = [(name, "mean error, true [m]", 0.03, "") for name in ("Q1", "Q2", "Q3")]
    rows += [("Q1 / Q3", "settling time, ratio", 6.0, verdict)]
    rows += [("Q2 / Q3", "overshoot, ratio", 1.9, "undecided")]
    table = pd.DataFrame(rows, columns=["weight", "quantity", "mean", "verdict"]).assign(n=20)
    said = answer.scenario_a_in_words(table)
    assert "6.00 times as long as Q³ to settle (20 fields)" in said
    assert f"that it is at least twice as long {verdict}." in said
    assert "best" not in said


@pytest.mark.parametrize("verdict", [HOLDS, FAILS, UNDECIDED])
def test_the_papers_words_on_the_weights_have_the_ledgers_verdicts(folder, verdict):
    """It says "oscillates" and "extremely important", and of no weight that it is the best."""
    claims = pd.read_csv(folder / "claims.csv")
    row = dict(
        id="A2", claim="With Q² it oscillates", verdict=verdict, conditions="", derived=False
    )
    row |= dict(value=0.4, low=0.3, high=0.5, unit="share of fields")
    pd.concat([claims, pd.DataFrame([row])]).to_csv(folder / "claims.csv", index=False)
    *_, last = answer.in_words(folder).splitlines()
    assert (
        last
        == f"- **With Q² it oscillates** (A2): {verdict}; 0.400 [0.300, 0.500] share of fields."
    )


def test_the_bar_counts_every_claim_once_and_in_words(tmp_path):
    claims = pd.DataFrame(dict(verdict=["holds"] * 4 + ["does not hold"] * 3, derived=False))
    claims.to_csv(tmp_path / "claims.csv", index=False)
    said = answer.bar(tmp_path, link="there")
    assert "Of the 7 sentences" in said
    assert "[holds: 4](there)" in said and "[does not hold: 3](there)" in said
    # No sign outside of the alphabet stands for a verdict.
    assert all(ord(letter) < 0x2600 for letter in said)
