"""The judge of an RHE: a sample far outside its prediction is not used, unless it is not alone.

With the innovation y of the outputs that are judged, given their prediction, and its covariance S,

    d = y' S⁻¹ y ≤ limit,  the quantile of χ² that good samples exceed with the gate's `share`

(Bar-Shalom, Li, Kirubarajan, "Estimation with Applications to Tracking and Navigation", 2001,
Sec. 5.7). One Gauss-Newton step from an outlier can end at a yaw and parameters from which no
later step returns. A sample has three chances:

1. It is used as it was measured, if d is within the limit.
2. It is used without those measured inputs that are beyond all inputs of the window, if d is then:
   an encoder may be wrong where the position is not. An input that the window has had before, such
   as a steering angle that changes sides, is no sign of a fault.
3. Otherwise it is rejected: the judged outputs count as missing, and so do such inputs.

While samples are rejected, or have no judged output, the window loses its measurements, and with a
large W the S of its prediction would let anything pass. So S is that of the last sample that was
used, times 1 + the number of samples that had no output since. An input that is not measured may
have any value: after n samples in a row without some input, S is multiplied by (1 + n)², too.

What is wrong may be the estimate and not the samples. Then their innovations follow each other:
those of a position that has moved for good are all alike, those of a wrong speed grow evenly. The
window restarts at the fourth sample rejected in a row if two second differences of the innovations
are no more than noise,

    (y_k - 2 y_{k-1} + y_{k-2})' (6 S)⁻¹ (…) ≤ limit,

where 6 stands because that of white noise with variance σ² is 6σ² (von Neumann, 1941). Up to three
wild samples therefore move nothing. Among samples that scatter, two small ones are found by chance:
after such a run it takes four. A window whose solution swings must not look like noisy samples, so
that the innovations of the last two samples are moved along with the newest node, as the feedback
moves it. The window also restarts

- where too many samples are rejected in a row, whichever they are (`patience`);
- where it fits the samples only because the robot is thought to be turned round (`half_turn`);
- where the integration rule is unstable at the estimate although the model is not: such intervals
  predict states that are wrong.

`new_start` says how it restarts.
"""

from dataclasses import dataclass
from typing import Any, NamedTuple

import casadi as ca
import numpy as np

from rhec.core._casadi.build import casadi_function, short_cut
from rhec.core.estimator import half_turn, new_start, newest_interval, noise_level
from rhec.core.estimator.half_turn import HalfTurn
from rhec.core.model.integration import growth_function
from rhec.core.model.limits import is_valid_measurement


class Tuned(NamedTuple):
    """The numbers that were chosen, not derived.

    They were chosen on drives 0 to 39 of the table in tests/guard_table.py; its nightly test has
    others.
    """

    # name: value  # [unit] meaning
    share: float = 1e-9  # [1] of good samples to reject: only outliers that would lose an estimator
    in_line: int = 2  # [second differences] within noise, and the window restarts
    scattered_line: int = 4  # [second differences] the same after rejected samples that scatter
    windows_of_patience: int = 3  # [windows] of rejected samples before it restarts in any case
    least_patience: int = 30  # [samples] at least
    settles: int = 3  # [good samples] in a row, after a restart, until the window grows again
    settled: float = 0.25  # [limit] distance of such a sample


TUNED = Tuned()


@dataclass(frozen=True)
class InnovationGate:
    """The gate that judges these outputs of a Model, by name; without names all of them.

    Outputs that measure an input belong to the inputs, and are not judged by themselves.
    `accepted` tells of the `reported` outputs, by name, which are used. Where the model may lead
    nowhere (`doubts_model`), as one without slopes in places does, the prediction and all nodes of
    the window have to be plausible. `half_turn` tells how to see that the robot is thought to be
    turned round; without it the Model does, if it names its heading. A gate that does not reject
    uses all samples, as far from their prediction as they are.
    """

    judged: tuple[str, ...] = ()
    reported: tuple[str, ...] = ()
    doubts_model: bool = True
    half_turn: HalfTurn | None = None
    rejects: bool = True

    def outputs(self, window):
        """The outputs that are judged."""
        names = window.model.outputs
        every = window.interval.outputs
        return [output for output in every if not self.judged or names[output.row] in self.judged]

    def limit(self, window):
        """The largest d of a sample that is used."""
        if not self.rejects:
            return np.inf
        return _quantile(max(len(self.outputs(window)), 1))

    def half_turn_of(self, window):
        """How this window can tell that it is turned round: as given, or as its Model says."""
        return self.half_turn or half_turn.of_model(window.model)

    def sees_parameter(self, window):
        """Whether a parameter of this window can tell that it is turned round."""
        turn = self.half_turn_of(window)
        return bool(turn and turn.has_parameter(window))

    def sees_opposite(self, window):
        """Whether it is predicted where the robot would be with the opposite heading."""
        return window.model.heading is not None

    def memory(self, window):
        """What is remembered of the samples before.

        How many were rejected in a row, how many second differences of these are within noise, how
        many had no output since the last one that was used; the innovations of the last two, and
        the covariance S of the last one that was used. How noisy they are (`noise_level`). For how
        many samples the window still has to settle, and how many had no inputs. Then after how many
        samples the robot seemed to be turned round, and where it would be then.
        """
        n = len(self.outputs(window))
        memory = dict(rejected=(1, 1), in_line=(1, 1), missing=(1, 1), trail=(n, 2), S=(n, n))
        memory |= noise_level.SHAPES
        if self.doubts_model:
            memory |= dict(settling=(1, 1))
        if window.at_measured_input:
            memory |= dict(unknown=(1, 1))
        if self.sees_parameter(window):
            memory |= dict(turned=(1, 1))
        if self.sees_opposite(window):
            memory |= dict(opposite=(window.interval.n_s, 1))
        return memory

    def _shapes(self, window):
        """{name: shape} of what the judge is given: prediction, sample, noise, memory."""
        shapes = window.prediction | window.noise | self.memory(window)
        shapes |= dict.fromkeys(("s_N", "m_0", "P_0"), (window.interval.n_s, 1))
        shapes |= dict(z_N=(len(window.model.sampled), 1), v=window.pieces.v)
        if self.sees_parameter(window):
            shapes |= dict(age=(1, 1))
        if window.at_measured_input:
            shapes |= newest_interval.variants_of(window)
        return shapes | (dict(iteration=(1, 1)) if self.doubts_model else {})

    def build_is_clean(self, window):
        """The Function (prediction, s_N, z_N, noise, memory, …) -> whether nothing is unusual.

        That is a sample that agrees as it was measured, after others of the noise that they should
        have.
        """

        @casadi_function("gate_is_clean", ca.SX, **self._shapes(window))
        def gate_is_clean(m_0, P_0, z_N, v, iteration=None, **values):
            before, noise, predictions = self._given(window, values)
            seen = self._compared(window, before, noise, predictions, z_N, v, iteration, 0)
            is_first = before["rejected"] + before["missing"] == 0
            return dict(is_clean=seen.fits * is_first * noise_level.is_usual(before))

        return gate_is_clean

    def _given(self, window, values):
        """The memory, the noise and the predictions among the values that the judge is given."""
        before = {name: values[name] for name in self.memory(window)}
        noise = {name: values[name] for name in window.noise}
        return before, noise, _predictions(window, values)

    def build(self, window):
        """The Function (prediction, s_N, z_N, noise, memory, …) -> how the newest sample is used.

        That is `z_used` with the noise's factor `scale_used`, the prediction's `m_used` and
        `P_used`, `agrees`, `accepted`, `restart` and where, `s_restart`, and of each piece of the
        memory `<piece>_after`. Where the sample `is_clean`, what is for others is not computed.
        """
        outputs = self.outputs(window)

        @short_cut("is_clean")
        @casadi_function("gate", ca.SX, **self._shapes(window), is_clean=(1, 1))
        def gate(m_0, P_0, z_N, v, is_clean, iteration=None, **values):
            before, noise, predictions = self._given(window, values)
            # A clean sample has usual ones before it: what follows from others is left out then.
            usual = noise_level.USUAL | dict(rejected=0, missing=0, in_line=0)
            before |= {key: ca.if_else(is_clean, each, before[key]) for key, each in usual.items()}
            seen = self._compared(window, before, noise, predictions, z_N, v, iteration, is_clean)
            run = self._run(window, before, noise, seen, z_N, P_0)
            m, P = new_start.anew(window, outputs, run.s, seen.at_kept.P, run.y, z_N, m_0, P_0)
            # The chances: as measured, with the inputs that are kept, by a noise that has grown,
            # without its outputs.
            as_measured = ca.if_else(run.is_noisier, 1, seen.fits)
            is_used = ca.if_else(run.is_noisier, 1, seen.is_used)
            has_outputs = ca.logic_or(is_used, run.restart)
            rejected = _without(outputs, seen.kept)
            z_used = ca.if_else(as_measured, z_N, ca.if_else(has_outputs, seen.kept, rejected))
            as_used = _chosen(as_measured, seen.at_measured, seen.at_kept)
            scale, after = self._after(window, before, seen, run, is_used)
            return dict(
                z_used=z_used,
                scale_used=scale,
                m_used=ca.if_else(run.restart, m, as_used.m),
                P_used=ca.if_else(run.restart, P, as_used.P),
                s_restart=run.s,
                s_predicted=run.s_predicted,
                m_alone=as_used.m,
                as_measured=as_measured,
                is_rejected=1 - is_used,
                # The QP of a window with bounds of states knows nothing of the restart.
                agrees=ca.logic_or(is_used, run.restart * (not window.model.state_bounds)),
                restart=run.restart,
                **self._report(window, z_used),
                **{f"{name}_after": value for name, value in after.items()},
            )

        return gate

    def _compared(self, window, before, noise, predictions, z_N, v, iteration, is_clean):
        """The sample beside its predictions: what is _Seen."""
        interval = window.interval
        outputs = self.outputs(window)
        at_measured, at_kept = predictions
        limit = self.limit(window)
        kept = _with_inputs_of_window(interval, z_N, v, limit * noise["V"])
        rows = [output.slope(at_measured.s, z_N) for output in outputs]
        H = ca.vertcat(ca.SX(0, interval.n_s), *rows)
        has = ca.vertcat(ca.SX(0, 1), *(output.is_valid(z_N) for output in outputs))
        scale = noise_level.scale_of(before)
        V = scale * ca.vertcat(*(noise["V"][output.row] for output in outputs))
        strays = 0
        if self.doubts_model:
            strays = _strays(at_measured, H, V, limit) * (iteration == 0)
            # Then those of an EKF: from the last estimate along the model.
            straight = (each._replace(m=ca.if_else(strays, each.s, each.m)) for each in predictions)
            at_measured, at_kept = straight
        m, P = at_measured.given(window, z_N, noise)
        m_kept, P_kept = at_kept.given(window, kept, noise)
        S = H @ P @ H.T + ca.diag(V)
        S = ca.if_else(before["rejected"] + before["missing"] > 0, before["S"], S)
        grown = S * (1 + before["missing"])
        unknown = 0
        if window.at_measured_input:
            unknown = before["unknown"] + (ca.sum1(has) > 0) * _lacks_inputs(interval, z_N)
            grown = grown * (1 + unknown) ** 2
        d = _distance(new_start.innovation(outputs, z_N, m, at_measured.s), grown, has)
        y_kept = new_start.innovation(outputs, z_N, m_kept, at_kept.s)
        fits_kept = _distance(y_kept, grown + H @ (P_kept - P) @ H.T, has) <= limit
        fits = ca.if_else(is_clean, 1, d <= limit)  # 0 where it is NaN
        return _Seen(
            at_measured=at_measured,
            at_kept=at_kept,
            kept=kept,
            has=has,
            S=S,
            grown=grown,
            limit=limit,
            d=d,
            scale=scale,
            strays=strays,
            unknown=unknown,
            fits=fits,
            is_used=ca.if_else(is_clean, 1, ca.logic_or(fits, fits_kept)),
            is_clean=is_clean,
        )

    def _run(self, window, before, noise, seen, z_N, P_0):
        """The _Run of rejected samples with this one, if it is not used."""
        outputs = self.outputs(window)
        # m_N knows nothing of bounds; s_N follows from the last solution, which does.
        s_N = seen.at_kept.s
        s, _ = seen.at_kept._replace(m=s_N).given(window, seen.kept, noise)
        y = new_start.innovation(outputs, z_N, s, s_N)
        square = _distance(noise_level.bend_of(before, y), 6 * seen.S, seen.has)
        counted, is_in_line = _counted(before, seen, square)
        is_rejected = 1 - seen.is_used
        is_noisy = noise_level.is_noisy(counted, is_in_line, seen.scale) * is_rejected
        if self.sees_parameter(window):  # what seems to be turned round is no noise
            is_noisy *= before["turned"] == 0
        is_noisier = is_noisy * (seen.d <= seen.limit * ca.fmax(counted["spread"], 1))
        asks = ca.logic_or(is_in_line, counted["rejected"] >= patience(window.N))
        restart = asks * is_rejected * (1 - is_noisier)
        opposite = None
        if self.sees_opposite(window):
            opposite, is_there = self._opposite(window, before, seen, z_N)
            opposite = ca.if_else(seen.is_clean, before["opposite"], opposite)
            is_there *= restart * (seen.d > seen.limit)
            y = ca.if_else(is_there, new_start.innovation(outputs, z_N, opposite, opposite), y)
            s_N = ca.if_else(is_there, opposite, s_N)
        restart *= new_start.fits(window, outputs, s, s_N, z_N, y, P_0)
        is_louder = is_noisy * ca.logic_or(is_noisier, restart)
        return _Run(
            counted=counted,
            y=y,
            square=square,
            s_predicted=s,
            s=s_N,
            is_noisier=is_noisier,
            is_louder=is_louder,
            restart=restart,
            opposite=opposite,
        )

    def _after(self, window, before, seen, run, is_used):
        """The noise's factor at this sample, and the memory after it."""
        has_any = ca.sum1(seen.has) > 0
        is_told = has_any * (1 - run.is_noisier) * (1 - seen.is_clean)
        if self.sees_parameter(window):
            is_told *= before["turned"] == 0
        followed = noise_level.followed(before, run.square / _count(seen), is_told)
        louder = seen.scale * ca.fmax(run.counted["spread"], 1)
        after_it = ca.if_else(run.is_louder, louder, followed)
        share = noise_level.share_after(before, 1 - is_used, has_any, patience(window.N))
        S = seen.S * (after_it / seen.scale)
        after = _remembered(run, is_used, has_any, S, before)
        after |= dict(share=share, noise_scale=after_it)
        if window.at_measured_input:
            is_known = is_used * (seen.unknown == before["unknown"])
            after |= dict(unknown=seen.unknown * (1 - is_known))
        if self.doubts_model:
            is_good = is_used * (seen.d <= seen.limit * TUNED.settled)
            after |= dict(settling=_settling(before, run.restart, seen.strays, is_good))
        if self.sees_opposite(window):
            after |= dict(opposite=run.opposite)
        return ca.if_else(run.is_louder, louder, seen.scale), after

    def _opposite(self, window, before, seen, z_N):
        """Where the robot would be with the opposite heading, and whether the sample is there."""
        s = window.interval.step(before["opposite"], seen.at_kept.v, window.dt_s)
        y = new_start.innovation(self.outputs(window), z_N, s, s)
        return s, _distance(y, seen.grown, seen.has) <= seen.limit

    def build_kept(self, window):
        """The Function (z_N, v, V) -> the sample with the inputs that are kept if rejected."""
        shapes = dict(z_N=(len(window.model.sampled), 1), v=window.pieces.v, V=window.noise["V"])

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

        The window fails, too, where a variance is not positive.

        Args:
            window: The rhe.Window.
            given: {name: expression} of the inputs of the gate's Function and of the feedback.
            verdict: {name: expression} of the gate's Function.
            result: {name: expression} of the feedback.
        """
        has_variances = ca.mmin(ca.diag(result["covariance"])) > 0
        kept = result["ok"] * has_variances
        ok = kept * verdict["agrees"]
        restart = kept * verdict["restart"]
        grows = growth_function(window.model, window.dt_s)
        if grows:
            is_growing = grows(*_kinds(window, result["estimate"], given["z_N"]))
            ok *= 1 - is_growing
            restart = ca.logic_or(restart, kept * is_growing)
        after = {name: value for name, value in verdict.items() if name.endswith("_after")}
        newest = _joint_state(window, result["estimate"], verdict["s_predicted"])
        # The next prediction begins at the estimate: innovations count from there.
        moved = self._moved(window, verdict["s_predicted"], newest, given["z_N"])
        after["trail_after"] -= ca.repmat(moved, 1, 2)
        turn = self.half_turn_of(window)
        if self.sees_parameter(window):
            is_seen = turn.is_seen(window, result, _quantile(1))
            turned = turn.counted(window, given, is_seen, restart)
            ok *= 1 - is_seen
            restart = ca.logic_or(restart, kept * turn.is_certain(window, turned))
            after["turned_after"] = turned
        if self.sees_opposite(window):
            goes_on = verdict["is_rejected"] * (1 - restart)
            opposite = turn.turned(window, newest, 1)
            after["opposite_after"] = ca.if_else(goes_on, after["opposite_after"], opposite)
        # A window that fails forgets: what its prediction left here may not be a number.
        after = {name: ca.if_else(kept, value, 0) for name, value in after.items()}
        return dict(ok=ok, kept=kept, restart=restart) | after

    def _moved(self, window, s, s_new, z):
        """By how much each judged output (n_y,) moves as a node moves from s to s_new."""
        rows = [output.value(s_new, z) - output.value(s, z) for output in self.outputs(window)]
        return ca.vertcat(ca.DM(0, 1), *rows)

    def build_restarted(self, window):
        """The memory of a window that restarts at its newest sample, unless it goes on."""

        def where(s, values):
            if not self.sees_parameter(window):
                return s
            turn = self.half_turn_of(window)
            return turn.turned(window, s, turn.is_certain(window, values["turned_after"]))

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


class _Seen(NamedTuple):
    """A sample beside its predictions."""

    at_measured: Any  # the _Prediction with all measured inputs
    at_kept: Any  # the one with the inputs that are kept
    kept: Any  # (n_z,) the sample with these
    has: Any  # (n_y,) which of the judged outputs it has
    S: Any  # (n_y, n_y) covariance of their innovation
    grown: Any  # S, larger the more samples before had no outputs, or not all inputs
    limit: Any  # of the distance
    d: Any  # distance, by `grown`
    scale: Any  # factor of the noise
    strays: Any  # whether the window leads elsewhere than its solution
    unknown: Any  # how many samples in a row had outputs, but not all inputs
    fits: Any  # whether it agrees as it was measured
    is_used: Any  # whether it agrees with some of its inputs
    is_clean: Any  # whether it is known that nothing is unusual


class _Run(NamedTuple):
    """Samples that were rejected in a row, the newest included."""

    counted: Any  # {name: value} of the memory
    y: Any  # (n_y,) innovation where the window would restart
    square: Any  # of the second difference of innovations
    s_predicted: Any  # (n_s,) the prediction with what is known of the inputs
    s: Any  # (n_s,) the prediction from which it would restart
    is_noisier: Any  # whether the newest one agrees if the noise is what they scatter
    is_louder: Any  # whether the noise is taken to be that
    restart: Any  # whether the window restarts
    opposite: Any  # (n_s,) where the robot would be with the opposite heading, or None


def _count(seen):
    """How many outputs a sample has, at least one."""
    return ca.fmax(ca.sum1(seen.has), 1)


def _predictions(window, values):
    """With the measured inputs, and with those of them that the judge keeps."""
    if not window.at_measured_input:
        prepared = _Prediction(*(values[name] for name in newest_interval.PIECES))
        return prepared, prepared
    variants = [values[name] for name in newest_interval.VARIANTS]
    n = len(newest_interval.PIECES)
    return _Prediction(*variants[:n]), _Prediction(*variants[n:])


def _chosen(is_first, first, second):
    """One of two predictions."""
    if first is second:
        return first
    return _Prediction(*(ca.if_else(is_first, *pair) for pair in zip(first, second)))


def patience(N):
    """Number of samples rejected in a row after which a window of N intervals restarts."""
    return max(TUNED.least_patience, TUNED.windows_of_patience * N)


def _kinds(window, estimate, z):
    """States, inputs and parameters (x, u, p) of an estimate; u ends with what is known in z."""
    model = window.model
    values = dict(zip(model.sampled, ca.vertsplit(z)))
    values |= dict(zip(window.estimated, ca.vertsplit(estimate)))
    kinds = (model.states, model.acting, model.parameters)
    return [ca.vertcat(*(values[name] for name in names)) for names in kinds]


def _joint_state(window, estimate, s):
    """The joint state (n_s,) of an estimate; what that does not hold is as in s."""
    values = dict(zip(window.model.joint_names, ca.vertsplit(s)))
    values |= dict(zip(window.estimated, ca.vertsplit(estimate)))
    return ca.vertcat(*(values[name] for name in window.model.joint_names))


def _quantile(n):
    """The value that a variable χ² with n degrees of freedom exceeds with the gate's share."""
    from scipy.special import chdtri  # it takes a quarter of a second to load

    return float(chdtri(n, TUNED.share))


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


def _counted(before, seen, square):
    """The run of rejected samples with this one (a dict), and whether the last ones are in line.

    Args:
        before: The memory before it.
        seen: The _Seen.
        square: Of the second difference of innovations, by the variances that are expected.
    """
    is_line = (before["rejected"] >= 2) * (square <= seen.limit)
    spreads = noise_level.spreads(before, square / _count(seen), ca.sum1(seen.has) > 0, is_line)
    run = dict(
        rejected=before["rejected"] + 1,
        in_line=ca.if_else(is_line, before["in_line"] + 1, 0),
        **spreads,
    )
    scatters = run["spread"] > noise_level.TUNED.scattered
    return run, run["in_line"] >= ca.if_else(scatters, TUNED.scattered_line, TUNED.in_line)


def _remembered(run, is_used, has_any, S, before):
    """The run of rejected samples, missing ones and their innovations, after this sample."""
    goes_on = 1 - ca.logic_or(is_used * has_any, run.restart)  # without a sample that was used
    is_rejected = 1 - is_used
    pairs = {name: (value, before[name]) for name, value in run.counted.items()}
    counted = {name: goes_on * ca.if_else(is_rejected, *pair) for name, pair in pairs.items()}
    trail = ca.if_else(has_any, ca.horzcat(run.y, before["trail"][:, 0]), before["trail"])
    return counted | dict(missing=goes_on * (before["missing"] + (1 - has_any)), trail=trail, S=S)


def _settling(before, restart, strays, is_good):
    """For how many good samples in a row the window has to settle after this one."""
    left = ca.if_else(is_good, before["settling"] - 1, TUNED.settles)
    left = (before["settling"] > 0) * left
    return ca.if_else(ca.logic_or(restart, strays), TUNED.settles, left)


def _strays(prediction, H, V, limit):
    """Whether the window does not lead where its last solution leads.

    It leads to the mean m, its last solution to s. At a solution they are the same. Where they are
    farther apart in the outputs than a sample may be, the step to m has left the region where the
    linearisation holds.
    """
    apart = H @ (prediction.m - prediction.s)
    S = H @ prediction.P @ H.T + ca.diag(V)
    return 1 - (_distance(apart, S, ca.SX.ones(V.numel())) <= limit)


def _lacks_inputs(interval, z):
    """Whether the sample z lacks a measured input."""
    has_inputs = ca.SX(1)
    for row, limit in interval.input_outputs.values():
        has_inputs *= is_valid_measurement(z[row], limit)
    return 1 - has_inputs


def _without(outputs, z):
    """The sample z (n_z,) without these outputs."""
    z = ca.SX(z)
    for output in outputs:
        z[output.row] = ca.DM.nan()
    return z
