"""What the live page computes, as CasADi Functions: the loop, its start, its errors and metrics.

All of it is traced from the Python that `rhec.simulate` runs: the page has no formula of its own.
"""

from types import SimpleNamespace

import casadi as ca
import numpy as np

from rhec import paper, simulation
from rhec._casadi.build import casadi_function
from rhec.columns import COLUMNS, ESTIMATE
from rhec.metrics import SETTLING_SAMPLES
from rhec.scenario import Scenario
from rhec.tracked_robot.estimators import Choice, estimator_of
from rhec.tracked_robot.path import Path, closest
from rhec.tracked_robot.references import build_references, pose_at
from rhec.tracked_robot.terrain import Terrain

__all__ = ["METRICS", "build_live"]

# Fields of Scenario that the page may change without another structure, by their length.
_FIELDS = dict(
    q=3, r=1, qn_factor=1, omega_max_radps=1, look_ahead_m=1, speed_mps=1,
    start_offset_m=1, start_yaw_rad=1, guess_yaw_rad=1, gnss_sigma_m=1, encoder_sigma_mps=1,
    speed_sigma_mps=1, bump_sigma_radps=1, sigma_v=4,
)  # fmt: skip
_SOIL = ("origin_m", "cell_m", "slip", "mean_traction")  # settings that come with the soil
_TALLY = dict(
    k=0.0, inside=0.0, settles=0.0, settling_time_s=np.nan, n=0.0, n_known=0.0, error=0.0,
    error_true=0.0, max_true=0.0, over=0.0, over_true=0.0, side=0.0, first_row=1.0,
    beyond=-np.inf, mu=0.0, kappa=0.0, yaw=0.0,
)  # fmt: skip
METRICS = (
    "settling_time_s", "mean_error_m", "mean_error_true_m", "max_error_true_m", "violations",
    "violations_true", "overshoot_m", "rms_mu", "rms_kappa", "rms_yaw_rad",
)  # fmt: skip


def build_live(own):
    """{name: Function} of the page for the structure of Scenario(**own).

    sample: one sample of the loop (memory, noise, settings) -> (memory, row, covariance). start:
    the Scenario's numbers -> first memory, tally and settings. judge: (tally, row) -> errors, and
    the metrics so far. desired: the desired points over the horizon.
    """
    scenario = Scenario(**own)
    setup = simulation.set_up(scenario)
    horizon, n_segments = scenario.prediction_horizon, len(setup.path.segments)
    return dict(
        sample=simulation.build_sample(*setup.structure)["step"],
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
    """`simulation.set_up`, traced: numbers of a Scenario -> first memory and settings."""
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
        setup = simulation.set_up(SimpleNamespace(**told | given))
        made = dict(memory=setup.memory, tally=[*_TALLY.values()]) | setup.settings
        return {name: _vector(value) for name, value in made.items() if name not in _SOIL}

    return start


def _vector(value):
    """Numbers and expressions in one column, as CasADi stores a matrix."""
    if isinstance(value, ca.SX):
        return value
    return ca.densify(ca.vertcat(*map(ca.SX, np.ravel(value, order="F"))))


def _build_judge(path):
    """`rhec.metrics.metrics` sample by sample: what counts begins anew once the robot settles."""
    pieces = {name: (1, 1) for name in _TALLY}

    @casadi_function("judge", tally=(len(pieces), 1), row=(len(COLUMNS), 1))
    def judge(tally, row):
        t = SimpleNamespace(**dict(zip(pieces, ca.vertsplit(tally))))
        c = SimpleNamespace(**dict(zip(COLUMNS, ca.vertsplit(row))))
        known = (ca.fabs(c.x_meas_m) < np.inf) * (ca.fabs(c.y_meas_m) < np.inf)
        error = closest(path, c.x_meas_m, c.y_meas_m, ca)[0]
        error_true, s = closest(path, c.x_m, c.y_m, ca)
        pose, curvature = pose_at(s, ca.DM(path.segments.T), path.period_m)
        straight = curvature == 0

        def total(before, value, when=1):
            return ca.if_else(t.settles, 0, before) + ca.if_else(when, value, 0)

        inside = ca.if_else(error_true < paper.TOLERANCE_M, t.inside + 1, 0)
        settles = (inside == SETTLING_SAMPLES) * ca.logic_not(t.settling_time_s >= 0)
        settled_s = (t.k - (SETTLING_SAMPLES - 1)) * paper.DT_S

        begins = t.k == 0
        left = (c.y_m - pose[1]) * ca.cos(pose[2]) - (c.x_m - pose[0]) * ca.sin(pose[2])
        side = ca.if_else(begins, ca.sign(left), t.side)
        # First row: until the first curve; if the robot begins in one, all of it.
        first_row = ca.if_else(begins, 2 - straight, t.first_row)
        first_row = ca.if_else(first_row == 2, 2, first_row * straight)
        new = dict(
            k=t.k + 1, inside=inside, settles=settles,
            settling_time_s=ca.if_else(settles, settled_s, t.settling_time_s),
            n=total(t.n, 1), n_known=total(t.n_known, 1, known), error=total(t.error, error, known),
            error_true=total(t.error_true, error_true),
            max_true=ca.fmax(ca.if_else(t.settles, 0, t.max_true), error_true),
            over=total(t.over, (error > paper.TOLERANCE_M) * straight, known),
            over_true=total(t.over_true, (error_true > paper.TOLERANCE_M) * straight),
            side=side, first_row=first_row,
            beyond=ca.fmax(t.beyond, ca.if_else(first_row > 0, -side * left, -np.inf)),
            mu=total(t.mu, (c.mu_hat - c.mu) ** 2),
            kappa=total(t.kappa, (c.kappa_hat - c.kappa) ** 2),
            yaw=total(t.yaw, (c.theta_hat_rad - c.theta_rad) ** 2),
        )  # fmt: skip
        a = SimpleNamespace(**new)
        metrics = (
            a.settling_time_s, a.error / a.n_known, a.error_true / a.n, a.max_true, a.over,
            a.over_true, ca.fmax(a.beyond, 0), ca.sqrt(a.mu / a.n), ca.sqrt(a.kappa / a.n),
            ca.sqrt(a.yaw / a.n),
        )  # fmt: skip
        errors = ca.vertcat(ca.if_else(known, error, np.nan), error_true)
        return dict(
            tally=ca.vertcat(*(new[name] for name in pieces)), errors=errors,
            metrics=ca.vertcat(*metrics),
        )  # fmt: skip

    return judge
