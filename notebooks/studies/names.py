"""What tables, figures and sentences call the rules that pick W, and the patterns of turns."""

from rhec.tracked_robot import tuning

RULES = {  # {process_noise: "W ..."}
    "printed": "as printed",
    "consistent": "consistent",
    "prediction": "by prediction",
    "tracking": "by least tracking error",
    "soft_soil": "by prediction on soft soil",
}
TURNS = {  # {turns: "turns ..."}
    "alternate": "to alternate sides",
    "left": "to the left alone",
    "right": "to the right alone",
    "figure_of_eight": "in a figure of eight",
}


def noise_text(process_noise):
    """The rule that picked W of a drive, for a title."""
    return f"W {RULES[process_noise or tuning.DEFAULT_RULE]}"


def turns_text(turns):
    """Which way the path of a drive turns, for a title."""
    return f"turns {TURNS[turns]}"
