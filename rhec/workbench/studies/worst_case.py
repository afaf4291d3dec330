"""The worst drive within bounds: soil, bumps and position errors chosen against the robot.

A share of random fields says how often; this says how far. Within bounds, `level` times two
standard deviations of the default scenario each, differential evolution looks for the drive (the
first row and headland, begun on the path) that goes furthest off it: traction of all the soil and
of one patch, where that lies; bumps and position errors always at their bound, with a sign that
changes periodically. What is found exists, by its seed and numbers; what is not found may exist.
"""

import dataclasses

import numpy as np
import pandas as pd
from scipy import optimize

from rhec import paper
from rhec.core._casadi import compiled, scan
from rhec.core._casadi.build import packed_size
from rhec.simulation.closed_loop import build_sample, finish, set_up
from rhec.simulation.scenario import Scenario
from rhec.tracked_robot import plant as robot

__all__ = ["drive", "search"]

_SIGMAS = 2.0  # at level 1
_ROW_M = paper.ROW_LENGTH_M
_HEADLAND_M = np.pi * paper.HEADLAND_RADIUS_M
_SIGNS = (-1.0, 1.0)  # of a bound
_RANGES = dict(
    mu=_SIGNS,
    kappa=_SIGNS,
    patch_mu=_SIGNS,
    patch_kappa=_SIGNS,
    patch_radius_m=(0.5, 4.0),
    patch_s_m=(10.0, _ROW_M + _HEADLAND_M),
    bump_period_s=(0.4, 20.0),
    bump_phase=(0.0, 1.0),
    gnss_period_s=(0.4, 40.0),
    gnss_phase=(0.0, 1.0),
    gnss_angle_rad=(0.0, np.pi),
)


def drive(base, level, **chosen):
    """The Run of a scenario's fields with the choices in _RANGES, at a level of the bounds."""
    off = {name: _SIGMAS * level * getattr(base, f"{name}_deviation") for name in ("mu", "kappa")}
    soil = {name: getattr(base, f"{name}_mean") for name in off}
    mu, kappa, *patch = (
        float(np.clip(soil[name] + off[name] * chosen[of], 0.01, 0.999))
        for name, of in zip(("mu", "kappa") * 2, ("mu", "kappa", "patch_mu", "patch_kappa"))
    )
    where = dict(mu_mean=mu, kappa_mean=kappa, mu_deviation=0.0, kappa_deviation=0.0)
    plain = dataclasses.replace(base, **where)
    ((x, y, _),), _ = set_up(plain).path.poses([chosen["patch_s_m"]])
    disc = (float(x), float(y), float(chosen["patch_radius_m"]), *patch)
    scenario = dataclasses.replace(plain, patches=(disc,))
    setup = set_up(scenario)

    noise = robot.draw_noise(scenario.seed, round(scenario.duration_s / paper.DT_S))
    ends = np.cumsum([packed_size({name: of}) for name, of in robot.NOISE.items()])
    places = dict(zip(robot.NOISE, np.split(np.arange(ends[-1]), ends[:-1])))
    t_s = np.arange(len(noise)) * paper.DT_S
    angle = chosen["gnss_angle_rad"]
    swing = {
        of: _SIGMAS
        * level
        * np.where((t_s / chosen[f"{of}_period_s"] + chosen[f"{of}_phase"]) % 1 < 0.5, 1.0, -1.0)
        for of in ("bump", "gnss")
    }
    noise[:, places["bump"]] = swing["bump"][:, None]
    noise[:, places["white"]] = np.outer(swing["gnss"], [np.cos(angle), np.sin(angle)])
    functions = compiled.load(build_sample, *setup.structure)
    return finish(scenario, setup, scan.scan(functions, setup.memory, noise, setup.settings)[1])


def search(levels, seed=0, evaluations=100, **fields):
    """The worst drives found, one row a level: their largest error [m], and the choices.

    Args:
        levels: Of the bounds.
        seed: Of the search, and of the encoders' noise.
        evaluations: Drives a level, about.
        fields: Of Scenario.
    """
    longest_s = 1.3 * (_ROW_M + _HEADLAND_M) / (paper.SPEED_MPS * Scenario.mu_mean)
    given = dict(duration_s=longest_s, start_offset_m=0.0, seed=seed)
    base = Scenario(**given | fields)
    rows = []

    def error_m(values, level):
        columns = drive(base, level, **dict(zip(_RANGES, values))).columns
        return -columns["error_true_m"][columns["s_m"] < _ROW_M + _HEADLAND_M].max()

    for level in levels:
        members = 2 * len(_RANGES)
        found = optimize.differential_evolution(
            error_m,
            [*_RANGES.values()],
            args=(level,),
            popsize=2,
            polish=False,
            tol=0,
            maxiter=max(1, evaluations // members - 1),
            rng=np.random.default_rng(seed),
        )
        rows.append(dict(level=level, worst_m=-found.fun, drives=found.nfev, seed=seed))
        rows[-1] |= dict(zip(_RANGES, found.x.tolist()))
    return pd.DataFrame(rows)
