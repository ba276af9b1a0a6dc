"""What is asked of a scene: a function x [n] -> y [m] of displacements of its variables, after so many steps."""

import functools
from dataclasses import dataclass

import mujoco
from jaxtyping import Array, Float

from tog_mjx.mjcf.followers import Origin
from tog_mjx.problems.outputs import Cost, Outputs
from tog_mjx.problems.wrt import OF_DATA, Displacements
from tog_mjx.running.errors import require_choice, require_whole
from tog_mjx.stepping._mjx import mjx
from tog_mjx.stepping.implicit import STEPS


@dataclass(frozen=True, eq=False)
class SceneFunction:
    """`steps` time steps of `model` from `start`, whose controls are held.

    Args:
      wrt: see `Displacements`.
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
    def x(self) -> Displacements:
        return Displacements(self.model, self.wrt, self.origin)

    @functools.cached_property
    def y(self) -> Outputs:
        return Outputs(self.model, self.output, self.differentiation)

    def place(self, model: mjx.Model, data: mjx.Data, x: Float[Array, " n"]) -> tuple[mjx.Model, mjx.Data]:
        """The model and the start, displaced."""
        model, start = self.x.place(x, model, {name: getattr(data, name) for name in OF_DATA})
        return model, data.replace(**start)
