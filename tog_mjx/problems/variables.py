"""Variables are a law: each kind says what it puts into the model and the start, and which controls it gives.

To everything above they are one vector x [n] with names, a scale and bounds.
"""

import functools
import itertools
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import NamedTuple, Protocol, runtime_checkable

import jax.numpy as jnp
import mujoco
import numpy as np
from jaxtyping import Array, Float

from tog_mjx.mjcf.fields import array_name
from tog_mjx.mjcf.followers import Origin
from tog_mjx.mjcf.parameter import Parameter
from tog_mjx.problems.state import State
from tog_mjx.problems.wrt import TURNED, Displacements, Model, Placed, control_names
from tog_mjx.running.errors import InputError, require_choice, require_whole
from tog_mjx.stepping.mjx_state import START

Law = Callable[[State], Float[Array, " nu"]]
"""Controls as an answer to the state."""


def _keep(x: Array, model: Model, start: dict[str, Array]) -> Placed:
    del x
    return model, start


@dataclass(frozen=True, eq=False)
class Bound:
    """Variables of one problem: what follows for x [n] from its model, start and steps.

    `low`, `high` [n] are infinite where there are no bounds; `scale` [n] is the size of a large change. `place` puts x
    into the model and the start. `controls` gives the controls: constant [nu], by time step [steps, nu], or a Law,
    whose answers are held for `every` time steps.
    """

    names: tuple[str, ...]
    guess: Float[np.ndarray, " n"]
    low: Float[np.ndarray, " n"]
    high: Float[np.ndarray, " n"]
    scale: Float[np.ndarray, " n"]
    place: Callable[[Array, Model, dict[str, Array]], Placed] = _keep
    controls: Callable[[Array], Array | Law] | None = None
    every: int = 1
    moves_model: bool = False

    @classmethod
    def of(cls, names: Sequence[str], guess: np.ndarray, limits: np.ndarray | None = None, **rest) -> "Bound":
        """With `limits` [n, 2]. A large change is half of what lies between them, else the guess itself, else 1."""
        guess = np.array(guess, float)
        low, high = np.tile([-np.inf, np.inf], (len(guess), 1)).T if limits is None else np.array(limits, float).T
        size = np.where(guess == 0, 1.0, np.abs(guess))
        scale = np.where(np.isfinite(high - low), (high - low) / 2, size)
        return cls(tuple(names), guess, low, high, **{"scale": scale, **rest})


class Setting(NamedTuple):
    """What variables are asked with: the model, what it was compiled from (if known), the start and the time steps."""

    model: mujoco.MjModel
    origin: Origin | None
    start: mujoco.MjData
    steps: int


@runtime_checkable
class Variables(Protocol):
    """One kind of them."""

    def bind(self, given: Setting) -> Bound:
        """What they are in a problem.

        Raises:
          InputError: for what the model does not have.
        """
        ...


@dataclass(frozen=True)
class Controls:
    """Controls over time, whatever the state: those of `knots` moments, evenly spaced from the first step to the last.

    x [knots * nu] holds those of the first knot, then those of the second, ... Between two knots they change linearly;
    with `hold` each is held until the next. One knot is a constant control.

    Raises:
      InputError: for a number of knots that is not positive.

    Units: of the actuators' inputs.
    Gradient: as that of `tog.objective`; controls are linear in x.
    """

    knots: int = 1
    hold: bool = False

    def __post_init__(self):
        require_whole("knots", self.knots, 1)

    def bind(self, given: Setting) -> Bound:
        """The variables in a problem. InputError: for a scene without actuators, or more knots than time steps."""
        model = given.model
        if not model.nu:
            raise InputError("the scene has no actuators, so there are no controls; take other variables")
        require_whole("knots", self.knots, 1, given.steps)
        names = control_names(model, np.arange(model.nu))
        if self.knots > 1:
            names = tuple(f"{name} at knot {k}" for k in range(self.knots) for name in names)
        limited = model.actuator_ctrllimited.astype(bool)[:, None]
        limits = np.tile(np.where(limited, model.actuator_ctrlrange, [-np.inf, np.inf]), (self.knots, 1))

        def controls(x: Array) -> Array:
            return self._over_time(jnp.reshape(x, (self.knots, model.nu)), given.steps)

        return Bound.of(names, np.tile(given.start.ctrl, self.knots), limits, controls=controls)

    def _over_time(self, table: Float[Array, "knots nu"], steps: int) -> Array:
        if self.knots == 1:
            return table[0]
        if self.hold:
            return table[np.arange(steps) * self.knots // steps]
        position = np.linspace(0, self.knots - 1, steps)
        before = np.minimum(position.astype(int), self.knots - 2)
        share = jnp.asarray((position - before)[:, None], table.dtype)
        return (1 - share) * table[before] + share * table[before + 1]


@dataclass(frozen=True)
class Start:
    """Where a motion starts: "qvel", "act" or "mocap_pos" themselves, or displacements from the start's own "qpos", in
    velocity space, or from its "mocap_quat", as rotation vectors.

    "qvel[2]" is one number of them; of positions too the index is that of a velocity, below nv. All of a field are [nv]
    (qpos, qvel), [na] (act) or [3 nmocap] numbers.

    Units: m and rad, m/s and rad/s where the model is in SI.
    Gradient: as that of `tog.objective`; a rotation's is right where nothing turns.
    """

    field: str = "qvel"

    def bind(self, given: Setting) -> Bound:
        """The variables in a problem. InputError: for a field that is none of the start, or that the scene lacks."""
        require_choice("the start's variable", array_name(self.field), START)
        found = Displacements(given.model, self.field)
        name, chosen = found.array, found.chosen
        if name in TURNED:
            return Bound.of(found.names, np.zeros(len(chosen)), place=found.place)

        def place(x: Array, model: Model, start: dict[str, Array]) -> Placed:
            old = start[name]
            return model, {**start, name: old.ravel().at[chosen].set(x).reshape(old.shape)}

        return Bound.of(found.names, getattr(given.start, name).ravel()[chosen], place=place)


class Parameters:
    """Numbers of the model, by their names in `mjx.Model`: `Parameters("geom_friction[1, 0]", "body_mass[2]")`.

    They move what MuJoCo's compiler derives from them, see `tog.Parameter`. x [n] are the numbers themselves.

    Units: those of the fields in MuJoCo.
    Gradient: as that of `tog.objective`; of what the MJCF file leaves out, as a friction loss, it is zero.
    """

    def __init__(self, *fields: str):
        self.fields = fields

    def __repr__(self) -> str:
        return f"Parameters({', '.join(map(repr, self.fields))})"

    def bind(self, given: Setting) -> Bound:
        """The variables in a problem. InputError: for no fields, or one that the model does not have."""
        if not self.fields:
            raise InputError("Parameters() names no field of the model; give one, such as geom_friction")
        parts = [Parameter(given.model, field, given.origin) for field in self.fields]
        names = [name for part in parts for name in part.names]
        ends = np.cumsum([len(part.value) for part in parts])[:-1]

        def place(x: Array, model: Model, start: dict[str, Array]) -> Placed:
            for part, new in zip(parts, jnp.split(x, ends), strict=True):
                model = part.moved(model, new - part.value)
            return model, start

        return Bound.of(names, np.concatenate([part.value for part in parts]), place=place, moves_model=True)


@dataclass(frozen=True)
class Several:
    """Variables of several kinds, one after the other. Controls of more than one kind add up: a plan and a feedback."""

    kinds: Sequence[Variables] = field(default_factory=tuple)

    def bind(self, given: Setting) -> Bound:
        parts = [kind.bind(given) for kind in self.kinds]
        ends = np.cumsum([len(part.guess) for part in parts])[:-1]

        def split(x: Array) -> list[tuple[Bound, Array]]:
            return list(zip(parts, jnp.split(x, ends), strict=True))

        def place(x: Array, model: Model, start: dict[str, Array]) -> Placed:
            for part, some in split(x):
                model, start = part.place(some, model, start)
            return model, start

        def controls(x: Array) -> Array | Law:
            return _sum([part.controls(some) for part, some in split(x) if part.controls])

        each = {
            name: np.concatenate([getattr(part, name) for part in parts]) for name in ("guess", "low", "high", "scale")
        }
        return Bound(
            tuple(itertools.chain.from_iterable(part.names for part in parts)),
            **each,
            place=place,
            controls=controls if any(part.controls for part in parts) else None,
            every=max(part.every for part in parts),
            moves_model=any(part.moves_model for part in parts),
        )


def _sum(controls: list[Array | Law]) -> Array | Law:
    """Of plans; of laws, and of laws and a constant plan, as a law. A law has no clock for a plan over time."""
    plans = [some for some in controls if not callable(some)]
    laws = [some for some in controls if callable(some)]
    plan = functools.reduce(jnp.add, plans) if plans else jnp.zeros(())
    if not laws:
        return plan
    if plan.ndim == 2:
        raise InputError("controls with knots and a policy do not add up; give one knot, or let the policy see time")
    return lambda state: functools.reduce(jnp.add, [law(state) for law in laws], plan)
