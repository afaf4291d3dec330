"""What the live page computes, as CasADi Functions: the loop, its start, its errors and metrics.

All of it is traced from the Python that `rhec.simulate` runs: the page has no formula of its own.
"""

from types import SimpleNamespace

import casadi as ca
import numpy as np

from rhec import paper
from rhec.core._casadi.build import casadi_function
from rhec.simulation import closed_loop
from rhec.simulation.columns import COLUMNS, ESTIMATE
from rhec.simulation.metrics import SETTLING_SAMPLES, per_sample
from rhec.simulation.scenario import Scenario
from rhec.tracked_robot.choice import Choice
from rhec.tracked_robot.estimators import estimator_of
from rhec.tracked_robot.path import Path, closest
from rhec.tracked_robot.references import build_references, pose_at
from rhec.tracked_robot.terrain import Terrain

__all__ = ["METRICS", "build_live"]

# Fields of Scenario that the page may change without another structure, by their length.
_FIELDS = dict(
    q=3,
    r=1,
    qn_factor=1,
    omega_max_radps=1,
    look_ahead_m=1,
    speed_mps=1,
    start_offset_m=1,
    start_yaw_rad=1,
    guess_yaw_rad=1,
    gnss_sigma_m=1,
    encoder_sigma_mps=1,
    speed_sigma_mps=1,
    bump_sigma_radps=1,
    sigma_v=4,
)
_SOIL = ("origin_m", "cell_m", "slip", "mean_traction")  # settings that come with the soil
METRICS = (
    "settling_time_s",
    "mean_error_m",
    "mean_error_true_m",
    "max_error_true_m",
    "violations",
    "violations_true",
    "overshoot_m",
    "rms_mu",
    "rms_kappa",
    "rms_yaw_rad",
)
# What the judge remembers; of a metric, its sum or maximum so far.
_TALLY = dict.fromkeys(METRICS, 0.0) | dict(
    k=0.0,
    inside=0.0,
    settles=0.0,
    settling_time_s=np.nan,
    n=0.0,
    n_known=0.0,
    side=0.0,
    first_row=1.0,
)


def build_live(own):
    """{name: Function} of the page for the structure of Scenario(**own).

    sample: one sample of the loop (memory, noise, settings) -> (memory, row, covariance). start:
    the Scenario's numbers -> first memory, tally and settings. judge: (tally, row) -> errors, and
    the metrics so far. desired: the desired points over the horizon.
    """
    scenario = Scenario(**own)
    setup = closed_loop.set_up(scenario)
    horizon = scenario.prediction_horizon
    n_segments = len(setup.path.segments)
    return dict(
        sample=closed_loop.build_sample(*setup.structure)["step"],
        start=_build_start(scenario, setup.path),
        judge=_build_judge(setup.path),
        desired=_build_desired(horizon, n_segments),
    )


def _build_desired(horizon, n_segments):
    """The desired poses over the horizon, from a row of the log."""
    references = build_references(paper.DT_S, horizon, n_segments)["references"]
    others = [name for name in references.name_in() if name not in ("estimate", "omega_measured")]
    shapes = {name: references.size_in(name) for name in others}

    @casadi_function("desired", ca.MX, row=(len(COLUMNS), 1), **shapes)
    def desired(row, **given):
        columns = dict(zip(COLUMNS, ca.vertsplit(row)))
        estimate = ca.vertcat(*(columns[name] for name in ESTIMATE))
        return dict(xi_ref=references(estimate=estimate, omega_measured=0, **given)["xi_ref"])

    return desired


class _TracedPath(Path):
    """A Path that projects expressions."""

    def project(self, xy):
        distance, s = closest(self, *xy[0], ca)
        return distance, np.array([s], dtype=object)


def _build_start(scenario, path):
    """`closed_loop.set_up`, traced: numbers of a Scenario -> first memory and settings."""
    choice = Choice.of(scenario)
    estimator = estimator_of(choice.estimator, choice.robust)
    lengths = _FIELDS | dict(sigma_w=estimator.n_sigma_w(choice))
    traced = _TracedPath(path.segments, path.length_m, path.closed)
    told = vars(scenario) | dict(path=traced, terrain=Terrain.uniform(1.0, 1.0))

    @casadi_function("start", **{name: (length, 1) for name, length in lengths.items()})
    def start(**given):
        given = {
            name: tuple(ca.vertsplit(value)) if lengths[name] > 1 else value
            for name, value in given.items()
        }
        setup = closed_loop.set_up(SimpleNamespace(**told | given))
        made = dict(memory=setup.memory, tally=[*_TALLY.values()]) | setup.settings
        return {name: _vector(value) for name, value in made.items() if name not in _SOIL}

    return start


def _vector(value):
    """Numbers and expressions in one column, as CasADi stores a matrix."""
    if isinstance(value, ca.SX):
        return value
    return ca.densify(ca.vertcat(*map(ca.SX, np.ravel(value, order="F"))))


def _build_judge(path):
    """`rhec.simulation.metrics.metrics` sample by sample: what counts begins anew once the robot settles."""

    @casadi_function("judge", tally=(len(_TALLY), 1), row=(len(COLUMNS), 1))
    def judge(tally, row):
        t = SimpleNamespace(**dict(zip(_TALLY, ca.vertsplit(tally))))
        c = SimpleNamespace(**dict(zip(COLUMNS, ca.vertsplit(row))))
        known = (ca.fabs(c.x_meas_m) < np.inf) * (ca.fabs(c.y_meas_m) < np.inf)
        c.error_m = ca.if_else(known, closest(path, c.x_meas_m, c.y_meas_m, ca)[0], np.nan)
        c.error_true_m, s = closest(path, c.x_m, c.y_m, ca)
        pose, curvature = pose_at(s, ca.DM(path.segments.T), path.period_m)
        c.on_straight = curvature == 0
        left, gathered = per_sample(c, ca.vertsplit(pose), ca)

        begins = t.k == 0
        inside = ca.if_else(c.error_true_m < paper.TOLERANCE_M, t.inside + 1, 0)
        settles = (inside == SETTLING_SAMPLES) * ca.logic_not(t.settling_time_s >= 0)
        settled_s = (t.k - (SETTLING_SAMPLES - 1)) * paper.DT_S
        side = ca.if_else(begins, ca.sign(left), t.side)
        # First row: until the first curve; if the robot begins in one, all of it.
        first_row = ca.if_else(begins, 2 - c.on_straight, t.first_row)
        first_row = ca.if_else(first_row == 2, 2, first_row * c.on_straight)
        new = dict(
            k=t.k + 1,
            inside=inside,
            settles=settles,
            settling_time_s=ca.if_else(settles, settled_s, t.settling_time_s),
            n=ca.if_else(t.settles, 0, t.n) + 1,
            n_known=ca.if_else(t.settles, 0, t.n_known) + known,
            side=side,
            first_row=first_row,
            overshoot_m=ca.fmax(t.overshoot_m, ca.if_else(first_row > 0, -side * left, 0)),
        )
        found = {}
        for name in (name for name in METRICS if name in gathered):
            how, value = gathered[name]
            before = ca.if_else(t.settles, 0, vars(t)[name])
            added = {"mean of known": ca.if_else(known, value, 0), "rms": value**2}.get(how, value)
            so_far = new[name] = ca.fmax(before, value) if how == "max" else before + added
            mean = so_far / new["n"]
            of_known = so_far / new["n_known"]
            of = {"mean": mean, "mean of known": of_known, "rms": ca.sqrt(mean)}
            found[name] = of.get(how, so_far)
        return dict(
            tally=ca.vertcat(*(new[name] for name in _TALLY)),
            errors=ca.vertcat(c.error_m, c.error_true_m),
            metrics=ca.vertcat(*((new | found)[name] for name in METRICS)),
        )

    return judge
