"""The penalty simulator against closed forms."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from jax.test_util import check_grads
from states import KINDS, draw_state

from tog_mjx.engines import PenaltySimulator, make_simulator
from tog_mjx.engines.objective import final_cost
from tog_mjx.engines.penalty import box_distance, mujoco_limit_force, paper_force
from tog_mjx.engines.plane import Plane
from tog_mjx.mjcf.contact import PenaltyLaw
from tog_mjx.paper.tasks import get_task
from tog_mjx.running.types import AnyArray

LAW = PenaltyLaw(stiffness=1000.0, damping=60.0, friction=0.7, viscosity=20.0, slope=2.0)
SCENE = get_task("grasp").scene
# The cube root of the resolution balances truncation and rounding of a central difference.
EPS = float(np.finfo(float).eps) ** (1 / 3)


class PlanarArrays(NamedTuple):
    box: AnyArray
    fingers: AnyArray


@jax.jit
def step(simulator: PenaltySimulator, state, setpoints):
    return simulator.step(state, setpoints)


@jax.jit
def observed_step(simulator: PenaltySimulator, box, fingers, setpoints):
    return simulator.observe(simulator.step(simulator.init(box, fingers), setpoints))


def after(simulator: PenaltySimulator, box, fingers, setpoints, steps: int):
    state = simulator.init(jnp.asarray(box, float), jnp.asarray(fingers, float))
    for _ in range(steps):
        state = step(simulator, state, jnp.asarray(setpoints, float))
    return PlanarArrays(*simulator.observe(state))


def test_free_fall_is_that_of_semi_implicit_euler():
    simulator = PenaltySimulator.from_scene(SCENE)
    box, fingers = np.array([0.3, 5, 0.4, 1, 2, -3]), np.array([[-9, 3, 0, 0], [9, 3, 0, 0]])
    steps, dt, g = 100, 0.001, 9.81
    end = after(simulator, box, fingers, np.zeros(4), steps).box
    t = steps * dt
    fall = g * dt**2 * steps * (steps + 1) / 2
    np.testing.assert_allclose(end, [0.3 + t, 5 + 2 * t - fall, 0.4 - 3 * t, 1, 2 - g * t, -3], atol=1e-12)


def test_a_finger_comes_to_rest_where_its_spring_carries_it():
    p = SCENE.physics
    box, fingers = np.array([5, 0.25, 0, 0, 0, 0]), np.array([[-1.0, 1, 0, 0], [1.0, 1, 0, 0]])
    end = after(PenaltySimulator.from_scene(SCENE), box, fingers, [-1.2, 1.1, 0.8, 0.9], 4000).fingers
    sag = p.finger_mass * p.gravity / p.finger_stiffness
    np.testing.assert_allclose(end, [[-1.2, 1.1 - sag, 0, 0], [0.8, 0.9 - sag, 0, 0]], atol=1e-9)


@pytest.mark.parametrize("friction", ["mujoco", "paper"])
def test_the_box_rests_on_two_corners(friction):
    p = SCENE.physics
    far = np.array([[-9, 3, 0, 0], [9, 3, 0, 0]])
    end = after(PenaltySimulator.from_scene(SCENE, friction), [0, 0.25, 0, 0, 0, 0], far, [-9, 3, 9, 3], 4000).box
    sink = p.box_mass * p.gravity / (2 * p.corner_floor.stiffness)
    np.testing.assert_allclose(end, [0, 0.25 + p.corner_radius - sink, 0, 0, 0, 0], atol=1e-9)


@pytest.mark.parametrize("friction", ["mujoco", "paper"])
@pytest.mark.parametrize("kind", KINDS)
def test_contact_of_finger_and_box_keeps_momentum(friction, kind):
    # Lifted off the floor and with controllers that do not push, only gravity acts from outside.
    p = SCENE.physics
    box, fingers = draw_state(kind, p, 3)
    box[1], fingers[:, 1] = box[1] + 3, fingers[:, 1] + 3
    simulator = PenaltySimulator.from_scene(SCENE, friction)
    relaxed = fingers[:, :2] + p.finger_damping / p.finger_stiffness * fingers[:, 2:]
    end = after(simulator, box, fingers, relaxed.ravel(), 1)

    def momentum(box, fingers):
        return p.box_mass * box[3:5] + p.finger_mass * fingers[:, 2:].sum(0)

    change = momentum(*end) - momentum(box, fingers)
    weight = p.gravity * (p.box_mass + 2 * p.finger_mass)
    np.testing.assert_allclose(change, [0, -p.timestep * weight], atol=1e-12)


speeds = st.floats(-2, 2)


@given(st.floats(1e-4, 0.05), speeds, speeds)
def test_the_limit_force_is_the_nearest_point_of_the_cone(penetration, normal_speed, tangential_speed):
    wanted = np.array([1000 * penetration - 60 * normal_speed, -20 * tangential_speed])
    force = np.asarray(mujoco_limit_force(LAW, *map(jnp.asarray, (penetration, normal_speed, tangential_speed))))
    mu = LAW.friction
    scale = 1 + np.abs(wanted).max()
    assert abs(force[1]) <= mu * force[0] + 1e-12 * scale
    # A projection onto a convex cone is known by its remainder: normal to the point, and in the polar cone.
    remainder = wanted - force
    assert abs(remainder @ force) <= 1e-12 * scale**2
    for edge in (np.array([1, mu]), np.array([1, -mu])):
        assert remainder @ edge <= 1e-12 * scale


@given(st.floats(1e-4, 0.05), speeds, speeds)
def test_the_papers_force(penetration, normal_speed, tangential_speed):
    normal, tangential = paper_force(LAW, *map(jnp.asarray, (penetration, normal_speed, tangential_speed)))
    assert normal == max(0.0, 1000 * penetration - 60 * normal_speed)
    mu = min(2 * abs(tangential_speed), 0.7)
    np.testing.assert_allclose(tangential, -np.sign(tangential_speed) * mu * normal, rtol=1e-12, atol=1e-300)


@given(st.floats(-0.6, 0.6), st.floats(-0.6, 0.6))
def test_box_distance_is_the_distance_to_the_outline(x, z):
    distance, normal = box_distance(Plane(0.25, 0.25), Plane(jnp.array(x), jnp.array(z)))
    ticks = np.linspace(-0.25, 0.25, 2001)
    sides = [(ticks, 0 * ticks + 0.25), (ticks, 0 * ticks - 0.25), (0 * ticks + 0.25, ticks), (0 * ticks - 0.25, ticks)]
    nearest = min(np.hypot(x - a, z - b).min() for a, b in sides)
    is_inside = max(abs(x), abs(z)) < 0.25
    np.testing.assert_allclose(distance, -nearest if is_inside else nearest, atol=2e-4)
    np.testing.assert_allclose(np.hypot(*normal), 1, rtol=1e-12)
    # Moving against the normal by the distance ends on the outline.
    foot = np.array([x, z]) - np.asarray(normal) * float(distance)
    np.testing.assert_allclose(np.abs(foot).max(), 0.25, atol=1e-9)


@pytest.mark.parametrize("friction", ["mujoco", "paper"])
@pytest.mark.parametrize("kind", KINDS)
def test_one_step_is_differentiated_right_in_both_modes(friction, kind):
    simulator = PenaltySimulator.from_scene(SCENE, friction)
    box, fingers = draw_state(kind, SCENE.physics, 7)

    def numpy_step(*args):
        return tuple(observed_step(simulator, *map(jnp.asarray, args)))

    args = (jnp.array(box), jnp.array(fingers), jnp.array([-0.1, 0.3, 0.2, 0.4]))
    check_grads(numpy_step, args, order=1, modes=["fwd", "rev"], eps=EPS, rtol=1e-6, atol=1e-6)


def test_the_drawn_states_are_what_they_are_called():
    p = SCENE.physics
    simulator = PenaltySimulator.from_scene(SCENE)
    for kind in KINDS:
        box, fingers = draw_state(kind, p, 7)
        state = simulator.init(box, fingers)
        forces = [simulator._finger_box(state.box, finger)[0] for finger in state.fingers]
        floor = np.sum([simulator._corner_floor(state.box, Plane.of(corner))[0] for corner in p.corners], axis=0)
        frame = np.array([[np.cos(box[2]), -np.sin(box[2])], [np.sin(box[2]), np.cos(box[2])]])
        pairs = [(abs(f @ frame[:, 0]), abs(f @ frame[:, 1])) for f in np.asarray(forces)] + [(floor[1], abs(floor[0]))]
        for normal, tangential in pairs:
            if kind in ("free", "parting"):
                assert normal == tangential == 0
            elif kind == "sticking":
                assert 0 < tangential < 0.69 * normal
            else:
                np.testing.assert_allclose(tangential, 0.7 * normal)


@pytest.mark.parametrize("friction", ["mujoco", "paper"])
@pytest.mark.parametrize("name", ["flip", "grasp"])
def test_the_horizons_gradient_is_that_of_differences(name, friction):
    task = get_task(name)
    simulator = make_simulator("penalty", task.scene, friction=friction)
    low, high = np.array(task.window).T
    points = np.random.default_rng(4).uniform(low, high, (12, 2))
    setpoints = jnp.array([task.expand(point) for point in jnp.array(points)])
    cost = jax.jit(jax.vmap(lambda u: final_cost(task, simulator, u)))
    value, along = jax.jit(jax.vmap(jax.value_and_grad(lambda u: final_cost(task, simulator, u))))(setpoints)
    # The mode of differentiation changes no value.
    np.testing.assert_allclose(value, cost(setpoints), rtol=1e-13)
    h = 1e-8
    columns = [(cost(setpoints + h * e) - cost(setpoints - h * e)) / (2 * h) for e in np.eye(setpoints.shape[1])]
    differences = np.stack(columns, 1)
    scale = 1 + np.abs(differences).max(1, keepdims=True)
    assert (np.abs(along - differences) <= 1e-4 * scale).all()
