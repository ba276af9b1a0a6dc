"""Differences against derivatives known in closed form."""

import numpy as np
import pytest

from tog_mjx.gradients.differences import halvings, settled_differences

POINTS = np.array([[0.3, -0.7], [1.1, 0.4]])


def smooth(x):
    return np.stack([np.sin(x[:, 0]) * x[:, 1], np.exp(x[:, 1]), x[:, 0] ** 3], axis=1)


def slopes(x):
    return np.array([[[np.cos(a) * b, np.sin(a)], [0, np.exp(b)], [3 * a**2, 0]] for a, b in x])


# Second order errs by h^2 and fourth by h^4; rounding by 1e-16 / h.
@pytest.mark.parametrize(("order", "first", "error"), [(2, 1e-4, 1e-9), (4, 1e-2, 1e-11)])
def test_a_smooth_function(order, first, error):
    found = settled_differences(smooth, POINTS, halvings(first, 6), order)
    np.testing.assert_allclose(found.jacobian, slopes(POINTS), rtol=0, atol=error)
    assert (found.change < 10 * error).all()


def test_a_jump_nearby_is_stepped_around():
    def jumping(x):
        return np.where(x > 1e-5, 1.0, 0.0) + 3 * x

    found = settled_differences(jumping, np.array([[0.0]]), halvings(1e-4, 8))
    np.testing.assert_allclose(found.jacobian, 3, rtol=1e-8)
    assert found.change < 1e-8
    astride = settled_differences(jumping, np.array([[1e-5]]), halvings(1e-4, 8))
    assert astride.change > 0.1


def test_a_constant_has_settled():
    found = settled_differences(np.ones_like, POINTS, halvings(1e-4, 3))
    np.testing.assert_array_equal(found.jacobian, 0)
    np.testing.assert_array_equal(found.change, 0)
