"""One guard around the phases of an RHE: a judge says how the newest sample is used.

    judge(prediction, z, memory) -> what is used of z, with which variances, whether the window
                                    restarts, memory

The prediction is that of the newest node, before its measurement. One Gauss-Newton step from an
outlier can end where no later step returns; so the judge comes before the feedback. What it says
then reaches all phases by `with_guard`, whoever the judge is:

- feedback solves with what is used; its `ok` is 0 where the sample contradicts the prediction;
- expand keeps the window, or restarts it, and remembers what was used;
- shift and linearise have the noise that was used at each node: Q of the interval before it, where
  process noise acts within the window (`window_noise`).

The words, here and in all judges:

| word | meaning |
| --- | --- |
| used | what the feedback takes in place of what was measured: `z_used`, NaN for what is left out |
| accepted | flags: which of the measurements are used |
| agrees | whether the sample as a whole agrees with its prediction |
| ok | whether the estimate is a solution that takes in a sample that agrees |
| kept | whether the window goes on from the solution; otherwise it fails, and restarts without it |
| restart | whether the window starts anew where the judge says, with a solution or without one |
"""

import casadi as ca
import numpy as np

from rhec.core._casadi.build import casadi_function, select_inputs


class Judge:
    """What is asked of a judge, a record that can be hashed. This one uses all as it is measured.

    Its Functions take by name any inputs and results of the phases that they wrap.
    """

    # Whether the model, too, may lead nowhere, as one without slopes in places does: then the
    # prediction and all nodes of the window have to be plausible.
    doubts_model = False

    def memory(self, window):
        """{name: shape} of what is remembered."""
        return {}

    def first(self, window):
        """{name: array} of what is remembered before the first sample."""
        return {}

    def build(self, window):
        """The Function (prediction, s_N, z_N, noise, age, memory) -> (z_used, …).

        Besides `z_used` it may return the prediction's `m_used` and `P_used`, `agrees`, `accepted`
        and `restart`. Of each piece of the memory it returns `<piece>_after`.
        """

        @casadi_function("judge", ca.SX, z_N=(len(window.model.outputs), 1))
        def judge(z_N):
            return dict(z_used=z_N)

        return judge

    def conclude(self, window, given, verdict, result):
        """The flags `ok` and `kept`, and what changes of the verdict, given the feedback's result.

        Args:
            window: The rhe.Window.
            given: {name: expression} of the inputs of the judge's Function and of the feedback.
            verdict: {name: expression} of the judge's Function.
            result: {name: expression} of the feedback.
        """
        return dict(ok=result["ok"] * verdict.get("agrees", 1), kept=result["ok"])

    def build_restarted(self, window):
        """The Function (goes_on, memory, …) -> memory, of a judge that restarts; otherwise None.

        `goes_on` is 1 where there is no `restart`.
        """
        return None


BELIEVER = Judge()


def fresh(window, memory, s, z_used, m, P):
    """The memory (a dict) of a window that starts at its newest node.

    Args:
        window: The rhe.Window.
        memory: {name: expression} so far.
        s: (n_s,) where it starts.
        z_used: (n_z,) the only measurement.
        m: (n_s,) mean of the arrival cost.
        P: (n_s, n_s) its covariance.
    """
    N = window.N
    return memory | dict(
        s=ca.repmat(s, 1, N + 1),
        v=ca.repmat(memory["v"][:, N - 1], 1, N),
        z=ca.horzcat(ca.SX.nan(z_used.numel(), N), z_used),
        age=0,
        m=m,
        P=P,
    )


# The noise of the window's nodes, which is remembered.


def _of_window(name):
    """The memory's name of a noise whose columns are those of the nodes."""
    return f"{name}_window"


def noise_memory(window):
    """{name: shape} of the noises that differ by node, as the memory has them."""
    return {_of_window(name): window.noises[name] for name in window.by_node}


def first_noise(window):
    """{name: array} of `noise_memory` before the first sample: no noise."""

    return {name: np.zeros(shape) for name, shape in noise_memory(window).items()}


def whole_noise(window, values):
    """{name: columns of all nodes} of the noises that differ by node, the newest as it is used."""
    return {
        name: ca.horzcat(values[_of_window(name)][:, :-1], values[f"{name}_used"])
        for name in window.by_node
    }


# The phases


def _shapes(function, *without):
    """{name: sparsity} of a Function's inputs."""
    return {key: function.sparsity_in(key) for key in function.name_in() if key not in without}


def _wrap_shift(window, shift_of_rhe, memory, symbols):
    remembered = noise_memory(window)

    @casadi_function("guarded_shift", symbols, **_shapes(shift_of_rhe, *window.by_node), **memory)
    def shift(**inputs):
        noises = {name: inputs[_of_window(name)] for name in window.by_node}
        result = shift_of_rhe(**select_inputs(shift_of_rhe, inputs | noises))
        pieces = {name: inputs[name] for name in memory}
        for name in remembered:  # the newest column is not known before the feedback
            pieces[name] = ca.horzcat(inputs[name][:, 1:], inputs[name][:, -1])
        return result | pieces

    return shift


def _wrap_linearise(window, linearise_of_rhe, symbols):
    if not window.by_node:
        return linearise_of_rhe
    shapes = _shapes(linearise_of_rhe, *window.by_node) | noise_memory(window)

    @casadi_function("guarded_linearise", symbols, **shapes)
    def linearise(**inputs):
        noises = {name: inputs[_of_window(name)] for name in window.by_node}
        return linearise_of_rhe(**select_inputs(linearise_of_rhe, inputs | noises))

    return linearise


def _wrap_feedback(window, feedback_of_rhe, judge, symbols):
    function = judge.build(window)
    shapes = _shapes(feedback_of_rhe) | _shapes(function)
    # The process noise of the sample has the name of the one by which the arrival cost grows.
    if "Q" in shapes:
        shapes["W"] = shapes.pop("Q")

    @casadi_function("guarded_feedback", symbols, **shapes)
    def feedback(**inputs):
        given = inputs | (dict(Q=inputs["W"]) if window.noisy else {})
        verdict = function(**select_inputs(function, given))
        given["z_N"] = verdict["z_used"]
        given["P_N"] = verdict.pop("P_used", given["P_N"])
        given["m_N"] = verdict.pop("m_used", given["m_N"])
        used = {f"{name}_used": given[name] for name in window.by_node}
        if set(noise_memory(window)) <= given.keys():  # the feedback solves for all of the window
            noises = whole_noise(window, given | used)
            given |= {_of_window(name): noises[name] for name in noises}
        result = feedback_of_rhe(**select_inputs(feedback_of_rhe, given))
        concluded = judge.conclude(window, inputs, verdict, result)
        verdict.pop("agrees", None)
        return result | verdict | used | concluded

    return feedback


def _wrap_expand(window, expand_of_rhe, judge, symbols):
    restarted = judge.build_restarted(window)
    pieces = judge.memory(window)
    shapes = _shapes(expand_of_rhe, "z_N", *window.by_node) | noise_memory(window)
    shapes |= dict(z_used=expand_of_rhe.sparsity_in("z_N"), kept=(1, 1))
    shapes |= {f"{name}_used": window.noise[name] for name in window.by_node}
    shapes |= {f"{name}_after": shape for name, shape in pieces.items()}
    if restarted:
        shapes |= _shapes(restarted, "goes_on", *window.by_node, *shapes) | dict(restart=(1, 1))

    @casadi_function("guarded_expand", symbols, **shapes)
    def expand(**inputs):
        noises = whole_noise(window, inputs)
        values = inputs | noises | dict(z_N=inputs["z_used"], ok=inputs["kept"])
        result = expand_of_rhe(**select_inputs(expand_of_rhe, values))
        kkt = ca.if_else(inputs["ok"], result.pop("kkt"), ca.DM.nan())
        memory = result | {_of_window(name): noises[name] for name in noises}
        memory |= {name: inputs[f"{name}_after"] for name in pieces}
        if restarted:
            newest = {name: inputs[f"{name}_used"] for name in window.by_node}
            values = inputs | newest | memory | dict(goes_on=1 - inputs["restart"])
            memory |= restarted(**select_inputs(restarted, values))
        return memory | dict(kkt=kkt)

    return expand


def with_guard(window, phases, symbols):
    """The phases {shift, linearise, feedback, expand} of an RHE with the window's judge.

    Args:
        window: The rhe.Window.
        phases: Its phases, in which expand takes the noises of all nodes, feedback the newest ones.
        symbols: SX or MX, of the Functions that call others.
    """
    judge = window.judge or BELIEVER
    memory = noise_memory(window) | judge.memory(window)
    return dict(
        shift=_wrap_shift(window, phases["shift"], memory, symbols),
        linearise=_wrap_linearise(window, phases["linearise"], symbols),
        feedback=_wrap_feedback(window, phases["feedback"], judge, symbols),
        expand=_wrap_expand(window, phases["expand"], judge, symbols),
    )
