"""The paper's tracked robot: its Model, estimators and controller, its path, and its simulation."""
