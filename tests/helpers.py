"""What several files of tests use: robots as live objects, noise, a recorded drive."""

import contextlib
import functools
import re
from pathlib import Path

import casadi as ca
import numpy as np
import pandas as pd
import pytest
from oracles import V
from robots import DT, N

import rhec
from rhec import paper
from rhec.core._casadi import compiled
from rhec.core._casadi.packing import pack_array
from rhec.core.estimator.estimate import Estimate
from rhec.tracked_robot.estimators import Choice, build_step, estimator_of

# Without the copies that JupyterLab keeps of those that were opened in it.
NOTEBOOKS = sorted(
    path
    for path in (Path(__file__).parents[1] / "notebooks").rglob("*.ipynb")
    if ".ipynb_checkpoints" not in path.parts
)
# What was built without a compiler is built once, too, and not again for each `no_compiler`.
_load_without_compiler = functools.cache(compiled.load.__wrapped__)


@contextlib.contextmanager
def no_compiler():
    """As on a machine without a C compiler."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(compiled, "compiler", lambda: None)
        patch.setattr(compiled, "load", _load_without_compiler)
        yield


def assert_refused(make, rows):
    """Each row is refused in one sentence: (arguments or options, how it begins).

    In the sentence … stands for any text.
    """
    for bad, begin in rows:
        given, named = ((), bad) if isinstance(bad, dict) else (bad, {})
        begins = re.escape(begin).replace("…", ".*")
        with pytest.raises(ValueError, match=f"^{begins}") as refused:
            make(*given, **named)
        assert "\n" not in str(refused.value)


# Any robot of `robots`


@functools.cache
def model(robot):
    return rhec.Model(**robot.model)


def estimator(robot, guess, **changes):
    settings = dict(model=model(robot), dt=DT, horizon=N, guess=tuple(guess)) | robot.estimator
    return rhec.RHE(**settings | dict(arrival_mean="filtered") | changes)


def controller(robot, **changes):
    return rhec.RHC(model=model(robot), **dict(dt=DT, horizon=N) | robot.controller | changes)


def estimate_of(**states):
    """The estimate of a Model with these states and one input."""
    found = Estimate(np.array([*states.values()]), np.zeros(1), np.zeros(0), np.eye(len(states)))
    found.names = (*states, "v_mps")
    return found


# The paper's robot

# Both tracks on one soil, white errors, white bumps.
SIMPLE_WORLD = dict(
    speed_mps=paper.SPEED_MPS,
    mu_mean=0.9,
    mu_deviation=0.04,
    kappa_mean=0.8,
    kappa_deviation=0.08,
    correlation_length_m=4.0,
    soil_under="centre",
    slip_difference=0.0,
    gnss_sigma_m=paper.SIGMA_V[0],
    gnss_slow_share=0.0,
    gnss_slow_time_s=60.0,
    encoder_sigma_mps=paper.ENCODER_SIGMA_MPS,
    speed_sigma_mps=paper.SIGMA_V[2],
    bump_sigma_radps=0.02,
    rut_length_m=0.0,
    track_width_m=paper.TRACK_WIDTH_M,
    rotation_centre_m=0.0,
    sigma_v=paper.SIGMA_V,  # the estimator assumes the noise that there is
)


def choice_of(name, horizon, speed_model="parameter", arrival_mean="smoothed"):
    """The Choice of an estimator of the paper's robot."""
    return Choice(name, horizon, speed_model, arrival_mean)


def answers_of(choice, z, *first, **settings):
    """What the estimator of a Choice answers to each row of z, as a list of results by name.

    Args:
        choice: The Choice.
        z: Measurements (n, n_z).
        first: What its `init` takes besides.
        settings: Those of its step by name, or with a row for each sample; others do not count.
    """
    step = build_step(choice)
    memory = pack_array(estimator_of(choice.estimator).init(choice, *first))
    answers = []
    for k, reading in enumerate(z):
        given = {name: of[k] if np.ndim(of) == 2 else of for name, of in settings.items()}
        given |= dict(memory=memory, z_N=reading)
        answers.append(step(**{name: given[name] for name in step.name_in()}))
        memory = answers[-1]["memory"]
    return answers


def own_controller(scenario, gain=4.0):
    """A rhec.Controller for a scenario: it steers to the path, the slower the more it steered."""
    shapes = dict(memory=1, s_0=6, x_ref=(3, scenario.prediction_horizon + 1), upper=1, speed_mps=1)
    given = {name: ca.SX.sym(name, *np.atleast_1d(shape)) for name, shape in shapes.items()}
    memory, s_0, x_ref, upper, speed_mps = given.values()
    x, y, theta = ca.vertsplit(x_ref[:, 0] - s_0[:3])
    left = y * ca.cos(s_0[2]) - x * ca.sin(s_0[2])
    command = upper * ca.tanh(gain * (left + theta))
    results = dict(command=command, memory=0.9 * memory + 0.1 * command)
    results |= dict(speed_mps=speed_mps * (1 - ca.fabs(memory)))
    names = [*given], [*results], {"allow_duplicate_io_names": True}
    step = ca.Function("steer", [*given.values()], [*results.values()], *names)
    return rhec.Controller(step, (0.0,))


def weaving_yaw_rates(samples):
    """Yaw rates that never stay the same."""
    return 0.1 * np.sin(0.7 * np.arange(samples)) + 0.05 * np.cos(0.31 * np.arange(samples))


def with_noise(z, seed=0, scale=1.0):
    """Readings z (n, 4) with white noise of the paper's V; seed may be a generator."""
    return z + scale * np.random.default_rng(seed).normal(size=z.shape) * np.sqrt(V)


# Recorded logs

MU, KAPPA, TRACK_WIDTH_M = 0.9, 0.75, 0.5


def recorded_log(
    rate_hz=10.0, duration_s=60.0, start_rad=0.4, noise_m=0.0, seed=0, arm_m=(0.0, 0.0)
):
    """A log with the documented columns: forwards, standing, backwards, in curves, integrated
    finely, with white noise of noise_m. arm_m: the antenna's place ahead and left of the centre.
    """
    fine = np.arange(round(duration_s * 1000) + 1) / 1000
    speed = np.interp(fine / duration_s, [0, 0.3, 0.33, 0.4, 0.43, 1], [0.6, 0.7, 0, 0, -0.5, -0.6])
    yaw_rate = 0.4 * np.sin(0.35 * fine)
    yaw = start_rad + np.concatenate(
        [[0], np.cumsum(KAPPA * (yaw_rate[1:] + yaw_rate[:-1]) / 2000)]
    )
    x, y = (
        np.concatenate([[0], np.cumsum((ahead[1:] + ahead[:-1]) / 2000)])
        for ahead in (MU * speed * np.cos(yaw), MU * speed * np.sin(yaw))
    )
    x, y = (
        x + arm_m[0] * np.cos(yaw) - arm_m[1] * np.sin(yaw),
        y + arm_m[0] * np.sin(yaw) + arm_m[1] * np.cos(yaw),
    )
    at = np.round(np.arange(0, duration_s, 1 / rate_hz) * 1000).astype(int)
    log = (
        pd.DataFrame(
            dict(
                t_s=fine,
                x_m=x,
                y_m=y,
                speed_mps=speed,
                yaw_rate_radps=yaw_rate,
                v_left_mps=speed - TRACK_WIDTH_M / 2 * yaw_rate,
                v_right_mps=speed + TRACK_WIDTH_M / 2 * yaw_rate,
                yaw_true_rad=yaw,
                x_true_m=x,
                y_true_m=y,
                v_true_mps=MU * speed,
                yaw_rate_true_radps=KAPPA * yaw_rate,
            )
        )
        .iloc[at]
        .reset_index(drop=True)
    )
    log[["x_m", "y_m"]] += noise_m * np.random.default_rng(seed).standard_normal((len(log), 2))
    return log


BY_M = 512.0, -2048.0  # whole powers of two, so that positions keep their digits
LATER_S = 4096.0
TURNED = "y_m", "yaw_rate_radps", "yaw_true_rad", "y_true_m", "yaw_rate_true_radps", "gyro_radps"


def in_a_mirror(log):
    """The log in a mirror along the x axis: left is right, tracks included."""
    turned = {name: -log[name] for name in TURNED if name in log}
    tracks = dict(v_left_mps=log["v_right_mps"], v_right_mps=log["v_left_mps"])
    return log.assign(**turned, **tracks)


def moved(log):
    return log.assign(
        **{name: log[name] + BY_M[0] for name in ("x_m", "x_true_m")},
        **{name: log[name] + BY_M[1] for name in ("y_m", "y_true_m")},
    )


def turned(log):
    """The log turned to the left by a right angle: x becomes y, and y becomes -x."""
    return log.assign(
        x_m=-log["y_m"],
        y_m=log["x_m"],
        x_true_m=-log["y_true_m"],
        y_true_m=log["x_true_m"],
        yaw_true_rad=log["yaw_true_rad"] + np.pi / 2,
    )


def later(log):
    return log.assign(t_s=log["t_s"] + LATER_S)


# A test that marks itself proves something else of a replay whose yaw may be unknown meanwhile.
may_be_unsure = pytest.mark.filterwarnings("ignore:The yaw is not known to")
warns_of_an_unknown_yaw = functools.partial(
    pytest.warns, UserWarning, match="^The yaw is not known to "
)


class Bomb:
    """To unpickle it fails the test."""

    def __reduce__(self):
        return (pytest.fail, ("a pickle was run",))


# The live page

LIVE_PAGE = Path(__file__).parents[1] / "build/report/live.html"
needs_live_page = pytest.mark.skipif(
    not LIVE_PAGE.exists(),
    reason="build/report has no live page: nothing compiled C to WebAssembly",
)


def wait_until(page, expression, patience_s=180):
    """Wait until a JavaScript expression is true in a page of the report.

    The pages' policy forbids what Playwright's `wait_for_function` does: it evaluates a text.
    """
    page.evaluate(
        f"""async () => {{
            const end = Date.now() + {1000 * patience_s};
            while (!({expression})) {{
                if (Date.now() > end) throw Error("in vain");
                await new Promise(done => setTimeout(done, 20));
            }}
        }}"""
    )
