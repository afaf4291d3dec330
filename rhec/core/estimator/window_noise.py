"""Process noise within the window of an RHE (weak-constraint moving horizon estimation).

The intervals of the window need not follow the model exactly:

    s_{i+1} = F(s_i, v_i) + w_i,  w_i ~ N(0, diag W_i)

The noise w (n_s,) is estimated like an input that is measured to be zero with the variances W. To
the phases of the RHE it is the end of v. W may differ by interval: the window remembers those of
its intervals, W_window, and feedback takes that of the newest one (`guard`). They are the W of
eq. (9): with it in the window, none is left to add to the arrival cost.
"""

import functools

import casadi as ca

from rhec.core.model import robot_model

# A state without noise has this variance: beside any other none, and its share of the cost is a
# number.
_NO_NOISE = 1e-30


class NoisyInterval(robot_model.Interval):
    """A shooting interval whose inputs v end with the process noise w (n_s,)."""

    def input_noise(self, z, v, V, c=None, *, W):
        """Mean and variances (n_v,) of inputs and noise; W (n_s,) are the noise's variances."""
        of_inputs = robot_model.Interval(*self)._replace(n_v=self.n_v - self.n_s)
        mean, variance = of_inputs.input_noise(z, v, V, c)
        motion_noise = self.motion_noise
        added = motion_noise.process(mean, W, None, c) if motion_noise else W
        none = ca.DM.zeros(self.n_s)
        return ca.vertcat(mean, none), ca.vertcat(variance, ca.fmax(added, _NO_NOISE))

    def process_noise(self, v, W, dt_s, c):
        """Variances (n_s,) of noise besides w: none."""
        return ca.DM.zeros(self.n_s)


@functools.cache
def noisy_interval(model, dt_s):
    """The NoisyInterval of a Model whose samples are dt_s [s] apart."""
    exact = robot_model.interval(model)
    s = ca.SX.sym("s", exact.n_s)
    v = ca.SX.sym("v", exact.n_v + exact.n_s)
    length_s = ca.SX.sym("dt_s")
    u = v[: exact.n_v]
    # An interval before the first sample has no length, and so no noise.
    counts = length_s > 0
    F, D, B = exact.linearised(s, u, length_s)
    B = ca.horzcat(B, counts * ca.SX.eye(exact.n_s))
    w = counts * v[exact.n_v :]
    inputs = [s, v, length_s]
    step = exact.step(s, u, length_s) + w
    noise = exact.motion_noise
    if noise:
        of_sample = noise.process
        noise = noise._replace(process=lambda v, W, _, c: of_sample(v, W, dt_s, c))
    changed = dict(
        step=ca.Function("noisy_interval", inputs, [step], {"cse": True}),
        linearised=ca.Function("noisy_linearised", inputs, [F + w, D, B], {"cse": True}),
        n_v=v.numel(),
        motion_noise=noise,
    )
    return NoisyInterval(**exact._asdict() | changed)
