"""The looks of the verdicts: what the cards of the claims have as colour and sign."""

from notebooks.claims.summary import DEPARTURE, PRINTED, class_of
from notebooks.studies.statistics import FAILS, HOLDS, LOST, POSSIBLE, UNDECIDED, UNTESTABLE
from rhec import style

_PARTLY = "holds as printed or with a departure"
# {kind of verdict: its colour and its sign}
LOOKS = {
    HOLDS: (style.GREEN, "✓"),
    _PARTLY: (style.BLUE, "±"),
    POSSIBLE: (style.SKY, "≈"),
    FAILS: (style.VERMILLION, "×"),
    LOST: (style.PURPLE, "∅"),
    UNDECIDED: (style.ORANGE, "?"),
    UNTESTABLE: (style.GREY, "–"),
}


def kind_of(verdict):
    """The kind of a verdict, a key of LOOKS: its class, with both classes of readings as one."""
    found = class_of(verdict)
    return _PARTLY if found in (PRINTED, DEPARTURE) else found
