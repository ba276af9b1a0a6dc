"""What a State of C MuJoCo shows, as JAX functions: sites, bodies, sensors and accelerations."""

import functools
from typing import Any

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
from jaxtyping import Array, Float

from tog_mjx.engines.c_mujoco import outside
from tog_mjx.engines.c_mujoco.forward import Forward
from tog_mjx.engines.c_mujoco.held import Held, instantiated, is_moved
from tog_mjx.engines.c_mujoco.linearise import NO_SECOND, columns_in_positions
from tog_mjx.engines.c_mujoco.moment import POS, QACC, Dynamics, Numbers, Place
from tog_mjx.problems.state import Derived
from tog_mjx.running.errors import InputError


@functools.partial(jax.custom_jvp, nondiff_argnums=(0,))
def observe(
    numbers: Numbers, state: Float[Array, " s"], controls: Float[Array, " nu"], held: Held
) -> Float[Array, " m"]:
    """y, differentiable once, in both modes; NaN after a burst. What was drawn of `held` is constant.

    Raises:
      InputError: where it is differentiated twice.
    """

    def run(states: np.ndarray, controls: np.ndarray, *held: np.ndarray) -> list[np.ndarray]:
        return [numbers.values(states, controls, np.concatenate(held, axis=1))]

    return outside.call(run, numbers.identity, [(numbers.size,)], state, controls, *held)[0]


def _push(numbers: Numbers, primals: tuple[Any, ...], tangents: tuple[Any, ...]) -> tuple[Array, Array]:
    (moved, steered), given = map(instantiated, tangents[:2]), tangents[2][:2]
    is_held, last = is_moved(given), int(numbers.forward.ends[-1])
    of_state, of_controls, of_held = _slopes(numbers, is_held, *primals)
    change = of_state @ moved[1:last] + of_controls @ steered
    if is_held:
        change += of_held @ jnp.concatenate([instantiated(some) for some in given])
    return observe(numbers, *primals), change


observe.defjvp(_push, symbolic_zeros=True)


@functools.partial(jax.custom_jvp, nondiff_argnums=(0, 1))
def _slopes(numbers: Numbers, is_held: bool, state: Array, controls: Array, held: Held) -> tuple[Array, ...]:
    """In (qpos, qvel, act), in the controls, and with `is_held` in what is held."""
    model, (_, q, *_, last) = numbers.forward.model, numbers.forward.ends
    n, m = 2 * model.nv + model.na, held.change.size + held.mocap.size if is_held else 0

    def run(states: np.ndarray, controls: np.ndarray, *held: np.ndarray) -> list[np.ndarray]:
        rows = np.concatenate(held, axis=1)
        precise = numbers.precise
        found = precise.slopes(states, controls, rows)
        of_held = precise.in_held(states, controls, rows) if is_held else np.zeros((len(rows), numbers.size, 0))
        return [columns_in_positions(model, states[:, 1:q], found[..., :n]), found[..., n:], of_held]

    shapes = [(numbers.size, int(last) - 1), (numbers.size, model.nu), (numbers.size, m)]
    return outside.call(run, numbers.identity, shapes, state, controls, *held)


@_slopes.defjvp
def _(numbers: Numbers, is_held: bool, primals: Any, tangents: Any) -> Any:
    del numbers, is_held, primals, tangents
    raise InputError(NO_SECOND)


class Observed(Derived):
    """Of a moment of C MuJoCo. What nobody asks for is not computed."""

    def __init__(self, forward: Forward, state: Float[Array, " s"], controls: Float[Array, " nu"], held: Held):
        super().__init__(
            "engine mujoco has no mjx.Data: take qacc, sensors, sites and bodies of a State, or engine mjx"
        )
        self._forward, self._moment, self._sensors = forward, (state, controls, held), dict[int, Array]()

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
