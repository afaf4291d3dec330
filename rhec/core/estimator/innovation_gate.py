"""The judge of an RHE: a sample far outside its prediction is not used, unless it is not alone.

With the innovation y of the outputs that are judged, given their prediction, and its covariance S,

    d = y' S⁻¹ y ≤ limit,  the quantile of χ² that good samples exceed with the gate's `share`

(Bar-Shalom, Li, Kirubarajan, "Estimation with Applications to Tracking and Navigation", 2001,
Sec. 5.7). One Gauss-Newton step from an outlier can end at a yaw and parameters from which no
later step returns. A sample has three chances:

1. It is used as it was measured, if d is within the limit.
2. It is used without those measured inputs that differ from the last ones, if d is then: an encoder
   may be wrong where the position is not.
3. Otherwise it is rejected: the judged outputs count as missing, and so do inputs beyond those of
   the window. An input that the window has had before, such as a steering angle that changes sides,
   is no sign of a fault.

While samples are rejected, or have no judged output, S is not that of the prediction, whose window
loses its measurements: an arrival cost with large W would let pass anything. It is that of the last
sample that was used, times one more than the samples that had no output since.

What is wrong may be the estimate and not the samples. Then their innovations follow each other:
those of a position that has moved for good are all alike, those of a wrong speed grow evenly. The
window restarts at the fourth sample rejected in a row if second differences of the innovations,

    (y_k - 2 y_{k-1} + y_{k-2})' (6 S)⁻¹ (…) ≤ limit  with the variances in S alone,

are twice no more than noise: white noise of variance σ² has 6σ² (von Neumann, 1941). Up to three
wild samples therefore move nothing. So it restarts where too many are rejected in a row, whichever
they are (`patience`). How it restarts says `new_start`. It restarts, too, where it fits the samples
only because the robot is thought to be turned round (`half_turn`), and where the integration rule
lets grow at the estimate what the model does not: such intervals tell of a state what is not so.
"""

from dataclasses import dataclass
from typing import Any, NamedTuple

import casadi as ca

from rhec.core._casadi.build import casadi_function
from rhec.core.estimator import new_start, newest_interval
from rhec.core.estimator.half_turn import HalfTurn
from rhec.core.model.integration import growth_function
from rhec.core.model.limits import MAX_PLAUSIBLE_STATE, is_valid_measurement


class Tuned(NamedTuple):
    """The numbers that were chosen, not derived.

    They were chosen on drives 0 to 39 of the table in tests/guard_table.py; its nightly test has
    drives 0 to 23. On drives 40 to 159, 10, 6 and 3 of 383 rows (by 40 drives) break the rule in
    the largest error or the time to come back; none is lost more often than the EKF.
    """

    # name: value  # [unit] meaning
    share: float = 1e-9  # [1] of good samples to reject: only outliers that would lose an estimator
    in_line: int = 2  # [second differences] within noise, and the window restarts
    windows_of_patience: int = 3  # [windows] of rejected samples before it restarts in any case
    least_patience: int = 30  # [samples] at least


TUNED = Tuned()


@dataclass(frozen=True)
class InnovationGate:
    """The gate that judges these outputs of a Model, by name; without names all of them.

    Outputs that measure an input belong to the inputs, and are not judged by themselves.
    `accepted` tells of the `reported` outputs, by name, which are used. Where the model may lead
    nowhere (`doubts_model`), as one without slopes in places does, the prediction and all nodes of
    the window have to be plausible. `half_turn` tells how to see that the robot is thought to be
    turned round; without it nothing does.
    """

    judged: tuple[str, ...] = ()
    reported: tuple[str, ...] = ()
    doubts_model: bool = True
    half_turn: HalfTurn | None = None

    def outputs(self, window):
        """The outputs that are judged."""
        names = window.model.outputs
        every = window.interval.outputs
        return [output for output in every if not self.judged or names[output.row] in self.judged]

    def limit(self, window):
        """The largest d of a sample that is used."""
        return _quantile(max(len(self.outputs(window)), 1))

    def sees_half_turns(self, window):
        """Whether this window can tell that it is turned round."""
        return bool(self.half_turn and self.half_turn.is_possible(window))

    def memory(self, window):
        """What is remembered of the samples before.

        How many were rejected in a row, how many second differences of these are within noise, how
        many had no output since the last one that was used; the innovations of the last two, and
        the covariance S of the last one that was used. Then after how many samples the robot seemed
        to be turned round.
        """
        n = len(self.outputs(window))
        memory = dict(rejected=(1, 1), in_line=(1, 1), missing=(1, 1), trail=(n, 2), S=(n, n))
        return memory | (dict(turned=(1, 1)) if self.sees_half_turns(window) else {})

    def build(self, window):
        """The Function (prediction, s_N, z_N, noise, memory, …) -> how the newest sample is used.

        That is `z_used`, the prediction's `m_used` and `P_used`, `agrees`, `accepted`, `restart`,
        and of each piece of the memory `<piece>_after`.
        """
        interval = window.interval
        outputs = self.outputs(window)
        limit = self.limit(window)
        shapes = window.prediction | window.noise | self.memory(window)
        shapes |= dict.fromkeys(("s_N", "m_0", "P_0"), (interval.n_s, 1))
        shapes |= dict(z_N=(len(window.model.outputs), 1), v=window.pieces.v)
        if self.sees_half_turns(window):
            shapes |= dict(age=(1, 1))  # for `conclude`
        if window.at_measured_input:
            shapes |= newest_interval.variants_of(window)

        @casadi_function("gate", ca.SX, **shapes)
        def gate(m_0, P_0, z_N, v, age=None, **values):
            before = {name: values.pop(name) for name in self.memory(window)}
            noise = {name: values.pop(name) for name in window.noise}
            prepared, at_measured, at_kept = _predictions(window, values)
            kept = _with_inputs_as_before(interval, z_N, prepared.v, limit * noise["V"])
            in_range = _with_inputs_of_window(interval, z_N, v, limit * noise["V"])
            measured = at_measured.given(window, z_N, noise)
            without = prepared.given(window, kept, noise)
            H = [output.H(at_measured.s) for output in outputs]
            H = ca.vertcat(ca.SX(0, interval.n_s), *H)
            has = ca.vertcat(*(output.is_valid(z_N) for output in outputs))
            V = ca.vertcat(*(noise["V"][output.row] for output in outputs))
            S = H @ measured[1] @ H.T + ca.diag(V)
            S = ca.if_else(before["rejected"] + before["missing"] > 0, before["S"], S)
            grown = S * (1 + before["missing"])
            y_measured = new_start.innovation(outputs, z_N, measured[0], at_measured.s)
            y_without = new_start.innovation(outputs, z_N, without[0], prepared.s)
            agrees = _distance(y_measured, grown, has) <= limit  # 0 where it is NaN
            more = H @ (without[1] - measured[1]) @ H.T
            agrees_without = _distance(y_without, grown + more, has) <= limit
            is_used = ca.logic_or(agrees, agrees_without)
            # m_N knows nothing of bounds; s_N follows from the last solution, which does.
            s_N = at_kept.s
            s, _ = at_kept._replace(m=s_N).given(window, in_range, noise)
            y = new_start.innovation(outputs, z_N, s, s_N)
            can_restart = new_start.fits(window, outputs, s, s_N, y)
            after, restart = _counted(before, is_used, has, y, S, limit, window.N, can_restart)
            rejected = ca.if_else(restart, in_range, _without(outputs, in_range))
            z_used = ca.if_else(agrees, z_N, ca.if_else(is_used, kept, rejected))
            m, P = new_start.anew(window, outputs, s_N, at_kept.P, y, m_0, P_0)
            as_used = _chosen(agrees, at_measured, is_used, prepared, at_kept)
            is_rejected = 1 - is_used
            is_used = ca.logic_or(is_used, restart)
            return dict(
                z_used=z_used,
                m_used=ca.if_else(restart, m, as_used.m),
                P_used=ca.if_else(restart, P, as_used.P),
                as_measured=agrees,
                is_rejected=is_rejected,
                # The QP of a window with bounds of states knows nothing of the restart.
                agrees=is_used * (1 - restart * bool(window.model.state_bounds)),
                restart=restart,
                **self._report(window, z_used),
                **{f"{name}_after": value for name, value in after.items()},
            )

        return gate

    def build_kept(self, window):
        """The Function (z_N, v, V) -> the sample with the inputs that are kept if it is rejected."""
        n_z = len(window.model.outputs)
        shapes = dict(z_N=(n_z, 1), v=window.pieces.v, V=(n_z, 1))

        @casadi_function("kept_inputs", ca.SX, **shapes)
        def kept(z_N, v, V):
            variances = self.limit(window) * V
            return dict(z_kept=_with_inputs_of_window(window.interval, z_N, v, variances))

        return kept

    def _report(self, window, z_used):
        """`accepted` (n,) of the n outputs that are reported, by name, if any."""
        rows = [window.model.outputs.index(name) for name in self.reported]
        used = [is_valid_measurement(z_used[row], window.model.limits[row]) for row in rows]
        return dict(accepted=ca.vertcat(*used)) if used else {}

    def conclude(self, window, given, verdict, result):
        """The flags `ok`, `kept` and `restart`, and the memory, given the feedback's result.

        The window fails, too, where a variance is not positive or too large.

        Args:
            window: The rhe.Window.
            given: {name: expression} of the inputs of the gate's Function and of the feedback.
            verdict: {name: expression} of the gate's Function.
            result: {name: expression} of the feedback.
        """
        variances = ca.diag(result["covariance"])
        has_variances = ca.mmin(variances) > 0
        kept = result["ok"] * has_variances * (ca.mmax(variances) <= MAX_PLAUSIBLE_STATE)
        ok = kept * verdict["agrees"]
        restart = kept * verdict["restart"]
        grows = growth_function(window.model, window.dt_s)
        if grows:
            is_growing = grows(*_kinds(window, result["estimate"]))
            ok *= 1 - is_growing
            restart = ca.logic_or(restart, kept * is_growing)
        after = {name: value for name, value in verdict.items() if name.endswith("_after")}
        if self.sees_half_turns(window):
            is_seen = self.half_turn.is_seen(window, result, _quantile(1))
            turned = self.half_turn.counted(window, given, is_seen)
            ok *= 1 - is_seen
            restart = ca.logic_or(restart, kept * self.half_turn.is_certain(window, turned))
            after["turned_after"] = turned
        # A window that fails forgets: what its prediction left here may not be a number.
        after = {name: ca.if_else(kept, value, 0) for name, value in after.items()}
        return dict(ok=ok, kept=kept, restart=restart) | after

    def build_restarted(self, window):
        """The memory of a window that restarts at its newest sample, unless it goes on."""

        def where(s, values):
            if not self.sees_half_turns(window):
                return s
            return self.half_turn.turned(window, s, values["turned_after"])

        after = {f"{name}_after": shape for name, shape in self.memory(window).items()}
        return new_start.build(window, self.outputs(window), where, after)


class _Prediction(NamedTuple):
    """A prediction of the newest node before its sample."""

    s: Any  # (n_s,) end of the newest interval, which follows the last solution
    v: Any  # (n_v,) its inputs
    B: Any  # (n_s, n_v) ∂s/∂v
    m: Any  # (n_s,) mean
    P: Any  # (n_s, n_s) covariance

    def given(self, window, z, noise):
        """Mean and covariance, with what z says about the inputs."""
        return window.predict_input(self.B, self.m, self.P, self.v, z, **noise)


def _predictions(window, values):
    """As it was prepared; with the measured inputs; with those kept of a rejected sample."""
    prepared = _Prediction(*(values[name] for name in newest_interval.PIECES))
    if not window.at_measured_input:
        return prepared, prepared, prepared
    variants = [values[name] for name in newest_interval.VARIANTS]
    n = len(newest_interval.PIECES)
    return prepared, _Prediction(*variants[:n]), _Prediction(*variants[n:])


def _chosen(is_first, first, is_second, second, third):
    """The first of three predictions, the second or the third."""
    if first is third:  # all are the same
        return first
    others = (ca.if_else(is_second, *pieces) for pieces in zip(second, third))
    return _Prediction(*(ca.if_else(is_first, *pair) for pair in zip(first, others)))


def patience(N):
    """Number of samples rejected in a row after which a window of N intervals restarts."""
    return max(TUNED.least_patience, TUNED.windows_of_patience * N)


def _kinds(window, estimate):
    """States, inputs and parameters (x, u, p) of an estimate."""
    values = dict(zip(window.estimated, ca.vertsplit(estimate)))
    model = window.model
    kinds = (model.states, model.inputs, model.parameters)
    return [ca.vertcat(*(values[name] for name in names)) for names in kinds]


def _quantile(n):
    """The value that a variable χ² with n degrees of freedom exceeds with the gate's share."""
    from scipy.special import chdtri  # it takes a quarter of a second to load

    return float(chdtri(n, TUNED.share))


def _with_inputs_as_before(interval, z, v, variances):
    """The sample z (n_z,) with NaN for measured inputs that differ from the last ones v (n_v,).

    They differ where the square of the change exceeds twice the variances (n_z,).
    """
    kept = ca.SX(z)
    for place, (row, _) in interval.input_outputs.items():
        stays = (z[row] - v[place]) ** 2 <= 2 * variances[row]
        kept[row] = ca.if_else(stays, z[row], ca.DM.nan())
    return kept


def _with_inputs_of_window(interval, z, v, variances):
    """The sample z (n_z,) with NaN for measured inputs beyond those of the window, v (n_v, N).

    They are beyond them where the square of the distance exceeds twice the variances (n_z,).
    """
    kept = ca.SX(z)
    for place, (row, _) in interval.input_outputs.items():
        nearest = ca.fmin(ca.fmax(z[row], ca.mmin(v[place, :])), ca.mmax(v[place, :]))
        stays = (z[row] - nearest) ** 2 <= 2 * variances[row]
        kept[row] = ca.if_else(stays, z[row], ca.DM.nan())
    return kept


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
