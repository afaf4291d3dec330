"""rhec: receding horizon estimation and control of a tracked field robot with unknown traction.

The robot of one paper: Kayacan, Young, Peschel, Chowdhary, "High-Precision Control of Tracked Field
Robots in the Presence of Unknown Traction Coefficients" (2018), and a thin core of moving horizon
estimation (MHE) and model predictive control (MPC) for any robot.

One run          Scenario, simulate, Run               The world    Path, Terrain, Fault, WORLDS
Parts of a run   Estimator, Controller
Many runs        campaign                              Any robot    Model, RHE, RHC, EKF, Bound
A recorded log   log, doctor, calibrate, replay        Its path     PathTracker
On a robot       export                                In Jupyter   Explorer
"""

from importlib import import_module as _import_module
from typing import TYPE_CHECKING

from rhec.version import __version__ as __version__

if TYPE_CHECKING:
    from rhec import logs as logs
    from rhec.any_robot import RHC as RHC
    from rhec.any_robot import RHE as RHE
    from rhec.core.controller.bounds import Bound as Bound
    from rhec.core.estimator.ekf import EKF as EKF
    from rhec.core.model.robot_model import Model as Model
    from rhec.embedded import export as export
    from rhec.explorer.explorer import Explorer as Explorer
    from rhec.logs.calibration import calibrate as calibrate
    from rhec.logs.checks import doctor as doctor
    from rhec.logs.replay import replay as replay
    from rhec.logs.summary import log as log
    from rhec.simulation.campaigns.campaign import campaign as campaign
    from rhec.simulation.controller import Controller as Controller
    from rhec.simulation.faults import Fault as Fault
    from rhec.simulation.run import Run as Run
    from rhec.simulation.scenario import Scenario as Scenario
    from rhec.simulation.simulate import simulate as simulate
    from rhec.simulation.worlds import WORLDS as WORLDS
    from rhec.tracked_robot.own_estimator import Estimator as Estimator
    from rhec.tracked_robot.path import Path as Path
    from rhec.tracked_robot.references import PathTracker as PathTracker
    from rhec.tracked_robot.terrain import Terrain as Terrain

# Loaded on first use, so that a program pays only for what it uses.
_HOME = {
    "Bound": "core.controller.bounds",
    "Controller": "simulation.controller",
    "EKF": "core.estimator.ekf",
    "Estimator": "tracked_robot.own_estimator",
    "Explorer": "explorer.explorer",
    "Fault": "simulation.faults",
    "Model": "core.model.robot_model",
    "Path": "tracked_robot.path",
    "PathTracker": "tracked_robot.references",
    "RHC": "any_robot",
    "RHE": "any_robot",
    "Run": "simulation.run",
    "Scenario": "simulation.scenario",
    "Terrain": "tracked_robot.terrain",
    "WORLDS": "simulation.worlds",
    "calibrate": "logs.calibration",
    "campaign": "simulation.campaigns.campaign",
    "doctor": "logs.checks",
    "export": "embedded",
    "log": "logs.summary",
    "logs": "logs",  # a module, shown whole
    "replay": "logs.replay",
    "simulate": "simulation.simulate",
}
__all__ = sorted(_HOME)


def __getattr__(name):
    if name not in _HOME:
        raise AttributeError(f"module 'rhec' has no attribute {name!r}")
    home = _import_module(f"rhec.{_HOME[name]}")
    found = home if _HOME[name] == name else getattr(home, name)
    globals()[name] = found  # the next time nobody asks here
    return found


def __dir__():
    return sorted([*__all__, *(name for name in globals() if name.startswith("__"))])
