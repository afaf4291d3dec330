"""Moving horizon estimation and model predictive control of any robot that a Model describes."""
