"""A recorded log through the paper's estimators and the default one: as it is, and made harder.

The harder replays add white noise to the positions, an error to the first yaw and faults to the
sensors (`rhec.logs.scores`). Their scores are means over noise seeds.
"""

import dataclasses
import functools
import itertools
from pathlib import Path

import numpy as np
import pandas as pd

from rhec.logs import recording, scores
from rhec.logs.calibration import calibrate
from rhec.logs.reader import found_lines, read
from rhec.logs.replay import replay
from rhec.simulation.faults import Fault
from rhec.tracked_robot import tuning
from rhec.workbench.studies.statistics import over_seeds

__all__ = ["ReplayStudy", "replay_table"]

_QUANTITIES = dict(
    yaw_rms_rad="RMS error of yaw [rad]",
    yaw_rms_slow_rad="RMS error of yaw without fast spins [rad]",
    position_rms_m="RMS error of position [m]",
    innovation_rms_m="RMS innovation [m]",
    mu_median="median of mu",
    mu_regression="mu by regression",
    mu_difference="median - regression, mu",
    kappa_median="median of kappa",
    kappa_regression="kappa by regression",
    kappa_difference="median - regression, kappa",
    nees_yaw="squared yaw error by its variance",
    inside_95="yaw errors within 95 % bounds",
    outside="samples with mu or kappa outside [0, 1]",
    not_ok="failed steps",
)
_FAULT_START_S = 60.0
_FAULT_DURATION_S = 10.0
_MOST_FAULT_SEEDS = 3  # a replay for each fault, handling and seed takes long
_FAULT_SCORES = ["worst_position_m", "worst_yaw_rad", "last_yaw_rad", "outside", "not_ok"]


def replay_table(trials):
    """Means of scores over noise seeds.

    Args:
        trials: {name: rows of `rhec.logs.scores.perturbed_scores`}.

    Returns:
        DataFrame with columns estimator, quantity, mean, low, high, n.
    """
    rows = []
    for (name, of_seeds), (column, quantity) in itertools.product(
        trials.items(), _QUANTITIES.items()
    ):
        if column in of_seeds:
            interval = over_seeds(np.mean, of_seeds[column])._asdict()
            rows.append(dict(estimator=name, quantity=quantity) | interval)
    return pd.DataFrame(rows)


def _fault_cases(start_s):
    """{name: Fault}, each of which begins at start_s; the first has no fault."""
    fault = functools.partial(Fault, start_s=start_s, duration_s=_FAULT_DURATION_S)
    return {
        "none": Fault(kind="missing", start_s=start_s, duration_s=0.0),
        "no position": fault(kind="missing"),
        "no reading at all": fault(kind="infinite", channel="all"),
        "outliers": fault(kind="outliers", size_m=2.0),
        "jump": fault(kind="jump", size_m=2.0),
        "position stuck": fault(kind="stuck"),
        "latency": fault(kind="latency", delay_s=0.4),
        "low rate": fault(kind="rate", rate_hz=1.0),
        "samples twice": fault(kind="duplicates", channel="all"),
        "samples out of order": fault(kind="disorder", channel="all"),
        "left encoder dead": fault(kind="dead", channel="left"),
        "encoders dead": fault(kind="dead", channel="encoders"),
    }


@dataclasses.dataclass(frozen=True)
class ReplayStudy:
    """Replays of one log; each result is computed when it is first read.

    Args:
        file: Path of the log.
        columns: Texts "ours=theirs" where the log has other names, such as "x_m=east".
        topics: Of a bag, as in `rhec.logs.read`; those of the usual types if there are none.
        wheel_radius_m: Of a bag's wheel speeds [m]; 0 if it has none.
        track_width_m: As in `rhec.replay` [m]; 0 if the log has speed and yaw rate.
        position_delay_s, trust_log: As in `rhec.replay`.
        process_noise: W of the paper's estimators, "printed" or "calibrated".
        calibrated: Whether the RHE takes what `rhec.calibrate` finds in this log.
        lever_arm_m, sigma_v: As in `rhec.replay`; without entries estimated, and as tuned.
        robust: Whether the RHE is robust to faults.
        first_yaw_rad: First guesses [rad], one or one for each segment; none if it is estimated.
        noise_m: Standard deviation of the white noise added to positions [m].
        yaw_error_rad: Error of the first yaw in each segment [rad], where the truth is recorded.
        seed: Of the noise in single replays.
        seeds: How many noise seeds the scores are means over.
    """

    file: Path
    columns: tuple = ()
    topics: tuple = ()
    wheel_radius_m: float = 0.0
    track_width_m: float = 0.0
    position_delay_s: float = 0.0
    trust_log: bool = False
    process_noise: str = "calibrated"
    calibrated: bool = False
    lever_arm_m: tuple = ()
    sigma_v: tuple = ()
    robust: bool = False
    first_yaw_rad: tuple = ()
    noise_m: float = 0.02
    yaw_error_rad: float = 0.3
    seed: int = 0
    seeds: int = 10

    @functools.cached_property
    def log(self):
        """The log, as `rhec.logs.read` returns it."""
        names = dict(pair.partition("=")[::2] for pair in self.columns)
        return read(
            self.file,
            columns=names or None,
            topics=tuple(self.topics) or None,
            wheel_radius_m=self.wheel_radius_m or None,
        )

    @property
    def found(self):
        """What the reader inferred, such as topics, unit of time and origin, as lines of text."""
        return found_lines(self.log)

    @property
    def _of_log(self):
        """Arguments of a replay and of a calibration that belong to the log."""
        return dict(
            track_width_m=self.track_width_m or None,
            position_delay_s=self.position_delay_s,
            trust_log=self.trust_log,
        )

    @property
    def _trial(self):
        """Arguments of `perturbed_replay` that all estimators share."""
        return dict(noise_m=self.noise_m, yaw_error_rad=self.yaw_error_rad) | self._of_log

    @functools.cached_property
    def rhe(self):
        """Arguments of `rhec.replay` for the RHE."""
        calibration = dict(calibrate(self.log, **self._of_log)) if self.calibrated else {}
        arguments = calibration | {"robust": self.robust} | self._of_log
        # A number of the user's replaces that of the calibration.
        for name in ("lever_arm_m", "sigma_v"):
            if getattr(self, name):
                arguments[name] = tuple(getattr(self, name))
        return arguments

    @property
    def estimators(self):
        """{name: arguments of `rhec.replay`} of the four estimators."""
        return {
            "RHE": self.rhe,
            "RHE, ν as input": dict(speed_model="input") | self._noise_of("rhe", without_nu=True),
            "RHE, ν over the window": dict(speed_model="parameter") | self._noise_of("rhe"),
            "EKF": dict(estimator="ekf") | self._noise_of("ekf"),
        }

    def _noise_of(self, estimator, without_nu=False):
        """W of one of the paper's estimators, as arguments of `rhec.replay`.

        Soil under recorded robots slips more than that of the default world, so "calibrated" is the
        likeliest W on the former world's soil.
        """
        if self.process_noise != "calibrated":
            return dict(process_noise=self.process_noise)
        sigma_w = tuning.SIGMA_W_FORMER[estimator]
        # Where ν is an input it has no noise of its own in W.
        return dict(sigma_w=sigma_w[:3] + sigma_w[4:] if without_nu else sigma_w)

    @property
    def about(self):
        """What made a figure of the study, for its file."""
        return dict(log=self.file.name, process_noise=self.process_noise, **self._trial)

    @functools.cached_property
    def _recording(self):
        return recording.prepare(self.log, self.track_width_m or None, self.position_delay_s)

    @property
    def unusable_rows(self):
        """How many rows of the log cannot be used, and why, as a DataFrame."""
        return pd.Series(self._recording.faults, name="rows of the log").to_frame()

    @property
    def has_true_yaw(self):
        """Whether the log has the true yaw, without which there are no scores of the yaw."""
        return "theta_rad" in self._recording.rows

    @functools.cached_property
    def estimates(self):
        """What a smoothed `rhec.replay` makes of the log as it is, a row for each of its rows."""
        yaws = tuple(self.first_yaw_rad)
        guess = yaws if len(yaws) > 1 else yaws[0] if yaws else None
        return replay(self.log, first_yaw_rad=guess, smooth=True, **self.rhe)

    @functools.cached_property
    def replays(self):
        """{estimator: samples of `perturbed_replay`} with the noise of one seed."""
        return {
            name: scores.perturbed_replay(self.log, self.seed, **(self._trial | arguments))
            for name, arguments in self.estimators.items()
        }

    @functools.cached_property
    def trials(self):
        """{estimator: scores over noise seeds}, also of an augmented EKF."""
        augmented = dict(estimator="augmented_ekf") | self._noise_of("augmented_ekf")
        every = self.estimators | {"augmented EKF": augmented}
        seeds = range(self.seeds)
        return {
            name: scores.perturbed_scores(self.log, seeds, **(self._trial | arguments))
            for name, arguments in every.items()
        }

    @functools.cached_property
    def table(self):
        """`replay_table` of the trials."""
        return replay_table(self.trials)

    @functools.cached_property
    def faults(self):
        """{name: Fault}, from the first time after 60 s at which the robot keeps moving."""
        samples = self.replays["RHE"]
        return _fault_cases(scores.while_moving(samples, _FAULT_START_S, _FAULT_DURATION_S))

    @functools.cached_property
    def fault_scores(self):
        """Scores of the RHE with each fault, without and with robust handling."""
        arguments = self._trial | self.rhe
        del arguments["robust"]
        seeds = range(min(self.seeds, _MOST_FAULT_SEEDS))
        return scores.fault_scores(self.log, self.faults, seeds, **arguments)

    @property
    def fault_means(self):
        """Means of the fault scores over noise seeds, one row a fault and handling."""
        groups = self.fault_scores.groupby(["fault", "robust"], sort=False)
        return groups[_FAULT_SCORES].mean().round(3)
