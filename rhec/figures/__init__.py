"""The paper's figures, one function each; `style` gives them one look and saves them with their provenance."""

from .drawings import hardware_blocks, robot_in_row, robot_parts, schematic
from .results import (errors, estimates, kkt, scenario_a_table, scenario_b_table, slip_fields, speed, trajectories, trajectories_q, violations,
                      weight_sweep, yaw_rate)
from .style import save, save_table, styled
from .timing import phases

__all__ = ["errors", "estimates", "hardware_blocks", "kkt", "phases", "robot_in_row", "robot_parts", "save", "save_table", "scenario_a_table",
           "scenario_b_table", "schematic", "slip_fields", "speed", "styled", "trajectories", "trajectories_q", "violations", "weight_sweep",
           "yaw_rate"]
