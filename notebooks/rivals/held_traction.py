"""An RHE that is told the traction, or takes μ = κ = 1, shows what estimating it is worth.

Here (μ, κ) are inputs that are measured almost exactly.
"""

import dataclasses
import functools

import casadi as ca
import numpy as np

import rhec
from notebooks.rivals.noises import NOISES
from rhec import paper
from rhec.core._casadi.packing import pack_array
from rhec.core.estimator import rhe as core_rhe
from rhec.core.model.robot_model import Model
from rhec.tracked_robot import paper_rhe
from rhec.tracked_robot.estimator_record import TOLD as SHAPES
from rhec.tracked_robot.kinematics import QUANTITIES, SPEED_MODELS, YAW_DRIFT, f, f_with_drift

TOLD = dict(rhe_fixed_traction=("mean_traction",), rhe_no_slip=(), rhe_no_slip_yaw_drift=())
_SIGMA_HELD = 1e-6
_HELD = Model(
    states=QUANTITIES[:3],
    inputs=("omega_radps", "mu", "kappa"),
    parameters={"nu_mps": None},
    outputs=("x_m", "y_m", "nu_mps", "omega_radps", "mu", "kappa"),
    f=lambda xi, u, p: f(xi, u[0], ca.vertcat(p, u[1:])),
    max_measurement=(*SPEED_MODELS["parameter"].model.limits, 2.0, 2.0),
)
_HELD_DRIFTING = dataclasses.replace(
    _HELD,
    parameters=_HELD.parameters | {YAW_DRIFT: None},
    f=lambda xi, u, p: f_with_drift(xi, u[0], ca.vertcat(p[0], u[1:], p[1])),
)


@functools.cache
def rival(name, horizon=paper.HORIZON, arrival_mean="filtered"):
    """The RHE as a rhec.Estimator, by a name in TOLD."""
    has_drift = name.endswith("yaw_drift")
    model = _HELD_DRIFTING if has_drift else _HELD
    quantities = (*QUANTITIES, YAW_DRIFT) if has_drift else QUANTITIES
    window = core_rhe.Window(
        model, paper.DT_S, horizon, arrival_mean, paper_rhe.JUDGE, quantities=quantities
    )
    return rhec.Estimator(
        _build_step(name, window, TOLD[name]),
        first=_first(window),
        states=model.joint_names,
        noises=NOISES[name],
    )


def _build_step(name, window, told):
    """The step of the RHE, with the traction appended to the measurements."""
    model = window.model
    step = core_rhe.build_phases(window)["step"]
    if YAW_DRIFT in model.names:
        step = paper_rhe.with_drift_apart(step)
    inputs = dict(memory=ca.MX.sym("memory", step.size1_in("memory")))
    inputs |= dict(z_N=ca.MX.sym("z_N", 4), V=ca.MX.sym("V", 4), W=ca.MX.sym("W", model.n_s))
    inputs |= {signal: ca.MX.sym(signal, *SHAPES[signal]) for signal in told}
    traction = ca.vertcat(*(inputs[signal] for signal in told)) if told else ca.DM.ones(2)
    values = inputs | dict(
        z_N=ca.vertcat(inputs["z_N"], traction),
        V=ca.vertcat(inputs["V"], *[_SIGMA_HELD**2] * 2),
        P_0=np.square([paper_rhe.SIGMA_START[state] for state in model.joint_names]),
        m_0=np.zeros(model.n_s),
    )
    results = step.call([values[place] for place in step.name_in()])
    options = {"allow_duplicate_io_names": True}
    return ca.Function(name, [*inputs.values()], results, [*inputs], step.name_out(), options)


def _first(window):
    """The Function (guess, sigma) -> first memory, which is affine in guess and sigma²."""
    names = (*QUANTITIES, YAW_DRIFT)
    n_known = len(QUANTITIES)
    n = len(names)

    def memory(both):
        guess, sigma = (dict(zip(names, part)) for part in np.split(both, 2))
        return pack_array(paper_rhe.init(window, guess, sigma))

    constant = memory(np.zeros(2 * n))
    # Missing measurements are NaN for any guess, so that their slope is 0.
    slopes = np.nan_to_num(np.column_stack([memory(unit) - constant for unit in np.eye(2 * n)]))
    guess = ca.SX.sym("guess", n_known)
    sigma = ca.SX.sym("sigma", n)
    # The first guess of the yaw drift is 0.
    known = ca.vertcat(guess, 0, sigma**2)
    first = ca.DM(constant) + ca.sparsify(ca.DM(slopes)) @ known
    names = ["guess", "sigma"], ["memory"]
    return ca.Function("first", [guess, sigma], [ca.densify(first)], *names)
