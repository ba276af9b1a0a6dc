"""MuJoCo's constraint force as a pure function: minus the gradient of the cost, and safe where it is singular."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from jax.test_util import check_grads

from tog_mjx.stepping.constraints import Rows, constraint_force, residual, solution

# One equality, two friction losses, one limit, one elliptic contact of condim 3 and one of condim 6.
LOSSES, SIZE = 2, 1 + 2 + 1 + 3 + 6
D = np.array([2.0, 1.5, 0.5, 3.0, *([4.0] * 3), *([5.0] * 6)])
FRICTION = np.array([[0.7, 0.7, 0.1, 0.1, 0.1], [0.6, 0.5, 0.02, 0.01, 0.03]])
IMPRATIO = 2.0


def consistent_regulariser() -> np.ndarray:
    """D as MuJoCo makes it, so that the quadratic and the cone meet: D_i = impratio D_n (friction_i / friction_1)^2."""
    regulariser = D.copy()
    for start, condim, friction in ((4, 3, FRICTION[0]), (7, 6, FRICTION[1])):
        regulariser[start + 1 : start + condim] = D[start] * IMPRATIO * (friction[: condim - 1] / friction[0]) ** 2
    return regulariser


ROWS = Rows(
    jacobian=jnp.zeros((SIZE, 1)),
    reference=jnp.zeros(SIZE),
    D=jnp.array(consistent_regulariser()),
    friction_loss=jnp.array([0.0, 0.8, 0.3, *([0.0] * (SIZE - 3))]),
    friction=jnp.array(FRICTION),
    impratio=jnp.array(IMPRATIO),
    equalities=1,
    losses=LOSSES,
    elliptic=((3, 1), (6, 1)),
)


def cost(x: np.ndarray) -> float:
    """The solver's cost s(x) of MuJoCo's documentation, row by row."""
    d = np.asarray(ROWS.D)
    total = 0.5 * d[0] * x[0] ** 2
    for i in (1, 2):
        f = float(ROWS.friction_loss[i])
        total += 0.5 * d[i] * x[i] ** 2 if abs(x[i]) <= f / d[i] else f * (abs(x[i]) - 0.5 * f / d[i])
    total += 0.5 * d[3] * min(x[3], 0.0) ** 2
    for start, condim, friction in ((4, 3, FRICTION[0]), (7, 6, FRICTION[1])):
        mu = friction[0] / np.sqrt(IMPRATIO)
        rows = slice(start, start + condim)
        n, t = mu * x[start], np.linalg.norm(friction[: condim - 1] * x[start + 1 : start + condim])
        if mu * n + t <= 0:
            total += 0.5 * (d[rows] * x[rows] ** 2).sum()
        elif n < mu * t:
            total += 0.5 * d[start] / (mu**2 * (1 + mu**2)) * (n - mu * t) ** 2
    return total


@pytest.mark.parametrize("seed", range(20))
def test_the_force_is_minus_the_gradient_of_the_cost(seed):
    x = np.random.default_rng(seed).normal(size=SIZE)
    h = 1e-6
    gradient = [(cost(x + h * e) - cost(x - h * e)) / (2 * h) for e in np.eye(SIZE)]
    np.testing.assert_allclose(constraint_force(ROWS, jnp.array(x)), -np.array(gradient), atol=1e-6)


@pytest.mark.parametrize("seed", range(20))
def test_its_derivative_is_right_in_both_modes(seed):
    x = jnp.array(np.random.default_rng(seed).normal(size=SIZE))
    check_grads(lambda x: constraint_force(ROWS, jnp.asarray(x)), (x,), order=1, modes=["fwd", "rev"], eps=1e-6)


@given(st.lists(st.sampled_from([0.0, 1e-300, 1e-8, -1e-8, 1.0, -1.0]), min_size=SIZE, max_size=SIZE))
def test_its_derivative_is_finite_symmetric_and_negative_everywhere(values):
    jacobian = np.asarray(JACOBIAN(jnp.array(values)))
    assert np.isfinite(jacobian).all()
    np.testing.assert_allclose(jacobian, jacobian.T, atol=1e-6 * np.abs(jacobian).max())
    assert np.linalg.eigvalsh((jacobian + jacobian.T) / 2).max() <= 1e-6 * np.abs(jacobian).max()


JACOBIAN = jax.jit(jax.jacrev(lambda x: constraint_force(ROWS, x)))


def test_at_the_apex_and_at_zero_sliding_speed():
    # At the apex nothing pushes; the derivative is that of parting.
    np.testing.assert_array_equal(constraint_force(ROWS, jnp.zeros(SIZE))[4:], 0)
    np.testing.assert_array_equal(JACOBIAN(jnp.zeros(SIZE))[4:, 4:], 0)
    # Pressed without sliding, the contact is linear in all its rows.
    pressed = jnp.zeros(SIZE).at[4].set(-1.0)
    np.testing.assert_allclose(JACOBIAN(pressed)[4:7, 4:7], -jnp.diag(ROWS.D[4:7]))


def test_the_solution_is_the_minimum_of_the_cost():
    """From afar, across kinks of all kinds, against the cost as the documentation has it."""
    solve, numbers = jax.jit(jax.vmap(solution)), np.random.default_rng(1)
    many, size = 40, 5
    jacobian, reference = numbers.normal(size=(many, SIZE, size)), 2 * numbers.normal(size=(many, SIZE))
    root = numbers.normal(size=(many, size, size))
    mass, smooth = root @ root.swapaxes(1, 2) + np.eye(size), 3 * numbers.normal(size=(many, size))
    repeated = jax.tree.map(lambda x: jnp.broadcast_to(x, (many, *x.shape)), ROWS)
    rows = dataclasses.replace(repeated, jacobian=jnp.array(jacobian), reference=jnp.array(reference))
    starts = 5 * numbers.normal(size=(many, size))
    found = np.asarray(solve(jnp.array(starts), jnp.array(mass), jnp.array(smooth), rows))
    for q, J, a, M, f in zip(found, jacobian, reference, mass, smooth, strict=True):

        def total(q, J=J, a=a, M=M, f=f):
            return q @ M @ q / 2 - q @ f + cost(J @ q - a)

        h = 1e-5
        slopes = [(total(q + h * e) - total(q - h * e)) / (2 * h) for e in np.eye(size)]
        np.testing.assert_allclose(slopes, 0, atol=1e-3)  # Half of h times the jump of the cost's second derivative.
        assert min(total(q + 1e-3 * step) for step in numbers.normal(size=(20, size))) > total(q)
    residuals = jax.vmap(residual)(jnp.array(found), jnp.array(mass), jnp.array(smooth), rows)
    np.testing.assert_allclose(residuals, 0, atol=1e-9)
