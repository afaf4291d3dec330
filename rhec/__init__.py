"""rhec: receding horizon estimation and control of a tracked field robot with unknown traction.

A workbench around one paper: Kayacan, Young, Peschel, Chowdhary, "High-Precision Control of Tracked
Field Robots in the Presence of Unknown Traction Coefficients" (2018). The names below are the whole
public face.
"""

import importlib

__version__ = "0.2.0"

# Loaded on first use, so that a program pays only for what it uses.
_HOME = {
    "Scenario": "scenario",
    "Run": "simulation",
    "simulate": "simulation",
    "RHC": "controller.rhc",
    "RHE": "estimator.rhe",
    "Terrain": "model.terrain",
    "Path": "model.path",
    "campaign": "campaigns.campaign",
    "Fault": "extensions.faults",
    "replay": "logs.replay",
    "Explorer": "workbench.explorer.explorer",
    "export": "codegen",
}
__all__ = sorted(_HOME)


def __getattr__(name):
    if name in _HOME:
        return getattr(importlib.import_module(f"rhec.{_HOME[name]}"), name)
    raise AttributeError(f"module 'rhec' has no attribute {name!r}")


def __dir__():
    return sorted([*globals(), *__all__])
