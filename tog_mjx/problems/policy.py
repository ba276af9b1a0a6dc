"""Controls that answer to the state."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from tog_mjx.problems.state import State
from tog_mjx.problems.variables import Bound, Law, Setting
from tog_mjx.running.errors import InputError, require_kind, require_whole
from tog_mjx.running.pytrees import variables
from tog_mjx.running.user_code import call


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

    Raises:
      InputError: for an `apply` or an `observe` that is no function, or an `every` that is no positive number.

    Units: of what it observes and of controls, the model's.
    Gradient: in the parameters [n], through `apply`, `observe` and the motion, as that of `tog.objective`; a law that
      has none where the model is at rest, as a plain norm at zero, makes it NaN there.
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

    def bind(self, given: Setting) -> Bound:
        """The variables in a problem. InputError: for parameters that are no arrays of floats, and later for an `apply`
        that fails or returns no controls."""
        parameters = variables(self.parameters, "policy")

        def controls(x: Array) -> Law:
            tree = parameters.restore(x)

            def law(state: State) -> Float[Array, " nu"]:
                found = jnp.asarray(call("the policy fails", self.apply, tree, self.observe(state)))
                if found.shape != (given.model.nu,):
                    raise InputError(
                        f"the policy returns an array of shape {list(found.shape)}; give [{given.model.nu}] controls"
                    )
                return found.astype(x.dtype)

            return law

        size = np.full(parameters.point.size, self.scale)
        return Bound.of(parameters.names, parameters.point, controls=controls, every=self.every, scale=size)
