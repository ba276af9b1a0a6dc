"""What is asked of a scene: a function x [n] -> y [m] of displacements of its variables, after so many steps.

x = 0 is the state and the model as they are. Of positions the displacement is one of velocity space [nv], as
`mj_integratePos` adds it: a free body's rotation has three numbers, not four.
"""

import importlib
import math
import sys
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from tog_mjx._mjx import mjx
from tog_mjx.checks.unused import unused
from tog_mjx.errors import InputError, near, require_choice, require_kind, require_whole
from tog_mjx.implicit import STEPS
from tog_mjx.integration import positions_after
from tog_mjx.state import on_mjx
from tog_mjx.user_code import call, real

Cost = Callable[[mjx.Data], Array]
_STATE_SIZES = {"ctrl": "nu", "qpos": "nv", "qvel": "nv"}


@dataclass(frozen=True, eq=False)
class SceneFunction:
    """`steps` time steps of `model` from `start`, whose controls are held.

    Args:
      wrt: "ctrl", "qpos", "qvel", or a field of floats of `mjx.Model`, such as "geom_friction" or "opt.gravity"; or one
        number of it, as in "ctrl[0]" or "geom_friction[2, 0]".
      output: "qpos", "qvel", or the name of a site, whose position counts; or one number of it; or a function of the
        last `mjx.Data`, with body, geom and site poses of the last positions, that returns a number.
      differentiation: "implicit", "saltation" or "native", see `tog.step`.
    """

    model: mujoco.MjModel
    start: mujoco.MjData
    steps: int
    wrt: str = "ctrl"
    output: str | Cost = "qpos"
    differentiation: str = "implicit"

    def __post_init__(self):
        require_whole("steps", self.steps, 1)
        require_choice("differentiation", self.differentiation, STEPS)
        require_kind("wrt", self.wrt, str, "give ctrl, qpos, qvel or the name of a field of mjx.Model")
        if not callable(self.output):
            require_kind("output", self.output, str, "give qpos, qvel, the name of a site, or a function")
        if not self.size:
            raise InputError(f"the scene has no {self.wrt}: differentiate with respect to something else")
        if isinstance(self.output, str):
            _entries(self.output, self._output_shape)

    @property
    def size(self) -> int:
        """n, the number of variables."""
        return len(self._chosen)

    @property
    def scale(self) -> Float[np.ndarray, " n"]:
        """The size [n] of a displacement that is large: that of the number itself in the model, where it is not 0."""
        if _name(self.wrt) in _STATE_SIZES:
            return np.ones(self.size)
        values = np.abs(field_of(self.model, _name(self.wrt)).ravel()[self._chosen])
        return np.where(values > 0, values, 1.0)

    @property
    def variables(self) -> tuple[str, ...]:
        """The names of x [n]."""
        names = [f"{_name(self.wrt)}[{', '.join(map(str, i))}]" for i in np.ndindex(self._shape)]
        if _name(self.wrt) == "ctrl":
            kind = mujoco.mjtObj.mjOBJ_ACTUATOR
            names = [mujoco.mj_id2name(self.model, kind, i) or name for i, name in enumerate(names)]
        return tuple(names[i] for i in self._chosen)

    @property
    def outputs(self) -> tuple[str, ...]:
        """The names of y [m]."""
        if not isinstance(self.output, str):
            return (getattr(self.output, "__name__", "cost"),)
        name = _name(self.output)
        every = [f"{name}[{i}]" for i in range(self._output_shape[0])]
        names = every if name in ("qpos", "qvel") else [f"{name}.{axis}" for axis in "xyz"]
        return tuple(names[i] for i in _entries(self.output, self._output_shape))

    @property
    def bodies(self) -> Int[np.ndarray, " m"]:
        """What each of y [m] is of, by number: of positions and velocities the tree of bodies that are joined."""
        name, trees = _name(str(self.output)), self.model.dof_treeid
        if name == "qpos":
            sizes = np.diff([*self.model.jnt_qposadr, self.model.nq])
            trees = np.repeat(trees[self.model.jnt_dofadr], sizes)
        elif name != "qvel":
            return np.zeros(len(self.outputs), int)
        return trees[_entries(str(self.output), trees.shape)]

    @property
    def kin(self) -> Int[np.ndarray, " n"]:
        """What each of x [n] acts on, by number: of positions and velocities the tree of bodies; each control is meant
        to act by itself; of a field of the model some numbers may well do so, and others not."""
        match _name(self.wrt):
            case "ctrl":
                return self._chosen
            case "qpos" | "qvel":
                return self.model.dof_treeid[self._chosen]
        return np.zeros(self.size, int)

    @property
    def unused(self) -> Bool[np.ndarray, " n"]:
        """Which of x [n] are numbers of the model that nothing reads."""
        return np.broadcast_to(unused(self.model, _name(self.wrt)), self._shape).ravel()[self._chosen]

    @property
    def _shape(self) -> tuple[int, ...]:
        """Of all numbers of the array that x is taken from."""
        return _shape_of(self.model, _name(self.wrt))

    @property
    def _chosen(self) -> Int[np.ndarray, " n"]:
        """The variables among those numbers."""
        return _entries(self.wrt, self._shape)

    @property
    def _output_shape(self) -> tuple[int]:
        name = _name(str(self.output))
        if name in ("qpos", "qvel"):
            return (self.model.nq if name == "qpos" else self.model.nv,)
        site_id(self.model, name)
        return (3,)

    def base(self, model: mjx.Model) -> mjx.Data:
        """The start on MJX."""
        return on_mjx(model, self.start)

    def place(self, model: mjx.Model, data: mjx.Data, x: Float[Array, " n"]) -> tuple[mjx.Model, mjx.Data]:
        """The model and the start, displaced."""
        change = jnp.zeros(math.prod(self._shape), x.dtype).at[self._chosen].set(x)
        match _name(self.wrt):
            case "ctrl":
                return model, data.replace(ctrl=data.ctrl + change)
            case "qvel":
                return model, data.replace(qvel=data.qvel + change)
            case "qpos":
                return model, data.replace(qpos=positions_after(model, data.qpos, change))
            case name:
                value = attribute(model, name)
                return model.tree_replace({name: value + change.reshape(value.shape)}), data

    def observe(self, model: mjx.Model, data: mjx.Data) -> Float[Array, " m"]:
        """y of the last state.

        Raises:
          InputError: for a cost that fails, or whose value is no number.
        """
        posed = mjx.com_pos(model, mjx.kinematics(model, data))
        if not isinstance(self.output, str):
            return _number(self.outputs[0], self.output, posed)
        name = _name(self.output)
        every = getattr(data, name) if name in ("qpos", "qvel") else posed.site_xpos[site_id(self.model, name)]
        return every[_entries(self.output, self._output_shape)]


def _number(name: str, cost: Cost, data: mjx.Data) -> Float[Array, "1"]:
    number = real(f"the cost {name}", call(f"the cost {name} fails", cost, data), "one number")
    if number.size != 1:
        raise InputError(f"the cost {name} returns an array of shape {list(number.shape)}; give one number")
    return jnp.reshape(number, (1,)).astype(float)


def _name(text: str) -> str:
    """The array's name in "name" or "name[1, 2]"."""
    return text.partition("[")[0]


def variables_of(model: mujoco.MjModel, wrt: str) -> tuple[str, Bool[np.ndarray, "..."]]:
    """The array's name in `wrt` ("ctrl", "geom_friction[1, 0]", ...), and which of its numbers are variables.

    Raises:
      InputError: for what is not in the scene.
    """
    shape = _shape_of(model, _name(wrt))
    chosen = np.zeros(math.prod(shape), bool)
    chosen[_entries(wrt, shape)] = True
    return _name(wrt), chosen.reshape(shape)


def _shape_of(model: mujoco.MjModel, name: str) -> tuple[int, ...]:
    return (getattr(model, _STATE_SIZES[name]),) if name in _STATE_SIZES else field_of(model, name).shape


def _entries(text: str, shape: tuple[int, ...]) -> Int[np.ndarray, " k"]:
    """Which of the numbers of an array of that shape "name" (all) or "name[1, 2]" (a part) means.

    Raises:
      InputError: for an index that is not in the array.
    """
    every = np.arange(math.prod(shape)).reshape(shape)
    name, bracket, index = text.partition("[")
    if not bracket:
        return every.ravel()
    try:
        if not index.endswith("]"):
            raise ValueError("no bracket closes it")
        return np.atleast_1d(every[tuple(int(i) for i in index.removesuffix("]").split(","))]).ravel()
    except (ValueError, IndexError):
        raise InputError(f"{text!r}: {name} has the shape {list(shape)}; give {name} or an index in it") from None


def attribute(tree: object, path: str):
    """The value at a path with dots; AttributeError where there is none."""
    for name in path.split("."):
        tree = getattr(tree, name)
    return tree


def field_of(model: mujoco.MjModel, name: str) -> np.ndarray:
    """An array of floats of the model, by its name in `mjx.Model`.

    Raises:
      InputError: if there is none.
    """
    try:
        on_mjx, value = name in _float_fields(), np.asarray(attribute(model, name))
    except AttributeError:
        on_mjx, value = False, np.zeros(0)
    if not on_mjx or value.dtype.kind != "f":
        raise InputError(
            f"{name!r} is none of ctrl, qpos, qvel, or an array of numbers of mjx.Model; examples are geom_friction, "
            f"body_mass, opt.gravity{near(name, [*_STATE_SIZES, *_float_fields()])}"
        )
    return value


def _float_fields() -> set[str]:
    """The arrays of `mjx.Model` and of its options."""
    options = {f"opt.{name}" for name, kind in mjx.Option.__annotations__.items() if kind is jax.Array}
    return options | {name for name, kind in mjx.Model.__annotations__.items() if kind is jax.Array}


def default_wrt(model: mujoco.MjModel) -> str:
    """The variables unless told otherwise: the controls, where there are any."""
    return "ctrl" if model.nu else "qvel"


def site_id(model: mujoco.MjModel, name: str) -> int:
    """The number of a site.

    Raises:
      InputError: with the names that there are.
    """
    found = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_SITE, name)
    if found < 0:
        names = [model.site(i).name for i in range(model.nsite) if model.site(i).name]
        listed = f"; its sites: {', '.join(names[:20])}" if names else " and no site with a name"
        close = near(name, ["qpos", "qvel", *names])
        raise InputError(f"the scene has no site named {name}{listed}; or give qpos or qvel as the output{close}")
    return found


def load_cost(name: str) -> Cost:
    """The function that "package.module:function" names; modules of the working folder are found too.

    Raises:
      InputError: if it cannot be imported, or is no function.
    """
    module, _, function = name.partition(":")
    if not module or not function:
        raise InputError(f"cost {name!r}: give package.module:function")
    folder = str(Path.cwd())
    if folder not in sys.path:
        sys.path.insert(0, folder)
    found = call(f"cost {name!r} cannot be imported", lambda: attribute(importlib.import_module(module), function))
    if not callable(found):
        raise InputError(f"cost {name!r} is no function but a {type(found).__name__}")
    return found
