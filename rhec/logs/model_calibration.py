"""Calibration of any Model: the noise of its outputs and of its process, from a log.

Around the values that the user passes, each standard deviation has a log-normal prior by a factor
of 3. Of a sample that is further from its prediction than one in a thousand good ones, only the
logarithm of its distance counts, so that outliers do not pass for noise.
"""

from typing import Any

import numpy as np
import pandas as pd

from rhec.core.estimator.ekf import EKF
from rhec.core.estimator.estimate import joint_guess, noise_of
from rhec.core.model import robot_model
from rhec.core.model.robot_model import Model
from rhec.logs import filtering
from rhec.logs.filtering import Loss
from rhec.logs.likelihood import Calibration, Likelihood, Unknown, normal_report
from rhec.logs.recording import prepare_for, with_ages

_PRIOR = np.log(3.0)  # standard deviation of the logarithm of a standard deviation
_NEEDED = ("dt", "sigma_v", "sigma_w", "guess", "sigma_guess")
_PASSED_ON = ("horizon", "arrival_mean")
_LEAST_SAMPLES = 50  # with measurements


def calibrate_model(
    log: Any, model: Model, delays_s: dict[str, float] | None, arguments: dict
) -> Calibration:
    """`rhec.calibrate` with a model.

    Args:
        log: DataFrame, as `rhec.replay` takes it with a model.
        model: The rhec.Model.
        delays_s: {output: delay of its time stamps [s]}.
        arguments: Those of rhec.RHE or rhec.EKF.

    Returns:
        Calibration: the arguments with the calibrated sigma_v and sigma_w.

    Raises:
        ValueError: For arguments or logs that a replay refuses, or a log with few measurements.
    """
    _check_arguments(model, arguments)
    segments = _streams(log, model, arguments["dt"], delays_s)
    names = [f"noise of {name}" for name in model.outputs]
    names += [f"process noise of {name}" for name in (*model.states, *model.parameters)]
    given = [*arguments["sigma_v"], *arguments["sigma_w"]]
    # What is 0 remains 0.
    unknowns = {
        place: Unknown(name, "as given", sigma, _PRIOR)
        for place, (name, sigma) in enumerate(zip(names, given))
        if sigma > 0
    }

    def sigmas(values):
        sigma = np.array(given, dtype=float)
        sigma[[*unknowns]] = values
        return [tuple(part.tolist()) for part in np.split(sigma, [len(model.outputs)])]

    likelihood = Likelihood(
        model=model,
        dt_s=arguments["dt"],
        loss=Loss.LOGARITHM,
        unknowns=tuple(unknowns.values()),
        settings_of=lambda values: noise_of(model, *sigmas(values)),
        segments=segments,
        firsts=[joint_guess(model, arguments["guess"], arguments["sigma_guess"])] * len(segments),
    )
    x = likelihood.most_likely()
    sigma_v, sigma_w = sigmas(likelihood.values(x))
    noise = likelihood.report(x)
    last = filtering.last_estimates(model, likelihood.filtered(x))
    before = dict(zip((*model.states, *model.parameters), arguments["sigma_guess"]))
    own = [
        normal_report(name, "own", *last[name], is_determined=last[name][1] < before[name] / 2)
        for name in model.parameters
    ]
    found = arguments | dict(model=model, sigma_v=sigma_v, sigma_w=sigma_w)
    found |= dict(delays_s=delays_s) if delays_s else {}
    return Calibration(found, pd.concat([noise, *own]))


def _check_arguments(model, arguments):
    """Raise a ValueError for arguments that a replay with a model does not take."""
    unknown = [name for name in arguments if name not in (*_NEEDED, *_PASSED_ON)]
    if unknown:
        raise ValueError(
            f"calibrate has no parameter {unknown[0]!r}; with a model it takes "
            f"{', '.join((*_NEEDED, *_PASSED_ON))}"
        )
    EKF(model=model, **{name: arguments[name] for name in _NEEDED if name in arguments})


def _streams(log, model, dt_s, delays_s):
    """Measurements and their ages of each segment of a log, as of `recording.with_ages`."""
    recording = prepare_for(model, dt_s, log, delays_s)
    segments = [with_ages(part, [*model.outputs]) for part in recording.samples()]
    outputs = [output.row for output in robot_model.interval(model).outputs]
    n = sum(np.isfinite(stream[:, outputs]).any(axis=1).sum() for stream in segments)
    if n < _LEAST_SAMPLES:
        names = ", ".join(model.outputs[row] for row in outputs)
        raise ValueError(
            f"the log had {n} samples with a measurement of {names}; a calibration needs at least "
            f"{_LEAST_SAMPLES}: record a longer drive"
        )
    return segments
