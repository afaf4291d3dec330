"""How often the verdict and the intervals of `rhec log` are right, on drives with a truth.

    python -m notebooks.further.recorded.verdicts [SEEDS]

drives simulated robots in closed and in open loop, asks `rhec.log` of each, and writes tables of
docs/recorded_robots.md. With 4 seeds these are 80 drives in closed and 44 in open loop.

A log is *wrong* if more than 5 % of its true yaws are more than 0.2 rad off, on the way or
smoothed, if the κ of the true path is more than 0.02 outside its interval, or if fewer than 85 % of
the true yaws on the way are within 1.96 σ. *False trust* is trust in a wrong log, *false alarm* "do
not trust" of one that is not, and *untold* "cannot tell" of one that is not.
"""

import sys
import warnings
from collections.abc import Callable
from functools import partial
from typing import NamedTuple

import numpy as np
import pandas as pd
from scipy import signal

import rhec
from notebooks.further.recorded.scores import save, score
from notebooks.studies.parallel import parallel_map
from notebooks.studies.statistics import share_interval
from rhec.logs import terms
from rhec.simulation.columns import ESTIMATE, POSE

SEEDS = 4  # of each kind in open loop, and twice as many in closed loop
FIRST_SEED = 560_000  # other seeds than those by which constants were chosen
_MOST_BAD = 0.05  # share of the yaws
FAR_KAPPA = 0.02
_LEAST_COVERED = 0.85

# Robots in open loop: their tracks follow a list of speeds, whatever the positions say.
MU, KAPPA = 0.95, 0.7
_FINE_S = 0.01
_RATE_HZ = 10
_SLIP = 0.05  # standard deviation of the tracks' slip in 1 s, as a share of their speeds
# {kind: changes of the robot}
OPEN_LOOP = {
    "as it is": {},
    "positions 0.2 s late": dict(late_s=0.2),
    "45 s short": dict(duration_s=45.0),
    "25 s short": dict(duration_s=25.0),
    "drift of 0.02 rad/m": dict(drift_radpm=0.02),
    "GNSS that wanders by 0.3 m": dict(wander_m=0.3),
    "GNSS that wanders by 1 m": dict(wander_m=1.0),
    "side slip of 0.3 rad on a slope": dict(slope_rad=0.3),
    "κ = μ = 1": dict(mu=1.0, kappa=1.0, slip=0.0),
    "GNSS of 1 Hz": dict(gnss_hz=1),
    # As the logs of MRCLAM, whose odometry is the command and whose positions are by cameras.
    "commands for encoders, 0.3 s early": dict(lag_s=0.3, noise_m=0.001),
}


def open_loop_log(
    seed,
    duration_s=180.0,
    mu=MU,
    kappa=KAPPA,
    slip=_SLIP,
    drift_radpm=0.0,
    slope_rad=0.0,
    late_s=0.0,
    lag_s=0.0,
    wander_m=0.0,
    gnss_hz=5,
    noise_m=0.02,
):
    """A log of a robot that drives, stands, turns on the spot and reverses, with its truth.

    Args:
        seed: Of the drive and the noise.
        duration_s: Of the drive [s].
        mu, kappa: Its mean traction.
        slip: Standard deviation of the traction from second to second.
        drift_radpm: By which it turns for each metre over ground.
        slope_rad: Amplitude of the angle between its way and its yaw, where it drives across a
            slope that rises along x.
        late_s: Delay of the time stamps of the positions [s].
        lag_s: After which the robot does what its encoders say [s].
        wander_m: Standard deviation of errors of the positions that wander over 60 s [m].
        gnss_hz: Rate of the positions.
        noise_m: Their white noise [m].
    """
    rng = np.random.default_rng(seed)
    n = round(duration_s / _FINE_S)
    begins = np.arange(0.0, duration_s + 8.0, 8.0)
    speeds = rng.choice([0.9, 0.7, -0.6, 0.0], len(begins), p=[0.5, 0.25, 0.15, 0.1])
    turns = rng.uniform(-0.9, 0.9, len(begins))
    t = _FINE_S * np.arange(n)
    # A new command is followed within about a second.
    at = np.sort(np.concatenate([begins, begins + 1.0]))
    nu, omega = (np.interp(t, at, np.concatenate([[0.0], np.repeat(each, 2)])[: len(at)])
                 for each in (speeds, turns))  # fmt: skip
    seconds = np.arange(0.0, duration_s + 1.0)
    slips = (1 + slip * rng.standard_normal(len(seconds)) for _ in range(2))
    of_mu, of_kappa = (np.interp(t, seconds, each) for each in slips)
    ahead = mu * of_mu * np.interp(t - lag_s, t, nu)
    turning = kappa * of_kappa * np.interp(t - lag_s, t, omega) + drift_radpm * ahead
    yaw = rng.uniform(-np.pi, np.pi) + np.cumsum(_FINE_S * turning)
    course = yaw + slope_rad * np.sin(yaw)
    place = np.cumsum(_FINE_S * ahead * np.exp(1j * course))
    every = round(1 / _RATE_HZ / _FINE_S)
    # An encoder has the mean since the row before.
    means = {name: each.reshape(-1, every).mean(axis=1)
             for name, each in dict(speed_mps=nu, yaw_rate_radps=omega, v_true_mps=ahead,
                                    yaw_rate_true_radps=turning).items()}  # fmt: skip
    last = slice(every - 1, None, every)
    log = pd.DataFrame(dict(t_s=t[last], **means, yaw_true_rad=yaw[last]))
    log["x_true_m"], log["y_true_m"] = place[last].real, place[last].imag
    measured = np.interp(t[last] - late_s, t, place)
    measured += noise_m * (rng.standard_normal((2, len(log))).T @ [1, 1j])
    measured += _wandering(len(log), wander_m, rng)
    is_there = np.arange(len(log)) % round(_RATE_HZ / gnss_hz) == 0
    log["x_m"], log["y_m"] = (
        np.where(is_there, each, np.nan) for each in (measured.real, measured.imag)
    )
    return log


def _wandering(n, sigma_m, rng):
    """Errors (n,) x + iy [m] of a Gauss-Markov process with a time constant of 60 s."""
    a = np.exp(-1 / _RATE_HZ / 60.0)
    steps = sigma_m * rng.standard_normal((2, n)).T @ [1, 1j]
    steps[1:] *= np.sqrt(1 - a**2)
    return signal.lfilter([1.0], [1.0, -a], steps)


def closed_loop_log(world, sensors, seed):
    """The log of a simulated drive on the default path."""
    return rhec.simulate(rhec.Scenario(**rhec.WORLDS[world], sensors=sensors, seed=seed)).log


class Drive(NamedTuple):
    """A simulated drive."""

    loop: str
    kind: str
    seed: int
    make: Callable  # () -> its log
    known: list | None = None  # μ, κ and drift of a robot in open loop


def drives(seeds):
    """All Drives, of ten kinds in closed and eleven in open loop, one seed after the other.

    Args:
        seeds: How many seeds a kind has in the open loop; in the closed loop there are twice as
            many.
    """
    for number in range(2 * seeds):
        seed = FIRST_SEED + number
        for world in rhec.WORLDS:
            for sensors in ((), ("gyro",)):
                kind = f"{world}, with a gyro" if sensors else world
                yield Drive("closed", kind, seed, partial(closed_loop_log, world, sensors, seed))
        for kind, changes in OPEN_LOOP.items() if number % 2 == 0 else ():
            traction = changes.get("mu", MU), changes.get("kappa", KAPPA)
            known = [*traction, changes.get("drift_radpm", 0.0)]
            yield Drive("open", kind, seed, partial(open_loop_log, seed, **changes), known)


def true_slopes(samples):
    """μ, κ and drift of the true path, by the regression of `rhec.logs.terms`."""
    there = samples[samples[POSE[2]].notna() & samples[POSE[0]].notna()]
    truth = there.assign(**dict(zip(ESTIMATE[:3], (there[name] for name in POSE))))
    return terms.slopes(truth.assign(arm_forward_hat_m=0.0, arm_left_hat_m=0.0))


def judged(log, known=None):
    """What `rhec.log` says of a log with a truth, and whether that is right: {name: value}.

    Args:
        log: DataFrame of the log.
        known: μ, κ and drift of its robot; by default those of its true path.
    """
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return of_summary(rhec.log(log, trust_log=True), known)


def of_summary(summary, known=None):
    """The row of `judged`, from the Summary that `rhec.log` has returned."""
    row = dict(is_trusted=summary.verdict.startswith("Trust it"), verdict=summary.verdict)
    row |= {name: summary.numbers[name] for name in ("inflation", "hidden", "hidden_covered")}
    for name, samples in (("way", summary.way), ("smoothed", summary.samples)):
        scores = score(samples)
        row[f"{name}_rms_rad"] = scores["yaw_rms_rad"]
        row[f"{name}_bad"] = scores["not_good"]
        row[f"{name}_in_95"] = scores["inside_95"]
    of_path = [slope.value for slope in true_slopes(summary.samples)]
    for (name, told), true, path in zip(summary.traction.iterrows(), known or of_path, of_path):
        row |= {f"{name}_true": true, f"{name}_path": path}
        row |= {f"{name}_{end}": float(told[end]) for end in ("low", "high")}
    outside = max(row["κ_low"] - row["κ_path"], row["κ_path"] - row["κ_high"], 0.0)
    is_bad = max(row["way_bad"], row["smoothed_bad"]) > _MOST_BAD
    row["is_wrong"] = bool(is_bad or outside > FAR_KAPPA or row["way_in_95"] < _LEAST_COVERED)
    return row


def trials(seeds):
    """A row of `judged` for each of `drives`, a DataFrame."""
    return pd.DataFrame(parallel_map(_tried, [*drives(seeds)]))


def _tried(drive):
    """The row of a Drive."""
    about = dict(loop=drive.loop, kind=drive.kind, seed=drive.seed)
    return about | judged(drive.make(), drive.known)


def rates(rows):
    """False trust and false alarms by loop, a DataFrame with Clopper and Pearson's intervals."""
    table = []
    for loop, of_loop in rows.groupby("loop"):
        wrong, trusted = (of_loop[name].astype(bool) for name in ("is_wrong", "is_trusted"))
        untold = of_loop["verdict"].str.startswith("Cannot tell")
        for rate, cases, counts in (
            ("false trust", wrong, trusted),
            ("false alarm", ~wrong, ~trusted & ~untold),
            ("untold", ~wrong, untold),
        ):
            k, n = int((cases & counts).sum()), int(cases.sum())
            low, high = share_interval(k, n) if n else (np.nan, np.nan)
            row = dict(drives=f"{loop} loop", seeds=of_loop["seed"].nunique(), rate=rate)
            table.append(row | dict(k=k, n=n, low=low, high=high))
    return pd.DataFrame(table)


def coverage(rows):
    """How often 95 % intervals hold the truth, by loop and kind, a DataFrame.

    Those of μ, κ and the drift once a drive, NaN where a log is too short for them; those of the
    yaw in the mean over its samples.
    """
    table = rows[["loop", "kind"]].copy()
    for name in ("μ", "κ", "drift"):
        low, true, high = (rows[f"{name}_{end}"] for end in ("low", "true", "high"))
        table[name] = true.between(low, high).where(low.notna()).astype(float)
    table["yaw on the way"] = rows["way_in_95"]
    table["yaw smoothed"] = rows["smoothed_in_95"]
    return table.groupby(["loop", "kind"], sort=False).mean().reset_index()


if __name__ == "__main__":
    seeds = int(sys.argv[1]) if len(sys.argv) > 1 else SEEDS
    rows = trials(seeds)
    save("verdicts", rates(rows), "Rates of false trust and false alarms")
    save("coverage", coverage(rows), "How often intervals hold the truth")
    print(rates(rows).to_string(), coverage(rows).to_string(), sep="\n\n")
