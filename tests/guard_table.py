"""The acceptance table of the guards: faults of sensors and jumps of a parameter, drive by drive.

Each row corrupts the same drives in one way. Each estimator sees the same measurements, and the EKF
has the same noises as the RHE. A row counts how many drives are lost, how far the estimate was off,
and when it was back for good.
"""

import functools
from collections.abc import Callable
from typing import Any, NamedTuple

import casadi as ca
import numpy as np

import rhec
from rhec.core._casadi import compiled
from rhec.core._casadi.packing import pack_array
from rhec.core.estimator import base, ekf, rhe
from rhec.core.estimator.innovation_gate import InnovationGate
from rhec.simulation.columns import MEASUREMENTS, POSE
from rhec.tracked_robot import rhe as paper_rhe
from rhec.tracked_robot import tuning
from rhec.tracked_robot.choice import Choice
from rhec.tracked_robot.kinematics import QUANTITIES

DT_S = 0.2
LATER = (20, 100)  # a fault that is not at the first sample begins between these samples
SAMPLES = 280  # the longest fault ends 20 s before
LONG = 25  # samples of a long fault, 5 s
WHEELBASE_M = 1.3
_SIGMA_V = (0.03, 0.03, 0.05, 0.02)


class Drives(NamedTuple):
    """Measurements (n, samples, n_z) and what they should tell of the outputs 0 and 1."""

    z: Any
    places: Any  # (n, samples, 1 or 2)


class Estimator(NamedTuple):
    """A step (memory, z_N, …) -> (memory, estimate, …), and what it is given."""

    step: ca.Function
    memory: Callable  # (first measurement) -> packed memory
    constants: dict


class Robot(NamedTuple):
    drives: Callable  # (n, jump of a parameter, from when) -> Drives
    estimators: Callable  # (judge) -> {name: Estimator}
    lost: float = 0.5  # [m] off at the end


# The estimators


def build_rhe(window, quantities):
    """The step of an RHE, as `compiled.load` takes it."""
    return dict(step=rhe.build_phases(window, quantities)["step"])


def _given(step, values):
    return {name: np.reshape(values[name], (-1, 1)) for name in step.name_in() if name in values}


def model_estimators(model, horizon, settings, judge):
    """RHE and EKF of a Model with the same numbers."""
    dt, sigma_v, sigma_w, guess, sigma = (
        settings[name] for name in ("dt", "sigma_v", "sigma_w", "guess", "sigma_guess")
    )
    m, sigma = base.joint_guess(model, guess, sigma)
    values = base.noise_of(model, sigma_v, sigma_w) | dict(m_0=m, P_0=np.square(sigma))
    window = rhe.Window(model, dt, horizon, "filtered", judge)
    steps = dict(
        RHE=compiled.load(build_rhe, window, None)["step"],
        EKF=compiled.load(ekf.build, model, dt)["step"],
    )
    kalman = rhec.EKF(model=model, **settings)
    memories = dict(
        RHE=pack_array(rhe.init(window, m, sigma)),
        EKF=kalman.first_memory,
    )
    return {
        name: Estimator(step, lambda z, first=memories[name]: first, _given(step, values))
        for name, step in steps.items()
    }


def paper_estimators(noise, judge, arrival_mean="filtered"):
    """The paper's RHE, and the EKF of the same Model and noises."""
    scenario = rhec.Scenario(process_noise=noise, arrival_mean=arrival_mean)
    window = paper_rhe.window_of(Choice.of(scenario))._replace(judge=judge)
    model = window.model
    values = dict(
        V=np.square(tuning.sigma_v_of(scenario)), W=np.square(tuning.SIGMA_W["rhe"][noise])
    )
    sigma = paper_rhe.SIGMA_START | dict(theta_rad=np.pi / 2)
    sigma = [sigma[name] for name in model.joint_names]
    values |= dict(P_0=np.square([paper_rhe.SIGMA_START[name] for name in model.joint_names]))

    def guess(z):
        values = dict(zip(QUANTITIES, (*z[:2], 0.0, z[2], 1.0, 1.0)))
        return np.array([values[name] for name in model.joint_names])

    first = dict(mu=1.0, kappa=1.0, nu_mps=0.5)
    values |= dict(m_0=np.array([first.get(name, 0.0) for name in model.joint_names]))
    step = compiled.load(build_rhe, window, QUANTITIES)["step"]
    filter_step = compiled.load(ekf.build, model, DT_S)["step"]

    def first_of_filter(z):
        n_v = window.interval.n_v
        return np.array([*guess(z), *np.diag(np.square(sigma)).ravel(), *np.zeros(n_v), 0.0])

    return dict(
        RHE=Estimator(
            step, lambda z: pack_array(rhe.init(window, guess(z), np.array(sigma))), _given(step, values)
        ),
        EKF=Estimator(filter_step, first_of_filter, _given(filter_step, values)),
    )


def run(estimator, z, rows):
    """Estimates (n, samples, rows), and `ok` (n, samples), of an Estimator on z (n, samples, n_z)."""
    n, samples, _ = z.shape
    step = estimator.step.map(n)
    first = np.where(np.isfinite(z[:, 0]), z[:, 0], 0.0)
    memory = np.array([estimator.memory(row) for row in first]).T
    given = {name: np.tile(value, n) for name, value in estimator.constants.items()}
    places, ok = [], []
    for k in range(samples):
        result = step(memory=memory, z_N=z[:, k].T, **given)
        memory = result["memory"]
        places.append(np.array(result["estimate"])[:rows].T)
        ok.append(np.array(result["ok"])[0] == 1 if "ok" in result else np.ones(n, bool))
    return np.swapaxes(places, 0, 1), np.array(ok).T


# The drives


@functools.cache
def paper_drives(n, jump=None, start=0):
    if jump is not None:
        return simulated_drives("paper", n, jump, start)
    scenarios = [rhec.Scenario(duration_s=DT_S * SAMPLES, seed=seed) for seed in range(n)]
    logs = [run.log[:SAMPLES] for run in rhec.simulate(scenarios)]
    z, pose = (np.array([log[columns] for log in logs]) for columns in (MEASUREMENTS, POSE))
    return Drives(z, pose[..., :2])


def _bicycle(x, u, p, cos=ca.cos, sin=ca.sin, tan=ca.tan, join=ca.vertcat):
    return join(u[0] * cos(x[2]), u[0] * sin(x[2]), u[0] / WHEELBASE_M * tan(u[1] + p[0]))


def _unicycle(x, u, p, cos=ca.cos, sin=ca.sin, tan=ca.tan, join=ca.vertcat):
    return join(p[0] * u[0] * cos(x[2]), p[0] * u[0] * sin(x[2]), p[1] * u[1])


class _Kind(NamedTuple):
    f: Callable
    parameters: dict
    guess: tuple
    sigma: tuple
    p_range: tuple
    speed: float = 1.0
    speed_weave: float = 0.3


KINDS = {
    "bicycle": _Kind(_bicycle, {"offset": (-0.1, 0.1)}, (0.0,), (0.08,), (-0.08, 0.08)),
    "unicycle": _Kind(
        _unicycle, {"mu": (0, 1), "kappa": (0, 1)}, (0.8,) * 2, (0.15,) * 2, (0.6, 0.95)
    ),
    "paper": _Kind(_unicycle, {}, (0, 0), (), (0.6, 0.95), 0.5, 0.0),
}


@functools.cache
def simulated_drives(name, n, jump=None, start=0):
    """Drives of a robot; its first parameter falls from .85 by `jump` at a sample."""
    kind = KINDS[name]
    every, places = [], []
    for seed in range(n):
        rng = np.random.default_rng([seed, 5])
        p = rng.uniform(*kind.p_range, len(kind.guess))
        if jump is not None:
            p[0] = 0.85
        x = rng.normal(size=3) * (0.3, 0.3, 0.2)
        z = np.zeros((SAMPLES, 4))
        place = np.empty((SAMPLES, 2))
        for k in range(SAMPLES):
            if k:
                if jump is not None and k == start:
                    p[0] -= jump
                weave = kind.speed_weave * np.sin(0.1 * k)
                u = np.array([kind.speed + weave, 0.25 * np.sin(0.07 * k + seed)])
                for _ in range(10):
                    slope = kind.f(x, u, p, np.cos, np.sin, np.tan, lambda *rows: np.array(rows))
                    x = x + DT_S / 10 * slope
                z[k, 2:] = u
            z[k, :2] = place[k] = x[:2]
        z[0, 2:] = z[1, 2:]
        every.append(z + rng.normal(size=z.shape) * _SIGMA_V)
        places.append(place)
    return Drives(np.array(every), np.array(places))


@functools.cache
def model_of(name):
    kind = KINDS[name]
    return rhec.Model(
        states=("x", "y", "yaw"),
        inputs=("speed", "turn"),
        parameters=kind.parameters,
        outputs=("x", "y", "speed", "turn"),
        f=kind.f,
    )


def simulated_estimators(name, judge):
    kind = KINDS[name]
    settings = dict(dt=DT_S, sigma_v=_SIGMA_V, guess=(0.0,) * 3 + kind.guess)
    settings |= dict(sigma_guess=(0.3, 0.3, 0.2, *kind.sigma))
    settings |= dict(sigma_w=(0.005,) * (3 + len(kind.guess)))
    return model_estimators(model_of(name), 10, settings, judge)


@functools.cache
def tank_model():
    return rhec.Model(
        states=("level",),
        inputs=("q",),
        parameters=dict(leak=(0.0, 1.0)),
        outputs=("level", "q"),
        f=lambda x, u, p: u[0] - p[0],
    )


@functools.cache
def tank_drives(n, jump=None, start=0):
    z, level = np.empty((n, SAMPLES, 2)), np.empty((n, SAMPLES, 1))
    for seed in range(n):
        rng = np.random.default_rng([seed, 6])
        x = 1.0
        for k in range(SAMPLES):
            x += 0.2 - (0.1 + (jump or 0) * (k >= start))
            level[seed, k] = x
            z[seed, k] = x + 0.01 * rng.normal(), 0.2 + 0.01 * rng.normal()
    return Drives(z, level)


def tank_estimators(judge):
    settings = dict(dt=1.0, sigma_v=(0.01, 0.01), sigma_w=(0.001, 0.001))
    settings |= dict(guess=(1.0, 0.1), sigma_guess=(0.1, 0.1))
    return model_estimators(tank_model(), 10, settings, judge)


ROBOTS = {
    "paper, printed": Robot(paper_drives, functools.partial(paper_estimators, "printed")),
    "paper, consistent": Robot(paper_drives, functools.partial(paper_estimators, "consistent")),
    "bicycle": Robot(
        functools.partial(simulated_drives, "bicycle"),
        functools.partial(simulated_estimators, "bicycle"),
    ),
    "unicycle": Robot(
        functools.partial(simulated_drives, "unicycle"),
        functools.partial(simulated_estimators, "unicycle"),
    ),
    "tank": Robot(tank_drives, tank_estimators, 0.2),
}

# The faults: (z, places, first sample k, random generator) -> the last bad sample. They change z
# and places of one drive in place.


def _away(rng, size_m, n=1):
    angle = rng.uniform(0, 2 * np.pi, n)
    return size_m * np.stack([np.cos(angle), np.sin(angle)], axis=-1)


def wild(n, size_m, alike=False, after=None):
    """n positions off by so much, each in a direction of its own or alike."""

    def apply(z, places, k, rng):
        start = k
        if after == "repeat":
            z[k, :2] = z[k - 1, :2]
            start = k + 1
        elif after == "gap":
            z[k : k + 5] = np.nan
            start = k + 5
        elif after is not None:
            z[k, :2] += _away(rng, after)[0]
            start = k + 1
        off = _away(rng, size_m, n)
        z[start : start + n, :2] += off[0] if alike else off
        return start + n - 1

    return apply


def held(period, size_m=None):
    """A receiver that gives a new position only every so many samples; one of them wild."""

    def apply(z, places, k, rng):
        n = 60
        for j in range(k, k + n):
            z[j, :2] = z[j - (j - k) % period, :2]
        if size_m:
            z[k + n // 2 : k + n // 2 + period, :2] += _away(rng, size_m)[0]
        return k + n - 1

    return apply


def stuck(columns, n=LONG):
    def apply(z, places, k, rng):
        z[k : k + n, columns] = z[k, columns]
        return k + n - 1

    return apply


def jump(size_m, n=LONG):
    return wild(n, size_m, alike=True)


def moved(size_m):
    def apply(z, places, k, rng):
        off = _away(rng, size_m)[0]
        z[k:, :2] += off
        places[k:] += off
        return k

    return apply


def encoders(n, factor=1.0, added=(0.0, 0.0)):
    def apply(z, places, k, rng):
        z[k : k + n, 2:] = factor * z[k : k + n, 2:] + added
        return k + n - 1

    return apply


def left_dead(n=LONG, width_m=0.5):
    def apply(z, places, k, rng):
        right = z[k : k + n, 2] + width_m / 2 * z[k : k + n, 3]
        z[k : k + n, 2:] = np.stack([right / 2, right / width_m], axis=-1)
        return k + n - 1

    return apply


def nothing(z, places, k, rng):
    return k


FAULTS = {
    f"{n} wild of {size:g} m{', alike' if alike else ''}": wild(n, size, alike)
    for n in (1, 2, 3, 4)
    for size in (5.0, 30.0, 1e3, 1e4)
    for alike in ((False, True) if n > 1 else (False,))
}
FAULTS |= {f"repeat, then {size:g} m": wild(1, size, after="repeat") for size in (10.0, 100.0, 1e3)}
FAULTS |= {
    f"{first:g} m, then {size:g} m": wild(1, size, after=first)
    for first in (1.2, 1.6, 2.0, 2.5)
    for size in (30.0, 1e3)
}
FAULTS |= {f"gap, then {n} of {size:g} m": wild(n, size, after="gap") for n, size in ((1, 1e3), (3, 10.0))}
FAULTS |= {
    "held 1 s": held(5),
    "held 1 s, one 1 km off": held(5, 1e3),
    "held 0.4 s, one 10 m off": held(2, 10.0),
    "burst 5 s of 3 m": wild(LONG, 3.0),
    "burst 5 s of 10 m": wild(LONG, 10.0),
    "jump 3 m for 5 s": jump(3.0),
    "jump 10 m for 1 s": jump(10.0, 5),
    "stuck 5 s": stuck(slice(0, 2)),
    "moved for good by 5 m": moved(5.0),
    "moved for good by 100 m": moved(100.0),
}
ENCODERS = {
    "encoders wild once": encoders(1, added=(5.0, 0.5)),
    "encoders wild 1 s": encoders(5, added=(5.0, 0.5)),
    "encoders dead 5 s": encoders(LONG, 0.0),
    "encoders stuck 5 s": stuck(slice(2, 4)),
    "left encoder dead 5 s": left_dead(),
}
JUMPS = (0.2, 0.4, 0.6)


class Case(NamedTuple):
    robot: str
    fault: str
    when: str  # "first" or "later"


def cases():
    every = []
    for robot in ("paper, printed", "paper, consistent", "bicycle", "unicycle"):
        every += [Case(robot, "none", "later")]
        every += [
            Case(robot, fault, "first")
            for fault in FAULTS
            if not fault.startswith(("repeat", "moved", "held", "stuck", "jump", "burst", "gap"))
        ]
        every += [
            Case(robot, fault, "later")
            for fault in FAULTS | ENCODERS
            if robot != "bicycle" or not fault.startswith("left")
        ]
        if robot != "bicycle":
            every += [Case(robot, f"parameter falls by {size}", "later") for size in JUMPS]
    every += [Case("tank", f"leak grows by {size}", "later") for size in (0.1, 0.2, 0.35)]
    return every


def corrupted(case, n):
    """The Drives of a Case, with the first and the last bad sample of each."""
    robot = ROBOTS[case.robot]
    if case.fault.startswith(("parameter", "leak")):
        start = 60
        drives = robot.drives(n, float(case.fault.split()[-1]), start)
        return drives, np.full(n, start), np.full(n, start)
    drives = robot.drives(n)
    z, places = drives.z.copy(), drives.places.copy()
    apply = (FAULTS | ENCODERS | dict(none=nothing))[case.fault]
    first, last = [], []
    for seed in range(n):
        rng = np.random.default_rng([seed, len(case.fault), 7])
        k = 0 if case.when == "first" else int(rng.integers(*LATER))
        first.append(k)
        last.append(apply(z[seed], places[seed], k, rng))
    return Drives(z, places), np.array(first), np.array(last)


class Row(NamedTuple):
    lost: int  # drives
    lost_ok: int  # drives that were lost while `ok` was True in the last sample
    worst: float  # the largest error [m] from the fault on
    median: float  # of the drives' largest errors
    back: int  # samples from the last bad one until the error stays small, of the slowest drive
    not_ok: float  # samples a drive


def row_of(robot, estimator, drives, first, last):
    rows = drives.places.shape[-1]
    found, ok = run(estimator, drives.z, rows)
    error = np.linalg.norm(found - drives.places, axis=-1)
    error = np.where(np.isfinite(error), error, np.inf)
    is_lost = error[:, -5:].max(axis=1) > robot.lost
    largest = [e[k:].max() for e, k in zip(error, first)]
    outside = [np.flatnonzero(e > robot.lost) for e in error]
    back = [max(0, (o[-1] if len(o) else 0) - k + 1) for o, k in zip(outside, last)]
    return Row(
        int(is_lost.sum()),
        int((is_lost & ok[:, -5:].all(axis=1)).sum()),
        float(max(largest)),
        float(np.median(largest)),
        int(max(back)),
        float((~ok).sum() / len(ok)),
    )
