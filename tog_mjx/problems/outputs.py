"""What is asked of the last state of a motion: numbers y [m] of it."""

from collections.abc import Callable
from dataclasses import dataclass

import mujoco
import numpy as np
from jaxtyping import Array, Float, Int

from tog_mjx.mjcf.fields import array_name, entries
from tog_mjx.problems.state import State
from tog_mjx.running.errors import InputError, near, require_kind
from tog_mjx.running.user_code import number
from tog_mjx.stepping._mjx import mjx

Cost = Callable[[mjx.Data], Array]
_SIZES = {"qpos": "nq", "qvel": "nv", "acc": "nv"}


@dataclass(frozen=True, eq=False)
class Outputs:
    """Numbers of the last state, or of what follows from it and the last inputs.

    Args:
      output: "qpos", "qvel", "acc" (the accelerations), the name of a site, whose position counts, or of a sensor
        ("sensor:NAME" where a site has that name too); or one number of it; or a function of the last `mjx.Data`, as
        `complete` leaves it, that returns a number.
      differentiation: see `tog.step`.
    """

    model: mujoco.MjModel
    output: str | Cost
    differentiation: str

    def __post_init__(self):
        if not callable(self.output):
            told = "give qpos, qvel, acc, the name of a site or of a sensor, or a function"
            require_kind("output", self.output, str, told)
            entries(self.output, self._shape)

    @property
    def names(self) -> tuple[str, ...]:
        """Of y [m]."""
        if not isinstance(self.output, str):
            return (getattr(self.output, "__name__", "cost"),)
        name = array_name(self.output)
        every = [f"{name}[{i}]" for i in range(self._shape[0])]
        if self.source[0] == "site":
            every = [f"{name}.{axis}" for axis in "xyz"]
        return tuple(every[i] for i in self.chosen)

    @property
    def bodies(self) -> Int[np.ndarray, " m"]:
        """What each of y [m] is of, by number: of positions, velocities and accelerations the tree of bodies that are
        joined."""
        if not isinstance(self.output, str) or self.source[0] not in _SIZES:
            return np.zeros(len(self.names), int)
        trees = self.model.dof_treeid
        if self.source[0] == "qpos":
            sizes = np.diff([*self.model.jnt_qposadr, self.model.nq])
            trees = np.repeat(trees[self.model.jnt_dofadr], sizes)
        return trees[entries(self.output, trees.shape)]

    def observe(self, model: mjx.Model, data: mjx.Data) -> Float[Array, " m"]:
        """y of the state and the inputs in `data`; the rest of it is computed here.

        Raises:
          InputError: for a cost that fails, or whose value is no number.
        """
        return self.seen(State.at(self.model, model, data, self.differentiation))

    def seen(self, state: State) -> Float[Array, " m"]:
        """y of a State of any engine; errors are those of `observe`."""
        if not isinstance(self.output, str):
            return number(f"the cost {self.names[0]}", self.output, state.data)[None].astype(float)
        kind, name = self.source
        match kind:
            case "acc":
                every = state.qacc
            case "sensor":
                every = state.sensor(name)
            case "site":
                every = state.site(name)
            case _:
                every = getattr(state, kind)
        return every[self.chosen]

    @property
    def chosen(self) -> Int[np.ndarray, " m"]:
        """Which numbers of its source y are."""
        return entries(str(self.output), self._shape)

    @property
    def source(self) -> tuple[str, str]:
        """One of _SIZES, or "site" or "sensor", and its name."""
        name = array_name(str(self.output))
        return (name, name) if name in _SIZES else _found(self.model, name)

    @property
    def _shape(self) -> tuple[int]:
        kind, name = self.source
        if kind in _SIZES:
            return (getattr(self.model, _SIZES[kind]),)
        return (3 if kind == "site" else int(self.model.sensor(name).dim[0]),)


def _found(model: mujoco.MjModel, name: str) -> tuple[str, str]:
    """A site or a sensor of that name.

    Raises:
      InputError: with the names that there are.
    """
    sites, sensors = (
        [some for i in range(count) if (some := getattr(model, kind)(i).name)]
        for kind, count in (("site", model.nsite), ("sensor", model.nsensor))
    )
    only = name.removeprefix("sensor:")
    for kind, given, names in (("site", name, sites), ("sensor", name, sensors), ("sensor", only, sensors)):
        if given in names:
            return kind, given
    listed = f"; its sites: {', '.join(sites[:20])}" if sites else ""
    listed += f"; its sensors: {', '.join(sensors[:20])}" if sensors else ""
    close = near(name, [*_SIZES, *sites, *sensors])
    raise InputError(f"the scene has no site or sensor named {name}{listed}; or give qpos, qvel or acc{close}")
