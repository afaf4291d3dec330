"""The judge of an RHE of any Model: a sample far outside its prediction is not used.

With the innovation y of a sample, given its prediction, and the covariance S of y,

    d = y' S⁻¹ y ≤ limit,  the quantile of χ² that good samples exceed with the gate's `share`

(Bar-Shalom, Li, Kirubarajan, "Estimation with Applications to Tracking and Navigation", 2001,
Sec. 5.7). One Gauss-Newton step from an outlier can end at a yaw and parameters from which no
later step returns. Beyond the limit, therefore, all outputs of the sample count as missing, and the
estimate is the prediction. Measured inputs are kept where they are as before.

After many such samples in succession (`patience`) it is the estimate that is wrong. The window then
fails: it restarts at its newest node with the variances of the first guess, and takes the next
sample as it is.
"""

from dataclasses import dataclass
from typing import NamedTuple

import casadi as ca

from rhec.core._casadi.build import casadi_function
from rhec.core.estimator import guard, kalman
from rhec.core.model.limits import MAX_PLAUSIBLE_STATE


class Tuned(NamedTuple):
    """The numbers that were chosen, not derived.

    The drives of tests/core/test_outliers.py, seeds 0 to 59 of two robots, show that they suffice;
    no seeds are recorded on which they were chosen.
    """

    # name: value  # [unit] meaning
    safeguard: float = 1e-9  # [1] share of good samples to reject: none but outliers that would
    # lose an estimator that is not robust
    robust: float = 1e-3  # [1] the same of one that is
    windows_of_patience: int = 3  # [windows] of bad samples before the estimate is wrong: a restart
    # amid bad samples starts from one of them
    least_patience: int = 30  # [samples] at least


TUNED = Tuned()
SAFEGUARD = TUNED.safeguard
ROBUST = TUNED.robust
_OPEN = -1.0  # in place of the number of samples rejected in succession: the next one is taken


@dataclass(frozen=True)
class InnovationGate(guard.Judge):
    """The gate that rejects this share of good samples."""

    share: float = SAFEGUARD

    doubts_model = True

    def limit(self, window):
        """The largest d of a sample that is used."""
        from scipy.stats import chi2  # takes long to load, and importing the core should not

        return float(chi2.isf(self.share, max(len(window.interval.outputs), 1)))

    def memory(self, window):
        """How many samples were rejected in succession."""
        return dict(rejected=(1, 1))

    def first(self, window):
        """None, and the first sample is taken as it is."""
        return dict(rejected=_OPEN)

    def build(self, window):
        """The Function that tells whether the newest sample agrees with its prediction."""
        interval = window.interval
        outputs = interval.outputs
        limit = self.limit(window)
        shapes = window.prediction | window.noise | self.memory(window)
        shapes |= dict(s_N=(interval.n_s, 1), z_N=(len(window.model.outputs), 1))

        @casadi_function("gate", ca.SX, **shapes)
        def gate(B_N, v_N, m_N, P_N, s_N, z_N, rejected, **noise):
            m, P = window.predict_input(B_N, m_N, P_N, v_N, z_N, **noise)
            distance = kalman.update(m, P, z_N, noise["V"], outputs, s_N).distance
            agrees = distance <= limit  # 0 where it is NaN
            is_used = ca.logic_or(agrees, rejected < 0)
            has_outputs = sum((output.is_valid(z_N) for output in outputs), ca.SX(0)) > 0
            as_before = ca.SX.nan(*z_N.shape)
            for place, (row, _) in interval.input_outputs.items():
                change = (z_N[row] - v_N[place]) ** 2
                stays = change <= 2 * limit * noise["V"][row]
                as_before[row] = ca.if_else(stays, z_N[row], ca.DM.nan())
            after = ca.if_else(is_used, ca.if_else(has_outputs, 0, rejected), rejected + 1)
            z_used = ca.if_else(is_used, z_N, as_before)
            return dict(z_used=z_used, agrees=agrees, rejected_after=after)

        return gate

    def conclude(self, window, verdict, result):
        """The window fails, too, where a variance is not positive or too large."""
        variances = ca.diag(result["covariance"])
        has_variances = ca.mmin(variances) > 0
        solved = result["ok"] * has_variances * (ca.mmax(variances) <= MAX_PLAUSIBLE_STATE)
        kept = solved * (verdict["rejected_after"] < patience(window))
        rejected_after = ca.if_else(kept, verdict["rejected_after"], _OPEN)
        return dict(ok=solved * verdict["agrees"], kept=kept, rejected_after=rejected_after)


def patience(window):
    """Number of samples rejected in succession after which the window restarts."""
    return max(TUNED.least_patience, TUNED.windows_of_patience * window.N)
