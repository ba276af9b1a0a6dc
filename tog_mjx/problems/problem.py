"""What to optimise: a model, where it starts, for how long, what may change, and at which cost."""

import functools
from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any, ClassVar

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
from jaxtyping import Array, Float

from tog_mjx.mjcf.followers import Origin, compiled
from tog_mjx.mjcf.keyframes import keyframe_start
from tog_mjx.mjcf.scene import Scene, compile_model, scene_path
from tog_mjx.problems.planes import Plane
from tog_mjx.problems.starts import Starts
from tog_mjx.problems.state import State
from tog_mjx.problems.variables import Bound, Controls, Setting, Several, Variables
from tog_mjx.running.errors import InputError, require_kind, require_whole
from tog_mjx.running.types import AnyArray, Numbers
from tog_mjx.running.user_code import call, load
from tog_mjx.stepping.mjx_state import require_state

Cost = Callable[[State], AnyArray]
CONSTANT = Controls()
_FARTHEST = 1e9
"""Of a variable: what is computed of one overflows from 1e19 on in float32, and from 1e150 on in float64."""


@dataclass(frozen=True, eq=False)
class Problem:
    """What to optimise: a model, where it starts, for how long, what may vary, and at which cost.

    Compared and hashed by identity.

    Args:
      model: a scene's name ("flip", "grasp"), the path of an MJCF file, an MjSpec, or an MjModel (whose `Parameters`
        then leave inertias behind).
      steps: time steps.
      variables: `Controls`, `Start`, `Parameters`, `Policy`, or a sequence of them.
      cost: of the last `State`; a JAX function that returns a number.
      running_cost: of a `State` and the controls in it, averaged over the states in which the time steps begin.
      start: an MjData, a keyframe's name, or `Starts`; by default the keyframe `start`, else the first, else the
        initial pose. Starts are drawn around that one.
      bounds: least and largest x, ([n], [n]) or numbers; by default those of the variables, as actuators' ctrlrange.
      guess: x [n] to begin with; by default what the start and the model hold.
      success: the cost below which the problem counts as solved.

    Raises:
      InputError: for a scene, start or variable that does not exist, a shape that does not fit, or no cost at all.

    Units: of the model, SI where it is; of x those of its variables.
    Gradient: of its cost, as that of `tog.objective`.
    """

    model: str | Path | mujoco.MjSpec | mujoco.MjModel
    steps: int
    variables: Variables | Sequence[Any] = CONSTANT
    cost: Any = None
    running_cost: Cost | None = None
    start: mujoco.MjData | str | Starts | None = None
    bounds: tuple[Numbers, Numbers] | None = None
    guess: Numbers | None = None
    success: float | None = None
    in_float64: ClassVar[bool] = False
    """Whether `tog.solve` leaves JAX's x64 flag aside."""

    def __post_init__(self):
        require_whole("steps", self.steps, 1)
        if self.cost is None and self.running_cost is None:
            raise InputError("the problem has no cost; give cost, of the last State, or running_cost, of every one")
        for name in ("cost", "running_cost"):
            if (given := getattr(self, name)) is not None:
                require_kind(name, given, Callable, "give a function of a State")
        require_kind(
            "the start", self.start, mujoco.MjData | str | Starts | None, "give an MjData, a keyframe or Starts"
        )
        if isinstance(self.start, mujoco.MjData):
            require_state(self.scene.model, self.start)
        _ = self.x0, self.limits  # Wrong shapes are told now, not later.

    @classmethod
    def load(cls, name: str) -> "Problem":
        """What the function that "my_problem.py:push" or "package.module:push" names returns.

        Raises:
          InputError: if it cannot be imported, fails, or returns no Problem.
        """
        if Path(name).suffix == ".xml":
            raise InputError(
                f"{name} is a scene; give a function that returns a tog.Problem of it, as my_problem.py:push"
            )
        found = call(f"the problem {name!r} fails", load("problem", name))
        require_kind(f"what {name!r} returns", found, cls, "give a tog.Problem")
        return found

    @property
    def _compiled_from(self) -> Origin | None:
        if isinstance(self.model, mujoco.MjModel):
            return None
        return self.model if isinstance(self.model, mujoco.MjSpec) else scene_path(self.model)

    def __getstate__(self) -> dict[str, Any]:
        """What it was made of: all else follows."""
        return {part.name: getattr(self, part.name) for part in fields(self)}

    @property
    def knots(self) -> int:
        """Of controls over time; 0 where the variables are others, or several."""
        return self.variables.knots if isinstance(self.variables, Controls) else 0

    @functools.cached_property
    def scene(self) -> Scene:
        """The compiled model."""
        if isinstance(self.model, mujoco.MjModel):
            return Scene("model", self.model)
        if isinstance(self.model, mujoco.MjSpec):
            return Scene(self.model.modelname, compiled(self.model)[0])
        path = scene_path(self.model)
        return Scene(path.stem, compile_model(path))

    @property
    def name(self) -> str:
        """The scene's."""
        return self.scene.name

    @functools.cached_property
    def origin(self) -> mujoco.MjData:
        """Where it starts, or around which it does, as MuJoCo's data. Treat it as read-only."""
        if isinstance(self.start, mujoco.MjData):
            return self.start
        return keyframe_start(self.scene.model, self.start if isinstance(self.start, str) else None)

    @functools.cached_property
    def bound(self) -> Bound:
        """The variables, of this model and start. InputError: for what is no kind of variables, or what the model does
        not have."""
        kinds = self.variables if isinstance(self.variables, Sequence) else [self.variables]
        if not kinds:
            raise InputError("the problem has no variables; give Controls, Start, Parameters or Policy")
        for kind in kinds:
            if isinstance(kind, type):
                raise InputError(f"a variable is the class {kind.__name__}; give one of it, as {kind.__name__}()")
            require_kind("a variable", kind, Variables, "give Controls, Start, Parameters or Policy")
        one = kinds[0] if len(kinds) == 1 else Several(tuple(kinds))
        return one.bind(Setting(self.scene.model, self._compiled_from, self.origin, self.steps))

    @functools.cached_property
    def x0(self) -> Float[np.ndarray, " n"]:
        """The guess. InputError: as `check`."""
        return self.bound.guess if self.guess is None else np.asarray(self.check(self.guess))

    @functools.cached_property
    def limits(self) -> tuple[np.ndarray, np.ndarray]:
        """Least and largest x, [n] each. InputError: for bounds that do not fit."""
        if self.bounds is None:
            return self.bound.low, self.bound.high
        try:
            low, high = (np.broadcast_to(np.asarray(some, float), self.bound.guess.shape) for some in self.bounds)
        except (TypeError, ValueError):
            raise InputError(f"bounds do not fit {len(self.bound.guess)} variables; give (least, largest)") from None
        if not (low <= high).all():
            raise InputError(f"the least {self.bound.names[int((low > high).argmax())]} is above the largest")
        return low, high

    @property
    def reach(self) -> Any:
        """How far a descent may move each variable [n], or all of them: a large change of it, unless told otherwise."""
        return self.bound.scale

    @property
    def plane(self) -> Plane:
        """What a landscape shows unless told otherwise: the first two variables, through the guess."""
        return Plane.of(self)

    def check(self, x: Numbers) -> Float[Array, " n"]:
        """x as numbers [n]; raises InputError where they are none."""
        try:
            with jax.ensure_compile_time_eval():  # Numbers stay numbers inside a transformation of something else.
                found = jnp.asarray(x, float)
        except (TypeError, ValueError):
            raise InputError(f"x = {x!r} is not numbers; give {len(self.bound.guess)} of them") from None
        if found.shape != self.bound.guess.shape:
            takes = f"{self.scene.name} takes [{len(self.bound.guess)}]: {', '.join(self.bound.names[:6])}"
            raise InputError(f"x has the shape {list(found.shape)}; {takes}")
        if not isinstance(found, jax.core.Tracer) and not (np.abs(np.asarray(found)) <= _FARTHEST).all():
            why = "not finite" if not np.isfinite(np.asarray(found)).all() else "too far away"
            raise InputError(f"x = {found.tolist()} is {why}; give finite numbers, up to {_FARTHEST:g}")
        return found
