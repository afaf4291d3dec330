"""The registry of speed models: how the speed ν of the tracks enters the robot's model."""

from rhec.tracked_robot.kinematics import SPEED_MODELS


def speed_model_of(name):
    """Look up the SpeedModel of a Scenario's `speed_model`."""
    if name == "slipping":
        # Imported here, because it is not in the paper: most runs do without it.
        from rhec.tracked_robot.slipping import SLIPPING

        return SLIPPING
    return SPEED_MODELS[name]
