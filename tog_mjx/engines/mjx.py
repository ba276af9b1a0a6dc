"""MuJoCo MJX as a planar simulator of one box and its fingers.

The loop carries the state, by `tog_mjx.stepping.mjx_state`, not the whole `mjx.Data`: reverse mode must store its carry
at every step.
"""

import dataclasses
from typing import ClassVar

import jax
import jax.numpy as jnp
from jaxtyping import Array

from tog_mjx.mjcf.scene import Scene
from tog_mjx.running.errors import InputError
from tog_mjx.running.types import Box, Fingers, Setpoints
from tog_mjx.stepping._mjx import make_data, mjx, put_model
from tog_mjx.stepping.implicit import STEPS
from tog_mjx.stepping.mjx_state import state_of

State = dict[str, Array]


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class MjxSimulator:
    """The model's arrays are leaves; addresses and differentiation are static. Implements `Simulator`.

    `differentiation="implicit"` differentiates by the implicit function theorem (`tog_mjx.stepping.implicit`);
    `"native"` leaves it to MJX, which raises in reverse mode and gives NaN on an elliptic cone. The values are the
    same.
    """

    OPTIONS: ClassVar[dict[str, tuple[str, ...]]] = {"differentiation": tuple(STEPS)}
    CHUNK: ClassVar[int] = 64
    GRADIENT_CHARGE: ClassVar[float] = 4.0
    SALTATION_CHARGE: ClassVar[float] = 5.0

    model: mjx.Model
    joints: tuple[int, ...] = dataclasses.field(metadata={"static": True})
    actuators: tuple[int, ...] = dataclasses.field(metadata={"static": True})
    differentiation: str = dataclasses.field(default="implicit", metadata={"static": True})

    @classmethod
    def from_scene(cls, scene: Scene, differentiation: str = "implicit") -> "MjxSimulator":
        model = put_model(scene.model)
        return cls(model, tuple(scene.joints.tolist()), tuple(scene.actuators.tolist()), differentiation)

    def init(self, box: Box, fingers: Fingers) -> State:
        if self.model.qpos0.dtype != jnp.zeros(0).dtype:
            raise InputError(
                "JAX's x64 flag changed after this simulator was made; make it again under the flag you run it with"
            )
        box, fingers = jnp.asarray(box, float), jnp.asarray(fingers, float)
        joints, data = jnp.array(self.joints), make_data(self.model)
        q, v = Scene.of_joints(box, fingers)
        return state_of(data.replace(qpos=data.qpos.at[joints].set(q), qvel=data.qvel.at[joints].set(v)))

    def step(self, state: State, setpoints: Setpoints) -> State:
        """Advances by one time step under the setpoints [2F]."""
        data = make_data(self.model)
        ctrl = data.ctrl.at[jnp.array(self.actuators)].set(setpoints)
        data = STEPS[self.differentiation](self.model, data.replace(**state, ctrl=ctrl))
        return state_of(data)

    def observe(self, state: State) -> tuple[Box, Fingers]:
        joints = jnp.array(self.joints)
        position, velocity = state["qpos"][joints], state["qvel"][joints]
        box = jnp.concatenate([position[:3], velocity[:3]])
        return box, jnp.concatenate([position[3:].reshape(-1, 2), velocity[3:].reshape(-1, 2)], axis=1)
