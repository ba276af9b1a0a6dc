"""Random models at random states: a step has MJX's value, and in both modes the derivative of its differences.

A structure (joints, geoms, equalities, tendons, actuators, cone, integrator) is a program, and compiling it is what
this test costs. So hypothesis draws two structures, which have all of these between them, and each is run with 15
models at once that differ in all their numbers, in four states each: "30 models" are 30 sets of numbers in two
programs, the same two each time. Stock `mjx.step` would be compiled beside them, and is in the first one alone.
`TOG_MJX_FUZZ=n` draws n structures for each cone and integrator in their place, and lets `tog.check_scene` judge a
model of each.
"""

import inspect
import os

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest
from hypothesis import Phase, event, given, settings
from hypothesis import strategies as st
from random_models import Structure, model_of, state_of, structure_of

import tog_mjx as tog
from tog_mjx.checks.step_check import compile_quickly
from tog_mjx.gradients.differences import halvings, settled_differences
from tog_mjx.stepping._mjx import make_data, mjx, put_model
from tog_mjx.stepping.implicit import STEPS

MODELS, STATES, HORIZON = 15, 4, 20
SETTLED, TOLERANCE = 1e-6, 1e-5
SAME = 1e-8
"""Of a value: two solvers of the same rows, rounded otherwise, may stop one iteration apart."""
ON_DEMAND = "TOG_MJX_FUZZ" in os.environ
step = inspect.unwrap(STEPS["implicit"])
"""`tog.step` without its checkpoint, by which all is written down twice, to be computed again on the way back."""
PROGRAMS = [(0, "elliptic", "Euler"), (1, "pyramidal", "implicitfast")]
if ON_DEMAND:
    INTEGRATORS = ("Euler", "implicitfast", "RK4")
    PROGRAMS = [(i % 2, cone, name) for cone in ("elliptic", "pyramidal") for i, name in enumerate(INTEGRATORS)]


def stacked(models: list[mjx.Model]) -> mjx.Model:
    """Models of one structure along a leading axis of their arrays, repeated for each state."""
    leaves, (tree, *_) = zip(*map(jax.tree.flatten, models), strict=True)
    return jax.tree.unflatten(tree, [np.repeat(np.stack(some), STATES, axis=0) for some in zip(*leaves, strict=True)])


def differentiated(model: mujoco.MjModel, steps: tuple):
    """A weighted next state by each of the steps, and its derivative by the first along a direction, in both modes."""

    def run(at: mjx.Model, x: jax.Array, direction: jax.Array, weight: jax.Array) -> tuple[tuple, jax.Array, jax.Array]:
        ends = np.cumsum([model.nq, model.nv, model.na])

        def after(step, t) -> jax.Array:
            qpos, qvel, act, ctrl = jnp.split(x + t * direction, ends)
            data = step(at, make_data(at).replace(qpos=qpos, qvel=qvel, act=act, ctrl=ctrl))
            return weight @ jnp.concatenate([data.qpos, data.qvel, data.act])

        value, push = jax.linearize(lambda t: after(steps[0], t), 0.0)
        others = (after(step, 0.0) for step in steps[1:])
        return (value, *others), push(1.0), jax.linear_transpose(push, 0.0)(1.0)[0]

    return compile_quickly(jax.vmap(run))


def check(structure: Structure, seed: int, steps: tuple) -> None:
    rng = np.random.default_rng(seed)
    models = [model_of(structure, rng) for _ in range(MODELS)]
    x = np.array([state_of(model, rng) for model in models for _ in range(STATES)])
    at, model = stacked([put_model(model) for model in models]), models[0]
    direction = rng.normal(size=x.shape)
    weight = rng.normal(size=(len(x), model.nq + model.nv + model.na))
    run = differentiated(model, steps)
    values, forward, reverse = jax.tree.map(np.asarray, run(at, x, direction, weight))
    np.testing.assert_allclose(values[-1], values[0], rtol=SAME, atol=SAME)
    assert np.isfinite(forward).all()
    np.testing.assert_allclose(reverse, forward, rtol=1e-9, atol=1e-9 * np.abs(forward).max())

    def moved(t) -> np.ndarray:
        """Of two points for each state, one after the other."""
        ends = [run(at, x + some * direction, direction, weight)[0][-1] for some in (t[::2], t[1::2])]
        return np.stack(ends, axis=1).reshape(-1, 1)

    expected = settled_differences(moved, np.zeros((len(x), 1)), halvings(1e-5, 5), order=4)
    settled = expected.change <= SETTLED
    assert settled.mean() >= 0.75
    np.testing.assert_allclose(forward[settled], expected.jacobian[settled, 0, 0], rtol=TOLERANCE)


# Every example is compiled, so that a smaller failing one would cost minutes.
@pytest.mark.parametrize(("half", "cone", "integrator"), PROGRAMS)
@settings(max_examples=int(os.environ.get("TOG_MJX_FUZZ", 1)), phases=[Phase.generate])
@given(seed=st.integers(0, 10**6))
def test_a_step_has_mjxs_value_and_the_derivative_of_differences(half, cone, integrator, seed):
    is_first = (half, cone, integrator) == PROGRAMS[0]
    steps = (step, mjx.step) if is_first or ON_DEMAND else (step,)
    check(structure_of(seed, half, cone, integrator), seed, steps)


def rolled(model: mujoco.MjModel, start: np.ndarray, controls: np.ndarray) -> np.ndarray:
    """Positions of C MuJoCo after `HORIZON` steps, of controls [N, nu]."""
    ends = []
    for ctrl in controls:
        data = mujoco.MjData(model)
        data.qpos[:], data.qvel[:], data.act[:], _ = np.split(start, np.cumsum([model.nq, model.nv, model.na]))
        data.ctrl[:] = ctrl
        mujoco.mj_step(model, data, HORIZON)
        ends.append(data.qpos.copy())
    return np.array(ends)


@pytest.mark.skipif(not ON_DEMAND, reason="a verdict costs a minute or more: TOG_MJX_FUZZ asks for it")
@pytest.mark.parametrize(("half", "cone", "integrator"), PROGRAMS)
@settings(max_examples=int(os.environ.get("TOG_MJX_FUZZ", 1)), phases=[Phase.generate])
@given(seed=st.integers(0, 10**6))
def test_what_is_trusted_is_the_derivative_of_c_mujoco(half, cone, integrator, seed):
    """Where differences settle; what is not trusted may be anything."""
    rng = np.random.default_rng(seed)
    model = model_of(structure_of(seed, half, cone, integrator), rng)
    x, start = state_of(model, rng), mujoco.MjData(model)
    start.qpos[:], start.qvel[:], start.act[:], start.ctrl[:] = np.split(x, np.cumsum([model.nq, model.nv, model.na]))
    verdict = tog.check_scene(model, start, steps=HORIZON, wrt="ctrl", quick=True)
    event(verdict.line)
    expected = settled_differences(
        lambda controls: rolled(model, x, np.asarray(controls)), start.ctrl[None], halvings(1e-2, 8)
    )
    if verdict.word == "trust" and expected.change[0] <= SETTLED:
        off = np.linalg.norm(np.array(verdict.gradient) - expected.jacobian[0])
        assert off <= 0.05 * np.linalg.norm(expected.jacobian[0])
