"""The paper's RHE that is told a robot turned round, as absurd measurements can turn it."""

import numpy as np
import pytest
from guard_table import model_of
from oracles import drive

import rhec
from rhec import paper
from rhec.core.estimator import half_turn

SAMPLES = 120
LENGTH = 15 + 2  # windows in a row that have no single sample in common


def followed(turned_rad, process_noise="printed", seed=0, spoil=None):
    """Errors of position (n,) and yaw (n,), and `ok` (n,), of an RHE that starts turned."""
    rates = 0.1 * np.sin(0.1 * np.arange(SAMPLES))
    truth, z = drive((0.0, 0.0, 0.3, 0.5, 0.9, 0.8), rates)
    z = z + np.random.default_rng(seed).normal(0.0, paper.SIGMA_V, z.shape)
    if spoil:
        spoil(z)
    guess = (0.0, 0.0, 0.3 + turned_rad, 0.5, 1.0, 1.0)
    rhe = rhec.RHE(guess=guess, process_noise=process_noise, sigma_v=paper.SIGMA_V)
    estimates, ok = [], []
    for row in z:
        rhe.prepare()
        estimates.append(rhe.feedback(row)[:3])
        ok.append(rhe.ok)
    error = np.array(estimates) - truth[:, :3]
    return np.hypot(*error[:, :2].T), np.angle(np.exp(1j * error[:, 2])), np.array(ok)


@pytest.mark.parametrize("process_noise", ["printed", "prediction"])
@pytest.mark.parametrize("turned_rad", [*np.arange(-3.0, 3.1, 0.5), 2.9, np.pi, -2.9, 3 * np.pi])
def test_an_rhe_that_is_turned_comes_back_and_is_not_lost_without_saying_so(
    turned_rad, process_noise
):
    error, yaw, ok = followed(turned_rad, process_noise)
    assert error[ok].max() < 0.5
    late = slice(3 * LENGTH, None)
    assert ok[late].all() and error[late].max() < 0.2 and np.abs(yaw[late]).max() < 0.5


@pytest.mark.parametrize("seed", range(6))
def test_one_that_is_not_turned_is_never_told_so(seed):
    error, _, ok = followed(0.0, seed=seed)
    assert ok.all() and error.max() < 0.2


@pytest.mark.parametrize("speed_mps", [-90.0, -8.0])
def test_speeds_that_were_measured_wildly_turn_nothing(speed_mps):
    """As long as the window holds one the robot seems to go the other way. Such a time does not
    count any more once a full window was good, so that two of them turn nothing, either.
    """

    def spoil(z):
        z[[40, 80], 2] = speed_mps

    _, yaw, ok = followed(0.0, spoil=spoil)
    assert np.abs(yaw[20:]).max() < np.pi / 2
    assert ok[40 + LENGTH + 2 : 80].all() and ok[80 + LENGTH + 2 :].all()


@pytest.mark.parametrize("robot, parameter", [("unicycle", "mu"), ("bicycle", None)])
def test_the_parameter_that_changes_sign_with_half_a_turn_is_found(robot, parameter):
    """Of a Model that names its heading; the unicycle drives by μν in its direction."""
    assert half_turn.of_model(model_of(robot)).parameter == parameter
