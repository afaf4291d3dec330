"""Innovation gating of an RHE of any Model: a sample far outside its prediction is not used.

With the innovation y of a sample, given its prediction, and the covariance S of y,

    d = y' S⁻¹ y ≤ limit,  the quantile of χ² that good samples exceed with the window's `gate`

(Bar-Shalom, Li, Kirubarajan, "Estimation with Applications to Tracking and Navigation", 2001,
Sec. 5.7). One Gauss-Newton step from an outlier can end at a yaw and parameters from which no
later step returns. Beyond the limit, therefore, all outputs of the sample count as missing, and the
estimate is the prediction. Measured inputs are kept where they are as before.

After many such samples in succession (`patience`) it is the estimate that is wrong. The window then
restarts at its newest node with the variances of the first guess, and takes the next sample as it
is.

All of it wraps the RHE's phases from outside, as `rhec.tracked_robot.robust` does.
"""

import casadi as ca

from rhec.core._casadi.build import casadi_function, select_inputs
from rhec.core.estimator import kalman
from rhec.core.model.limits import MAX_PLAUSIBLE_STATE, is_plausible

# Probability that the innovation of a good sample exceeds the limit.
SAFEGUARD = 1e-9  # of an estimator that is not robust: outliers that would lose it, and no others
ROBUST = 1e-3
WINDOWS_OF_PATIENCE = 3  # a restart amid bad samples starts from one of them
LEAST_PATIENCE = 30
OPEN = -1.0  # in place of the number of samples rejected in succession: the next one is taken


def limit_of(window):
    """The largest d of a sample that is used."""
    from scipy.stats import chi2  # takes long to load, and importing the core should not

    return float(chi2.isf(window.gate, max(len(window.interval.outputs), 1)))


def patience(window):
    """Number of samples rejected in succession after which the window restarts."""
    return max(LEAST_PATIENCE, WINDOWS_OF_PATIENCE * window.N)


def _build_gate(window, predict_input):
    """Function that tells whether the newest sample agrees with its prediction."""
    interval = window.interval
    outputs = interval.outputs
    limit = limit_of(window)
    z_N = (len(window.model.outputs), 1)
    one = (1, 1)

    @casadi_function(
        "gate",
        ca.SX,
        **window.prediction,
        **window.noise,
        s_N=(interval.n_s, 1),
        z_N=z_N,
        rejected=one,
    )
    def gate(B_N, v_N, m_N, P_N, s_N, z_N, rejected, **noise):
        m, P = predict_input(window, B_N, m_N, P_N, v_N, z_N, **noise)
        distance = kalman.update(m, P, z_N, noise["V"], outputs, s_N).distance
        agrees = distance <= limit  # 0 where it is NaN
        used = ca.logic_or(agrees, rejected < 0)
        has_outputs = sum((output.is_valid(z_N) for output in outputs), ca.SX(0)) > 0
        kept = ca.SX.nan(*z_N.shape)
        for place, (row, _) in interval.input_outputs.items():
            change = (z_N[row] - v_N[place]) ** 2
            kept[row] = ca.if_else(change <= 2 * limit * noise["V"][row], z_N[row], ca.DM.nan())
        after = ca.if_else(used, ca.if_else(has_outputs, 0, rejected), rejected + 1)
        return dict(z_used=ca.if_else(used, z_N, kept), agrees=agrees, rejected_after=after)

    return gate


def _build_hold(window):
    """Function that keeps the last node where the newest interval leads to no plausible state.

    The newest node is the estimate where a step fails, and the window restarts there. If it has
    restarted and still no interval leads on, the model has no slopes there, such as sqrt(x) for
    x < 0. The newest node is then the first guess m_0, where it has some.
    """
    n_s = window.interval.n_s
    nodes = (n_s, window.N + 1)

    @casadi_function("hold")
    def hold(s: nodes, age: (1, 1), m_0: (n_s, 1)):
        kept = ca.if_else(age == 0, m_0, s[:, -2])
        last = ca.if_else(is_plausible(s[:, -1]), s[:, -1], kept)
        return dict(s=ca.horzcat(s[:, :-1], last))

    return hold


def _wrap_feedback(window, feedback_of_rhe, predict_input, kind):
    gate = _build_gate(window, predict_input)
    shapes = {name: feedback_of_rhe.sparsity_in(name) for name in feedback_of_rhe.name_in()}

    @casadi_function("gated_feedback", kind, **shapes, rejected=(1, 1))
    def feedback(**inputs):
        checked = gate(**select_inputs(gate, inputs))
        used = inputs | dict(z_N=checked["z_used"])
        result = feedback_of_rhe(**select_inputs(feedback_of_rhe, used))
        variances = ca.diag(result["covariance"])
        has_variances = ca.mmin(variances) > 0
        solved = result["ok"] * has_variances * (ca.mmax(variances) <= MAX_PLAUSIBLE_STATE)
        return result | checked | dict(solved=solved, ok=solved * checked["agrees"])

    return feedback


def _wrap_expand(window, expand_of_rhe, kind):
    shapes = {name: expand_of_rhe.sparsity_in(name) for name in expand_of_rhe.name_in()}
    del shapes["z_N"]
    z_used = (len(window.model.outputs), 1)
    one = (1, 1)

    @casadi_function("gated_expand", kind, **shapes, z_used=z_used, solved=one, rejected_after=one)
    def expand(z_used, solved, rejected_after, **inputs):
        keeps = solved * (rejected_after < patience(window))
        values = inputs | dict(z_N=z_used, ok=keeps)
        result = expand_of_rhe(**select_inputs(expand_of_rhe, values))
        rejected = ca.if_else(keeps, rejected_after, OPEN)
        kkt = ca.if_else(inputs["ok"], result["kkt"], ca.DM.nan())
        return result | dict(rejected=rejected, kkt=kkt)

    return expand


def gated(window, phases, predict_input, kind):
    """The phases {shift, linearise, feedback, expand} of an RHE, with a gate before feedback.

    The feedback's `ok` is 0 where the sample does not agree with its prediction, and where the
    covariance has a variance that is not positive or too large. `kkt` is NaN there.

    Args:
        window: The rhe.Window, with a gate.
        phases: The phases of the same window without one.
        predict_input: `rhe.predict_input`.
        kind: SX or MX, of the Functions that call others.
    """
    shapes = {name: phases["shift"].sparsity_in(name) for name in phases["shift"].name_in()}
    shapes |= dict(rejected=(1, 1), m_0=shapes["m"])

    hold = _build_hold(window)

    @casadi_function("gated_shift", kind, **shapes)
    def shift(rejected, m_0, **inputs):
        shifted = phases["shift"](**inputs)
        return shifted | dict(s=hold(shifted["s"], inputs["age"], m_0), rejected=rejected)

    return dict(
        shift=shift,
        linearise=phases["linearise"],
        feedback=_wrap_feedback(window, phases["feedback"], predict_input, kind),
        expand=_wrap_expand(window, phases["expand"], kind),
    )
