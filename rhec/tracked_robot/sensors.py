"""The robot's Model by its speed model, with a gyro and a heading as further outputs.

Only the speed model "parameter" without sensors is in the paper.

The gyro measures s θ̇ + β with a scale s and a bias β, two bounded parameters that are estimated.
Its noise has a constant part, and with the speed model "slipping" one in proportion to the yaw
rate, for errors of its axis and its timing. The heading, as of two GNSS antennas, measures θ up to
full turns.
"""

import functools

import casadi as ca

from rhec.core.model.robot_model import Model, MotionNoise
from rhec.tracked_robot import tuning
from rhec.tracked_robot.kinematics import DRIFTING_SPEED_MODELS, SPEED_MODELS, SpeedModel

# The outputs of the sensors, in the order in which they follow (x, y, ν, ω).
OUTPUTS = {"gyro": "gyro_radps", "heading": "heading_rad"}
_LIMITS = {"gyro": 100.0, "heading": 1e8}
# Parameters of the gyro with their bounds.
GYRO = {"gyro_bias_radps": (-0.2, 0.2), "gyro_scale": (0.8, 1.25)}
GYRO_GUESS = {"gyro_bias_radps": 0.0, "gyro_scale": 1.0}
_ERROR = "gyro_error_radps"


def refuse_drift_with(speed_model):
    """Refuse a speed model that has no yaw drift."""
    if speed_model not in DRIFTING_SPEED_MODELS:
        expected = f"with yaw_drift it should be one of {tuple(DRIFTING_SPEED_MODELS)}"
        raise ValueError(f"speed_model was {speed_model!r}; {expected}")


@functools.cache
def speed_model_of(name, sensors=(), yaw_drift=False):
    """The SpeedModel of a Scenario's `speed_model`, `sensors` and `yaw_drift`.

    `sensors` is a tuple of names of OUTPUTS.
    """
    if yaw_drift:
        speed_model = DRIFTING_SPEED_MODELS[name]
    elif name == "slipping":
        # Imported here, because it is not in the paper: most runs do without it.
        from rhec.tracked_robot.slipping import SLIPPING as speed_model
    else:
        speed_model = SPEED_MODELS[name]
    return _with_sensors(speed_model, sensors) if sensors else speed_model


def _with_sensors(speed_model, sensors):
    """The SpeedModel whose Model has these sensors, too."""
    base = speed_model.model
    has_gyro = "gyro" in sensors
    n_u = len(base.inputs)
    names = [*base.parameters]
    n_fixed = names.index("mu")  # from μ on they stay the last ones
    n_last = len(names) - n_fixed
    bounds = {name: base.parameters[name] for name in names[:n_fixed]}
    bounds |= GYRO if has_gyro else {}
    bounds |= {name: base.parameters[name] for name in names[n_fixed:]}
    has_error = has_gyro and base.motion_noise is not None

    def own(p):
        """The parameters of the Model without sensors."""
        return ca.vertcat(p[:n_fixed], p[-n_last:])

    def f(x, u, p):
        return base.dynamics(x, u[:n_u], own(p))

    def h(x, u, p):
        outputs = [base.measurement(x, u[:n_u], own(p))]
        if has_gyro:
            error = u[n_u] if has_error else 0
            outputs.append(p[n_fixed + 1] * f(x, u, p)[2] + p[n_fixed] + error)
        if "heading" in sensors:
            outputs.append(x[2])
        return ca.vertcat(*outputs)

    model = Model(
        states=base.states,
        inputs=(*base.inputs, _ERROR) if has_error else base.inputs,
        parameters=bounds,
        outputs=(*base.outputs, *(OUTPUTS[sensor] for sensor in OUTPUTS if sensor in sensors)),
        f=f,
        h=h,
        max_measurement=(*base.limits, *(_LIMITS[name] for name in OUTPUTS if name in sensors)),
        angles=(OUTPUTS["heading"],) if "heading" in sensors else (),
        sigma_held=base.sigma_held,
        motion_noise=_with_gyro_noise(base) if has_error else base.motion_noise,
    )
    return SpeedModel(model, speed_model.noise)


def _with_gyro_noise(base):
    """The MotionNoise of a Model, and that of its gyro: share · ω, and a walk of the bias."""
    of_base = base.motion_noise
    n_c = len(of_base.constants)
    n_u = len(base.inputs)
    omega = base.inputs.index("omega_radps")

    def inputs(u, R, c):
        mean, variances = of_base.inputs(u[:n_u], R[:n_u], c[:n_c])
        return ca.vertcat(mean, 0), ca.vertcat(variances, (c[n_c] * u[omega]) ** 2 + _LEAST)

    def process(u, W, dt_s, c):
        noise = of_base.process(u[:n_u], W, dt_s, c[:n_c])
        bias = W.numel() - len(GYRO) - 2
        walk = c[n_c + 1] ** 2 * dt_s
        return ca.vertcat(noise[:bias], walk, noise[bias + 1 :])

    return MotionNoise(of_base.constants | tuning.GYRO, inputs, process)


_LEAST = 1e-12  # variance of the gyro's error of a robot that does not turn, besides σ²
