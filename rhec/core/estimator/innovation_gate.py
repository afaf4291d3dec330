"""The judge of an RHE: a sample far outside its prediction is not used, unless it is not alone.

With the innovation y of the outputs that are judged, given their prediction, and its covariance S,

    d = y' S⁻¹ y ≤ limit,  the quantile of χ² that good samples exceed with the gate's `share`

(Bar-Shalom, Li, Kirubarajan, "Estimation with Applications to Tracking and Navigation", 2001,
Sec. 5.7). One Gauss-Newton step from an outlier can end at a yaw and parameters from which no
later step returns. A sample has three chances:

1. It is used as it was measured, if d is within the limit.
2. It is used without those measured inputs that differ from the last ones, if d is then: an encoder
   may be wrong where the position is not.
3. Otherwise it is rejected: the judged outputs count as missing, and so do such inputs.

While samples are rejected, or have no judged output, S is not that of the prediction, whose window
loses its measurements: an arrival cost with large W would let pass anything. It is that of the last
sample that was used, times one more than the samples that had no output since.

What is wrong may be the estimate and not the samples. Then their innovations follow each other:
those of a position that has moved for good are all alike, those of a wrong speed grow evenly. The
window restarts at the fourth sample rejected in a row if second differences of the innovations,

    (y_k - 2 y_{k-1} + y_{k-2})' (6 S)⁻¹ (…) ≤ limit  with the variances in S alone,

are twice no more than noise: white noise of variance σ² has 6σ² (von Neumann, 1941). Up to three
wild samples therefore move nothing. So it restarts where too many are rejected in a row, whichever
they are (`patience`). Then the newest sample is the only one of the window, and its arrival cost is
the prediction, with more variance: that of the start, and y² in the direction of each output.
Bounded parameters begin anew from their first guess, because the wrong estimate may have driven
them to a bound at which they stay: a robot that is thought to be turned round drives best at μ = 0.
"""

from dataclasses import dataclass
from typing import NamedTuple

import casadi as ca
import numpy as np

from rhec.core._casadi.build import casadi_function, short_cut
from rhec.core.estimator import guard, kalman
from rhec.core.model.limits import MAX_PLAUSIBLE_STATE, is_plausible, is_valid_measurement


class Tuned(NamedTuple):
    """The numbers that were chosen, not derived.

    They were chosen on drives 0 to 39 of the table in tests/guard_table.py, and not judged on
    others; its nightly test has drives 0 to 23.
    """

    # name: value  # [unit] meaning
    share: float = 1e-9  # [1] of good samples to reject: only outliers that would lose an estimator
    in_line: int = 2  # [second differences] within noise, and the window restarts
    windows_of_patience: int = 3  # [windows] of rejected samples before it restarts in any case
    least_patience: int = 30  # [samples] at least


TUNED = Tuned()
_MAX_VARIANCE = MAX_PLAUSIBLE_STATE / 2  # of a restart, in the direction of an output


@dataclass(frozen=True)
class InnovationGate(guard.Judge):
    """The gate that judges these outputs of a Model, by name; without names all of them.

    Outputs that measure an input belong to the inputs, and are not judged by themselves.
    `accepted` tells of the `reported` outputs, by name, which are used.
    """

    judged: tuple[str, ...] = ()
    reported: tuple[str, ...] = ()
    doubts_model: bool = True

    def outputs(self, window):
        """The outputs that are judged."""
        names = window.model.outputs
        every = window.interval.outputs
        return [output for output in every if not self.judged or names[output.row] in self.judged]

    def limit(self, window):
        """The largest d of a sample that is used."""
        from scipy.stats import chi2  # takes long to load, and importing the core should not

        return float(chi2.isf(TUNED.share, max(len(self.outputs(window)), 1)))

    def memory(self, window):
        """What is remembered of the samples before.

        How many were rejected in a row, how many second differences of these are within noise, how
        many had no output since the last one that was used; the innovations of the last two, and
        the covariance S of the last one that was used.
        """
        n = len(self.outputs(window))
        return dict(rejected=(1, 1), in_line=(1, 1), missing=(1, 1), trail=(n, 2), S=(n, n))

    def first(self, window):
        """Nothing: the first sample is judged by the first guess."""
        return {name: np.zeros(shape) for name, shape in self.memory(window).items()}

    def build(self, window):
        """The Function that tells how the newest sample is used."""
        interval = window.interval
        outputs = self.outputs(window)
        limit = self.limit(window)
        shapes = window.prediction | window.noise | self.memory(window)
        shapes |= dict.fromkeys(("s_N", "m_0", "P_0"), (interval.n_s, 1))
        shapes |= dict(z_N=(len(window.model.outputs), 1))

        @casadi_function("gate", ca.SX, **shapes)
        def gate(B_N, v_N, m_N, P_N, s_N, m_0, P_0, z_N, **values):
            before = {name: values.pop(name) for name in self.memory(window)}
            kept = _with_inputs_as_before(interval, z_N, v_N, limit * values["V"])
            measured = window.predict_input(B_N, m_N, P_N, v_N, z_N, **values)
            without = window.predict_input(B_N, m_N, P_N, v_N, kept, **values)
            H = ca.vertcat(ca.SX(0, interval.n_s), *(output.H(s_N) for output in outputs))
            has = ca.vertcat(*(output.is_valid(z_N) for output in outputs))
            V = ca.vertcat(*(values["V"][output.row] for output in outputs))
            S = H @ measured[1] @ H.T + ca.diag(V)
            S = ca.if_else(before["rejected"] + before["missing"] > 0, before["S"], S)
            grown = S * (1 + before["missing"])
            y_measured, y_without = (
                _innovation(outputs, z_N, m, s_N) for m, _ in (measured, without)
            )
            agrees = _distance(y_measured, grown, has) <= limit  # 0 where it is NaN
            more = H @ (without[1] - measured[1]) @ H.T
            agrees_without = _distance(y_without, grown + more, has) <= limit
            is_used = ca.logic_or(agrees, agrees_without)
            # m_N knows nothing of bounds; s_N follows from the last solution, which does.
            s, _ = window.predict_input(B_N, s_N, P_N, v_N, kept, **values)
            y = _innovation(outputs, z_N, s, s_N)
            can_restart = _fits(window, outputs, s, s_N, y)
            after, restart = _counted(before, is_used, has, y, S, limit, window.N, can_restart)
            is_used = ca.logic_or(is_used, restart)
            rejected = _without(outputs, kept)
            z_used = ca.if_else(agrees, z_N, ca.if_else(is_used, kept, rejected))
            m, P = _anew(window, outputs, s_N, P_N, y, m_0, P_0)
            return dict(
                z_used=z_used,
                m_used=ca.if_else(restart, m, m_N),
                P_used=ca.if_else(restart, P, P_N),
                # The QP of a window with bounds of states knows nothing of the restart.
                agrees=is_used * (1 - restart * bool(window.model.state_bounds)),
                restart=restart,
                **self._report(window, z_used),
                **{f"{name}_after": value for name, value in after.items()},
            )

        return gate

    def _report(self, window, z_used):
        """`accepted` (n,) of the n outputs that are reported, by name, if any."""
        rows = [window.model.outputs.index(name) for name in self.reported]
        used = [is_valid_measurement(z_used[row], window.model.limits[row]) for row in rows]
        return dict(accepted=ca.vertcat(*used)) if used else {}

    def conclude(self, window, verdict, result):
        """The window fails, too, where a variance is not positive or too large."""
        variances = ca.diag(result["covariance"])
        has_variances = ca.mmin(variances) > 0
        kept = result["ok"] * has_variances * (ca.mmax(variances) <= MAX_PLAUSIBLE_STATE)
        flags = dict(ok=kept * verdict["agrees"], kept=kept, restart=kept * verdict["restart"])
        # A window that fails forgets: what its prediction left here may not be a number.
        after = [f"{name}_after" for name in self.memory(window)]
        return flags | {name: ca.if_else(kept, verdict[name], 0) for name in after}

    def build_restarted(self, window):
        """The memory of a window that restarts at its newest sample, unless it goes on.

        Nearly always it goes on. Then the prediction of the restart is not computed.
        """
        interval = window.interval
        outputs = self.outputs(window)
        shapes = window.prediction | window.noise | window.pieces._asdict()
        shapes |= dict.fromkeys(("s_N", "m_0", "P_0"), (interval.n_s, 1))
        shapes |= dict(goes_on=(1, 1), z_used=(len(window.model.outputs), 1))

        @short_cut("goes_on")
        @casadi_function("restarted", ca.SX, **shapes)
        def restarted(goes_on, B_N, v_N, m_N, P_N, s_N, m_0, P_0, z_used, **values):
            memory = {name: values[name] for name in window.pieces._fields}
            noise = {name: values[name] for name in window.noise}
            s, _ = window.predict_input(B_N, s_N, P_N, v_N, z_used, **noise)
            y = _innovation(outputs, z_used, s, s_N)
            m, P = _anew(window, outputs, s_N, P_N, y, m_0, P_0)
            m, P = window.predict_input(B_N, m, P, v_N, z_used, **noise)
            s = kalman.update(m, P, z_used, noise["V"], interval.outputs, s_N).m
            for place, (lower, upper) in interval.bounds.items():
                s[place] = ca.fmin(ca.fmax(s[place], lower), upper)
            fresh = guard.fresh(window, memory, s, z_used, m, P)
            return {name: ca.if_else(goes_on, memory[name], fresh[name]) for name in memory}

        return restarted


def patience(N):
    """Number of samples rejected in a row after which a window of N intervals restarts."""
    return max(TUNED.least_patience, TUNED.windows_of_patience * N)


def _with_inputs_as_before(interval, z, v, variances):
    """The sample z (n_z,) with NaN for measured inputs that differ from the last ones v (n_v,).

    They differ where the square of the change exceeds twice the variances (n_z,).
    """
    kept = ca.SX(z)
    for place, (row, _) in interval.input_outputs.items():
        stays = (z[row] - v[place]) ** 2 <= 2 * variances[row]
        kept[row] = ca.if_else(stays, z[row], ca.DM.nan())
    return kept


def _innovation(outputs, z, m, s_bar):
    """y (n_y,) of these outputs, given their prediction by m (n_s,); 0 where none was measured."""
    rows = [ca.if_else(each.is_valid(z), each.residual(z, m, s_bar), 0) for each in outputs]
    return ca.vertcat(ca.SX(0, 1), *rows)


def _distance(y, S, has):
    """y' S⁻¹ y of the outputs that were measured; `has` (n_y,) tells which."""
    both = has @ has.T
    S = S * both + ca.diag(1 - has)
    return ca.dot(y, ca.ldl_solve(y, *ca.ldl(S, False))) if y.numel() else ca.SX(0)


def _counted(before, is_used, has, y, S, limit, N, can_restart):
    """The memory (a dict) after this sample, and whether the window restarts at it.

    Args:
        before: The memory before it.
        is_used: Whether it is used.
        has: (n_y,) which outputs it has.
        y: (n_y,) their innovation.
        S: (n_y, n_y) its covariance.
        limit: Of the distance.
        N: Intervals of the window.
        can_restart: Whether the window may restart at this sample.
    """
    has_any = ca.sum1(has) > 0
    bend = y - 2 * before["trail"][:, 0] + before["trail"][:, 1]
    is_line = (before["rejected"] >= 2) * (ca.sum1(bend**2 / (6 * ca.diag(S))) <= limit)
    rejected = before["rejected"] + 1
    in_line = ca.if_else(is_line, before["in_line"] + 1, 0)
    has_to = ca.logic_or(in_line >= TUNED.in_line, rejected >= patience(N))
    restart = (1 - is_used) * has_to * can_restart
    goes_on = 1 - ca.logic_or(is_used * has_any, restart)  # without a sample that was used
    is_rejected = 1 - is_used
    after = dict(
        rejected=goes_on * ca.if_else(is_rejected, rejected, before["rejected"]),
        in_line=goes_on * ca.if_else(is_rejected, in_line, before["in_line"]),
        missing=goes_on * (before["missing"] + (1 - has_any)),
        trail=ca.if_else(has_any, ca.horzcat(y, before["trail"][:, 0]), before["trail"]),
        S=S,
    )
    return after, restart


def _without(outputs, z):
    """The sample z (n_z,) without these outputs."""
    z = ca.SX(z)
    for output in outputs:
        z[output.row] = ca.DM.nan()
    return z


def _anew(window, outputs, s_N, P, y, m_0, P_0):
    """Mean and covariance of the newest node before its measurement, where the window restarts.

    Args:
        window: The rhe.Window.
        outputs: Those that are judged.
        s_N: (n_s,) the prediction.
        P: (n_s, n_s) its covariance.
        y: (n_y,) their innovation.
        m_0: (n_s,) first guess.
        P_0: (n_s,) its variances.
    """
    m = ca.SX(s_N)
    P = ca.SX(ca.densify(ca.if_else(is_plausible(P), P, 0)))
    for name, bounds in window.model.parameters.items():
        if bounds:
            place = window.model.joint_names.index(name)
            m[place] = m_0[place]
            P[place, :] = 0
            P[:, place] = 0
    away = ca.sum2(_moves(outputs, s_N, y) ** 2)
    return m, P + ca.diag(P_0 + ca.fmin(away, _MAX_VARIANCE))


def _moves(outputs, s_bar, y):
    """By how much each output's innovation moves the state, (n_s, n_y): the shortest way."""
    columns = [ca.SX(s_bar.numel(), 0)]
    for k, output in enumerate(outputs):
        H = output.H(s_bar)
        columns.append(H.T * y[k] / ca.fmax(ca.sumsqr(H), 1e-300))
    return ca.horzcat(*columns)


def _fits(window, outputs, m, s_bar, y):
    """Whether what is measured lies within the bounds of states; a window cannot start beyond."""
    measured = m + ca.sum2(_moves(outputs, s_bar, y))
    names = window.model.joint_names
    fits = ca.SX(1)
    for name, (lower, upper) in (window.model.state_bounds or {}).items():
        place = names.index(name)
        fits *= (lower <= measured[place]) * (measured[place] <= upper)
    return fits
