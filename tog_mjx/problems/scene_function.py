"""What is asked of a scene: a function x [n] -> y [m] of displacements of its variables, after so many steps."""

import functools
from dataclasses import dataclass

import mujoco
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from tog_mjx.mjcf.followers import Origin
from tog_mjx.problems.wrt import Variables
from tog_mjx.running.errors import require_choice, require_whole
from tog_mjx.stepping._mjx import mjx
from tog_mjx.stepping.implicit import STEPS
from tog_mjx.stepping.mjx_state import on_mjx
from tog_mjx.stepping.outputs import Cost, Outputs


@dataclass(frozen=True, eq=False)
class SceneFunction:
    """`steps` time steps of `model` from `start`, whose controls are held.

    Args:
      wrt: see `Variables`.
      output: see `Outputs`.
      differentiation: "implicit", "saltation" or "native", see `tog.step`.
      origin: what the model was compiled from, if known.
    """

    model: mujoco.MjModel
    start: mujoco.MjData
    steps: int
    wrt: str = "ctrl"
    output: str | Cost = "qpos"
    differentiation: str = "implicit"
    origin: Origin | None = None

    def __post_init__(self):
        require_whole("steps", self.steps, 1)
        require_choice("differentiation", self.differentiation, STEPS)
        _ = self.x, self.y  # Bad ones are told now.

    @functools.cached_property
    def x(self) -> Variables:
        return Variables(self.model, self.wrt, self.origin)

    @functools.cached_property
    def y(self) -> Outputs:
        return Outputs(self.model, self.output, self.differentiation)

    @property
    def size(self) -> int:
        """n, the number of variables."""
        return len(self.x.chosen)

    @property
    def scale(self) -> Float[np.ndarray, " n"]:
        """The size [n] of a displacement that is large."""
        return self.x.scale

    @property
    def variables(self) -> tuple[str, ...]:
        """The names of x [n]."""
        return self.x.names

    @property
    def outputs(self) -> tuple[str, ...]:
        """The names of y [m]."""
        return self.y.names

    @property
    def bodies(self) -> Int[np.ndarray, " m"]:
        """What each of y [m] is of, see `Outputs`."""
        return self.y.bodies

    @property
    def kin(self) -> Int[np.ndarray, " n"]:
        """What each of x [n] acts on, see `Variables`."""
        return self.x.kin

    @property
    def unused(self) -> Bool[np.ndarray, " n"]:
        """Which of x [n] are numbers of the model that nothing reads."""
        return self.x.unused

    def base(self, model: mjx.Model) -> mjx.Data:
        """The start on MJX."""
        return on_mjx(model, self.start)

    def place(self, model: mjx.Model, data: mjx.Data, x: Float[Array, " n"]) -> tuple[mjx.Model, mjx.Data]:
        """The model and the start, displaced."""
        return self.x.place(model, data, x)

    def observe(self, model: mjx.Model, data: mjx.Data) -> Float[Array, " m"]:
        """y of the last state.

        Raises:
          InputError: for a cost that fails, or whose value is no number.
        """
        return self.y.observe(model, data)
