"""The paper's figures, one function each; `style` gives them one look and saves them with their
provenance.
"""

import importlib

# Loaded on first use, so that a notebook is made again only when a figure of its own changed.
_HOME = {
    name: module
    for module, names in {
        "any_robot": (
            "commands_and_bounds",
            "parameters_and_bounds",
            "positions",
            "solver_tolerances",
        ),
        "ranking": ("errors_over_sigma", "nees_over_time", "pose_noise", "ranked"),
        "claims": ("save_ledger", "verdicts"),
        "robot_drawings": ("hardware_blocks", "robot_in_row", "robot_parts", "schematic"),
        "faults": ("fault_family",),
        "multiverse": ("multiverse_map",),
        "interpretations": ("ekf_yaw", "forest", "likelihood", "rhe_kappa"),
        "replay": (
            "replay_faults",
            "replay_folder",
            "replay_innovations",
            "replay_log",
            "replay_traction",
            "replay_trials",
            "replay_uncertainty",
            "replay_yaw",
        ),
        "scenarios": (
            "errors",
            "estimates",
            "kkt",
            "slip_fields",
            "speed",
            "trajectories",
            "trajectories_q",
            "violations",
            "weight_sweep",
            "yaw_rate",
        ),
        "style": ("save", "save_table", "styled"),
        "embedded": ("embedded_times",),
        "timing": ("phases",),
    }.items()
    for name in names
}
__all__ = sorted(_HOME)


def __getattr__(name):
    if name in _HOME:
        return getattr(importlib.import_module(f"{__name__}.{_HOME[name]}"), name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
