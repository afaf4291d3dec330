"""The window that `suggest_window` suggests: near the best one, and from both sides."""

import numpy as np
import pytest
from helpers import model
from robots import CART, DT, SKID_STEERED

import rhec
from rhec.workbench.studies import window_length

DRIVE = np.sin(0.3 * np.arange(120))[:, None]


def suggested(**changes):
    options = dict(model=model(CART), u=DRIVE, dt=DT, guess=(0.0, 0.0, 0.1)) | CART.estimator
    return rhec.suggest_window(**options | changes)


@pytest.mark.parametrize("name", ["pendulum", "skid-steered robot"])
def test_its_error_is_within_5_percent_of_the_best(name, virtual_machine):
    """Three drives of each; some of the other lengths are worse than that."""
    table = window_length.table(name, (2, 8, 28), range(3))
    assert table.excess[table.suggested].item() <= 0.05 < table.excess.max()


def test_many_precise_sensors_need_a_shorter_window_than_few_noisy_ones():
    lengths = [suggested(sigma_v=(sigma, 0.2)) for sigma in (0.005, 0.05, 0.5)]
    assert lengths == sorted(lengths) and lengths[0] < lengths[-1]


def test_more_process_noise_makes_it_shorter():
    lengths = [suggested(sigma_w=tuple(k * np.array(CART.sigma_w))) for k in (0.3, 1, 10)]
    assert lengths == sorted(lengths, reverse=True) and lengths[0] > lengths[-1]


def test_noise_in_the_window_is_not_neglected():
    """So the suggestion is not shorter; and without process noise it is the same."""
    assert suggested(noise_in_window=True) >= suggested()
    exact = dict(sigma_w=(0.0, 0.0, 0.0))
    assert suggested(**exact, noise_in_window=True) == suggested(**exact)


def test_it_is_at_most_half_of_the_drive():
    assert suggested(u=DRIVE[:10], sigma_v=(5.0, 0.2)) <= 5


@pytest.mark.parametrize(
    "changes, sentence",
    [
        (dict(u=DRIVE[:3]), "u had shape"),
        (dict(u=np.zeros((50, 2))), "u had shape"),
        (dict(sigma_v=(0.1,)), "sigma_v was"),
        (dict(dt=0), "dt was"),
        (dict(guess=(0.0,)), "guess was"),
    ],
)
def test_bad_arguments_are_refused_in_one_sentence(changes, sentence):
    with pytest.raises(ValueError, match=f"^{sentence} [^\n]*$"):
        suggested(**changes)


def test_a_model_with_held_inputs_and_bounds():
    options = dict(model=model(SKID_STEERED), dt=DT, guess=(0.0, 0.0, 0.0, 0.1, 0.1))
    options |= SKID_STEERED.estimator
    assert 2 <= rhec.suggest_window(**options, u=np.full((40, 2), 0.5)) <= 20
