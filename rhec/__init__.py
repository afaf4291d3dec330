"""rhec: receding horizon estimation and control of a tracked field robot with unknown traction.

A workbench around one paper: Kayacan, Young, Peschel, Chowdhary, "High-Precision Control of Tracked Field Robots in the Presence
of Unknown Traction Coefficients" (2018). The names below are the whole public face.
"""

import importlib

__version__ = "0.1.0"

# Loaded on first use, so that a program pays only for what it uses.
_HOME = {
    "Scenario": "closed_loop", "Run": "closed_loop", "simulate": "closed_loop",
    "RHC": "rhc", "RHE": "rhe", "Terrain": "terrain", "Path": "path", "campaign": "campaigns", "Fault": "faults", "replay": "replays",
    "Explorer": "figures.explorer", "export": "embedded",
}
__all__ = sorted(_HOME)


def __getattr__(name):
    if name in _HOME:
        return getattr(importlib.import_module(f"rhec.{_HOME[name]}"), name)
    raise AttributeError(f"module 'rhec' has no attribute {name!r}")


def __dir__():
    return sorted([*globals(), *__all__])
