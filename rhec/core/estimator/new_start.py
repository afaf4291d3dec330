"""Where the window of an RHE starts anew: at its newest sample.

That sample is then the only one of the window, and its arrival cost is the prediction, with more
variance: that of the start, and y² in the direction of each output, for its innovation y; a state
that was less known then moves farther. Bounded parameters begin anew from their first guess, as a
wrong estimate may have driven them to a bound. A window that seems turned is turned (`half_turn`).

One Gauss-Newton step through a window that began far from the truth may lead anywhere. So until
some good samples followed each other the window has to settle: each sample is the only one of the
window, its arrival cost the prediction and process noise. That is an EKF. So it has to where the
step of a window led somewhere else than its solution leads (`innovation_gate`). The paper's RHE
does not settle.
"""

import casadi as ca

from rhec.core._casadi.build import casadi_function, short_cut
from rhec.core.model.limits import MAX_PLAUSIBLE_STATE, TINY, is_plausible

_MAX_VARIANCE = MAX_PLAUSIBLE_STATE / 2  # in the direction of an output


def build(window, outputs, where, after):
    """The Function (goes_on, …) -> memory of a window that restarts, unless it goes on.

    Nearly always it goes on. Then the prediction of the restart is not computed.

    Args:
        window: The rhe.Window.
        outputs: Those that are judged.
        where: (m, values) -> m, the mean (n_s,) of the arrival cost as the judge has it.
        after: {name: shape} of the judge's memory after the sample, which is among the values.
    """
    interval = window.interval
    shapes = window.prediction | window.noise | window.pieces._asdict() | after
    shapes |= dict.fromkeys(("s_restart", "m_0", "P_0"), (interval.n_s, 1))
    shapes |= dict(goes_on=(1, 1), z_used=(len(window.model.sampled), 1))
    if window.doubts_model:
        shapes |= dict(restart=(1, 1), m_alone=(interval.n_s, 1), W=(interval.n_s, 1))

    @short_cut("goes_on", window.symbols)
    @casadi_function("restarted", window.symbols, **shapes)
    def restarted(goes_on, B_N, v_N, m_N, P_N, s_restart, m_0, P_0, z_used, **values):
        memory = {name: values[name] for name in window.pieces._fields}
        noise = {name: values[name] for name in window.noise}
        s_N = s_restart
        s, _ = window.predict_input(B_N, s_N, P_N, v_N, z_used, **noise)
        y = innovation(outputs, z_used, s, s_N)
        m, P = anew(window, outputs, s_N, P_N, y, z_used, m_0, P_0)
        m = where(m, values)
        if window.doubts_model:
            added = interval.process_noise(v_N, values["W"], window.dt_s, noise.get("c"))
            m = ca.if_else(values["restart"], m, values["m_alone"])
            P = ca.if_else(values["restart"], P, P_N + ca.diag(added))
        m, P = window.predict_input(B_N, m, P, v_N, z_used, **noise)
        s = window.updated(m, P, v_N, z_used, s_N, **noise).m
        for place, (lower, upper) in interval.bounds.items():
            s[place] = ca.fmin(ca.fmax(s[place], lower), upper)
        N = window.N
        fresh = memory | dict(
            s=ca.repmat(s, 1, N + 1),
            v=ca.repmat(memory["v"][:, N - 1], 1, N),
            z=ca.horzcat(ca.repmat(interval.without_measurements(z_used), 1, N), z_used),
            age=0,
            m=m,
            P=P,
        )
        return {name: ca.if_else(goes_on, memory[name], fresh[name]) for name in memory}

    return restarted


def innovation(outputs, z, m, s_bar):
    """y (n_y,) of these outputs, given their prediction by m (n_s,); 0 where none was measured."""
    rows = [ca.if_else(each.is_valid(z), each.residual(z, m, s_bar), 0) for each in outputs]
    return ca.vertcat(ca.DM(0, 1), *rows)


def anew(window, outputs, s_N, P, y, z, m_0, P_0):
    """Mean and covariance of the newest node before its measurement, where the window restarts.

    Args:
        window: The rhe.Window.
        outputs: Those that are judged.
        s_N: (n_s,) the prediction.
        P: (n_s, n_s) its covariance.
        y: (n_y,) their innovation.
        z: (n_z,) the sample.
        m_0: (n_s,) first guess.
        P_0: (n_s,) its variances.
    """
    m = type(s_N)(s_N)
    P = type(P)(ca.densify(ca.if_else(is_plausible(P), P, 0)))
    for name, bounds in window.model.parameters.items():
        if bounds:
            place = window.model.joint_names.index(name)
            m[place] = m_0[place]
            P[place, :] = 0
            P[:, place] = 0
    away = ca.sum2(_moves(outputs, s_N, z, y, P_0) ** 2)
    return m, P + ca.diag(P_0 + ca.fmin(away, _MAX_VARIANCE))


def _moves(outputs, s_bar, z, y, P_0):
    """By how much the innovation y of each output moves the state, (n_s, n_y).

        P_0 H' y / (H P_0 H')

    Of all moves that explain y it is the shortest, measured in standard deviations of the start, so
    that the units of the states do not count.
    """
    columns = [ca.DM(s_bar.numel(), 0)]
    for k, output in enumerate(outputs):
        H = output.slope(s_bar, z).T
        way = ca.fmax(P_0, TINY**0.5) * H  # also where the start is known exactly
        columns.append(way / ca.fmax(ca.dot(H, way), TINY) * y[k])
    return ca.horzcat(*columns)


def fits(window, outputs, m, s_bar, z, y, P_0):
    """Whether what is measured lies within the bounds of states; a window cannot start beyond."""
    measured = m + ca.sum2(_moves(outputs, s_bar, z, y, P_0))
    fits = ca.SX(1)
    for name, (lower, upper) in (window.model.state_bounds or {}).items():
        place = window.model.joint_names.index(name)
        fits *= (lower <= measured[place]) * (measured[place] <= upper)
    return fits
