"""What a State of C MuJoCo shows, as JAX functions: sites, bodies, sensors and accelerations."""

import functools
from typing import Any

import jax
import mujoco
import numpy as np
from jaxtyping import Array, Float

from tog_mjx.engines.c_mujoco import outside
from tog_mjx.engines.c_mujoco.forward import Forward
from tog_mjx.engines.c_mujoco.linearise import NO_SECOND, columns_in_positions
from tog_mjx.engines.c_mujoco.moment import POS, QACC, Dynamics, Numbers, Place
from tog_mjx.problems.state import Derived
from tog_mjx.running.errors import InputError


@functools.partial(jax.custom_jvp, nondiff_argnums=(0,))
def observe(numbers: Numbers, state: Float[Array, " s"], controls: Float[Array, " nu"]) -> Float[Array, " m"]:
    """y, differentiable once, in both modes; NaN after a burst.

    Raises:
      InputError: where it is differentiated twice.
    """
    return outside.call(
        lambda *moment: [numbers.values(*moment)], numbers.identity, [(numbers.size,)], state, controls
    )[0]


@observe.defjvp
def _(numbers: Numbers, primals: tuple[Array, Array], tangents: tuple[Array, Array]) -> tuple[Array, Array]:
    (moved, steered), last = tangents, int(numbers.forward.ends[-1])
    of_state, of_controls = _slopes(numbers, *primals)
    return observe(numbers, *primals), of_state @ moved[1:last] + of_controls @ steered


@functools.partial(jax.custom_jvp, nondiff_argnums=(0,))
def _slopes(numbers: Numbers, state: Array, controls: Array) -> tuple[Array, ...]:
    """In (qpos, qvel, act), and in the controls."""
    model, (_, q, *_, last) = numbers.forward.model, numbers.forward.ends
    n = 2 * model.nv + model.na

    def run(states: np.ndarray, controls: np.ndarray) -> list[np.ndarray]:
        found = numbers.slopes(states, controls)
        return [columns_in_positions(model, states[:, 1:q], found[..., :n]), found[..., n:]]

    shapes = [(numbers.size, int(last) - 1), (numbers.size, model.nu)]
    return outside.call(run, numbers.identity, shapes, state, controls)


@_slopes.defjvp
def _(numbers: Numbers, primals: Any, tangents: Any) -> Any:
    del numbers, primals, tangents
    raise InputError(NO_SECOND)


class Observed(Derived):
    """Of a moment of C MuJoCo. What nobody asks for is not computed."""

    def __init__(self, forward: Forward, state: Float[Array, " s"], controls: Float[Array, " nu"]):
        super().__init__(
            "engine mujoco has no mjx.Data: take qacc, sensors, sites and bodies of a State, or engine mjx"
        )
        self._forward, self._moment, self._sensors = forward, (state, controls), dict[int, Array]()

    def site(self, number: int) -> Float[Array, "3"]:
        return observe(Place(self._forward, mujoco.mjtObj.mjOBJ_SITE, number), *self._moment)

    def body(self, number: int) -> Float[Array, "3"]:
        return observe(Place(self._forward, mujoco.mjtObj.mjOBJ_BODY, number), *self._moment)

    def sensors(self, stage: int) -> Float[Array, " ns"]:
        stage = min(stage, max(self._forward.model.sensor_needstage, default=POS))
        if stage not in self._sensors:
            self._sensors[stage] = observe(Dynamics(self._forward, stage), *self._moment)
        return self._sensors[stage]

    @property
    def qacc(self) -> Float[Array, " nv"]:
        return observe(Dynamics(self._forward, QACC), *self._moment)
