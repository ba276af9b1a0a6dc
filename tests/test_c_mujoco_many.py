"""Many motions of C MuJoCo at once, on all threads and devices, in any precision: each is that of one alone."""

import dataclasses
import os
import signal
import subprocess
import sys
import time

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from c_mujoco_scenes import STEPS, bodies, by_hand, floor, somewhere

import tog_mjx as tog
from tog_mjx.engines.c_mujoco.forward import Forward
from tog_mjx.engines.c_mujoco.linearise import slopes
from tog_mjx.engines.c_mujoco.threads import for_each, pool
from tog_mjx.running.devices import cores


@pytest.fixture(scope="module", name="bodies")
def _bodies() -> tog.Problem:
    return bodies()


@pytest.fixture(scope="module")
def x(bodies) -> np.ndarray:
    return somewhere(bodies)


def test_many_motions_are_those_of_one_and_no_call_leaves_anything_to_the_next(bodies, x):
    """To the bit, also after a motion that burst, and for any number of threads."""
    points = jnp.asarray(x + np.random.default_rng(2).normal(size=(5, len(x))) * 0.3)

    def ends(x):
        motion = tog.rollout(bodies, x, "mujoco")
        return jnp.concatenate([motion.qpos[-1], motion.qvel[-1]])

    together, slopes_together = jax.vmap(ends)(points), jax.vmap(jax.jacfwd(ends))(points)
    assert np.isnan(ends(points[0] * 1e8)).all()
    one_by_one = [ends(point) for point in points]
    np.testing.assert_array_equal(together, one_by_one)
    assert len({row.tobytes() for row in np.asarray(together)}) == len(points)
    for point, slope in zip(points, slopes_together, strict=True):
        # The last bit of a start, which is computed otherwise for many, divided by the step of a difference.
        np.testing.assert_allclose(jax.jacfwd(ends)(point), slope, atol=1e-8)


def test_neither_the_number_of_threads_nor_what_ran_before_changes_a_bit(bodies, monkeypatch):
    """Of motions and their derivatives, some of which burst; nor how many a thread moves at once."""
    model, rng = bodies.scene.model, np.random.default_rng(3)
    forwards = [Forward(model, bodies.origin, threads) for threads in (1, 3)]
    many = rng.normal(size=(7, STEPS, 2)), np.tile(forwards[0].start, (7, 1))
    many[1][:, 1 + model.nq :] += rng.normal(size=(7, forwards[0].start.size - 1 - model.nq))
    many[1][3, 1 + model.nq] = 1e12

    def run(forward: Forward, some: slice) -> list[np.ndarray]:
        controls, start = (part[some] for part in many)
        after = forward.motions(start, controls)
        before = np.concatenate([start[:, None], after[:, :-1]], axis=1)
        rows = (part.reshape(-1, part.shape[-1]) for part in (before, after, controls))
        return [after, *(part.reshape(len(start), STEPS, *part.shape[1:]) for part in slopes(forward, *rows))]

    expected = run(forwards[0], slice(None))
    assert [np.isnan(motion).any() for motion in expected[0]] == [i == 3 for i in range(7)]
    monkeypatch.setattr("tog_mjx.engines.c_mujoco.forward.AT_ONCE", STEPS)
    for forward in forwards:
        for some in (slice(2, 4), slice(None), slice(4, 5)):
            for found, of_all in zip(run(forward, some), expected, strict=True):
                np.testing.assert_array_equal(found, of_all[some])


def test_an_interruption_ends_all_threads(bodies):
    """They would sleep for minutes."""

    def one(_, i):
        if i == 0:
            os.kill(os.getpid(), signal.SIGINT)
        time.sleep(0.01)

    forward = Forward(bodies.scene.model, bodies.origin, 2)
    with pytest.raises(KeyboardInterrupt):
        for_each(forward, np.tile(forward.row, (30_000, 1)), one)
    for done in [pool().submit(int) for _ in range(cores())]:
        assert done.result(timeout=60) == 0


def test_starts_descents_landscapes_and_single_precision():
    def sample(key):
        return {"qvel": jax.random.normal(key, [3]) * 0.1}

    problem = floor(start=tog.Starts(sample, 4), variables=tog.Controls())
    J, key, x = tog.objective(problem, "mujoco"), jax.random.key(1), jnp.array([0.3, -0.1])
    costs = J.each(x, key)
    motions = J.motion(x, key)
    for cost, qpos, qvel in zip(costs, motions.qpos, motions.qvel, strict=True):
        data = by_hand(problem, {"qvel": qvel[0]}, lambda *_: np.asarray(x))
        np.testing.assert_allclose(qpos[-1], data.qpos, rtol=1e-12, atol=1e-14)
        np.testing.assert_allclose(cost, ((data.qpos - 0.3) ** 2).sum() + data.qvel @ np.arange(3), rtol=1e-12)
    single = dataclasses.replace(problem, start=None)
    J = tog.objective(single, "mujoco")
    found = tog.solve(single, engine="mujoco", budget=400)
    assert J(found.best) < J(single.x0) - 0.1
    seen = tog.landscape(single, "mujoco", size=3)
    np.testing.assert_allclose(seen.costs.ravel(), [J(point) for point in seen.points], rtol=1e-12)
    expected = jax.grad(J)(x)
    with jax.enable_x64(False):
        gradient = jax.grad(tog.objective(single, "mujoco"))(jnp.asarray(np.asarray(x), jnp.float32))
    assert gradient.dtype == jnp.float32
    np.testing.assert_allclose(gradient, expected, rtol=1e-3)


def test_float64_of_one_thread_is_enough(x, bodies):
    """As `tog.solve("flip")` and landscapes have it: a callback runs in another thread."""
    J = tog.objective(bodies, "mujoco")
    expected = jax.grad(J)(jnp.asarray(x))
    jax.config.update("jax_enable_x64", False)
    try:
        with jax.enable_x64(True):
            gradient = jax.jit(jax.grad(J))(jnp.asarray(x))
    finally:
        jax.config.update("jax_enable_x64", True)
    assert gradient.dtype == jnp.float64
    np.testing.assert_allclose(gradient, expected, atol=1e-7)


DEVICES = """
import os, jax, numpy as np
jax.config.update("jax_num_cpu_devices", os.cpu_count())
import tog_mjx as tog
from tog_mjx.running.devices import over_devices
flip = tog.get_task("flip")
with jax.enable_x64(True):
    points = np.tile(flip.x0, (8 * jax.device_count(), 1))
    slopes = over_devices(jax.vmap(jax.grad(tog.objective(flip, "mujoco"))))(points)
assert np.ptp(slopes, axis=0).max() < 1e-9 * np.abs(slopes).max()
"""


def test_all_devices_at_once_wait_for_none():
    """Each core a device, and each in a callback with arguments that JAX would copy on a thread of its own."""
    subprocess.run([sys.executable, "-c", DEVICES], check=True, timeout=100)
