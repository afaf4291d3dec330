"""W of the rivals by the rules of `Scenario.process_noise`, from tuned.csv beside this file."""

from pathlib import Path

from rhec import paper
from rhec.tracked_robot import tuning

FILE = Path(__file__).with_name("tuned.csv")
_WITHOUT_TRACTION = tuning.Noise(paper.SIGMA_W_RHE[:4], paper.SIGMA_V)
# The paper's, for a rival that has as many states as its RHE.
_PRINTED = {
    "rhe_fixed_traction": _WITHOUT_TRACTION,
    "rhe_no_slip": _WITHOUT_TRACTION,
    "augmented_ekf": tuning.Noise(paper.SIGMA_W_RHE, paper.SIGMA_V),
}
NOISES = tuning.read(FILE, _PRINTED)
