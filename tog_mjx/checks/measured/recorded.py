"""A scene's motion with its derivatives carried along, step by step, and a record of what happens on the way.

One compiled program serves most checks: the model, the state to start from and the number of steps are its arguments.
"""

import dataclasses
from collections.abc import Callable, Mapping
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from tog_mjx.checks.measured.motion import NEVER, QUANTITIES, SAMPLES, Motion, Recorder
from tog_mjx.checks.step_check import compile_quickly
from tog_mjx.problems.scene_function import SceneFunction
from tog_mjx.running.batches import call_in_chunks
from tog_mjx.stepping._mjx import constraint_rows, contacts, mjx, put_model
from tog_mjx.stepping.constraints import constraint_hessian, read_rows, residual
from tog_mjx.stepping.implicit import STEPS
from tog_mjx.stepping.mjx_state import INPUTS, MOVING, STATE, on_mjx, state_of
from tog_mjx.stepping.tangents import in_velocity_space, state_basis

_CHUNK = 32


class Simulation(Recorder):
    """On MJX, compiled; `states` adds directions of the initial state, 2 nv + na."""

    engine = "mjx"

    def __init__(self, scene: SceneFunction, directions: Float[np.ndarray, "n k"], states: bool = True):
        self.scene, self.directions = scene, directions
        self.model = put_model(scene.model)
        self.data = on_mjx(self.model, scene.start)
        jax.eval_shape(scene.y.observe, self.model, self.data)  # A cost that fails does so now, not after compilation.
        self._states = 2 * scene.model.nv + scene.model.na if states else 0
        self._rows = directions.shape[1] + self._states
        self._run = compile_quickly(self._motion)
        self._batch = compile_quickly(jax.vmap(self.value))

    def run(self, model: Any = None, steps: int | None = None, start: dict | None = None) -> Motion:
        data = self.data.replace(**(start or {}))
        record = self._run(model or self.model, data, self._tangents(data), steps or self.scene.steps)
        found = jax.tree.map(np.asarray, record)
        k = self.directions.shape[1]
        used = found["step"] >= 0
        states = {name: found[name][used] for name in STATE}
        each = zip(states["qpos"], found["change"][used], strict=True)  # [nq], [K, nq + nv + na]
        tangent = np.stack([in_velocity_space(self.scene.model, qpos, change) for qpos, change in each])
        changed = {
            "slopes": found["slopes"].T[:, :k],
            "times": found["step"][used],
            "moved": np.linalg.norm(tangent[:, :k], axis=2),
            "jacobians": tangent[:, k:].swapaxes(1, 2),
            "states": states,
            "geoms": found["geoms"].astype(int),
        }
        return Motion(**{name: changed[name] if name in changed else found[name] for name in Motion._fields})

    def differentiated(self, differentiation: str) -> Motion:
        scene = dataclasses.replace(self.scene, differentiation=differentiation)
        return Simulation(scene, self.directions, states=False).run()

    def values(self, points: Float[np.ndarray, "N n"]) -> Float[np.ndarray, "N m"]:
        return call_in_chunks(self._batch, points, _CHUNK)

    def value(self, x: Float[Array, " n"]) -> Float[Array, " m"]:
        model, data = self.scene.place(self.model, self.data, x)
        state, _ = jax.lax.scan(
            lambda state, _: (_advance(self.scene, model, data.replace(**state))[0], None),
            state_of(data),
            length=self.scene.steps,
        )
        return self.scene.y.observe(model, data.replace(**state))

    def changed(self, numbers: Mapping[str, Any]) -> mjx.Model:
        # Arrays of the model's own kind: a plain float would compile the motion again.
        arrays = {name: x if isinstance(x, int) else jnp.asarray(x, float) for name, x in numbers.items()}
        return self.model.tree_replace(arrays)

    def displaced(self, x: Float[np.ndarray, " n"]) -> tuple[mjx.Model, dict[str, Any]]:
        model, data = self.scene.place(self.model, self.data, jnp.asarray(x))
        return model, {**state_of(data), **{name: np.asarray(getattr(data, name)) for name in INPUTS}}

    def _tangents(self, data: mjx.Data) -> dict[str, Array]:
        """Tangents of the initial state [K, ...] beside those that the variables bring."""
        zeros = {name: jnp.zeros((self._rows, *getattr(data, name).shape)) for name in STATE}
        if not self._states:
            return zeros
        model, k = self.scene.model, self.directions.shape[1]
        basis = state_basis(model, np.asarray(data.qpos))
        parts = dict(zip(MOVING, np.split(basis, [model.nq, model.nq + model.nv], axis=1), strict=True))
        return {**zeros, **{name: zeros[name].at[k:].set(part) for name, part in parts.items()}}

    def _motion(self, model: mjx.Model, data: mjx.Data, tangents: dict[str, Array], steps: Int[Array, ""]) -> Any:
        k = self.directions.shape[1]
        along = jnp.zeros((self._rows, len(self.directions))).at[:k].set(self.directions.T)
        x = jnp.zeros(len(self.directions))

        def begin(x: Array, state: dict) -> dict:
            _, placed = self.scene.place(model, data.replace(**state), x)
            return state_of(placed)

        def advance(x: Array, state: dict) -> Any:
            return _advance(self.scene, *self.scene.place(model, data, x), state)

        def observe(x: Array, state: dict) -> Array:
            placed, start = self.scene.place(model, data, x)
            return self.scene.y.observe(placed, start.replace(**state))

        def with_tangents(function: Callable, state: dict, changes: dict) -> Any:
            one = lambda dx, change: jax.jvp(function, (x, state), (dx, change))  # noqa: E731
            return jax.vmap(one, out_axes=(None, 0))(along, changes)

        state, change = with_tangents(begin, state_of(data), tangents)
        record = _empty(contacts(data).distance.size, state, change)

        def body(i: Array, carry: Any) -> Any:
            state, change, record = carry
            (state, stages), (change, stage_changes) = with_tangents(advance, state, change)
            record = _note(record, i, jnp.maximum(1, -(-steps // SAMPLES)), state, change, stages, stage_changes)
            return state, change, record

        state, change, record = jax.lax.fori_loop(0, steps, body, (state, change, record))
        value, slopes = with_tangents(observe, state, change)
        return {**record, "value": value, "slopes": slopes}


def _advance(scene: SceneFunction, model: mjx.Model, data: mjx.Data, state: dict | None = None) -> Any:
    """The next state, and what the stages of the step have left."""
    after = STEPS[scene.differentiation](model, data.replace(**state) if state else data)
    touching, rows = contacts(after), constraint_rows(after)
    distance = touching.distance - touching.margin
    stages = {
        "collision": distance,
        "smooth dynamics": after.qacc_smooth,
        "constraints": (rows.D, rows.reference),
        "solver": after.qacc,
        "integrator": (after.qpos, after.qvel),
    }
    # As floats, like all that is carried along: integers have tangents of a kind of their own.
    still = jax.lax.stop_gradient(
        {"correction": _correction(model, after), "geoms": touching.geoms.astype(distance.dtype)}
    )
    return state_of(after), {**stages, **still}


def _correction(model: mjx.Model, data: mjx.Data) -> Float[Array, ""]:
    """The norm of the Newton step that the solver's answer still asks for, relative to the accelerations at play."""
    if model.nv == 0 or constraint_rows(data).jacobian.size == 0:
        return jnp.zeros(())
    rows, mass = read_rows(model, data), mjx.full_m(model, data)
    off = residual(data.qacc, mass, data.qfrc_smooth, rows)
    step = jnp.linalg.solve(mass + constraint_hessian(rows, rows.at(data.qacc)), off)
    size = jnp.linalg.norm(data.qacc) + jnp.linalg.norm(data.qacc_smooth)
    return jnp.linalg.norm(step) / jnp.where(size > 0, size, 1.0)


def _flat(state: dict) -> Array:
    """What moves, one after the other along the last axis."""
    return jnp.concatenate([state[name] for name in MOVING], axis=-1)


def _empty(contacts: int, state: dict, change: dict) -> dict[str, Array]:
    first = {**state, "change": _flat(change)}
    return {
        "step": jnp.full(SAMPLES + 1, -1).at[0].set(0),
        **{name: jnp.zeros((SAMPLES + 1, *value.shape)).at[0].set(value) for name, value in first.items()},
        "bad_value": jnp.full(len(QUANTITIES), NEVER),
        "bad_slope": jnp.full(len(QUANTITIES), NEVER),
        "distance": jnp.full(contacts, jnp.inf),
        "distance_step": jnp.zeros(contacts, int),
        "geoms": jnp.zeros((contacts, 2)),
        "correction": jnp.array(0.0),
    }


def _note(record: dict, i: Array, stride: Array, state: dict, change: dict, stages: dict, changes: dict) -> dict:
    """The record with step i (which makes state i + 1) in it."""
    at, step = 1 + i // stride, i + 1
    bad = {
        key: jnp.where(jnp.array([_is_bad(part[name]) for name in QUANTITIES]), step, NEVER)
        for key, part in (("bad_value", stages), ("bad_slope", changes))
    }
    is_nearer = stages["collision"] < record["distance"]
    nearer = {"distance": stages["collision"], "distance_step": i}
    samples = {"step": step, **state, "change": _flat(change)}
    return {
        **record,
        **{key: record[key].at[at].set(new) for key, new in samples.items()},
        **{key: jnp.minimum(record[key], new) for key, new in bad.items()},
        **{key: jnp.where(is_nearer, new, record[key]) for key, new in nearer.items()},
        "geoms": jnp.where(is_nearer[:, None], stages["geoms"], record["geoms"]),
        "correction": jnp.maximum(record["correction"], stages["correction"]),
    }


def _is_bad(tree: Any) -> Array:
    return ~jnp.array([jnp.isfinite(leaf).all() for leaf in jax.tree.leaves(tree)]).all()
