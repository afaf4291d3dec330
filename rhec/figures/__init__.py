"""The paper's figures, one function each; `style` gives them one look and saves them with their provenance."""

from .drawings import hardware_blocks, robot_in_row, robot_parts, schematic
from .style import save, save_table, styled

__all__ = ["hardware_blocks", "robot_in_row", "robot_parts", "save", "save_table", "schematic", "styled"]
