"""One guard around the phases of an RHE: a judge says how the newest sample is used.

    judge(prediction, z, memory) -> what is used of z, with which variances, whether the window
                                    restarts, memory

The prediction is that of the newest node, before its measurement. One Gauss-Newton step from an
outlier can end where no later step returns; so the judge, the `innovation_gate`, comes before the
feedback. What it says then reaches all phases by `with_guard`:

- feedback solves with what is used; its `ok` is 0 where the sample contradicts the prediction;
- expand keeps the window, or restarts it, and remembers what was used;
- the newest interval is linearised at its input as it is used (`newest_interval`);
- shift and linearise have the noise that was used at each node: W of the interval before it, where
  process noise acts within the window (`window_noise`).

The words, here and there:

| word | meaning |
| --- | --- |
| used | what the feedback takes in place of what was measured: `z_used`, NaN for what is left out |
| accepted | flags: which of the measurements are used |
| agrees | whether the sample as a whole agrees with its prediction, or restarts the window |
| ok | whether the estimate is a solution that takes in a sample that agrees |
| kept | whether the window goes on from the solution; otherwise it fails, and restarts without it |
| restart | whether the window starts anew where the judge says; after a solution that is kept |
"""

import casadi as ca

from rhec.core._casadi.build import casadi_function, inlined, select_inputs
from rhec.core.estimator import newest_interval, noise_level

# The feedback of `solve`, if it is another: its input `iteration` is 1 at first and then 2. That of
# a sample without iterations is 0.
ITERATED = "iterated_feedback"
# What the judge tells the feedback alone.
_WITHIN = ("m_used", "P_used", "agrees", "as_measured", "is_rejected", "s_predicted")


def noise_memory(window):
    """{name: shape} of the noise W of all intervals, where it acts within the window."""
    return dict(W_window=(window.interval.n_s, window.N)) if window.noisy else {}


def whole_noise(window, values):
    """{"W_window": columns of all intervals}, the newest as used; empty without such noise."""
    if not window.noisy:
        return {}
    return dict(W_window=ca.horzcat(values["W_window"][:, :-1], values["W_used"]))


def _shapes(function, *without):
    """{name: sparsity} of a Function's inputs."""
    return {key: function.sparsity_in(key) for key in function.name_in() if key not in without}


def noise_as_used(window, values, scale):
    """`values` with the variances V of a time when the noise had this scale."""
    return values | dict(V=noise_level.scaled(window, values["V"], scale))


def _wrap_shift(window, shift_of_rhe, memory, symbols):
    @casadi_function("guarded_shift", symbols, **_shapes(shift_of_rhe) | memory)
    def shift(**inputs):
        pieces = {name: inputs[name] for name in memory}
        if window.noisy:  # the newest column is not known before the feedback
            W = inputs["W_window"]
            pieces["W_window"] = ca.horzcat(W[:, 1:], W[:, -1])
        return inlined(shift_of_rhe, noise_as_used(window, inputs, inputs["noise_scale"])) | pieces

    return shift


def _wrap_linearise(window, linearise_of_rhe, symbols):
    shapes = _shapes(linearise_of_rhe) | dict(noise_scale=(1, 1))

    @casadi_function("guarded_linearise", symbols, **shapes)
    def linearise(**inputs):
        return inlined(linearise_of_rhe, noise_as_used(window, inputs, inputs["noise_scale"]))

    return linearise


def _wrap_feedback(window, feedback_of_rhe, symbols):
    judge = window.judge
    function = judge.build(window)
    is_clean = judge.build_is_clean(window)
    intervals = newest_interval.build(window, judge) if window.at_measured_input else None
    shapes = _shapes(feedback_of_rhe) | _shapes(function, "is_clean", *newest_interval.VARIANTS)
    shapes |= newest_interval.needs(window) if intervals else {}

    @casadi_function("guarded_feedback", symbols, **shapes)
    def feedback(**inputs):
        variants = intervals(**select_inputs(intervals, inputs)) if intervals else {}
        predicted = inputs | variants
        predicted |= is_clean(**select_inputs(is_clean, predicted))
        verdict = inlined(function, predicted)
        chosen = newest_interval.chosen(window, predicted, verdict) if intervals else {}
        used = _as_used(window, inputs, verdict, chosen)
        result = feedback_of_rhe(**select_inputs(feedback_of_rhe, used))
        for_expand = {f"{name}_taken": piece for name, piece in chosen.items()}
        for_expand |= dict(is_only_step=inputs["iteration"] == 0) if intervals else {}
        for_expand |= dict(W_used=inputs["W"]) if window.noisy else {}
        told = {name: value for name, value in verdict.items() if name not in _WITHIN}
        return result | told | judge.conclude(window, inputs, verdict, result) | for_expand

    return feedback


def _as_used(window, inputs, verdict, chosen):
    """The feedback's inputs, with the newest interval and the sample as the judge has them used."""
    used = newest_interval.replaced(inputs, chosen)
    used = noise_as_used(window, used, verdict["scale_used"])
    if "W_window" in used:  # the feedback solves for all of the window
        used |= whole_noise(window, used | dict(W_used=inputs["W"]))
    return used | dict(z_N=verdict["z_used"], m_N=verdict["m_used"], P_N=verdict["P_used"])


def _first_and_later(window, feedback, symbols):
    """The phase "feedback", and the one of later iterations on a sample, if it is another."""
    if not window.doubts_model:
        return dict(feedback=feedback)

    @casadi_function("only_feedback", symbols, **_shapes(feedback, "iteration"))
    def first(**inputs):
        return feedback(**inputs, iteration=0)

    return {"feedback": first, ITERATED: feedback}


def _wrap_expand(window, expand_of_rhe, symbols):
    restarted = window.judge.build_restarted(window)
    pieces = window.judge.memory(window)
    shapes = _shapes(expand_of_rhe, "z_N") | noise_memory(window)
    shapes |= dict(z_used=expand_of_rhe.sparsity_in("z_N"), kept=(1, 1), scale_used=(1, 1))
    if window.noisy:
        shapes |= dict(W_used=window.noise["W"])
    shapes |= {f"{name}_after": shape for name, shape in pieces.items()}
    known = ("goes_on", "W") if window.noisy else ("goes_on",)
    shapes |= _shapes(restarted, *known, *shapes) | dict(restart=(1, 1))
    pieces_of_newest = newest_interval.pieces_of(window) if window.at_measured_input else {}
    shapes |= {f"{name}_taken": shape for name, shape in pieces_of_newest.items()}
    shapes |= dict(is_only_step=(1, 1)) if pieces_of_newest else {}

    @casadi_function("guarded_expand", symbols, **shapes)
    def expand(**inputs):
        taken = {name: inputs[f"{name}_taken"] for name in pieces_of_newest}
        inputs = newest_interval.replaced(inputs, taken)
        inputs = noise_as_used(window, inputs, inputs["scale_used"])
        noises = whole_noise(window, inputs)
        values = inputs | noises | dict(z_N=inputs["z_used"], ok=inputs["kept"])
        result = inlined(expand_of_rhe, values)
        kkt = ca.if_else(inputs["ok"], result.pop("kkt"), ca.DM.nan())
        if pieces_of_newest:
            within = newest_interval.within_range(window, result["v"], inputs["v"], inputs["V"])
            result["v"] = ca.if_else(inputs["is_only_step"], within, result["v"])
        memory = result | noises
        memory |= {name: inputs[f"{name}_after"] for name in pieces}
        is_alone = inputs["restart"]
        if window.doubts_model:
            settles = inputs["kept"] * (inputs["settling_after"] > 0)
            is_alone = ca.logic_or(is_alone, settles)
        newest = dict(goes_on=1 - is_alone)
        newest |= dict(W=inputs["W_used"]) if window.noisy else {}
        memory |= inlined(restarted, inputs | memory | newest)
        return memory | dict(kkt=kkt)

    return expand


def with_guard(window, phases, symbols):
    """The phases {shift, linearise, feedback, expand} of an RHE with the window's judge.

    Args:
        window: The rhe.Window.
        phases: Its phases, in which expand takes the noise of all intervals, feedback the newest.
        symbols: SX or MX, of the Functions that call others.
    """
    memory = noise_memory(window) | window.judge.memory(window)
    feedback = _wrap_feedback(window, phases["feedback"], symbols)
    return dict(
        shift=_wrap_shift(window, phases["shift"], memory, symbols),
        linearise=_wrap_linearise(window, phases["linearise"], symbols),
        **_first_and_later(window, feedback, symbols),
        expand=_wrap_expand(window, phases["expand"], symbols),
    )
