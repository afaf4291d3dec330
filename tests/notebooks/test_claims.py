"""The claims ledger: every rule can come out either way, every claim is judged by its own, and what
it is judged on is what the log shows.
"""

import collections
import dataclasses
import functools
import re
import time
from operator import ge, le
from types import SimpleNamespace

import numpy as np
import pandas as pd
import pytest
from scipy import stats

import rhec
from notebooks.claims import __main__ as command
from notebooks.claims import evidence, experiments, ledger, rules, run_sets, summary, worlds
from notebooks.claims.live_robot import LiveRobot
from notebooks.rivals import RIVALS
from notebooks.studies import parallel, statistics
from notebooks.studies.answer import RESULTS
from notebooks.studies.statistics import (
    FAILS,
    HOLDS,
    LOST,
    LOST_ITSELF,
    MET,
    NOT_MET,
    POSSIBLE,
    UNDECIDED,
    Finding,
)
from notebooks.studies.tables import with_minus
from rhec import paper
from rhec.simulation import closed_loop
from rhec.tracked_robot import tuning

RNG = np.random.default_rng(0)
NORMAL = RNG.normal(size=200)
SHARES = np.arange(200)
SHORT = dict(estimation_horizon=3, prediction_horizon=3, duration_s=12.0)
WEIGHTS = (1, 1, 0), (1, 1, 5)
PUBLISHED = pd.read_csv(RESULTS / "claims.csv").set_index("id")


# Rules

# {name: (rule, its bounds, samples with which it holds, fails, and is undecided)}; those that are
# judged by an interval are in test_invariances.
RULES = {
    "always": (statistics.always, {}, [np.ones(9, bool)], [np.arange(9) > 0], [np.ones(0, bool)]),
    "possible": (
        statistics.possible,
        {},
        [np.arange(9) == 0],
        [np.zeros(400, bool)],
        [np.zeros(100, bool)],
    ),
    # Where the oracle fails, nothing counts.
    "always relative to oracle": (
        statistics.always_relative_to_oracle,
        {},
        [SHARES < 170, SHARES < 160],
        [SHARES < 159, SHARES < 160],
        [SHARES < 0, SHARES < 0],
    ),
    "equal": (statistics.equal, dict(expected=0.12, tolerance=0.005), [0.124], [0.126], [np.nan]),
    "between": (statistics.between, dict(above=1), [1.1], [1.0], [np.nan]),
}


@pytest.mark.parametrize("name", RULES)
def test_each_rule_holds_fails_and_stays_open(name):
    rule, bounds, *every = RULES[name]
    for wanted, samples in zip((HOLDS, FAILS, UNDECIDED), every):
        found = rule(*samples, **bounds)
        assert found.verdict == wanted
        if wanted != UNDECIDED:
            counted = 160 if "oracle" in name else np.size(samples[0])
            assert found.low <= found.value <= found.high and found.n == counted


def test_a_bound_that_is_touched_is_not_kept():
    for low, high, bounds, word in [
        (2.0, 3.0, dict(above=2), UNDECIDED),
        (1.0, 2.0, dict(above=2), FAILS),
        (-1.0, 0.0, dict(below=0), UNDECIDED),
        (0.0, 0.0, dict(below=0), FAILS),
        (np.nan, np.nan, dict(below=0), UNDECIDED),
    ]:
        assert statistics.verdict(low, high, **bounds) == word
    same = np.zeros(5), np.zeros(5)
    assert statistics.difference(*same, above=0).verdict == FAILS
    assert statistics.mean([1.0]).verdict == UNDECIDED


def test_the_interval_of_a_mean_ends_at_what_it_cannot_be_below_and_its_verdict_does_not():
    rare = [0.0, 0.0, 1.0]
    free, count = statistics.mean(rare, above=-0.5), statistics.mean(rare, above=-0.5, least=0)
    assert free.low < -0.5 and count == free._replace(low=0.0) and count.verdict == UNDECIDED


def test_p_and_interval_of_a_mean_and_of_a_share_are_those_of_their_tests():
    expected = stats.ttest_1samp(NORMAL, 0.1)
    found = statistics.mean(NORMAL, above=0.1)
    assert found.p == pytest.approx(expected.pvalue)
    interval = tuple(expected.confidence_interval())
    assert (found.low, found.high) == pytest.approx(interval, rel=1e-12)
    exact = stats.binomtest(120, 200)
    found = statistics.share(SHARES < 120, above=0.5)
    assert found.p == pytest.approx(exact.pvalue)
    assert (found.low, found.high) == pytest.approx(exact.proportion_ci(0.95, "exact"))
    assert np.isnan(statistics.always(SHARES < 120).p)


@pytest.mark.parametrize(
    "statistic", [np.mean, statistics.ratio_of_means, statistics.difference_of_means]
)
def test_the_intervals_cover_the_truth_as_often_as_they_say(statistic):
    """Of skewed numbers, as errors and violations are, at the ledger's n."""
    rng = np.random.default_rng(1)
    samples = rng.lognormal(size=(1 if statistic is np.mean else 2, 1000))
    assert 0.94 <= statistics.coverage(statistic, *samples) <= 0.96


def test_the_coverage_is_shown_of_each_statistic_that_the_ledger_uses(monkeypatch):
    """Of skewed numbers in all runs it is nearly what the intervals say.

    Tables that some looks have left shorter are compared where both have rows.
    """
    metrics = ["mean_error_m", "mean_error_true_m", "violations", "rms_kappa"]
    samples = np.random.default_rng(0).lognormal(size=(99, 200, 4))
    drawn = (pd.DataFrame(of[: 200 - n % 2], columns=metrics) for n, of in enumerate(samples))
    monkeypatch.setattr(ledger, "coverage", functools.partial(statistics.coverage, trials=200))
    shown = ledger.coverages(collections.defaultdict(lambda: next(drawn)))
    assert {*shown["statistic"]} == {"mean", "difference_of_means", "ratio_of_means"}
    assert shown["coverage"].between(0.9, 0.99).all()


@pytest.mark.filterwarnings("error")
def test_a_ratio_to_almost_nothing_is_undecided_without_a_warning():
    """If one pair alone keeps the denominator from zero, the ratio has no interval."""
    found = statistics.ratio(np.ones(5), np.arange(5) == 0, above=1)
    assert found.value == 5 and np.isnan([found.low, found.high, found.p]).all()
    assert found.verdict == UNDECIDED and found.n == 5


# Numbers that the paper reports, an order and "never": README has the same words

ERRORS = np.full(200, 0.04)  # of a robot that is not lost
LOST_ERRORS = ERRORS + 0.1
AROUND_TOLERANCE = 0.13 + NORMAL - NORMAL.mean()
ONE_IN_TEN = 0.1 * NORMAL / np.abs(NORMAL).max()


@pytest.mark.parametrize(
    "values, errors, early, last",
    [
        (10 + ONE_IN_TEN, ERRORS, MET, MET),
        (12 + ONE_IN_TEN, ERRORS, NOT_MET, NOT_MET),
        (8 + ONE_IN_TEN, ERRORS, NOT_MET, NOT_MET),
        (11 + 3 * NORMAL, ERRORS, UNDECIDED, POSSIBLE),  # may well be met
        (15 + 3 * NORMAL, ERRORS, UNDECIDED, NOT_MET),  # at the edge of single drives
        (10 + ONE_IN_TEN, LOST_ERRORS, LOST_ITSELF, LOST_ITSELF),
        (10 + ONE_IN_TEN, AROUND_TOLERANCE, UNDECIDED, LOST_ITSELF),
        (10 + ONE_IN_TEN[:1], ERRORS[:1], UNDECIDED, UNDECIDED),
    ],
)
def test_a_reported_number_has_its_word_and_an_early_look_leaves_open_what_may_change(
    values, errors, early, last
):
    confidence = statistics.EARLY_CONFIDENCE
    assert statistics.reported(values, errors, 10.0, confidence=confidence).verdict == early
    found = statistics.reported(values, errors, 10.0)
    assert found.verdict == last
    assert (found.low, found.high) == pytest.approx(tuple(np.quantile(values, [0.05, 0.95])))
    assert (found.above, found.below) == pytest.approx((9, 11))


def with_verdicts(verdicts, p=np.nan):
    """{condition: Finding} of {condition: verdict}."""
    return {name: Finding(1.0, 0.0, 2.0, 9, each, p=p) for name, each in verdicts.items()}


@pytest.mark.parametrize(
    "printed, prediction, expected",
    [
        (HOLDS, FAILS, ("holds only as printed", "as printed")),
        (FAILS, UNDECIDED, (UNDECIDED, "W by prediction")),
        (MET, MET, (HOLDS, "as printed")),
        (MET, LOST_ITSELF, ("holds only as printed", "as printed")),
        (NOT_MET, UNDECIDED, (UNDECIDED, "W by prediction")),
        (LOST, LOST, (LOST, "as printed")),
    ],
)
def test_one_verdict_from_two_process_noises(printed, prediction, expected):
    """Cases that the published ledger does not have."""
    verdicts = {"as printed": printed, "W by prediction": prediction}
    assert statistics.combined(with_verdicts(verdicts)) == expected


def test_the_published_verdicts_follow_from_those_under_each_condition():
    """What decides, what stands beside it, and p among all claims."""
    findings = {}
    for id_, row in PUBLISHED.iterrows():
        parts = (part.rpartition(": ") for part in row["conditions"].split("; "))
        findings[id_] = with_verdicts({name: verdict for name, _, verdict in parts}, row["p"])
    looks = {id_: dict.fromkeys(found, 0.95) for id_, found in findings.items()}
    of_worlds = ["posterior", "posterior_low", "posterior_high", "posterior_n"]
    driven = PUBLISHED[of_worlds].dropna(subset="posterior")
    shares = {id_: Finding(*row, HOLDS) for id_, row in driven.iterrows()}
    found = ledger.ledger(findings, looks, dict.fromkeys(findings, {}), shares).set_index("id")
    columns = ["verdict", "condition", "p", "p_adjusted", "other_condition", "other_verdict"]
    columns += ["conditions", *of_worlds]
    expected = PUBLISHED[columns]
    pd.testing.assert_frame_equal(found[columns].replace("", np.nan), expected, rtol=1e-9)


def test_the_p_of_a_claim_is_the_largest_of_what_is_decided_or_else_of_what_is_open():
    found = with_verdicts(dict(one=HOLDS, two=FAILS), 0.01) | with_verdicts(dict(three=HOLDS), 0.02)
    found |= with_verdicts(dict(open=UNDECIDED), 0.3)
    assert ledger._largest_p(found, HOLDS) == 0.02
    assert ledger._largest_p(found, UNDECIDED) == 0.3


def test_beside_what_decides_stands_the_first_that_says_otherwise():
    found = with_verdicts(dict(one=HOLDS, two=HOLDS, three=FAILS, four=FAILS))
    assert ledger._other(found, "one")["other_condition"] == "three"


# The ledger itself


def test_to_beat_a_rival_that_is_lost_is_named_so():
    """Evidence for B5: the RHE is better by one rule and worse by another, and the EKF is lost as
    printed.
    """
    rng = np.random.default_rng(0)
    errors_m = dict(printed=1.3, consistent=0.05, prediction=0.03, tracking=0.04)
    tables = {}
    for noise, ekf_m in errors_m.items():
        # By tracking the EKF is as often the better as the worse.
        sign = (-1.0) ** np.arange(60) if noise == "tracking" else np.ones(60)
        for id_ in ("rhe", "rhe_smoothed", "rhe_left"):
            errors = 0.04 + 1e-5 * rng.normal(size=60)
            tables[noise, "runs", id_] = pd.DataFrame(dict(mean_error_m=errors))
        for id_ in ("ekf", "ekf_left"):
            tables[noise, "runs", id_] = pd.DataFrame(dict(mean_error_m=ekf_m + 0.001 * sign))
    for table in tables.values():
        table["mean_error_from_start_m"] = table["mean_error_m"]
    claim = ledger.CLAIMS["B5"]
    found = {name: judge(tables) for name, judge in claim.rule.by_condition.items()}
    # The arrival mean (G7) belongs to every claim on the RHE.
    assert found["as printed"].verdict == found["smoothed arrival mean"].verdict == LOST
    assert found["W consistent"].verdict == HOLDS
    assert found[statistics.PREDICTION].verdict == FAILS
    assert found["W by tracking"].verdict == UNDECIDED
    assert claim.rule.combined(found) == ("holds with W consistent", "W consistent")
    # A rival is lost by the mean of its drives, also where most of them are good. Such a verdict
    # rests on no interval.
    ekf = tables["printed", "runs", "ekf"]
    ekf["mean_error_m"] = np.where(ekf.index < 6, 13.0, 0.05)
    lost = claim.rule.by_condition["as printed"](tables)
    assert lost.verdict == LOST and np.isnan(lost.p) and found[statistics.PREDICTION].p < 0.01
    assert claim.beside["P(RHE < EKF), W consistent"](tables).value == 1
    left = claim.beside["on a path that turns to the left alone, W by prediction"](tables)
    assert left.value == pytest.approx(0.009, abs=5e-4)


def test_a_rival_has_the_rhes_w_where_none_was_tuned_for_it():
    for id_, entries in (("no_slip", 4), ("fixed_traction", 4), ("bounded_ekf", 6)):
        for rule in statistics.CONDITIONS:
            (scenario,) = run_sets.scenarios(run_sets.RUNS[id_], rule, [0])
            tuned = tuning.noises_of(scenario.estimator)
            if rule in tuned:
                assert (scenario.process_noise, scenario.sigma_w) == (rule, None)
            else:
                assert scenario.sigma_w == tuning.NOISES["rhe"][rule].sigma_w[:entries]
                assert scenario.sigma_v == tuning.NOISES["rhe"][rule].sigma_v


def fields_of(kind, id_):
    return dict(runs=run_sets.RUNS, logs=run_sets.LOGS)[kind][id_]


def test_a_claim_s_words_have_the_numbers_of_its_drives():
    """But for how long they last, from where the robot starts, and for noise that is none."""
    for id_, claim in ledger.CLAIMS.items():
        conditions = claim.rule.by_condition | claim.beside
        words = {*re.findall(r"\d+(?:\.\d+)?", " ".join([claim.test, *conditions]))}
        for _, kind, table in evidence.driven_tables_of(conditions.values()):
            for name, value in fields_of(kind, table).items():
                is_number = type(value) in (int, float) and name not in run_sets._NOISES
                if is_number and name not in ("duration_s", "start_offset_m"):
                    assert f"{value:g}" in words, (id_, table, name)


def test_drives_on_the_first_row_end_before_its_end():
    """By the set speed, and there is nothing to be seen of the headland."""
    for kind, id_ in [("logs", "q2_slow"), ("logs", "q2_fast"), ("runs", "q3"), ("logs", "q2")]:
        (scenario,) = run_sets.scenarios(fields_of(kind, id_), "printed", [0])
        way_m = scenario.speed_mps * scenario.duration_s
        assert 0.97 * scenario.row_length_m < way_m <= scenario.row_length_m


def test_a_drive_without_disturbance_is_measured_as_it_is():
    """On the same soil everywhere, whose tracks do not turn it to one side."""
    fields = fields_of("logs", "ekf_undisturbed")
    (scenario,) = run_sets.scenarios(fields, "printed", [3], dict(duration_s=4.0))
    log = rhec.simulate(scenario).log
    measured = log[["x_meas_m", "y_meas_m", "nu_meas_mps"]]
    np.testing.assert_allclose(measured, log[["x_m", "y_m", "nu_mps"]], atol=1e-9)
    assert np.ptp(log[["mu", "kappa"]].to_numpy(), axis=0).max() < 1e-12


def test_no_claim_is_judged_on_the_calibrations_seeds():
    from notebooks.studies.calibration import TRAINING_SEEDS

    assert set(range(1000)).isdisjoint(TRAINING_SEEDS)
    assert max(TRAINING_SEEDS) < worlds.FIRST_SEED


def test_the_published_ledger_has_the_words_and_conditions_of_the_claims():
    """All that no evidence changes; `make studies` writes it anew."""
    published = pd.read_csv(RESULTS / "claims.csv", dtype=str, keep_default_na=False)
    assert [*published["id"]] == [*ledger.CLAIMS]
    for row in published.to_dict("records"):
        claim = ledger.CLAIMS[row["id"]]
        ours = claim._asdict() | claim.rule._asdict()
        words = {name: str(of) for name, of in ours.items() if name in row and name != "beside"}
        assert {name: row[name] for name in words} == words
        said = [part.rpartition(": ")[0] for part in row["conditions"].split("; ")]
        assert [name.strip(":") for name in said] == [*claim.rule.by_condition]
        beside = [part.rpartition(": ")[0] for part in row["beside"].split("; ") if part]
        assert beside == [*claim.beside]
        if not evidence.tables_of(claim.rule.by_condition.values()):
            found = claim.rule.by_condition[row["condition"]]({})
            bounds = [float(row[name] or "nan") for name in ("above", "below", "value")]
            np.testing.assert_array_equal([found.above, found.below, found.value], bounds)


def test_the_paper_s_values_are_those_of_the_package():
    says = {id_: claim.rule.paper for id_, claim in ledger.CLAIMS.items()}
    values = dict(B3=paper.MEAN_ERROR_RHE_M, B4=paper.MEAN_ERROR_EKF_M, B9=paper.VIOLATIONS_EKF)
    values |= dict(I1=paper.TOLERANCE_M, T1=paper.STEP_MEAN_MS, T2=paper.STEP_MAX_MS)
    assert {id_: says[id_] for id_ in values} == values
    for id_, within in dict(B3=statistics.WITHIN, B9=statistics.WITHIN_COUNTS).items():
        keywords = ledger.CLAIMS[id_].rule.by_condition["as printed"].rule.keywords
        assert keywords["bounds"]["within"] == pytest.approx(within)
    assert ledger.CLAIMS["B7"].rule.bound == f"> {statistics.ALMOST_ALWAYS}"
    for id_, bound in dict(B1=paper.ROW_SPACING_M / 2, I2=paper.TOLERANCE_M).items():
        keywords = ledger.CLAIMS[id_].rule.by_condition["as printed"].rule.keywords
        assert keywords["expressions"] == [f"arrived & (max_error_true_m < {bound})"]


# Looks

B6 = {"B6": ledger.CLAIMS["B6"]}


@pytest.fixture
def drawn(monkeypatch):
    """Evidence that is drawn: in `helped`, slip makes the rival's error worse by the advantage."""
    chosen = dict(helped=["printed", "prediction"], advantage=0.0, raw_m=0.05, asked=[])

    def rows(noise, id_, first, n):
        rng = np.random.default_rng([len(noise), len(id_), first])
        effect = chosen["advantage"] * (id_ == "no_slip" and noise in chosen["helped"])
        error = 1 + effect + 0.1 * rng.normal(size=n)
        columns = dict.fromkeys("mean_error_true_m large_r small_r".split(), error)
        return pd.DataFrame(columns).assign(mean_error_m=chosen["raw_m"])

    def measure(scenarios, folder):
        assert folder is None
        found = {}
        for table, of_table in (*scenarios["runs"].items(), *scenarios["logs"].items()):
            seeds = [scenario.seed for scenario in of_table]
            chosen["asked"].append((*table, seeds))
            found[table] = rows(table[0], table[2], seeds[0], len(seeds))
        return found

    def experiment(tables, n):
        chosen["asked"] += [(noise, "experiments", name, n) for noise, name in tables]
        return {table: rows(*table, 0, n) for table in tables}

    monkeypatch.setattr(run_sets, "measure", measure)
    monkeypatch.setattr(experiments, "make", experiment)
    return chosen


@pytest.mark.parametrize(
    "advantage, n, confidence", [(0.5, 20, 0.998), (0.05, 200, 0.998), (0.012, 900, 0.95)]
)
def test_only_what_a_look_leaves_undecided_is_looked_at_again(drawn, advantage, n, confidence):
    drawn["advantage"] = advantage
    _, findings, _, looks = evidence.collect(B6, [20, 200, 900])
    found, look = findings["B6"]["as printed"], looks["B6"]["as printed"]
    assert (found.n, found.verdict, look) == (n, HOLDS, confidence)
    # Each look before has spent two thousandths.
    spent = 0.002 * [20, 200, 900].index(n)
    assert spent <= found.p < spent + 1 - confidence
    # No field is driven at two looks.
    driven = [
        seeds for noise, _, id_, seeds in drawn["asked"] if (noise, id_) == ("printed", "rhe")
    ]
    fields = [field for seeds in driven for field in seeds]
    assert fields == [*range(n)]


@pytest.mark.parametrize("helped, n", [(["prediction"], 40), ([], 80)])
def test_the_last_look_is_for_claims_that_nothing_decides_before(drawn, helped, n):
    """There is no effect with W as printed; with W by prediction there is one, or none either."""
    drawn.update(helped=helped, advantage=0.5)
    _, findings, _, _ = evidence.collect(B6, [20, 40, 80])
    found = findings["B6"]["as printed"]
    assert (found.verdict, found.n) == (UNDECIDED, n)
    assert findings["B6"][statistics.PREDICTION].verdict == (HOLDS if helped else UNDECIDED)
    assert 0.002 * 2 < found.p <= 1


def test_an_experiment_has_one_look(drawn):
    _, findings, _, looks = evidence.collect({"A6": ledger.CLAIMS["A6"]}, [20, 40])
    assert drawn["asked"] == [("printed", "experiments", "gains", 40)]
    assert looks["A6"] == {"": statistics.CONFIDENCE} and findings["A6"][""].n == 40


@pytest.mark.parametrize("lost_from, verdict", [(100, HOLDS), (300, FAILS)])
def test_fields_that_are_all_equal_decide_at_the_last_look_alone(monkeypatch, lost_from, verdict):
    """The augmented EKF is lost in later fields or in none, the bounded one never."""

    def make(tables, seeds, folder=None):
        arrived = np.array(seeds) < lost_from
        return {
            table: pd.DataFrame(dict(arrived=arrived | ("bounded" in table[2]))).assign(
                max_error_true_m=0.1
            )
            for table in tables
        }

    monkeypatch.setattr(evidence, "make", make)
    _, findings, _, looks = evidence.collect({"M9": ledger.CLAIMS["M9"]}, [20, 80, 300])
    found = findings["M9"]["as printed"]
    assert (found.n, found.verdict, looks["M9"]["as printed"]) == (300, verdict, 0.95)


LOOKS = [40, 150, 300, 500, 1000]  # of notebook 06
# Rules at their bounds, where each verdict but "undecided" is wrong: functions of two columns, and
# the columns of n drives. The errors of drives are skewed, so those of the ratio are, too.
NULLS = {
    "mean": (
        lambda one, other, confidence: statistics.mean(one, above=0, confidence=confidence),
        lambda rng, n: rng.normal(size=(2, n)),
    ),
    "difference": (
        lambda *given, confidence: statistics.difference(*given, below=0, confidence=confidence),
        lambda rng, n: rng.gamma(9, size=(2, n)) + rng.normal(size=n),
    ),
    "ratio": (
        lambda *given, confidence: statistics.ratio(*given, above=1, confidence=confidence),
        lambda rng, n: rng.gamma(9, size=(2, n)),
    ),
    "share": (
        lambda one, other, confidence: statistics.share(one < 0, above=0.5, confidence=confidence),
        lambda rng, n: rng.normal(size=(2, n)),
    ),
    "share_less": (
        lambda *given, confidence: statistics.share_less(*given, above=0.5, confidence=confidence),
        lambda rng, n: rng.gamma(9, size=(2, n)),
    ),
    "never": (
        lambda flags, oracle, confidence: statistics.relative_to_oracle(
            flags, oracle, statistics.ALMOST_ALWAYS, confidence
        ),
        lambda rng, n: rng.random((2, n)) < [[statistics.ALMOST_ALWAYS], [0.8]],
    ),
}


def _claim_on(rule, table):
    """A claim that a rule judges by the columns of its own table."""

    def judge(evidence, confidence):
        return rule(evidence[table]["one"], evidence[table]["other"], confidence=confidence)

    of = rules.Rule({"": rules.Condition(judge, (table,))})
    return rules.Claim("", "", "", "", of, derived=False, beside={}, why="", mended="")


@pytest.mark.nightly(keep=1)
@pytest.mark.parametrize("rule", NULLS)
def test_where_nothing_is_to_be_found_five_looks_are_wrong_as_seldom_as_they_say(rule, monkeypatch):
    """200 claims on drives of their own. Notebook 06 says at most 5.8 %, by Bonferroni."""
    judge, columns = NULLS[rule]
    rng = np.random.default_rng(3)
    tables = [("printed", "runs", str(number)) for number in range(200)]
    claims = {table[2]: _claim_on(judge, table) for table in tables}

    def make(tables, seeds, folder=None):
        return {
            table: pd.DataFrame(dict(zip(["one", "other"], columns(rng, len(seeds)))))
            for table in tables
        }

    monkeypatch.setattr(evidence, "make", make)
    _, findings, _, decided_at = evidence.collect(claims, LOOKS)
    wrong = {id_ for id_, of in findings.items() if of[""].verdict != UNDECIDED}
    # 0.058, and three standard errors of the share of 200
    assert len(wrong) / 200 < 0.058 + 3 * np.sqrt(0.058 * 0.942 / 200)
    early = sum(decided_at[id_][""] == statistics.EARLY_CONFIDENCE for id_ in wrong)
    assert early / 200 < 0.008 + 3 * np.sqrt(0.008 * 0.992 / 200)
    # p has what the looks before have spent.
    last = [of[""].p for id_, of in findings.items() if decided_at[id_][""] == 0.95]
    assert min(last) >= 4 * (1 - statistics.EARLY_CONFIDENCE)


# Verdicts in words


def test_the_published_ledger_is_shown_by_what_fails_and_what_is_lost():
    fails = PUBLISHED["verdict"] == FAILS
    ids = [*PUBLISHED.index[fails]]
    table = PUBLISHED.reset_index()
    counts = summary.verdict_counts(table).loc[FAILS]
    assert [*counts] == [len(ids), (fails & PUBLISHED["derived"]).sum()]
    assert [*summary.failing(table).index] == ids and ids
    assert [*summary.lost(table).index] == summary.survivors(table)[1]


def test_a_weak_verdict_does_not_survive_among_many():
    row = dict(id=["A", "B", "C"], p=[1e-4, 0.02, 0.02], p_adjusted=[2e-4, 0.06, 0.06])
    table = pd.DataFrame(row | dict(verdict=HOLDS, derived=[False, False, True]))
    assert summary.survivors(table) == (2, ["B"])


# Worlds


@pytest.mark.parametrize(
    "found, verdict",
    [
        (statistics.mean([1.0, 3.0], above=1), HOLDS),
        (statistics.mean([0.0, 2.0], above=1), FAILS),  # at the bound, which is not included
        (statistics.share([True] * 5 + [False], above=0.95), FAILS),
        (statistics.always([True] * 6), HOLDS),
        (statistics.possible([False, False]), FAILS),
        (statistics.reported([1.0, 2.0, 48.0], [0.05] * 3, 17), HOLDS),
        (statistics.reported([17.0, 17.0], [0.3, 0.5], 17), FAILS),
        (statistics.ratio([1.0], [0.0], above=1), UNDECIDED),
    ],
)
def test_a_rule_is_applied_to_the_value_in_a_world(found, verdict):
    assert worlds.by_value(found) == verdict


def test_a_claim_in_worlds_follows_the_runs(monkeypatch):
    chosen = dict(advantage=0.5, raw_m=0.05)

    def measure(scenarios, folder=None):
        def errors(part):
            rival = np.array([each.estimator == RIVALS["rhe_no_slip"] for each in part])
            is_slow = np.array([each.speed_mps == 0.4 for each in part])
            return 1 + chosen["advantage"] * rival * np.where(is_slow, 1, -1)

        return {
            name: pd.DataFrame(dict(mean_error_true_m=errors(part), mean_error_m=chosen["raw_m"]))
            for name, part in scenarios["runs"].items()
        }

    monkeypatch.setattr(run_sets, "measure", measure)
    drawn = [dict(speed_mps=0.4), dict(kappa_mean=0.9), dict(speed_mps=0.4)]
    assert worlds.judge(B6, drawn, 4)["B6"].tolist() == [HOLDS, FAILS, HOLDS]
    assert worlds.shares(B6, drawn[::2], 4)["B6"][:4] == (1.0, pytest.approx(0.025**0.5), 1.0, 2)
    chosen["advantage"] = -0.5
    assert worlds.judge(B6, drawn, 4)["B6"].tolist() == [FAILS, HOLDS, FAILS]
    chosen.update(advantage=0.5, raw_m=0.2)
    assert worlds.judge(B6, drawn, 4)["B6"].tolist() == [LOST] * 3
    assert worlds.shares(B6, drawn, 4)["B6"].value == 0


def test_every_claim_about_driving_is_judged_in_a_world(run, monkeypatch):
    """By drives with its own controller and estimator, at the world's speed or its own."""
    shown = run_sets.measured(run) | dict(mu_deviation=0.01, kappa_deviation=0.01)
    asked = {}

    def measure(scenarios, folder=None):
        asked.update(scenarios["runs"] | scenarios["logs"])
        return {name: pd.DataFrame([shown] * len(part)) for name, part in asked.items()}

    monkeypatch.setattr(run_sets, "measure", measure)
    world = dict(speed_mps=0.4, duration_s=50.0, process_noise="printed", q=(9.0, 9.0, 9.0))
    verdicts = worlds.judge(ledger.CLAIMS, [world], 2)
    assert {*verdicts} == {*PUBLISHED["posterior"].dropna().index}
    for (kind, id_, whole), (one, other) in asked.items():
        # Its own length is that of claims on the paper's two estimators alone.
        rows = one.mu_mean * one.speed_mps * one.duration_s / one.row_length_m
        is_on_row = id_ in ("oracle_row", "q1", "q2", "q3") or id_.startswith(("q2_", "q3_"))
        is_on_row &= "speed_mps" not in fields_of(kind, id_)
        assert (
            one.duration_s == 50 if whole else rows == pytest.approx(1) if is_on_row else rows > 2
        )
        assert whole <= (kind == "runs" and id_ in ("rhe", "ekf", "oracle"))
        (usual,) = run_sets.scenarios(fields_of(kind, id_), "prediction", [0])
        for name in ("estimator", "q", "r", "qn_factor", "look_ahead_m", "guess_yaw_rad"):
            assert getattr(one, name) == getattr(usual, name)
        assert one.speed_mps == fields_of(kind, id_).get("speed_mps", 0.4)
        assert other.seed == one.seed + 1


@pytest.mark.parametrize("w", ["prediction", "free", "fitted", "printed"])
def test_a_rival_has_a_w_of_its_own_in_a_world_whose_rhe_has_another(w):
    noise = worlds._noise(dict(w_rhe=w, sigma_rhe_m=0.1), RIVALS["rhe_no_slip"])
    assert noise == dict(process_noise=w if w in ("prediction", "printed") else "prediction")


def test_the_two_estimators_of_the_paper_have_the_w_of_a_world_that_says_which():
    world = dict(w_rhe="free", w_ekf="printed", sigma_rhe_m=0.1, sigma_rhe_rad=0.2)
    rhe = worlds._noise(world | dict(sigma_rhe_traction=0.3), "rhe")
    assert (rhe["sigma_w"][:3], rhe["sigma_w"][4:]) == ((0.1, 0.1, 0.2), (0.3, 0.3))
    assert worlds._noise(world, "ekf") == dict(process_noise="printed")


def test_a_start_on_the_other_side_is_mirrored():
    usual = rhec.Scenario().start_offset_m
    for fields in (run_sets.RUNS, run_sets.LOGS):
        for id_ in fields:
            (scenario,) = run_sets.scenarios(fields[id_], "printed", [0])
            assert scenario.start_offset_m == (-usual if "other_side" in id_ else usual)


def test_a_tenth_of_w_is_a_tenth_of_the_worlds_own():
    own = (0.01, 0.01, 0.02, 0.05, 0.03, 0.04)
    fields = run_sets.LOGS["rhe_small_w"]
    (scenario,) = run_sets.scenarios(fields, None, [0], dict(sigma_w=own))
    assert scenario.sigma_w == pytest.approx((*own[:4], 0.003, 0.004))
    (scenario,) = run_sets.scenarios(fields, "printed", [0])
    assert scenario.sigma_w == pytest.approx((*paper.SIGMA_W_RHE[:4], 0.025, 0.025))


# One claim alone


def test_one_claim_is_told_with_its_words_and_numbers(drawn, capsys):
    drawn["advantage"] = 0.5
    command.main(["b6, I1", "--fields", "12"])  # in either case
    text = capsys.readouterr().out
    claim = ledger.CLAIMS["B6"]
    assert claim.quote in text and claim.section in text and "verdict: holds" in text
    assert ledger.CLAIMS["I1"].quote in text
    assert "seeds 0 to 11" in text and text.count("has more fields, and other worlds") == 1
    value, low, high = re.search(
        r"as printed: (\S+) \[(\S+), (\S+)\] m, n = 12: holds\n", text
    ).groups()
    low_m, value_m, high_m = (float(each.replace("−", "-")) for each in (low, value, high))
    assert low_m < value_m < high_m < 0
    said = re.findall(r"beside it: (.*): \S+ \[\S+ \S+\], n = 12$", text, re.MULTILINE)
    assert said == [*claim.beside]
    command.main(["B6"])
    assert f"seeds 0 to {LOOKS[0] - 1};" in capsys.readouterr().out


def test_what_needs_no_drive_is_told_as_it_is_published(capsys):
    published = PUBLISHED[~PUBLISHED["n"].gt(1) & PUBLISHED["beside"].isna()].fillna({"why": ""})
    command.main([*published.index, "--fields", "2"])
    lines = [line.strip() for line in capsys.readouterr().out.splitlines()]
    for id_, row in published.iterrows():
        verdict = f"verdict: {row['verdict']}{', by derivation' if row['derived'] else ''}"
        expected = [f"{row['section']}: “{row['quote']}”", f"test: {with_minus(row['test'])}"]
        expected += [verdict, *row["conditions"].split("; ")]
        expected += [f"why: {row['why']}"] if row["why"] else []
        begin = lines.index(f"{id_}: {row['claim']}") + 1
        for line, wanted in zip(lines[begin:], expected):
            # The number of a condition stands before its verdict.
            condition, _, word = wanted.rpartition(": ")
            name = re.escape(condition.strip(":") or "in all cases")
            assert line == wanted or re.fullmatch(rf"{name}: (\S+( \S+)?, n = 1: )?{word}", line)
    assert len(published) > 10 and not [line for line in lines if "seeds 0 to" in line]


def test_without_an_id_all_claims_are_listed_with_their_verdicts(capsys, monkeypatch):
    new = ledger.CLAIMS["B6"]._replace(claim="A new sentence")
    monkeypatch.setattr(command, "CLAIMS", ledger.CLAIMS | {"Z1": new})
    command.main([])
    lines = capsys.readouterr().out.splitlines()
    for line, (id_, claim) in zip(lines, command.CLAIMS.items(), strict=True):
        assert line.split()[0] == id_ and claim.claim in line
        verdict = PUBLISHED["verdict"].get(id_, "not judged yet")
        assert line.endswith(f"  {verdict}")
        assert len(line) - len(verdict) == len(lines[0]) - len(PUBLISHED["verdict"].iloc[0])


# Refusals

GOOD = """
[Times.X1]
sentence = "It is fast"
quote = "is fast"
test = "times; below 1 s"
rule = { name = "mean", below = 1 }
runs = ["ekf"]
of = ["mean_error_m"]
"""


def test_a_claim_is_read_as_it_is_written_and_a_malformed_one_is_refused(tmp_path):
    file = tmp_path / "claims.toml"
    file.write_text(GOOD, encoding="utf-8")
    ((id_, claim),) = rules.load(file).items()
    assert (id_, claim.section, claim.claim) == ("X1", "Times", "It is fast")
    assert claim.rule.bound == "< 1" and list(claim.rule.by_condition) == [
        "as printed",
        "W by prediction",
    ]
    assert claim.rule.by_condition["as printed"].tables == (("printed", "runs", "ekf"),)
    for written, instead, named in [
        ('sentence = "It is fast"', "", "sentence"),
        ("test =", "tests =", "tests"),
        ('"mean"', '"median"', "median"),
        ("below = 1", "under = 1", "under"),
        ("of =", 'departures = ["late"]\nof =', "late"),
    ]:
        file.write_text(GOOD.replace(written, instead), encoding="utf-8")
        with pytest.raises(ValueError, match=f"^claim X1 could not be read: .*{named}"):
            rules.load(file)


def test_what_makes_no_sense_is_refused_in_a_sentence(capsys):
    for call, sentence in [
        (lambda: statistics.mean([1.0, np.nan]), "samples had missing values"),
        (lambda: statistics.difference([1.0, 2.0], [1.0]), "samples had lengths"),
        (lambda: evidence.collect(B6, [200, 40]), r"fields was .* a number for each look"),
        (lambda: evidence.collect(B6, []), r"fields was .* a number for each look"),
    ]:
        with pytest.raises(ValueError, match=f"^{sentence}"):
            call()
    for words, sentence in (
        (["Z9"], "claim was 'Z9'; `make claim` without an ID lists"),
        (["K2"], "claim was 'K2'; it is part of K1 now"),
        (["B6", "--fields", "1"], "fields was 1; it should be 2 or more"),
    ):
        with pytest.raises(SystemExit) as refused:
            command.main(words)
        assert refused.value.code == 2 and capsys.readouterr().err.startswith(sentence)
    table = pd.DataFrame(dict(settling_time_s=[3.0, np.nan], duration_s=60.0, error=""))
    found = run_sets.complete(table)  # who never arrives has used up the time
    assert list(found["settling_time_s"]) == [3.0, 60.0]
    assert list(found["arrived"]) == [True, False]
    with pytest.raises(RuntimeError, match="1 of 2 runs failed, the first with: ValueError: no"):
        run_sets.complete(table.assign(error=["", "ValueError: no"]))


# What is measured


def test_runs_whose_logs_are_needed_are_driven_once(monkeypatch):
    one, other = ([rhec.Scenario(seed=seed, q=q, **SHORT) for seed in (9, 2)] for q in WEIGHTS)
    driven = []

    def campaign(scenarios, *options):
        driven.extend(scenarios)
        return rhec.campaign(scenarios, *options)

    monkeypatch.setattr(parallel, "campaign", campaign)
    asked = dict(runs=dict(same=list(one), own=other), logs=dict(log=one))
    tables = run_sets.measure(asked)
    assert driven == other and set(tables) == {"same", "own", "log"}
    for name, scenarios in (("same", one), ("own", other), ("log", one)):
        for (_, row), scenario in zip(tables[name].iterrows(), scenarios):
            metrics = rhec.simulate(scenario).metrics
            assert row["mean_error_true_m"] == metrics["mean_error_true_m"]
            assert row["violations"] == metrics["violations"]
    assert {*tables["own"]} - {"error", "seed", "duration_s"} <= {*tables["same"]}
    assert "kkt_rhe_late" in tables["log"] and "kkt_rhe_late" not in tables["own"]
    assert run_sets.measure(dict(runs={}, logs={})) == {}


def test_measured_agrees_with_the_log(run):
    shown, log = run_sets.measured(run), run.log
    assert shown["in_bounds"] == log[["mu_hat", "kappa_hat"]].stack().between(0, 1).all()
    highest = log[["mu_hat", "kappa_hat"]].max(axis=None)
    assert highest == 1 and not shown["above_one"]  # a bound that is reached is not exceeded
    beyond = run.columns | dict(mu_hat=run.columns["mu_hat"] + 1e-6)
    found = run_sets.measured(dataclasses.replace(run, columns=beyond))
    assert found["above_one"] and shown["in_bounds"] and not found["in_bounds"]
    assert (
        shown["within_bound"] == (log["omega_cmd_radps"].abs() <= 0.1).all()
        and shown["reaches_bound"] == (log["omega_cmd_radps"].abs() > 0.1 - 1e-9).any()
    )
    assert shown["settling_time_s"] == run.metrics["settling_time_s"] and shown["arrived"]
    late = log[log["t_s"] >= 30]
    moving = log[log["t_s"] >= 5]
    before, after = (log[op(log["t_s"], shown["settling_time_s"])] for op in (le, ge))
    speed = moving["nu_mps"].abs()
    expected = dict(
        near_bound=(log[["mu_hat", "kappa_hat"]].min(axis=1) >= 0.9).mean(),
        deviation_kappa_late=late["kappa_hat"].std(ddof=0),
        step_kappa=root_mean_square(log["kappa_hat"].diff()),
        lag_mu_s=0.2
        * min(range(51), key=lambda n: (log["mu_hat"].shift(-n) - log["mu"]).pow(2).mean()),
        speed_variation=speed.std(ddof=0) / speed.mean(),
        rms_nu_hat_mps=root_mean_square(moving["nu_hat_mps"] - moving["nu_mps"]),
        rms_nu_meas_mps=root_mean_square(moving["nu_meas_mps"] - moving["nu_mps"]),
        rms_yaw_rate_radps=root_mean_square(log["omega_radps"] - log["omega_cmd_radps"].shift()),
        kkt_rhc_largest_first=log["kkt_rhc"].idxmax() in before.index,
        kkt_rhc_before=before["kkt_rhc"].median(),
        kkt_rhc_after=after["kkt_rhc"].median(),
        kkt_rhc_late=late["kkt_rhc"].median(),
        kkt_rhe_first=log.loc[log["t_s"].between(0.1, 3.1), "kkt_rhe"].median(),
        kkt_rhe_late=late["kkt_rhe"].median(),
    )
    assert {name: shown[name] for name in expected} == pytest.approx(expected)
    far = log["y_m"][log["y_m"].abs() > 0.05]  # the first row runs along x
    assert shown["swings"] == (np.sign(far).diff().dropna() != 0).sum()
    assert 0 < shown["late_s"] == pytest.approx(59.8 - log["s_m"].iloc[-1] / 0.5)


def root_mean_square(values):
    return np.sqrt(values.pow(2).mean())


def test_a_robot_that_never_arrives_has_used_up_its_time(run):
    """All of its drive is before the arrival, and no curve counts."""
    metrics = run.metrics | dict(settling_time_s=np.nan)
    shown = run_sets.measured(dataclasses.replace(run, metrics=metrics))
    assert shown["settling_time_s"] == 60.0 and not shown["arrived"]
    assert shown["kkt_rhc_largest_first"]
    assert shown["kkt_rhc_before"] == shown["kkt_rhc_after"] == run.log["kkt_rhc"].median()
    assert shown["yaw_bias_rad"] == shown["offset_curves_m"] == shown["row_m"] == 0.0


@pytest.mark.parametrize("turns", ["left", "right", "alternate"])
def test_yaw_bias_and_offset_are_measured_in_curves_to_either_hand(turns):
    """Against the log, with the hand of a curve from the path's heading. On soil that slips alike
    on both sides one hand's are to the other side than the other's.
    """
    fields = dict(row_length_m=8.0, headland_radius_m=4.0, duration_s=90.0, slip_difference=0.0)
    run = rhec.simulate(rhec.Scenario(seed=3, turns=turns, **fields))
    shown = run_sets.measured(run)
    log = run.log[run.log["t_s"] >= run.metrics["settling_time_s"] + 5]
    _, s_m = run.path.project(log[["x_m", "y_m"]].to_numpy())
    x_m, y_m, heading = run.path.poses(s_m)[0].T
    turned = run.path.poses(s_m + 0.05)[0][:, 2] - heading
    left_m = (log["y_m"] - y_m) * np.cos(heading) - (log["x_m"] - x_m) * np.sin(heading)
    errors = pd.DataFrame(dict(yaw_bias=log["theta_hat_rad"] - log["theta_rad"], offset=left_m))
    curved = ~log["on_straight"].to_numpy(bool)
    hands = np.sign(turned[curved].round(6))
    by_hand = errors[curved].groupby(hands).mean().drop(0.0, errors="ignore")
    assert [*by_hand.index] == dict(left=[1], right=[-1], alternate=[-1, 1])[turns]
    bias_rad = by_hand["yaw_bias"].reindex([1, -1], fill_value=0.0)
    found = shown["yaw_bias_left_rad"], shown["yaw_bias_right_rad"]
    assert found == pytest.approx(tuple(bias_rad), abs=3e-4)
    sizes = by_hand.abs().mean()
    assert shown["yaw_bias_rad"] == pytest.approx(sizes["yaw_bias"], abs=3e-4)
    assert shown["offset_curves_m"] == pytest.approx(sizes["offset"], abs=3e-4)
    ahead = 0.2 * (log["mu"] * log["nu_mps"])[log["on_straight"].astype(bool)]
    assert shown["row_m"] == pytest.approx(ahead.sum())


def test_dead_reckoning_sums_the_encoders_yaw_rates():
    fields = run_sets.RUNS["dead_reckoning"]
    (scenario,) = run_sets.scenarios(fields, "prediction", [0], dict(duration_s=20.0))
    log = rhec.simulate(scenario).log
    turned = paper.DT_S * log["omega_meas_radps"].cumsum()
    np.testing.assert_allclose(log["theta_hat_rad"], turned, atol=1e-12)
    np.testing.assert_array_equal(log[["x_hat_m", "nu_hat_mps"]], log[["x_meas_m", "nu_meas_mps"]])


def test_a_drive_in_a_world_turns_to_both_sides():
    for fields in (dict(), dict(speed_mps=0.3, row_length_m=12.0)):
        duration_s = worlds._drive_s(fields, on_row=False)
        run = rhec.simulate(rhec.Scenario(**fields, duration_s=duration_s, estimator="oracle"))
        shown = run_sets.measured(run)
        assert shown["yaw_bias_left_rad"] == shown["yaw_bias_right_rad"] == 0.0  # it knows
        _, s_m = run.path.project(run.log[["x_m", "y_m"]].to_numpy())
        curvature = run.path.poses(s_m)[1]
        assert (curvature > 0).any() and (curvature < 0).any()
        # It ends on the third row, on which the soil's mean would be driven for a quarter of it.
        third_m = s_m[-1] - 2 * (run.scenario.row_length_m + np.pi * run.scenario.headland_radius_m)
        assert 0.1 < third_m / run.scenario.row_length_m < 0.4


@pytest.mark.parametrize("lag", [0.0, 1.4, 5.0, 12.0])
def test_a_lag_of_up_to_ten_seconds_is_found(lag):
    truth = np.convolve(np.random.default_rng(0).normal(size=600), np.ones(25) / 25, "same")
    shift = round(lag / 0.2)
    late = np.concatenate([np.zeros(shift), truth[: 600 - shift]])
    found = run_sets.lag_s(late, truth)
    assert found == pytest.approx(lag, abs=0.2) if lag < 10 else found <= 10


# Experiments


def test_the_time_from_which_an_error_stays_small():
    assert experiments.reached_s(np.r_[np.ones(10), np.zeros(40)]) == pytest.approx(2.0)
    assert experiments.reached_s(np.ones(50)) == pytest.approx(10.0)
    # exp(-t) is below 0.1 from ln 10 = 2.303 s on
    decaying = np.exp(-paper.DT_S * np.arange(50))
    for error in (decaying, -decaying):
        assert experiments.reached_s(error) == pytest.approx(2.4)


def test_an_experiment_that_no_process_noise_affects_is_made_once_for_all(monkeypatch):
    monkeypatch.setattr(experiments, "_tasks", lambda *asked: [functools.partial(dict, of=asked)])
    monkeypatch.setattr(experiments, "parallel_map", lambda call, tasks: [task() for task in tasks])
    tables = [(noise, name) for noise in ("printed", "tracking") for name in ("models", "search")]
    made = experiments.make(tables, 9)
    for noise, name in tables:
        expected = (None if name == "models" else noise, name, 9)
        assert made[noise, name].to_dict("list") == dict(of=[expected])


def test_what_is_published_of_exact_properties_is_computed_again(monkeypatch):
    """No process noise, soil or computer affects it."""
    monkeypatch.setattr(experiments, "parallel_map", map)
    claims = {id_: ledger.CLAIMS[id_] for id_ in "S2 S3 S5 N2 A6 K1".split()}
    _, findings, beside, looks = evidence.collect(claims, [1000])
    columns = ["value", "low", "high", "n", "verdict", "confidence", "beside"]
    found = ledger.ledger(findings, looks, beside, {}, claims).set_index("id")[columns]
    published = PUBLISHED.loc[[*claims], columns]
    pd.testing.assert_frame_equal(found.replace("", np.nan), published, rtol=1e-6, atol=1e-9)


def test_each_field_of_the_arrival_costs_is_driven_once():
    tasks = experiments._tasks("prediction", "arrival_cost", 300)
    assert [seed for task in tasks for seed in task.args[-1]] == [*range(300 * 64 // 1000)]
    for name, fewest in (("arrival_cost", [0, 1]), ("iterations", [0, 1])):
        tasks = experiments._tasks("printed", name, 10)
        seeds = np.ravel([task.args[-1] for task in tasks])
        assert [*seeds] == fewest and all(task.args[0] == "printed" for task in tasks)
    assert len(experiments._tasks("printed", "iterations", 100)) == 4


def test_one_iteration_stands_beside_many_once_the_robot_has_settled(monkeypatch):
    """Of drives whose errors, times and distances from the converged command are known."""
    is_late = paper.DT_S * np.arange(800) >= experiments.SETTLED_S

    def live(scenario, iterations):
        # Long enough for two rows and two turns, of which the second is to the other side.
        way_m = 2 * (scenario.row_length_m + np.pi * scenario.headland_radius_m)
        assert way_m < scenario.mu_mean * scenario.speed_mps * scenario.duration_s < 1.2 * way_m
        return np.where(is_late, 0.01 * iterations, 9.0), np.full(800, 1e-6 * iterations)

    apart = np.where(is_late, 3e-4, 9.0), np.where(is_late, -5e-4, 9.0)
    monkeypatch.setattr(experiments, "live", live)
    monkeypatch.setattr(experiments, "_distances_from_converged", lambda scenario: apart)
    found = experiments._iterations("prediction", 0)
    expected = dict(error_one_m=0.01, error_many_m=0.1, one_us=1.0, many_us=10.0)
    expected |= dict(rms_warm=3e-4, rms_cold=5e-4, max_warm=3e-4)
    assert found == pytest.approx(expected)


def test_one_iteration_a_sample_is_the_run_that_is_simulated():
    faults = (rhec.Fault(kind="jump", channel="gnss", start_s=3.0, size_m=0.5),)
    scenario = rhec.Scenario(process_noise="prediction", duration_s=8.0, seed=3, faults=faults)
    begin = time.perf_counter()
    distance_m, taken_s, problems, commands = experiments.live(scenario, 1)
    took_s = time.perf_counter() - begin
    columns = rhec.simulate(scenario).columns
    np.testing.assert_allclose(commands, columns["omega_cmd_radps"], atol=1e-9)
    np.testing.assert_allclose(distance_m, columns["error_true_m"], atol=1e-9)
    assert len(problems) == len(taken_s) == 40
    assert (taken_s > 0).all() and taken_s.sum() < took_s


def test_every_sample_has_as_many_iterations_as_were_asked_for():
    """Oracle: an RHE and an RHC on what the same robot measures under the same commands."""
    faults = (rhec.Fault(kind="jump", channel="gnss", start_s=2.0, size_m=0.5),)
    scenario = rhec.Scenario(process_noise="prediction", duration_s=4.0, faults=faults)
    *_, problems, commands = experiments.live(scenario, 3)
    robot = LiveRobot(scenario)
    estimator = rhec.RHE(process_noise="prediction", guess=tuple(robot.world.guess))
    controller = rhec.RHC()
    for z, problem, omega in zip(robot, problems, commands):
        estimator.prepare()
        estimate = estimator.solve(z, 3)
        np.testing.assert_allclose([*estimate.pose, *estimate.p], np.hstack(problem[:2]), atol=1e-9)
        controller.prepare()
        assert controller.solve(*problem, 3) == pytest.approx(omega, abs=1e-9)
        robot.drive(omega)


def test_a_cold_command_is_that_of_a_controller_just_made():
    """Its first, where the previous estimate is the newest one; a warm one may be converged."""
    scenario = rhec.Scenario(process_noise="prediction", duration_s=8.0)
    *_, problems, commands = experiments.live(scenario, 20)
    guess = np.array(closed_loop.set_up(scenario).guess)
    problems = [(guess[:3], guess[3:], *problems[0][2:]), *problems[10:]]
    commands = [rhec.RHC().solve(*problems[0]), *commands[10:]]
    first = [rhec.RHC().feedback(*problem) for problem in problems]
    twice = [each for each in problems for _ in range(2)]
    warm, cold = experiments._distances_from_converged(scenario, twice, np.repeat(commands, 2))
    np.testing.assert_allclose(warm, 0, atol=1e-9)
    np.testing.assert_allclose(cold[1::2], np.subtract(first, commands), atol=1e-12)
    assert cold[0] == pytest.approx(cold[1], abs=1e-12) and np.abs(cold).max() > 1e-3


def test_a_step_is_in_time_if_all_of_it_fits_between_two_samples(monkeypatch):
    phases_us = np.array([[1.0, 2.0, 3.0, 4.0], [1e5, 2e4, 7e4, 1e4], [1e5, 2e4, 7e4, 9e3]])
    driven = []
    monkeypatch.setattr(
        experiments.timing, "phases", lambda scenario: driven.append(scenario) or phases_us
    )
    found = experiments.steps_in_time()
    # The first sample is not counted.
    assert driven[0].duration_s == pytest.approx(paper.DT_S * (1 + PUBLISHED.loc["T7", "n"]))
    assert [*found["in_time"]] == [True, False, True]
    assert [*found["whole_us"]] == [10, 2e5, 1.99e5]
    assert [*found["feedback_us"]] == [6, 3e4, 2.9e4]


def test_a_search_ends_as_published_or_after_as_many_runs_as_is_said(monkeypatch):
    """With W by prediction it finds an estimate below zero."""
    claim = ledger.CLAIMS["M7"]
    judge = claim.rule.by_condition[statistics.PREDICTION]
    table = experiments.lowest_traction("prediction")
    found = judge({judge.tables[0]: table})
    assert (found.value, found.n) == tuple(PUBLISHED.loc["M7", ["value", "n"]])
    for name in ("guess_yaw_rad", "start_offset_m"):  # to both sides
        assert table[name].min() < -2 and table[name].max() > 2
    columns = dict(mu_hat=np.array([0.5]), kappa_hat=np.array([0.1]))
    monkeypatch.setattr(experiments, "simulate", lambda scenario: SimpleNamespace(columns=columns))
    said = int(re.search(r"in (\d+) runs", claim.test)[1])
    assert len(experiments.lowest_traction("printed")) == said


def test_at_rest_the_model_drives_straight_ahead_and_never_to_the_side():
    found = experiments.models(3)
    ahead = [mu * speed for speed, mu, *_ in experiments._draw_states(3)]
    np.testing.assert_allclose(found["at_rest_mps"], ahead)
    np.testing.assert_allclose(found[["off_unicycle_m", "sideways_mps"]], 0, atol=1e-9)


def test_the_bending_of_a_cost_is_its_second_derivative_along_a_constant_yaw_rate(monkeypatch):
    """A trajectory that is no linear function of the inputs is off the mean of two."""

    def quadratic(state, parameters, inputs):
        return inputs**2, 3.5 * inputs.sum() ** 2

    monkeypatch.setattr(experiments, "_drive_and_cost", quadratic)
    found = experiments.convexity(20)
    np.testing.assert_allclose(found["bending"], 2 * 3.5 * paper.HORIZON**2, rtol=1e-6)
    # ((u - v) / 2)² of inputs within their bounds
    assert found["off_mean_m"].between(0.002, paper.OMEGA_MAX_RADPS**2).all()


def test_the_cost_of_a_curve_has_its_inputs_and_turns_by_what_the_soil_lets_through():
    speed, mu, kappa, _ = next(experiments._draw_states(1))
    omega = 0.05 * np.ones(paper.HORIZON)
    straight = np.array(experiments._straight_ahead(speed, mu)[0]).T[1:]
    poses, cost = experiments._drive_and_cost((0.0, 0.0, 0.0), (speed, mu, kappa), omega)
    turned = kappa * 0.05 * paper.DT_S * np.arange(1, paper.HORIZON + 1)
    np.testing.assert_allclose(poses[:, 2], turned)
    np.testing.assert_allclose(np.hypot(*poses[0, :2]), mu * speed * paper.DT_S, rtol=1e-3)
    weights = np.repeat([paper.Q3], paper.HORIZON, axis=0)
    weights[-1] = paper.QN_FACTOR * np.array(paper.Q3)
    squares = (weights * (poses - straight) ** 2).sum() + paper.R * (omega**2).sum()
    assert cost == pytest.approx(squares / 2)


def test_the_share_of_sigma_that_is_left_is_of_the_second_half():
    P = np.zeros((10, 6, 6))
    P[:, 4, 4] = np.square([2.0, *[9.0] * 4, *[1.0] * 5])
    P[:, 5, 5] = np.square([1.0, *[9.0] * 4, *[0.5] * 4, 1.0])
    assert experiments._sigma_left(P) == pytest.approx(
        dict(sigma_mu_left=0.5, sigma_kappa_left=0.6)
    )


def test_the_growth_of_a_weight_has_no_unit():
    """It is that of H_N: of P's least eigenvalue, whatever the units of the states are."""
    roots = np.random.default_rng(0).normal(size=(10, 6, 6))
    P = roots @ roots.swapaxes(1, 2)
    units = np.diag([1.0, 1e3, 0.1, 5.0, 1e-3, 20.0])
    assert experiments._growth(units @ P @ units) == pytest.approx(experiments._growth(P))
    # The first covariance is the unit, whatever comes then.
    first, last = np.eye(6), np.diag([1 / 3, 1, 1, 1, 1, 1])
    halves = np.repeat([first, np.diag([1, 99, 1, 1, 1, 1]), first, last], [1, 1, 5, 3], axis=0)
    assert experiments._growth(halves) == pytest.approx(3)


def test_commands_on_estimates_are_those_on_a_truth_that_is_the_same():
    off = experiments.certainty_equivalence(4.0)["off_radps"]
    assert len(off) == 20 and off.max() < 1e-9
    (usual_s,) = experiments.certainty_equivalence.__defaults__
    assert usual_s == pytest.approx(paper.DT_S * PUBLISHED.loc["N1", "n"])


def test_the_step_with_the_usual_arrival_cost_is_the_rhe(run):
    steps = experiments.build_with_given_arrival()
    log = run.log[:60]
    estimates, P = experiments.run_with_given_arrival(steps, log, run.scenario)
    names = ["x_hat_m", "y_hat_m", "theta_hat_rad", "nu_hat_mps", "mu_hat", "kappa_hat"]
    np.testing.assert_allclose(estimates, log[names], atol=1e-8)
    W = np.diag(np.square(tuning.NOISES["rhe"]["prediction"].sigma_w))
    assert np.linalg.eigvalsh(P - W).min() >= -1e-12
    given = np.diag([1.0, 2.0, 3.0, 4.0, 5.0, 6.0])
    _, constant = experiments.run_with_given_arrival(steps, log, run.scenario, P_given=given)
    np.testing.assert_allclose(constant, np.broadcast_to(given, constant.shape), atol=1e-12)


def test_arrival_costs_are_those_of_each_field_with_its_own_covariance(monkeypatch):
    runs = [SimpleNamespace(log=f"log {seed}") for seed in (4, 7)]
    P = [dict(covariance=share * np.ones((2, 6, 6)) + np.eye(6)) for share in (0.0, 1.0)]
    monkeypatch.setattr(experiments, "simulate", lambda scenarios: runs)
    monkeypatch.setattr(experiments, "run_estimator_on_all", lambda scenario, runs, of: P)
    monkeypatch.setattr(experiments, "_arrival_cost", lambda noise, log: dict(of=f"{noise}, {log}"))
    found = experiments._arrival_costs("tracking", [4, 7])
    assert [*found["of"]] == ["tracking, log 4", "tracking, log 7"]
    assert [*found["sigma_mu_left"]] == [1, 1]


def test_an_arrival_cost_forgets_by_w_and_the_adaptive_one_is_the_rhes():
    """A heavy one holds κ nearly constant, a light one as if there were none. Late in this log the
    true yaw is a lost robot's.
    """
    log = rhec.simulate(rhec.Scenario(process_noise="prediction", duration_s=20.0)).log
    log.loc[90:, "theta_rad"] += 0.6
    row = experiments._arrival_cost("prediction", log)
    changes = log["kappa_hat"].diff()
    assert row["step_adaptive"] == pytest.approx(np.sqrt(changes.pow(2).mean()))
    error = log["kappa_hat"] - log["kappa"]
    assert row["reached_s_adaptive"] == experiments.reached_s(error.to_numpy())
    assert row["lost_adaptive"] and 0.5 < (log["theta_hat_rad"] - log["theta_rad"]).abs().max() < 1
    assert row["least"] >= -1e-9  # P - W, in units of W
    # Without W the weight of the past grows with all that was measured.
    assert row["grown_with_w"] < 1.1 < row["grown_without_w"]
    steps = [row[f"step_{name}"] for name in ("heavy", "adaptive", "light", "none")]
    assert 10 * steps[0] < steps[1] < steps[2] < 1.1 * steps[3]
    # It is about the mean covariance of full windows.
    given = experiments.build_with_given_arrival(), log, rhec.Scenario(process_noise="prediction")
    _, P = experiments.run_with_given_arrival(*given)
    heavy = P[paper.HORIZON + 1 :].mean(axis=0) / 100
    estimates, _ = experiments.run_with_given_arrival(*given, heavy)
    assert steps[0] == pytest.approx(np.sqrt(np.mean(np.diff(estimates[:, 5]) ** 2)))
