"""Numbers of a model as variables, which move what follows from them."""

import copy
import functools
from typing import Any

import jax.numpy as jnp
import mujoco
import numpy as np
from jaxtyping import Array, Float, Int

from tog_mjx.mjcf.fields import array_name, assign, attribute, entries, entry_names, field_of
from tog_mjx.mjcf.followers import Followers, Origin, compiled, followers, spec_of
from tog_mjx.mjcf.moved import MovedModel, Rates, check_moves, put
from tog_mjx.running.errors import InputError, require_kind
from tog_mjx.running.types import AnyArray
from tog_mjx.stepping._mjx import mjx, put_model, with_forces_of

ALONE = "field:"
"""Before the name of an array that is to move alone."""


class Parameter:
    """Numbers of a model as a function x [n] -> `mjx.Model`, differentiable in both modes.

    A body's mass moves its inertia and the inverse weights by which constraints are scaled, a geom's size the mass, and
    so on: to first order about the model as it is, by differences of MuJoCo's compiler, taken once.

        mass = tog.Parameter(mujoco.MjSpec.from_file("scene.xml"), "body_mass[1]")
        end = lambda x: tog.simulate(mass(x), data, controls, 100)[0].qpos
        jax.jacfwd(end)(mass.value)

    Args:
      source: the MjSpec, or the compiled model.
      name: an array of floats of `mjx.Model`, or one number of it: "geom_size", "geom_friction[2, 0]"; with "field:"
        before it, the array moves alone.
      origin: what that model was compiled from, an MjSpec or the path of an MJCF file; without it inertias stay behind.

    Raises:
      InputError: for a source of another kind, or a name that is not in the model.

    Units: of x [n], those of the field in MuJoCo.
    Gradient: the model is linear in x, so that its derivative is the same everywhere; that of a motion is as that of
      `tog.step`. A friction loss or a limit that the MJCF file does not have makes no constraint, and has the
      derivative zero.
    Source: own: differences of MuJoCo's compiler.
    """

    def __init__(self, source: mujoco.MjModel | mujoco.MjSpec, name: str, origin: Origin | None = None):
        require_kind("the source", source, (mujoco.MjModel, mujoco.MjSpec), "give a mujoco.MjSpec or a mujoco.MjModel")
        require_kind("the name", name, str, "give the name of an array of mjx.Model, as in body_mass[1]")
        if isinstance(source, mujoco.MjSpec):
            source, origin = compiled(source)
        self.model, self._origin = source, origin
        self.is_alone, self.name = name.startswith(ALONE), name
        name = name.removeprefix(ALONE)
        self.array = array_name(name)
        field = field_of(self.model, self.array)
        self.chosen: Int[np.ndarray, " n"] = entries(name, field.shape)
        if not len(self.chosen):
            raise InputError(f"the model has no {name}: choose another array")
        self.value: Float[np.ndarray, " n"] = field.ravel()[self.chosen]
        self.names = entry_names(self.array, field.shape, self.chosen)

    def __call__(self, x: Float[AnyArray, " n"]) -> mjx.Model:
        """The model with these numbers [n], on MJX."""
        return self.moved(put_model(self.model), jnp.asarray(x) - self.value)

    def in_c(self, x: Float[AnyArray, " n"]) -> mujoco.MjModel:
        """The same model of C MuJoCo: a copy.

        Raises:
          InputError: for a number that C MuJoCo does not move of a compiled model.
        """
        for name, rate in self.rates.items():
            check_moves(self.model, name, np.flatnonzero(rate.any(1)))
        changed, on_mjx = copy.copy(self.model), self(x)
        fields = {name: np.asarray(attribute(on_mjx, name)) for name in self.arrays}
        put(
            self.model,
            fields,
            functools.partial(assign, changed),
            lambda: mujoco.mj_setConst(changed, mujoco.MjData(changed)),
        )
        return changed

    @functools.cached_property
    def followers(self) -> Followers:
        """What moves, and what should and does not."""
        return followers(self.model, self.array, self.chosen, spec_of(self.model, self._origin))

    @property
    def arrays(self) -> tuple[str, ...]:
        """All that moves."""
        return (self.array,) if self.is_alone else tuple({self.array: None, **self.followers.rates})

    @functools.cached_property
    def rates(self) -> Rates:
        """The derivatives [size, n] of all that moves."""
        own = np.zeros((field_of(self.model, self.array).size, len(self.chosen)))
        own[self.chosen, np.arange(len(self.chosen))] = 1.0
        return {name: self.followers.rates.get(name, own) for name in self.arrays}

    @property
    def size(self) -> Float[np.ndarray, " n"]:
        """Of large changes: the numbers themselves, and of one that is nothing beside others of its array, those."""
        largest = np.abs(field_of(self.model, self.array)).max()
        return np.where(np.abs(self.value) > 1e-6 * largest, np.abs(self.value), largest or 1.0)

    def moved(self, model: Any, change: Float[Array, " n"]) -> Any:
        """Such a model with these numbers, and what follows from them, displaced."""
        if isinstance(model, MovedModel):
            return model.displaced(self.rates, self.size, change)
        found = {}
        for name in self.arrays:
            value = attribute(model, name)
            if name in self.followers.rates:
                moved = jnp.asarray(self.followers.rates[name], value.dtype) @ change
            else:
                moved = jnp.zeros(value.size, value.dtype).at[self.chosen].set(change)
            found[name] = value + moved.reshape(value.shape)
        return with_forces_of(model.tree_replace(found), self.array)
