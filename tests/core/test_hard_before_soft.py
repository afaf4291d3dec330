"""A row without a price is dearer than all rows with one, whatever finite prices these have."""

import numpy as np
import pytest

import rhec

pytestmark = pytest.mark.usefixtures("virtual_machine")
CART = rhec.Model(
    states=("x", "v"),
    inputs=("u",),
    discrete=True,
    f=lambda x, u, p: [x[0] + 0.1 * x[1] + 0.005 * u[0], x[1] + 0.1 * u[0]],
)
PRICES = [dict(linear=price) for price in (1e2, 1e3, 1e4, 1e6)]
PRICES += [dict(quadratic=price) for price in (1e3, 1e6)]


@pytest.mark.parametrize("price", PRICES, ids=str)
@pytest.mark.parametrize("hard", ["change", "state"])
def test_a_hard_bound_that_can_be_kept_is_kept(hard, price):
    bounds = {"x": rhec.Bound(-np.inf, 0.5, **price), "u": (-1.0, 1.0)}
    changes = {"u": (-0.05, 0.05)} if hard == "change" else {}
    bounds |= {"v": (-0.3, 0.3)} if hard == "state" else {}
    rhc = rhec.RHC(
        model=CART, dt=0.1, horizon=15, bounds=bounds, q=(1.0, 0.1), r=(0.1,), delta_bounds=changes
    )
    rhc.step(x=(1.0, 0.0), p=(), x_ref=(0, 0), u_ref=(0,))
    assert rhc.ok, rhc.status
    if hard == "change":
        assert np.abs(np.diff(np.ravel(rhc.u_plan), prepend=0)).max() < 0.05 + 1e-6
    else:
        assert np.abs(rhc.x_plan[1]).max() < 0.3 + 1e-6


@pytest.mark.parametrize("width", [1e-3, 1e-5, 1e-6, 1e-7])
def test_a_command_in_a_narrow_band_away_from_the_first_plan(width):
    """The QP is solved; whatever the state does, the command is in its band."""
    bounds = {"u": (0.3, 0.3 + width), "v": (-5.0, 5.0)}
    rhc = rhec.RHC(model=CART, dt=0.1, horizon=15, bounds=bounds, q=(1.0, 0.1), r=(0.1,))
    rhc.step(x=(1.0, 0.0), x_ref=(0, 0), u_ref=(0,))
    assert rhc.ok, rhc.status
    np.testing.assert_allclose(rhc.u_plan, 0.3, rtol=0, atol=1.01 * width)
