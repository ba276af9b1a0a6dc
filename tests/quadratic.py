"""A quadratic at a point, what estimates of its gradient there have as variance, and a jump: shared by tests.

A mean over KEYS independent estimates is held to SIGMAS standard errors of it, from the variance in closed form.
"""

import math

import jax
import jax.numpy as jnp
import numpy as np

A = jnp.array([[2.0, 0.5, 0.0], [0.5, 1.0, -0.7], [0.0, -0.7, 3.0]])
B = jnp.array([1.0, -3.0, 0.5])
AT = jnp.array([0.3, -0.2, 0.9])
SLOPE = A @ AT + B
N_VARIABLES = AT.size
FOURTH = float(jnp.trace(A) ** 2 + 2 * jnp.sum(A**2))
"""E (w^T A w)^2 / sigma^4."""
SIGMA = 0.4
SAMPLES = 8
KEYS = 20_000
SIGMAS = 5
KEY = jax.random.key(7)


def quadratic(u):
    return 0.5 * u @ A @ u + B @ u


def jump(u):
    return jnp.where(u[0] > 0, 1.0, 0.0)


def density(x):
    return math.exp(-(x**2) / 2) / math.sqrt(2 * math.pi)


COST = float(quadratic(AT))
FIRST = SIGMA**2 * float(jnp.sum(A**2))
ANTITHETIC = (N_VARIABLES + 1) * float(SLOPE @ SLOPE)
BASELINE = ANTITHETIC + SIGMA**2 * (N_VARIABLES + 4) * FOURTH / 4
PLAIN = BASELINE + N_VARIABLES * COST**2 / SIGMA**2 + (N_VARIABLES + 2) * COST * float(jnp.trace(A))
"""Traces of the covariance of one sample, of the quadratic at AT."""


def draw(estimate, u, keys=KEYS):
    """Estimates under many keys."""
    return jax.jit(jax.vmap(estimate, (0, None)))(jax.random.split(KEY, keys), u)[1]


def assert_mean(estimates, expected, variance):
    """`variance`: the trace of the covariance of one estimate, or a bound of it."""
    error = np.linalg.norm(estimates.mean(0) - expected)
    assert error < SIGMAS * math.sqrt(variance / len(estimates))
