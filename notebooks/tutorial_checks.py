"""The tutorial's exercises, checked: each function takes a student's answer and says, in one
sentence, whether it has the property asked for.

What is checked is what the answer does, never how it is written: a model is compared with the exact
arc, a weight is driven, a terrain is sampled.
"""

import functools
from dataclasses import dataclass
from html import escape

import casadi as ca
import numpy as np

from rhec import paper
from rhec.simulation.closed_loop import simulate
from rhec.simulation.scenario import Scenario
from rhec.tracked_robot import kinematics as model
from rhec.tracked_robot.path import advance
from rhec.tracked_robot.terrain import Terrain

SEEDS = range(100, 110)  # seeds that neither the tutorial nor calibration uses
SETTLED_S = 15.0
OVERSHOOT_M = 0.1
DRY = (0.9, 0.8)
WET = (0.6, 0.5)
STRIP_M = (20.0, 25.0)  # the wet strip of the terrain exercise: from x to x


@dataclass(frozen=True)
class Answer:
    """Whether an answer is right, and one sentence about it. A notebook shows it in colour."""

    right: bool
    sentence: str

    def __repr__(self):
        return f"{'Right' if self.right else 'Not yet'}: {self.sentence}"

    def _repr_html_(self):
        colour, mark = ("#009E73", "✓ Right") if self.right else ("#D55E00", "✗ Not yet")
        return (
            f'<div class="answer" style="border-left: 4px solid {colour}; padding: 0.3em 0.8em">'
            f'<b style="color: {colour}">{mark}:</b> {escape(self.sentence)}</div>'
        )


class NotYet(Exception):
    """The answer lacks the property asked for; the message says which."""


def exercise(check):
    """Decorator: `check` returns a sentence of praise or raises `NotYet`. Whatever else the
    student's code raises is told as it is.
    """

    @functools.wraps(check)
    def checked(answer, *given):
        if answer is None or answer is ...:
            return Answer(
                False,
                "nothing here yet; put your answer in place of the dots, and run this cell again.",
            )
        try:
            return Answer(True, check(answer, *given))
        except NotYet as wrong:
            return Answer(False, str(wrong))
        # anything may go wrong in a student's code, and none of it should stop the notebook
        except Exception as error:
            return Answer(
                False,
                f"using your answer raised {type(error).__name__}: "
                f"{' '.join(str(error).split())[:300]}",
            )

    return checked


def expect(condition, sentence):
    if not condition:
        raise NotYet(sentence)


def numbers(value, count, what):
    """`value` as `count` numbers, of NumPy or CasADi or anything alike."""
    expect(
        value is not None and value is not ...,
        f"{what} returned nothing; it should return {count} number{'s' * (count > 1)}.",
    )
    array = np.array(value.full() if isinstance(value, ca.DM) else value, dtype=float).ravel()
    expect(array.size == count, f"{what} returned {array.size} numbers; it should return {count}.")
    expect(
        np.isfinite(array).all(),
        f"{what} returned {array.tolist()}; these should be finite numbers.",
    )
    return array


@exercise
def interval(step):
    """step(xi (3,), omega, p (3,)) -> xi after one sample: against the exact arc that constant
    inputs and traction make.
    """
    draw = np.random.default_rng(1)
    worst = 0.0
    ours = {"an Euler step": 0.0, "μ = 1": 0.0, "κ = 1": 0.0}
    for _ in range(50):
        xi = draw.normal(size=3)
        omega = draw.uniform(-1, 1)
        nu, mu, kappa = p = draw.uniform([0.2, 0.3, 0.3], [1.4, 1.0, 1.0])
        exact = arc(xi, omega, p)
        end = numbers(step(xi, omega, p), 3, "step(xi, omega, p)")
        worst = max(worst, np.abs(end - exact).max())
        for name, wrong in [
            ("an Euler step", xi + paper.DT_S * model.f(xi, omega, p).full().ravel()),
            ("μ = 1", arc(xi, omega, (nu, 1, kappa))),
            ("κ = 1", arc(xi, omega, (nu, mu, 1))),
        ]:
            ours[name] = max(ours[name], np.abs(end - wrong).max())
    looks = [name for name, distance in ours.items() if distance < 1e-4]
    expect(
        worst < 1e-6,
        f"after one sample of {paper.DT_S} s it is off by up to {worst:.2g} (m or rad) "
        "from the arc that the robot really drives"
        + (
            f"; it does exactly what {looks[0]} would do."
            if looks
            else "; Runge and Kutta's fourth order would be off by less than a millionth."
        ),
    )
    return f"never off by more than {worst:.1g} (m or rad) from the exact arc, on 50 random inputs."


def arc(xi, omega, p):
    """Where constant ω and p = (ν, μ, κ) take the pose within one sample, exactly."""
    nu, mu, kappa = p
    return np.array(advance(*xi, kappa * omega / (mu * nu), mu * nu * paper.DT_S, np))


@exercise
def weights(q):
    """q = (x, y, θ): driven on ten fields, with the calibrated RHE."""
    runs = [
        simulate(Scenario(process_noise="calibrated", q=q, seed=seed, duration_s=60.0)).metrics
        for seed in SEEDS
    ]
    settled = [run["settling_time_s"] for run in runs]
    overshoot = max(run["overshoot_m"] for run in runs)
    expect(
        not np.isnan(settled).any(),
        f"on {np.isnan(settled).sum()} of {len(runs)} fields the robot never settles within 60 s.",
    )
    said = (
        f"on {len(runs)} fields it settles within {max(settled):.1f} s "
        f"and overshoots by {overshoot:.3f} m at most"
    )
    expect(
        max(settled) <= SETTLED_S,
        f"{said}: too slow; which weight turns the robot along the row before it has reached it?",
    )
    expect(overshoot <= OVERSHOOT_M, f"{said}: too far beyond the row; which weight damps that?")
    return f"{said}."


@exercise
def feedforward(turn):
    """turn(curvature, p) -> ω: a robot that turns like this must stay on the circle, whatever the
    soil.
    """
    draw = np.random.default_rng(2)
    worst = 0.0
    ours = {"κ": 0.0, "μ": 0.0}
    for _ in range(20):
        curvature = draw.choice([-1, 1]) * draw.uniform(0.05, 0.2)
        nu, mu, kappa = p = draw.uniform([0.2, 0.4, 0.4], [1.0, 0.95, 0.95])
        (omega,) = numbers(turn(curvature, p), 1, "turn(curvature, p)")
        pose = np.zeros(3)
        for _ in range(50):
            pose = arc(pose, omega, p)
        centre = np.array([0, 1 / curvature])
        worst = max(
            worst,
            abs(np.hypot(*(pose[:2] - centre)) - 1 / abs(curvature)),
            abs(pose[2] - curvature * mu * nu * 50 * paper.DT_S),
        )
        for name, forgot in [("κ", curvature * mu * nu), ("μ", curvature * nu / kappa)]:
            ours[name] = max(ours[name], abs(omega - forgot))
    forgotten = [name for name, distance in ours.items() if distance < 1e-9]
    expect(
        worst < 1e-6,
        f"after 10 s the robot is up to {worst:.2g} (m or rad) off the circle"
        + (f"; what does {forgotten[0]} do?" if forgotten else "."),
    )
    return "the robot stays on every circle tried, on every soil."


@exercise
def estimator(learner, first):
    """Two CasADi Functions, compared at equal seeds: the RMS error of μ must be smaller with the
    learner, with the whole 95 % interval.
    """
    expect(
        isinstance(learner, ca.Function),
        f"it is a {type(learner).__name__}; "
        "it should be a CasADi Function (memory, z) -> (memory, estimate).",
    )
    for place, count, kind in [(1, 4, "input z"), (1, 6, "output estimate")]:
        size = learner.numel_in(place) if kind.startswith("input") else learner.numel_out(place)
        expect(size == count, f"the {kind} has {size} entries; it should have {count}.")
    expect(
        learner.numel_in(0) == learner.numel_out(0),
        "the memory that comes out should be as long as the one that goes in.",
    )
    runs = {
        name: [simulate(Scenario(estimator=each, seed=seed)).metrics for seed in SEEDS]
        for name, each in [("first", first), ("learner", learner)]
    }
    gain, low, high = paired(
        *(np.array([run["rms_mu"] for run in runs[name]]) for name in ("learner", "first"))
    )
    said = (
        f"RMS error of μ, learner minus first: {gain:+.4f} "
        f"(95 % interval {low:+.4f} to {high:+.4f}, {len(SEEDS)} fields)"
    )
    expect(high < 0, f"{said}; the whole interval should be below zero.")
    drove = [
        np.mean([run["mean_error_true_m"] for run in runs[name]]) for name in ("first", "learner")
    ]
    return (
        f"{said}. It knows μ better; the mean true error went from {drove[0]:.4f} m "
        f"to {drove[1]:.4f} m: does it drive better for it?"
    )


@exercise
def terrain(soil, path):
    """A Terrain with the wet strip: sampled along the path, a cell away from the strip's edges."""
    from scipy.interpolate import (
        RegularGridInterpolator,  # here, because importing it takes half a second
    )

    expect(
        isinstance(soil, Terrain), f"it is a {type(soil).__name__}; it should be a rhec.Terrain."
    )
    expect(
        soil.cell_m <= 0.5,
        f"a cell is {soil.cell_m} m wide; at most 0.5 m is needed to draw the edges of the strip.",
    )
    poses, _ = path.poses(np.arange(0, path.length_m, 0.1))
    axes = [
        origin + soil.cell_m * np.arange(points)
        for origin, points in zip(soil.origin_m, soil.mu.shape)
    ]
    inside_grid = np.clip(
        poses[:, :2], [axis[0] for axis in axes], [axis[-1] for axis in axes]
    )  # constant beyond
    found = RegularGridInterpolator(axes, np.stack([soil.mu, soil.kappa], axis=-1))(inside_grid)
    edges = np.abs(poses[:, :1] - STRIP_M)
    inside = (poses[:, 0] > STRIP_M[0]) & (poses[:, 0] < STRIP_M[1])
    for where, there, (mu, kappa) in [
        ("in the strip", inside, WET),
        ("outside the strip", ~inside, DRY),
    ]:
        wrong = (
            there
            & (edges.min(axis=1) > soil.cell_m)
            & (np.abs(found - (mu, kappa)).max(axis=1) > 1e-6)
        )
        if wrong.any():
            (x, y, _) = poses[wrong][0]
            (mu_found, kappa_found) = found[wrong][0]
            raise NotYet(
                f"at x = {x:.1f} m, y = {y:.1f} m, {where}, "
                f"it has μ = {mu_found:.3g}, κ = {kappa_found:.3g}; "
                f"it should have μ = {mu}, κ = {kappa}."
            )
    return (
        f"wet from x = {STRIP_M[0]:g} m to {STRIP_M[1]:g} m, dry elsewhere, along the whole path."
    )


@exercise
def difference(answer, one, other):
    """(mean, low, high) of one minus other at equal seeds: against the bootstrap of the paired
    differences; other ways may come out a little different.
    """
    mean, low, high = numbers(answer, 3, "your answer")
    one = np.asarray(one, dtype=float)
    other = np.asarray(other, dtype=float)
    right, right_low, right_high = paired(one, other)
    expect(
        abs(mean - right) < 1e-9 + 1e-6 * abs(right),
        f"the mean difference is {right:.3g}, not {mean:.3g}.",
    )
    width = right_high - right_low
    unpaired = 2 * 1.96 * np.sqrt((one.var() + other.var()) / len(one))
    spread = 2 * 1.96 * np.std(one - other)
    given = high - low
    like = {
        "the seeds taken apart: both ran on the same fields, "
        "so take the differences first": unpaired,
        "the spread of single seeds, not how well their mean is known": spread,
    }
    nearest = min(like, key=lambda name: abs(given - like[name]))
    expect(
        max(abs(low - right_low), abs(high - right_high)) < 0.15 * width,
        f"the interval should be about {width:.2g} wide around the mean, not {given:.2g}"
        + (f"; that is {nearest}." if abs(given - like[nearest]) < 0.2 * like[nearest] else "."),
    )
    verdict = "below" if high < 0 else "above" if low > 0 else "on both sides of"
    return (
        f"{mean:+.4f} ({low:+.4f} to {high:+.4f}), {len(one)} seeds: "
        f"the whole interval lies {verdict} zero."
    )


def paired(one, other):
    """Mean of one minus other (n,) each and its 95 % percentile bootstrap interval: (mean, low,
    high).
    """
    from rhec.workbench.studies.statistics import over_seeds  # here, as above

    return tuple(over_seeds(np.mean, one - other)[:3])
