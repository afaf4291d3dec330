"""The registry of speed models: how the speed ν of the tracks enters the robot's model."""

from rhec.tracked_robot import kinematics, slipping

SPEED_MODELS = kinematics.SPEED_MODELS | {"slipping": slipping.SLIPPING}


def speed_model_of(name):
    """Look up the SpeedModel of a Scenario's `speed_model`."""
    return SPEED_MODELS[name]
