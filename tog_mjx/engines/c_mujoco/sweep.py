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
from tog_mjx.engines.c_mujoco.held import Held, instantiated, is_moved
from tog_mjx.engines.c_mujoco.linearise import NO_SECOND, slopes
from tog_mjx.engines.c_mujoco.switching import check_jumps
from tog_mjx.running.errors import InputError


@functools.partial(jax.custom_jvp, nondiff_argnums=(0,))
def motion(
    forward: Forward, state: Float[Array, " s"], controls: Float[Array, "k nu"], held: Held
) -> Float[Array, "k s"]:
    """The states after each of k steps, differentiable once, in both modes. What was drawn of `held` is constant.

    Raises:
      InputError: where it is differentiated twice.
    """
    (steps, _), (size,) = controls.shape, state.shape

    def run(state: np.ndarray, controls: np.ndarray, *held: np.ndarray) -> list[np.ndarray]:
        return [forward.motions(state, controls, np.concatenate(held, axis=1))]

    return outside.call(run, forward.identity, [(steps, size)], state, controls, *held)[0]


def _push(forward: Forward, primals: tuple[Any, ...], tangents: tuple[Any, ...]) -> tuple[Array, Array]:
    state, controls, held = primals
    (moved, steered), numbers = map(instantiated, tangents[:2]), tangents[2][:2]
    is_held = is_moved(numbers)
    if forward.differentiation == "saltation":
        check_jumps(forward.model)
    after = motion(forward, state, controls, held)
    before = jnp.concatenate([state[None], after[:-1]])
    last = int(forward.ends[-1])
    of_state, of_controls, of_held = _linearised(forward, is_held, before, after, controls, held)
    pushed = jnp.zeros((len(after), last), after.dtype)
    if is_held:
        pushed = of_held @ jnp.concatenate([instantiated(some) for some in numbers])
    pushed = pushed.at[:, 1:].add(jnp.einsum("kij,kj->ki", of_controls, steered))

    def push(moved: Array, step: tuple[Array, ...]) -> tuple[Array, Array]:
        of_state, pushed = step
        # Time goes on whatever moves but the model.
        moved = jnp.concatenate([moved[:1], of_state @ moved[1:]]) + pushed
        return moved, moved

    _, rows = jax.lax.scan(push, moved[:last], (of_state, pushed))
    # Where the solver starts is not where it ends.
    return after, jnp.concatenate([rows, jnp.zeros((len(rows), len(state) - last), rows.dtype)], axis=1)


motion.defjvp(_push, symbolic_zeros=True)


@functools.partial(jax.custom_jvp, nondiff_argnums=(0, 1))
def _linearised(
    forward: Forward,
    is_held: bool,
    before: Float[Array, "k s"],
    after: Float[Array, "k s"],
    controls: Float[Array, "k nu"],
    held: Held,
) -> tuple[Array, ...]:
    """See `slopes`."""
    (steps, nu), n = controls.shape, int(forward.ends[-1]) - 1
    m = held.change.size + held.mocap.size if is_held else 0

    def run(before: np.ndarray, after: np.ndarray, controls: np.ndarray, *held: np.ndarray) -> list[np.ndarray]:
        count = len(before) * steps
        before, after, controls = (some.reshape(count, some.shape[-1]) for some in (before, after, controls))
        rows = np.repeat(np.concatenate(held, axis=1), steps, axis=0)
        return list(slopes(forward, before, after, controls, rows, is_held=is_held))

    shapes = [(steps, n, n), (steps, n, nu), (steps, 1 + n, m)]
    return outside.call(run, forward.identity, shapes, before, after, controls, *held)


@_linearised.defjvp
def _(forward: Forward, is_held: bool, primals: Any, tangents: Any) -> Any:
    del forward, is_held, primals, tangents
    raise InputError(NO_SECOND)
