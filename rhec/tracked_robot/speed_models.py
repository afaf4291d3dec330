"""The robot's Model by its speed model, with the sensors of `sensors.SENSORS` as further outputs.

Only the speed model "parameter" without sensors is in the paper.
"""

import functools

import casadi as ca

from rhec.core.model.robot_model import Model, MotionNoise
from rhec.tracked_robot.kinematics import DRIFTING_SPEED_MODELS, SPEED_MODELS, SpeedModel
from rhec.tracked_robot.sensors import YAW, records

_LEAST = 1e-12  # variance of a sensor's error in proportion to ω of a robot that does not turn


def refuse_drift_with(speed_model):
    """Refuse a speed model that has no yaw drift."""
    if speed_model not in DRIFTING_SPEED_MODELS:
        expected = f"with yaw_drift it should be one of {tuple(DRIFTING_SPEED_MODELS)}"
        raise ValueError(f"speed_model was {speed_model!r}; {expected}")


@functools.cache
def speed_model_of(name, sensors=(), yaw_drift=False):
    """The SpeedModel of a Scenario's `speed_model`, `sensors` and `yaw_drift`."""
    if yaw_drift:
        speed_model = DRIFTING_SPEED_MODELS[name]
    elif name == "slipping":
        # Imported here, because it is not in the paper: most runs do without it.
        from rhec.tracked_robot.slipping import SLIPPING as speed_model
    else:
        speed_model = SPEED_MODELS[name]
    return _with_sensors(speed_model, records(sensors)) if sensors else speed_model


def _with_sensors(speed_model, sensors):
    """The SpeedModel whose Model has these Sensors, too."""
    base = speed_model.model
    n_u = len(base.inputs)
    names = [*base.parameters]
    n_fixed = names.index("mu")  # from μ on they stay the last ones
    n_last = len(names) - n_fixed
    bounds = {name: base.parameters[name] for name in names[:n_fixed]}
    bounds |= {unknown.name: unknown.bounds for of in sensors for unknown in of.unknowns}
    bounds |= {name: base.parameters[name] for name in names[n_fixed:]}
    inputs = (*base.inputs, *_errors(base, sensors))
    known = (*base.states, *inputs, *bounds)

    def own(p):
        """The parameters of the Model without sensors."""
        return ca.vertcat(p[:n_fixed], p[-n_last:])

    def f(x, u, p):
        return base.dynamics(x, u[:n_u], own(p))

    def h(x, u, p):
        values = dict(zip(known, ca.vertsplit(ca.vertcat(x, u, p))))
        slopes = dict(zip(base.states, ca.vertsplit(f(x, u, p))))
        measured = (sensor.h(values, slopes) for sensor in sensors)
        return ca.vertcat(base.measurement(x, u[:n_u], own(p)), *measured)

    model = Model(
        states=base.states,
        inputs=inputs,
        parameters=bounds,
        outputs=(*base.outputs, *(sensor.output for sensor in sensors)),
        f=f,
        h=h,
        max_measurement=(*base.limits, *(sensor.limit for sensor in sensors)),
        angles=tuple(sensor.output for sensor in sensors if sensor.measures == YAW),
        sigma_held=base.sigma_held,
        motion_noise=base.motion_noise and _with_noise_of(sensors, base, n_last),
    )
    return SpeedModel(model, speed_model.noise)


def _errors(base, sensors):
    """{input: name of its constant} of the errors in proportion to ω that a Model has as inputs."""
    if not base.motion_noise:
        return {}
    return {sensor.error: f"{sensor.name}_share" for sensor in sensors if sensor.error}


def constants_of(sensor, sigma):
    """The constants of the MotionNoise of a Sensor with these standard deviations of its noise."""
    shares = {f"{sensor.name}_share": sigma[1]} if sensor.error else {}
    return shares | {f"{of.name}_walk": of.walk for of in sensor.unknowns if of.walk}


def _with_noise_of(sensors, base, n_last):
    """The MotionNoise of a Model and of Sensors: errors share · ω, and walks of their unknowns.

    The last n_last entries of the Model's joint state stay the last ones.
    """
    of_base = base.motion_noise
    n_c = len(of_base.constants)
    n_u = len(base.inputs)
    omega = base.inputs.index("omega_radps")
    constants = dict(of_base.constants)
    for sensor in sensors:
        constants |= constants_of(sensor, [entry.default for entry in sensor.noise])
    place = [*constants].index
    shares = _errors(base, sensors).values()
    unknowns = [unknown for sensor in sensors for unknown in sensor.unknowns]

    def inputs(u, R, c):
        mean, variances = of_base.inputs(u[:n_u], R[:n_u], c[:n_c])
        errors = [(c[place(share)] * u[omega]) ** 2 + _LEAST for share in shares]
        return ca.vertcat(mean, *[0 for _ in errors]), ca.vertcat(variances, *errors)

    def process(u, W, dt_s, c):
        noise = ca.vertsplit(of_base.process(u[:n_u], W, dt_s, c[:n_c]))
        first = len(noise) - n_last - len(unknowns)
        for row, unknown in enumerate(unknowns, first):
            if unknown.walk:
                noise[row] = c[place(f"{unknown.name}_walk")] ** 2 * dt_s
        return ca.vertcat(*noise)

    return MotionNoise(constants, inputs, process)
