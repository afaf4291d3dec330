"""The acceptance table of the judge of an RHE: faults of sensors, and what a robot may do.

Each row spoils the same drives in one way, or lets the robot do something sudden: jump with its
inputs or a parameter, stand still, be turned round. The RHE and the EKF have the same model,
noises, first guess and measurements. A row tells how many drives are lost, how far the estimate was
off, and when it was back for good.
"""

import functools
from collections.abc import Callable
from typing import Any, NamedTuple

import casadi as ca
import numpy as np

import rhec
from rhec.core._casadi import compiled
from rhec.core._casadi.packing import pack_array
from rhec.core.estimator import ekf, estimate, rhe
from rhec.core.estimator.innovation_gate import InnovationGate
from rhec.simulation.columns import MEASUREMENTS, POSE
from rhec.tracked_robot import paper_rhe, tuning
from rhec.tracked_robot.estimators import Choice
from rhec.tracked_robot.kinematics import QUANTITIES

DT_S = 0.2
LATER = (20, 100)  # a fault that is not at the first sample begins between these samples
SAMPLES = 280  # no fault lasts until 20 s before the end
LONG = 25  # samples of a long fault, 5 s
NOISY = 130  # samples of a receiver that is noisier, 26 s, and of a robot that stands
HELD = 60  # samples of a receiver that holds its position
PATIENCE = 4  # the window restarts at the fourth sample of those that follow each other
LATER_BACK = 10  # samples, 2 s: what two restarts cost beside an EKF that believes all
ANY = object()  # a judge that is not None, and no judge either: the estimator's own

WHEELBASE_M = 1.3
SIGMA_V = (0.03, 0.03, 0.05, 0.02)


class Drives(NamedTuple):
    """Drives of a robot, and where each is spoiled."""

    z: Any  # (n, samples, n_z) measurements
    places: Any  # (n, samples, 1 or 2) what the first outputs should tell
    first: Any = None  # (n,) first bad sample
    last: Any = None  # (n,) last bad sample


class Estimator(NamedTuple):
    """A step (memory, z_N, …) -> (memory, estimate, …), and what it is given."""

    step: ca.Function
    memory: Callable  # (first measurement) -> packed memory
    constants: dict


class Robot(NamedTuple):
    """A robot, and the two estimators of its drives."""

    drives: Callable  # (seeds, what happens) -> Drives
    estimators: Callable  # (judge) -> {"RHE": Estimator, "EKF": Estimator}
    lost: float  # [m] or [1] of a level: farther off is lost, nearer is back
    fastest: float  # [m] in one sample


# The estimators


def build_rhe(window):
    """The step of an RHE, as `compiled.load` takes it."""
    return dict(step=rhe.build_phases(window)["step"])


def _estimator(step, memory, values):
    names = [name for name in step.name_in() if name in values]
    return Estimator(step, memory, {name: np.reshape(values[name], (-1, 1)) for name in names})


def _estimators(window, values, guess, sigma):
    """RHE and EKF with the same numbers; `guess` maps the first measurement to a joint state."""

    def of_rhe(z):
        return pack_array(rhe.init(window, guess(z), sigma))

    def of_ekf(z):
        covariance = np.diag(np.square(sigma)).ravel()
        return np.array([*guess(z), *covariance, *np.zeros(window.interval.n_v), 0.0])

    step = compiled.load(build_rhe, window)["step"]
    kalman = compiled.load(ekf.build, window.model, window.dt_s)["step"]
    return dict(RHE=_estimator(step, of_rhe, values), EKF=_estimator(kalman, of_ekf, values))


def paper_estimators(process_noise, judge=ANY):
    """The paper's RHE, whose first guess is its first position; the EKF of the same Model."""
    scenario = rhec.Scenario(process_noise=process_noise, arrival_mean="filtered")
    window = paper_rhe.window_of(Choice.of(scenario))
    window = window if judge is ANY else window._replace(judge=judge)
    names = window.model.joint_names
    sigma = paper_rhe.SIGMA_START | dict(theta_rad=np.pi / 2)

    def guess(z):
        values = dict(zip(QUANTITIES, (*z[:2], 0.0, z[2], 1.0, 1.0)))
        return np.array([values[name] for name in names])

    values = dict(
        V=np.square(tuning.sigma_v_of(scenario)),
        W=np.square(tuning.NOISES["rhe"][process_noise].sigma_w),
        m_0=guess(np.zeros(4)),
        P_0=np.square([paper_rhe.SIGMA_START[name] for name in names]),
    )
    return _estimators(window, values, guess, np.array([sigma[name] for name in names]))


def model_estimators(model, dt_s, sigma_v, sigma_w, guess, sigma_guess, judge=ANY):
    """RHE and EKF of a Model, both from the same first guess."""
    m, sigma = estimate.joint_guess(model, guess, sigma_guess)
    values = estimate.noise_of(model, sigma_v, sigma_w) | dict(m_0=m, P_0=np.square(sigma))
    judge = InnovationGate() if judge is ANY else judge
    window = rhe.Window(model, dt_s, 10, "filtered", judge)
    return _estimators(window, values, lambda z: m, sigma)


def run(estimator, drives):
    """Estimates (n, samples, 1 or 2) of `places`, and `ok` (n, samples)."""
    n, samples, _ = drives.z.shape
    rows = drives.places.shape[-1]
    step = estimator.step.map(n)
    first = np.where(np.isfinite(drives.z[:, 0]), drives.z[:, 0], 0.0)
    memory = np.array([estimator.memory(z) for z in first]).T
    given = {name: np.tile(value, n) for name, value in estimator.constants.items()}
    found = []
    ok = []
    for k in range(samples):
        result = step(memory=memory, z_N=drives.z[:, k].T, **given)
        memory = result["memory"]
        found.append(np.array(result["estimate"])[:rows].T)
        ok.append(np.array(result.get("ok", np.ones((1, n))))[0] == 1)
    return np.swapaxes(found, 0, 1), np.array(ok).T


# The drives


@functools.cache
def paper_drives(seeds, event=None):
    """Drives in the default world; where something happens those of a simpler robot."""
    if event is not None:
        return simulated_drives("paper", seeds, event)
    scenarios = [rhec.Scenario(duration_s=DT_S * SAMPLES, seed=seed) for seed in seeds]
    logs = [run.log[:SAMPLES] for run in rhec.simulate(scenarios)]
    z, pose = (np.array([log[columns] for log in logs]) for columns in (MEASUREMENTS, POSE))
    return Drives(z, pose[..., :2])


def bicycle(x, u, p, cos=ca.cos, sin=ca.sin, tan=ca.tan, join=ca.vertcat):
    return join(u[0] * cos(x[2]), u[0] * sin(x[2]), u[0] / WHEELBASE_M * tan(u[1] + p[0]))


def unicycle(x, u, p, cos=ca.cos, sin=ca.sin, tan=ca.tan, join=ca.vertcat):
    return join(p[0] * u[0] * cos(x[2]), p[0] * u[0] * sin(x[2]), p[1] * u[1])


def gentle(k, seed):
    """A turn that changes slowly."""
    return 0.25 * np.sin(0.07 * k + seed)


def jumping(size):
    """A turn to one side and the other, a second each."""

    def turn(k, seed):
        return size * (-1) ** ((k + seed) // 5)

    return turn


class Kind(NamedTuple):
    """A robot with the inputs speed and turn, whose true parameters are drawn from `p_range`."""

    f: Callable
    parameters: dict
    guess: tuple = ()
    sigma: tuple = ()
    p_range: tuple = (0.6, 0.95)
    n_p: int = 2
    speed: float = 1.0
    change: float = 0.3  # of the speed
    turn: Callable = gentle  # (sample, seed) -> the second input
    sigma_v: tuple = SIGMA_V
    sigma_w: float = 0.005
    heading: bool = True  # whether its Model names it
    sigma_held: dict = {}  # how inputs change in a sample that does not measure them


BICYCLE = Kind(bicycle, {"offset": (-0.1, 0.1)}, (0.0,), (0.08,), (-0.08, 0.08), 1)
UNICYCLE = Kind(unicycle, {"mu": (0, 1), "kappa": (0, 1)}, (0.8,) * 2, (0.15,) * 2)
FINE = dict(change=0.0, sigma_v=(0.02, 0.02, 0.005, 0.005), sigma_w=0.002)
KINDS = {
    "bicycle": BICYCLE,
    "unicycle": UNICYCLE,
    "paper": Kind(unicycle, {}, speed=0.5, change=0.0),
} | {
    f"jumping {name}, {speed:g} m/s": robot._replace(
        speed=speed, turn=jumping(size), sigma_held={"turn": 2 * size}, **FINE
    )
    for name, robot, speed, size in (
        ("bicycle", BICYCLE, 2.0, 0.5),
        ("bicycle", BICYCLE, 3.0, 0.5),
        ("bicycle", BICYCLE, 4.0, 0.3),
        ("unicycle", UNICYCLE, 2.0, 3.0),
    )
}
TURNED = "turned round"
STANDS = "stands 26 s"


@functools.cache
def simulated_drives(name, seeds, event=None):
    """Drives of a robot, in which it is turned round, stands, or its first parameter jumps.

    A number is a jump, at sample 60: the parameter falls from 0.85 by so much.
    """
    kind = KINDS[name]
    n = len(seeds)
    z = np.zeros((n, SAMPLES, 4))
    places = np.empty((n, SAMPLES, 2))
    first = np.full(n, 60)
    for i, seed in enumerate(seeds):
        rng = np.random.default_rng([seed, 5])
        p = rng.uniform(*kind.p_range, kind.n_p)
        x = rng.normal(size=3) * (0.3, 0.3, 0.2)
        if event in (TURNED, STANDS):
            first[i] = np.random.default_rng([seed, 9]).integers(*LATER)
        elif event is not None:
            p[0] = 0.85
        for k in range(SAMPLES):
            if k:
                u = np.array([kind.speed + kind.change * np.sin(0.1 * k), kind.turn(k, seed)])
                if event == TURNED:
                    x[2] += np.pi * (k == first[i])
                elif event == STANDS:
                    u = u * (not first[i] <= k < first[i] + NOISY)
                elif event is not None:
                    p[0] -= event * (k == first[i])
                for _ in range(10):
                    slope = kind.f(x, u, p, np.cos, np.sin, np.tan, lambda *rows: np.array(rows))
                    x = x + DT_S / 10 * slope
                z[i, k, 2:] = u
            z[i, k, :2] = places[i, k] = x[:2]
        z[i, 0, 2:] = z[i, 1, 2:]
        z[i] += rng.normal(size=(SAMPLES, 4)) * kind.sigma_v
    return Drives(z, places, first, first + (NOISY if event == STANDS else 0))


@functools.cache
def model_of(name):
    kind = KINDS[name]
    return rhec.Model(
        states=("x", "y", "yaw"),
        inputs=("speed", "turn"),
        parameters=kind.parameters,
        outputs=("x", "y", "speed", "turn"),
        f=kind.f,
        heading="yaw" if kind.heading else None,
        sigma_held=kind.sigma_held,
    )


def settings_of(name):
    """Settings of an estimator of a simulated robot."""
    kind = KINDS[name]
    guess = (0.0, 0.0, 0.0, *kind.guess)
    sigma_guess = (0.3, 0.3, 0.2, *kind.sigma)
    noises = dict(sigma_v=kind.sigma_v, sigma_w=(kind.sigma_w,) * (3 + kind.n_p))
    return noises | dict(guess=guess, sigma_guess=sigma_guess)


def simulated_estimators(name, judge=ANY):
    return model_estimators(model_of(name), DT_S, **settings_of(name), judge=judge)


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
def tank_drives(seeds, jump=None):
    """A tank with an inflow of 0.2 and a leak of 0.1, which grows by `jump` at sample 60."""
    n = len(seeds)
    rng = np.random.default_rng([6, *seeds[:1]])
    leak = 0.1 + (jump or 0) * (np.arange(SAMPLES) >= 60)
    level = 1 + np.cumsum(0.2 - leak)
    truth = np.stack([level, np.full(SAMPLES, 0.2)], axis=-1)
    z = truth + 0.01 * rng.normal(size=(n, SAMPLES, 2))
    places = np.tile(level[:, None], (n, 1, 1))
    return Drives(z, places, np.full(n, 60), np.full(n, 60))


def tank_estimators(judge=ANY):
    noises = ((0.01, 0.01), (0.001, 0.001), (1.0, 0.1), (0.1, 0.1))
    return model_estimators(tank_model(), 1.0, *noises, judge=judge)


def _simulated(name):
    drives = functools.partial(simulated_drives, name)
    fastest = DT_S * (KINDS[name].speed + KINDS[name].change)
    # Half a wheelbase.
    return Robot(drives, functools.partial(simulated_estimators, name), 0.65, fastest)


ROBOTS = {
    f"paper, {noise}": Robot(paper_drives, functools.partial(paper_estimators, noise), 0.5, 0.1)
    for noise in ("printed", "consistent")
}
ROBOTS |= {name: _simulated(name) for name in KINDS if name != "paper"}
ROBOTS["tank"] = Robot(tank_drives, tank_estimators, 0.5, 0.0)

# The faults: (z, places, first bad sample k, random numbers) -> the last bad sample. They change z
# and places of one drive in place.


def _away(rng, size_m, n=1):
    angle = rng.uniform(0, 2 * np.pi, n)
    return size_m * np.stack([np.cos(angle), np.sin(angle)], axis=-1)


def wild(n, size_m, alike=False, after=None):
    """n positions off by so much, each in a direction of its own or all alike.

    Before them the position repeats, is off by `after` [m], or is missing ("gap").
    """

    def spoil(z, places, k, rng):
        start = k + (0 if after is None else 5 if after == "gap" else 1)
        if after == "repeat":
            z[k, :2] = z[k - 1, :2]
        elif after == "gap":
            z[k:start] = np.nan
        elif after is not None:
            z[k, :2] += _away(rng, after)[0]
        off = _away(rng, size_m, n)
        z[start : start + n, :2] += off[0] if alike else off
        return start + n - 1

    return spoil


def held(period, size_m=0.0):
    """A receiver that measures one sample of a few and holds it; once it is wild."""

    def spoil(z, places, k, rng):
        measured = k + np.arange(HELD) // period * period
        z[k : k + HELD, :2] = z[measured, :2]
        wild = k + HELD // 2
        z[wild : wild + period, :2] += _away(rng, size_m)[0]
        return k + HELD - 1

    return spoil


def stuck(columns):
    """The last sample of these columns for 5 s."""

    def spoil(z, places, k, rng):
        z[k : k + LONG, columns] = z[k, columns]
        return k + LONG - 1

    return spoil


def moved(size_m):
    """Positions that have moved for good, and so has what they should tell."""

    def spoil(z, places, k, rng):
        off = _away(rng, size_m)[0]
        z[k:, :2] += off
        places[k:] += off
        return k

    return spoil


def encoders(n, factor=1.0, added=(0.0, 0.0)):
    def spoil(z, places, k, rng):
        z[k : k + n, 2:] = factor * z[k : k + n, 2:] + added
        return k + n - 1

    return spoil


def left_dead(width_m=0.5):
    """Speed and turn of a robot whose left track measures 0 for 5 s."""

    def spoil(z, places, k, rng):
        right = z[k : k + LONG, 2] + width_m / 2 * z[k : k + LONG, 3]
        z[k : k + LONG, 2:] = np.stack([right / 2, right / width_m], axis=-1)
        return k + LONG - 1

    return spoil


def missing(n, columns=slice(2, 4)):
    """Inputs, all or these, that are not measured for so long."""

    def spoil(z, places, k, rng):
        z[k : k + n, columns] = np.nan
        return k + n - 1

    return spoil


def noisy(size_m, radius=True):
    """Positions of a receiver that is noisier for 26 s: each so far off, or white noise."""

    def spoil(z, places, k, rng):
        off = _away(rng, size_m, NOISY) if radius else size_m * rng.normal(size=(NOISY, 2))
        z[k : k + NOISY, :2] += off
        return k + NOISY - 1

    return spoil


# Those that may begin at the first sample, too
WILD = {
    f"{n} wild of {size:g} m{', alike' * alike}": wild(n, size, alike)
    for n in (1, 2, 3, 4)
    for size in (5.0, 30.0, 1e3, 1e4)
    for alike in ((False, True) if n > 1 else (False,))
}
WILD |= {
    f"{first:g} m, then {size:g} m": wild(1, size, after=first)
    for first in (1.2, 1.6, 2.0, 2.5)
    for size in (30.0, 1e3)
}
FAULTS = {f"repeat, then {size:g} m": wild(1, size, after="repeat") for size in (10.0, 100.0, 1e3)}
FAULTS |= {
    "gap, then 1 of 1 km": wild(1, 1e3, after="gap"),
    "gap, then 3 of 10 m": wild(3, 10.0, after="gap"),
    "held for 1 s each": held(5),
    "held for 1 s each, one 1 km off": held(5, 1e3),
    "held for 0.4 s each, one 10 m off": held(2, 10.0),
    "burst 5 s of 3 m": wild(LONG, 3.0),
    "burst 5 s of 10 m": wild(LONG, 10.0),
    "jump 3 m for 5 s": wild(LONG, 3.0, alike=True),
    "jump 10 m for 1 s": wild(5, 10.0, alike=True),
    "stuck 5 s": stuck(slice(0, 2)),
    "moved for good by 5 m": moved(5.0),
    "moved for good by 100 m": moved(100.0),
    "encoders wild once": encoders(1, added=(5.0, 0.5)),
    "encoders wild 1 s": encoders(5, added=(5.0, 0.5)),
    "encoders dead 5 s": encoders(LONG, 0.0),
    "encoders stuck 5 s": stuck(slice(2, 4)),
    "left encoder dead 5 s": left_dead(),
}
MISSING = {f"inputs missing {0.2 * n:g} s": missing(n) for n in (1, 3, 10, 25)}
MISSING |= {f"turn missing {0.2 * n:g} s": missing(n, 3) for n in (3, 10)}
NOISES = {f"positions {size:g} m off, 26 s": noisy(size) for size in (0.1, 0.3, 1.0)}
NOISES |= {f"white noise {size:g} m, 26 s": noisy(size, False) for size in (0.1, 0.6)}
SPOILED = WILD | FAULTS | MISSING | NOISES
JUMPS = {"paper": (0.2, 0.4, 0.6), "unicycle": (0.2, 0.4, 0.6), "tank": (0.1, 0.2, 0.35)}


class Case(NamedTuple):
    """A row of the table: a fault of a robot, at its "first" sample or "later"."""

    robot: str
    when: str
    fault: str  # of SPOILED, "none", TURNED, STANDS, or the size of a parameter's "jump"


def cases():
    """All rows of the table."""
    rows = []
    for robot in ROBOTS:
        jumps = robot.startswith("jumping")
        faults = MISSING | NOISES if jumps else SPOILED
        if robot != "tank":
            rows += [Case(robot, "later", "none")]
            rows += [Case(robot, "first", fault) for fault in ({} if jumps else WILD)]
            # A bicycle has no left encoder.
            names = [name for name in faults if robot != "bicycle" or "left" not in name]
            rows += [Case(robot, "later", fault) for fault in names]
            rows += [Case(robot, "later", event) for event in (TURNED, STANDS)]
        for jump in JUMPS.get(robot.split(",")[0], ()):
            rows.append(Case(robot, "later", f"parameter jumps by {jump}"))
    return rows


def event_of(case):
    """What the robot does: TURNED, STANDS, or by how much its parameter jumps; or None."""
    if case.fault.startswith("parameter"):
        return float(case.fault.split()[-1])
    return case.fault if case.fault in (TURNED, STANDS) else None


def spoiled(case, seeds):
    """The Drives of a Case."""
    robot = ROBOTS[case.robot]
    if event_of(case) is not None:
        return robot.drives(seeds, event_of(case))
    drives = robot.drives(seeds)
    z = drives.z.copy()
    places = drives.places.copy()
    first = np.zeros(len(seeds), int)
    last = np.zeros(len(seeds), int)
    spoil = SPOILED.get(case.fault, lambda z, places, k, rng: k)
    for i, seed in enumerate(seeds):
        rng = np.random.default_rng([seed, len(case.fault), 7])
        first[i] = 0 if case.when == "first" else rng.integers(*LATER)
        last[i] = spoil(z[i], places[i], first[i], rng)
    return Drives(z, places, first, last)


def moved_in_patience(case, drives, seeds):
    """How far a fault moves what is measured until the fourth sample, at which a window restarts.

    A wrong speed or parameter moves the robot from where it is predicted. Up to three wild samples
    move nothing; a burst of them is never followed.
    """
    robot = ROBOTS[case.robot]
    if case.fault == TURNED:
        return PATIENCE * 2 * robot.fastest
    if case.fault == STANDS:
        return 0.0
    if event_of(case) is not None:
        return PATIENCE * (robot.fastest or 1.0) * event_of(case)
    if "encoder" in case.fault or "missing" in case.fault:
        return PATIENCE * robot.fastest
    if case.fault.startswith(("4 wild", "jump", "stuck", "held", "moved")) or case.when == "first":
        clean = robot.drives(seeds)
        return np.nanmax(np.linalg.norm((drives.z - clean.z)[..., :2], axis=-1)) + robot.fastest
    return 0.0


class Row(NamedTuple):
    """What a row of the table counts."""

    lost: int  # drives
    lost_ok: int  # drives that are lost while `ok` is True
    worst: float  # the largest error from the fault on
    median: float  # over drives, of their largest errors
    back: int  # samples from the last bad one until the error stays small, of the slowest drive


def row_of(case, estimator, drives):
    """The Row of an Estimator."""
    robot = ROBOTS[case.robot]
    found, ok = run(estimator, drives)
    error = np.linalg.norm(found - drives.places, axis=-1)
    error = np.where(np.isfinite(error), error, np.inf)
    is_lost = error[:, -5:].max(axis=1) > robot.lost
    largest = [each[first:].max() for each, first in zip(error, drives.first)]
    outside = [np.flatnonzero(each > robot.lost) for each in error]
    back = [max(0, far[-1] + 1 - last) for far, last in zip(outside, drives.last) if len(far)]
    return Row(
        lost=int(is_lost.sum()),
        lost_ok=int((is_lost & ok[:, -5:].all(axis=1)).sum()),
        worst=float(max(largest)),
        median=float(np.median(largest)),
        back=int(max(back, default=0)),
    )


@functools.cache
def estimators_of(robot):
    """The estimators of a robot by name, with the judge that users get."""
    return ROBOTS[robot].estimators()


def rows_of(case, seeds):
    """The Rows of the RHE and of the EKF on these drives, and what `moved_in_patience` allows."""
    drives = spoiled(case, seeds)
    estimators = estimators_of(case.robot)
    rows = [row_of(case, estimators[name], drives) for name in ("RHE", "EKF")]
    return *rows, moved_in_patience(case, drives, seeds)


def breaches(rhe_row, ekf_row, moved):
    """What an RHE breaks of the rule, by name; the table asks for none."""
    broken = dict(
        lost=rhe_row.lost > ekf_row.lost,
        lost_ok=rhe_row.lost_ok > ekf_row.lost_ok,
        worst=rhe_row.worst > max(1.3 * ekf_row.worst, moved + ekf_row.median),
        back=rhe_row.back > ekf_row.back + LATER_BACK,
    )
    return [name for name, is_broken in broken.items() if is_broken]


# {row: what it breaks of the rule, and its largest figure} on drives 1000 to 1119. A window that
# restarts with a wrong heading finds it later, some noisy positions follow each other by chance,
# and a robot that stands tells nothing of its speed and traction.
KNOWN = {
    Case("paper, printed", "first", "4 wild of 5 m"): dict(back=20),
    Case("paper, printed", "first", "1.2 m, then 30 m"): dict(back=21),
    Case("paper, printed", "first", "1.2 m, then 1000 m"): dict(back=20),
    Case("paper, printed", "later", "burst 5 s of 3 m"): dict(back=36),
    Case("paper, printed", "later", "burst 5 s of 10 m"): dict(back=37),
    Case("paper, printed", "later", "positions 0.3 m off, 26 s"): dict(worst=0.545),
    Case("paper, printed", "later", "white noise 0.6 m, 26 s"): dict(back=13),
    Case("paper, printed", "later", TURNED): dict(back=27),
    Case("paper, printed", "later", STANDS): dict(worst=0.412),
    Case("paper, consistent", "first", "1.2 m, then 1000 m"): dict(back=14),
    Case("paper, consistent", "later", STANDS): dict(worst=0.208),
    Case("bicycle", "later", "encoders dead 5 s"): dict(back=28),
    Case("unicycle", "later", "stuck 5 s"): dict(back=25),
    Case("unicycle", "later", "encoders dead 5 s"): dict(back=24),
    Case("unicycle", "later", "left encoder dead 5 s"): dict(back=28),
    Case("unicycle", "later", TURNED): dict(back=26),
    Case("jumping bicycle, 2 m/s", "later", "positions 0.1 m off, 26 s"): dict(worst=0.231),
    Case("jumping bicycle, 2 m/s", "later", "positions 0.3 m off, 26 s"): dict(worst=1.12),
    Case("jumping bicycle, 3 m/s", "later", "positions 0.1 m off, 26 s"): dict(worst=0.238),
    Case("jumping bicycle, 3 m/s", "later", "positions 0.3 m off, 26 s"): dict(worst=3.06),
    Case("jumping bicycle, 4 m/s", "later", "positions 0.1 m off, 26 s"): dict(worst=0.641),
    Case("jumping bicycle, 4 m/s", "later", "positions 0.3 m off, 26 s"): dict(worst=3.77),
    Case("jumping bicycle, 4 m/s", "later", "white noise 0.1 m, 26 s"): dict(worst=0.355),
    Case("jumping unicycle, 2 m/s", "later", "inputs missing 5 s"): dict(worst=2.46, back=29),
    Case("jumping unicycle, 2 m/s", "later", "turn missing 2 s"): dict(worst=2.05),
    Case("jumping unicycle, 2 m/s", "later", "positions 0.3 m off, 26 s"): dict(worst=1.44),
}
