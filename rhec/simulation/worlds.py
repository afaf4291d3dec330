"""Named worlds: soil, ground, sensors and speed of a Scenario, by the names of its fields."""

from rhec import paper
from rhec.simulation.scenario import Scenario

_FORMER = dict(
    speed_mps=paper.SPEED_MPS,
    mu_mean=0.9,
    mu_deviation=0.04,
    kappa_mean=0.8,
    kappa_deviation=0.08,
    correlation_length_m=4.0,
    soil_under="centre",
    slip_difference=0.0,
    gnss_sigma_m=paper.SIGMA_V[0],
    gnss_slow_share=0.0,
    gnss_slow_time_s=60.0,
    encoder_sigma_mps=paper.ENCODER_SIGMA_MPS,
    speed_sigma_mps=paper.SIGMA_V[2],
    bump_sigma_radps=0.02,
    rut_length_m=0.0,
    track_width_m=paper.TRACK_WIDTH_M,
    rotation_centre_m=0.0,
)

# "default": what a Scenario has where nothing is said. "former": the default until version 0.2, the
# paper's robot on soil that slips alike below both tracks, with white errors of the position. For
# example `Scenario(**WORLDS["former"], seed=3)`. docs/world.md has the source of each value.
WORLDS: dict[str, dict] = {
    "default": {name: getattr(Scenario, name) for name in _FORMER},
    "former": _FORMER,
}
