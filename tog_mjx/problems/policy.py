"""Controls that answer to the state."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
from jax.flatten_util import ravel_pytree
from jaxtyping import Array, Float

from tog_mjx.errors import InputError, require_kind, require_whole
from tog_mjx.problems.state import State
from tog_mjx.problems.variables import Bound, Law


def positions_and_velocities(state: State) -> Float[Array, " k"]:
    """What a policy observes unless told otherwise: qpos and qvel."""
    return jnp.concatenate([state.qpos, state.qvel])


@dataclass(frozen=True)
class Policy:
    """A feedback law whose parameters are the variables.

    Args:
      apply: `(parameters, observation) -> controls [nu]`, any JAX function: of flax, equinox, or your own.
      parameters: any pytree of arrays of floats, where descent starts.
      observe: of a `State`; the default is qpos and qvel, one after the other.
      every: time steps for which a control is held.
      scale: the size of a large change of a parameter.
    """

    apply: Callable[[Any, Any], Array]
    parameters: Any
    observe: Callable[[State], Any] = positions_and_velocities
    every: int = 1
    scale: float = 1.0

    def __post_init__(self):
        require_kind("apply", self.apply, Callable, "give a function of parameters and an observation")
        require_kind("observe", self.observe, Callable, "give a function of a State")
        require_whole("every", self.every, 1)

    def bind(self, model: mujoco.MjModel, start: mujoco.MjData, steps: int) -> Bound:
        del start, steps
        flat, unravel = ravel_pytree(self.parameters)
        if not flat.size or not jnp.issubdtype(flat.dtype, jnp.floating):
            raise InputError("the policy's parameters hold no numbers with a derivative; give a pytree of float arrays")

        def controls(x: Array) -> Law:
            parameters = unravel(x.astype(flat.dtype))

            def law(state: State) -> Float[Array, " nu"]:
                given = jnp.asarray(self.apply(parameters, self.observe(state)))
                if given.shape != (model.nu,):
                    shape = list(given.shape)
                    raise InputError(f"the policy returns an array of shape {shape}; give {model.nu} controls, [{model.nu}]")
                return given.astype(x.dtype)

            return law

        size = np.full(flat.size, self.scale)
        return Bound.of(_names(self.parameters), np.asarray(flat), controls=controls, every=self.every, scale=size)


def _names(parameters: Any) -> list[str]:
    """Of each number in a pytree, in the order of `ravel_pytree`."""
    names = []
    for path, leaf in jax.tree_util.tree_leaves_with_path(parameters):
        name = jax.tree_util.keystr(path, simple=True, separator=".") or "parameter"
        names += [f"{name}[{', '.join(map(str, i))}]" if i else name for i in np.ndindex(np.shape(leaf))]
    return names
