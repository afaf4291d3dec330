"""Checks of the tutorial's exercises.

Each check takes a student's answer and says in one sentence whether it is right. It tests what the
answer does, never how it is written: a model is compared with the exact arc, weights are driven, a
terrain is sampled.
"""

import functools
from dataclasses import dataclass
from html import escape

import casadi as ca
import numpy as np

from rhec import paper
from rhec.simulation.scenario import Scenario
from rhec.simulation.simulate import simulate
from rhec.tracked_robot import kinematics as model
from rhec.tracked_robot.path import advance
from rhec.tracked_robot.terrain import Terrain

SEEDS = range(100, 110)  # neither the tutorial nor calibration uses these
SETTLED_S = 10.0
OVERSHOOT_M = 0.06
DRY = (0.9, 0.8)
WET = (0.6, 0.5)
STRIP_M = (20.0, 25.0)  # the wet strip of the terrain exercise: from x to x
EMPTY = "nothing here yet; put your answer in place of the dots, and run this cell again."


@dataclass(frozen=True)
class Answer:
    """Whether an answer is right, and one sentence about it. A notebook shows it in colour."""

    right: bool
    sentence: str

    def __repr__(self):
        return f"{'Right' if self.right else 'Not yet'}: {self.sentence}"

    def _repr_html_(self):
        colour = "#009E73" if self.right else "#D55E00"
        mark = "✓ Right" if self.right else "✗ Not yet"
        return (
            f'<div class="answer" style="border-left: 4px solid {colour}; padding: 0.3em 0.8em">'
            f'<b style="color: {colour}">{mark}:</b> {escape(self.sentence)}</div>'
        )


class NotYet(Exception):
    """The answer is not right; the message says why."""


def exercise(check):
    """Decorate a check, which returns a sentence about a right answer or raises NotYet.

    Any other exception comes from the student's code, and its message is shown.
    """

    @functools.wraps(check)
    def checked(answer, *arguments):
        if answer is None or answer is ...:
            return Answer(False, EMPTY)
        try:
            return Answer(True, check(answer, *arguments))
        except NotYet as wrong:
            return Answer(False, str(wrong))
        # Nothing that goes wrong in a student's code should stop the notebook.
        except Exception as error:
            message = " ".join(str(error).split())[:300]
            return Answer(False, f"using your answer raised {type(error).__name__}: {message}")

    return checked


def expect(condition, sentence):
    """Raise NotYet with this sentence unless the condition holds."""
    if not condition:
        raise NotYet(sentence)


def numbers(value, count, what):
    """The value as an array of `count` numbers; it may be NumPy's, CasADi's or Python's."""
    plural = "s" * (count > 1)
    nothing = f"{what} returned nothing; it should return {count} number{plural}."
    expect(value is not None and value is not ..., nothing)
    array = np.array(value.full() if isinstance(value, ca.DM) else value, dtype=float).ravel()
    expect(array.size == count, f"{what} returned {array.size} numbers; it should return {count}.")
    not_finite = f"{what} returned {array.tolist()}; these should be finite numbers."
    expect(np.isfinite(array).all(), not_finite)
    return array


def arc(xi, omega, p):
    """The pose one sample later, exactly, for constant ω and p = (ν, μ, κ)."""
    nu, mu, kappa = p
    return np.array(advance(*xi, kappa * omega / (mu * nu), mu * nu * paper.DT_S, np))


# Exercise 1


@exercise
def interval(step):
    """Check step(xi, omega, p) -> xi one sample later, against the exact arc."""
    random = np.random.default_rng(1)
    worst = 0.0
    typical = {"an Euler step": 0.0, "μ = 1": 0.0, "κ = 1": 0.0}  # largest distance from each
    for _ in range(50):
        xi = random.normal(size=3)
        omega = random.uniform(-1, 1)
        p = random.uniform([0.2, 0.3, 0.3], [1.4, 1.0, 1.0])
        end = numbers(step(xi, omega, p), 3, "step(xi, omega, p)")
        worst = max(worst, np.abs(end - arc(xi, omega, p)).max())
        for name, wrong in _wrong_steps(xi, omega, p).items():
            typical[name] = max(typical[name], np.abs(end - wrong).max())
    mistakes = [name for name, distance in typical.items() if distance < 1e-4]
    if mistakes:
        hint = f"it does exactly what {mistakes[0]} would do."
    else:
        hint = "Runge and Kutta's fourth order would be off by less than a millionth."
    off = f"after one sample of {paper.DT_S} s it is off by up to {worst:.2g} (m or rad)"
    expect(worst < 1e-6, f"{off} from the arc that the robot really drives; {hint}")
    return f"never off by more than {worst:.1g} (m or rad) from the exact arc, on 50 random inputs."


def _wrong_steps(xi, omega, p):
    """The poses that typical mistakes lead to."""
    nu, mu, kappa = p
    return {
        "an Euler step": xi + paper.DT_S * model.f(xi, omega, p).full().ravel(),
        "μ = 1": arc(xi, omega, (nu, 1, kappa)),
        "κ = 1": arc(xi, omega, (nu, mu, 1)),
    }


# Exercise 2


@exercise
def weights(q):
    """Check the weights q of (x, y, θ): drive ten fields with W by prediction."""
    runs = [
        simulate(Scenario(process_noise="prediction", q=q, seed=seed, duration_s=60.0)).metrics
        for seed in SEEDS
    ]
    settled_s = [run["settling_time_s"] for run in runs]
    overshoot_m = max(run["overshoot_m"] for run in runs)
    n_lost = np.isnan(settled_s).sum()
    lost = f"on {n_lost} of {len(runs)} fields the robot never settles within 60 s."
    expect(n_lost == 0, lost)
    outcome = (
        f"on {len(runs)} fields it settles within {max(settled_s):.1f} s "
        f"and overshoots by {overshoot_m:.3f} m at most"
    )
    hint = "which weight turns the robot along the row before it has reached it?"
    expect(max(settled_s) <= SETTLED_S, f"{outcome}: too slow; {hint}")
    too_far = f"{outcome}: too far beyond the row; which weight damps that?"
    expect(overshoot_m <= OVERSHOOT_M, too_far)
    return f"{outcome}."


# Exercise 3


@exercise
def feedforward(turn):
    """Check turn(curvature, p) -> ω: the robot must stay on the circle, whatever the soil."""
    random = np.random.default_rng(2)
    worst = 0.0
    forgetful = {"κ": 0.0, "μ": 0.0}  # largest distance from a formula without it
    for _ in range(20):
        curvature = random.choice([-1, 1]) * random.uniform(0.05, 0.2)
        p = random.uniform([0.2, 0.4, 0.4], [1.0, 0.95, 0.95])
        nu, mu, kappa = p
        (omega,) = numbers(turn(curvature, p), 1, "turn(curvature, p)")
        worst = max(worst, _off_circle(curvature, omega, p))
        for name, wrong in {"κ": curvature * mu * nu, "μ": curvature * nu / kappa}.items():
            forgetful[name] = max(forgetful[name], abs(omega - wrong))
    forgotten = [name for name, distance in forgetful.items() if distance < 1e-9]
    hint = f"; what does {forgotten[0]} do?" if forgotten else "."
    off = f"after 10 s the robot is up to {worst:.2g} (m or rad) off the circle"
    expect(worst < 1e-6, off + hint)
    return "the robot stays on every circle tried, on every soil."


def _off_circle(curvature, omega, p):
    """How far a robot is off the circle after 10 s, in place [m] or yaw [rad]."""
    samples = round(10 / paper.DT_S)
    nu, mu, _ = p
    pose = np.zeros(3)
    for _ in range(samples):
        pose = arc(pose, omega, p)
    centre = np.array([0, 1 / curvature])
    off_m = abs(np.hypot(*(pose[:2] - centre)) - 1 / abs(curvature))
    off_rad = abs(pose[2] - curvature * mu * nu * samples * paper.DT_S)
    return max(off_m, off_rad)


# Exercise 4


@exercise
def estimator(learner, first):
    """Check that the RMS error of μ is smaller with `learner` than with `first`.

    Both are CasADi Functions and drive at equal seeds; the whole 95 % interval counts.
    """
    _check_signature(learner)
    chosen = {"learner": learner, "first": first}
    runs = {
        name: [simulate(Scenario(estimator=function, seed=seed)).metrics for seed in SEEDS]
        for name, function in chosen.items()
    }
    rms_mu = {name: np.array([run["rms_mu"] for run in runs[name]]) for name in runs}
    error_m = {name: np.mean([run["mean_error_true_m"] for run in runs[name]]) for name in runs}
    gain, low, high = paired(rms_mu["learner"], rms_mu["first"])
    outcome = (
        f"RMS error of μ, learner minus first: {gain:+.4f} "
        f"(95 % interval {low:+.4f} to {high:+.4f}, {len(SEEDS)} fields)"
    )
    expect(high < 0, f"{outcome}; the whole interval should be below zero.")
    return (
        f"{outcome}. It knows μ better; the mean true error went from {error_m['first']:.4f} m "
        f"to {error_m['learner']:.4f} m: does it drive better for it?"
    )


def _check_signature(learner):
    """Refuse what is not a CasADi Function (memory, z) -> (memory, estimate)."""
    wanted = "it should be a CasADi Function (memory, z) -> (memory, estimate)."
    expect(isinstance(learner, ca.Function), f"it is a {type(learner).__name__}; {wanted}")
    n_z = learner.numel_in(1)
    n_estimate = learner.numel_out(1)
    expect(n_z == 4, f"the input z has {n_z} entries; it should have 4.")
    expect(n_estimate == 6, f"the output estimate has {n_estimate} entries; it should have 6.")
    as_long = "the memory that comes out should be as long as the one that goes in."
    expect(learner.numel_in(0) == learner.numel_out(0), as_long)


# Exercise 5


@exercise
def terrain(soil, path):
    """Check a Terrain with the wet strip along the path, a cell away from the strip's edges."""
    kind = f"it is a {type(soil).__name__}; it should be a rhec.Terrain."
    expect(isinstance(soil, Terrain), kind)
    fine = (
        f"a cell is {soil.cell_m} m wide; at most 0.5 m is needed to draw the edges of the strip."
    )
    expect(soil.cell_m <= 0.5, fine)
    poses, _ = path.poses(np.arange(0, path.length_m, 0.1))
    traction = _traction_at(soil, poses[:, :2])
    x_m = poses[:, 0]
    is_inside = (x_m > STRIP_M[0]) & (x_m < STRIP_M[1])
    is_clear = np.abs(x_m[:, None] - STRIP_M).min(axis=1) > soil.cell_m
    for where, region, expected in [
        ("in the strip", is_inside, WET),
        ("outside the strip", ~is_inside, DRY),
    ]:
        wrong = region & is_clear & (np.abs(traction - expected).max(axis=1) > 1e-6)
        if wrong.any():
            x, y, _ = poses[wrong][0]
            mu, kappa = traction[wrong][0]
            raise NotYet(
                f"at x = {x:.1f} m, y = {y:.1f} m, {where}, it has μ = {mu:.3g}, κ = {kappa:.3g}; "
                f"it should have μ = {expected[0]}, κ = {expected[1]}."
            )
    return (
        f"wet from x = {STRIP_M[0]:g} m to {STRIP_M[1]:g} m, dry elsewhere, along the whole path."
    )


def _traction_at(soil, points):
    """(μ, κ) of a Terrain at points (n, 2): bilinear, and constant beyond the grid."""
    # Importing it takes half a second.
    from scipy.interpolate import RegularGridInterpolator

    axes = [
        origin + soil.cell_m * np.arange(size) for origin, size in zip(soil.origin_m, soil.mu.shape)
    ]
    on_grid = np.clip(points, [axis[0] for axis in axes], [axis[-1] for axis in axes])
    maps = np.stack([soil.mu, soil.kappa], axis=-1)
    return RegularGridInterpolator(axes, maps)(on_grid)


# Exercise 6


@exercise
def difference(answer, one, other):
    """Check (mean, low, high) of one minus other at equal seeds.

    The reference is the interval of the paired differences; other right ways may differ a little.
    """
    mean, low, high = numbers(answer, 3, "your answer")
    one = np.asarray(one, dtype=float)
    other = np.asarray(other, dtype=float)
    right, right_low, right_high = paired(one, other)
    is_mean = abs(mean - right) < 1e-9 + 1e-6 * abs(right)
    expect(is_mean, f"the mean difference is {right:.3g}, not {mean:.3g}.")
    width = right_high - right_low
    is_interval = max(abs(low - right_low), abs(high - right_high)) < 0.15 * width
    wanted = f"the interval should be about {width:.2g} wide around the mean, not {high - low:.2g}"
    expect(is_interval, wanted + _mistake_of_width(high - low, one, other))
    verdict = "below" if high < 0 else "above" if low > 0 else "on both sides of"
    return (
        f"{mean:+.4f} ({low:+.4f} to {high:+.4f}), {len(one)} seeds: "
        f"the whole interval lies {verdict} zero."
    )


def _mistake_of_width(width, one, other):
    """The end of the sentence about an interval of a wrong width: the mistake that explains it."""
    unpaired = "the seeds taken apart: both ran on the same fields, so take the differences first"
    single = "the spread of single seeds, not how well their mean is known"
    widths = {
        unpaired: 2 * 1.96 * np.sqrt((one.var() + other.var()) / len(one)),
        single: 2 * 1.96 * np.std(one - other),
    }
    nearest = min(widths, key=lambda mistake: abs(width - widths[mistake]))
    is_near = abs(width - widths[nearest]) < 0.2 * widths[nearest]
    return f"; that is {nearest}." if is_near else "."


def paired(one, other):
    """(mean, low, high): mean of one minus other, arrays (n,), with its 95 % interval."""
    # Importing it takes half a second.
    from notebooks.studies.statistics import over_seeds

    return tuple(over_seeds(np.mean, one - other)[:3])
