"""A motion of C MuJoCo as a JAX function, whose derivative is a sweep over the linearised steps.

JAX transposes the sweep, which makes it the adjoint one. Numbers are float64 inside, whatever the flag.
"""

import functools
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from tog_mjx.engines.c_mujoco import outside
from tog_mjx.engines.c_mujoco.forward import Forward
from tog_mjx.engines.c_mujoco.linearise import NO_SECOND, check_differences, slopes
from tog_mjx.running.errors import InputError


@functools.partial(jax.custom_jvp, nondiff_argnums=(0,))
def motion(forward: Forward, state: Float[Array, " s"], controls: Float[Array, "k nu"]) -> Float[Array, "k s"]:
    """The states after each of k steps, differentiable once, in both modes.

    Raises:
      InputError: where it is differentiated twice, or is one that MuJoCo does not linearise.
    """
    (steps, _), (size,) = controls.shape, state.shape

    def run(state: np.ndarray, controls: np.ndarray) -> list[np.ndarray]:
        return [forward.motions(state, controls)]

    return outside.call(run, forward.identity, [(steps, size)], state, controls)[0]


@motion.defjvp
def _(forward: Forward, primals: tuple[Array, Array], tangents: tuple[Array, Array]) -> tuple[Array, Array]:
    check_differences(forward.model)
    (state, controls), (moved, steered) = primals, tangents
    after = motion(forward, state, controls)
    before = jnp.concatenate([state[None], after[:-1]])
    last = int(forward.ends[-1])

    def push(moved: Array, step: tuple[Array, ...]) -> tuple[Array, Array]:
        of_state, of_controls, steered = step
        moved = of_state @ moved + of_controls @ steered
        return moved, moved

    _, rows = jax.lax.scan(push, moved[1:last], (*_linearised(forward, before, after, controls), steered))
    # Time goes on whatever moves, and where the solver starts is not where it ends.
    time = jnp.broadcast_to(moved[:1], (len(rows), 1))
    return after, jnp.concatenate([time, rows, jnp.zeros((len(rows), len(state) - last), rows.dtype)], axis=1)


@functools.partial(jax.custom_jvp, nondiff_argnums=(0,))
def _linearised(
    forward: Forward, before: Float[Array, "k s"], after: Float[Array, "k s"], controls: Float[Array, "k nu"]
) -> tuple[Array, ...]:
    """See `slopes`."""
    (steps, nu), n = controls.shape, int(forward.ends[-1]) - 1

    def run(*rows: np.ndarray) -> list[np.ndarray]:
        return list(slopes(forward, *(some.reshape(-1, some.shape[-1]) for some in rows)))

    return outside.call(run, forward.identity, [(steps, n, n), (steps, n, nu)], before, after, controls)


@_linearised.defjvp
def _(forward: Forward, primals: Any, tangents: Any) -> Any:
    del forward, primals, tangents
    raise InputError(NO_SECOND)
