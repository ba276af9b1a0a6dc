"""Each quirk of the released program can be mended alone: one step in closed form, and what the study makes of it.

The box stands upright, so that its frame is the world's; a finger's setpoint is where it is.
"""

import contextlib
import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from tog_mjx.engines import make_simulator, precision
from tog_mjx.paper.published import published
from tog_mjx.paper.questions.catalogue import STUDIES
from tog_mjx.paper.released import MENDED, ReleasedSimulator, ReleasedState
from tog_mjx.paper.tasks import get_task
from tog_mjx.studies.study import Store

PHYSICS = get_task("grasp").scene.physics
DT, G, HALF = PHYSICS.timestep, PHYSICS.gravity, 0.25
STIFFNESS, DAMPING, FRICTION, _, SLOPE = PHYSICS.corner_floor
DEPTH = 1e-3
"""Of the two lower corners of a box that stands in the floor, in m."""
STANDING, FLYING = (0.0, HALF - DEPTH), (0.0, 2.0)
APART = (1.0, 3.0, 0.0, 0.0)
INSIDE = (HALF - 0.01, 2.0)
"""A finger 1 cm behind the right face of a flying box, at half its height."""
SHIFT = np.hypot(1e-3, 1e-3)


@functools.partial(jax.jit, static_argnums=0)
def _step(mended, scale, state):
    simulator = ReleasedSimulator(PHYSICS._replace(box_half=HALF * scale), mended)
    return simulator.step(state, state.fingers[:, :2].ravel())


def step(mended, place, velocity=(0.0, 0.0, 0.0), finger=APART, scale=(1.0, 1.0)) -> ReleasedState:
    """One step of an upright box at `place` (x, z); its half sides are the scene's times `scale`."""
    return _step(mended, jnp.array(scale), ReleasedState(jnp.array([*place, 0.0, *velocity]), jnp.array([finger])))


def close(found, expected):
    np.testing.assert_allclose(found, expected, rtol=1e-12, atol=1e-15)


def test_semi_implicit_euler_moves_with_the_new_velocities():
    start = (STANDING, (0.1, -0.2, 0.3), (HALF - 0.01, HALF, 0.5, -0.5))
    explicit, semi_implicit = step("nothing", *start), step("integrator", *start)
    for before, after in zip(explicit, semi_implicit, strict=True):
        half = before.shape[-1] // 2
        np.testing.assert_array_equal(before[..., half:], after[..., half:])
    close(explicit.box[:3], [DT * 0.1, HALF - DEPTH - DT * 0.2, DT * 0.3])
    close(semi_implicit.box[:3], np.array([*STANDING, 0]) + DT * semi_implicit.box[3:])
    close(semi_implicit.fingers[0, :2], np.array(start[2][:2]) + DT * semi_implicit.fingers[0, 2:])


@pytest.mark.parametrize(("mended", "damping"), [("nothing", 2.0), ("finger damping", 2 * np.sqrt(0.1 * 40.0))])
def test_damping_of_a_finger(mended, damping):
    found = step(mended, FLYING, finger=(1.0, 3.0, 0.5, 0.0)).fingers[0, 2:]
    close(found, [0.5 - DT * damping * 0.5 / 0.1, -DT * G])


def test_the_flips_finger_has_the_damping_of_the_paper_anyway():
    close(get_task("flip").scene.physics.finger_damping, 2.0)


@pytest.mark.parametrize(("mended", "damping"), [("nothing", DAMPING), ("contact damping", 0.0)])
def test_damping_of_a_contact(mended, damping):
    found = step(mended, STANDING, (0.0, -0.2, 0.0)).box[4]
    close(found, -0.2 + DT * (2 * (STIFFNESS * DEPTH + damping * 0.2) - G))


@pytest.mark.parametrize(("mended", "pull"), [("nothing", STIFFNESS * DEPTH - DAMPING * 1.0), ("pulling", 0.0)])
def test_a_floor_that_the_box_leaves_may_pull(mended, pull):
    close(step(mended, STANDING, (0.0, 1.0, 0.0)).box[4], 1.0 + DT * (2 * pull - G))


@pytest.mark.parametrize(("mended", "factor"), [("nothing", np.sqrt(2)), ("corner speed", 1.0)])
def test_velocity_of_a_corner(mended, factor):
    spin = 0.3
    found = step(mended, STANDING, (0.0, 0.0, spin)).box[3]
    coefficient = SLOPE * factor * spin * HALF  # The dampers of the two corners cancel in the sum of normal forces.
    close(found, -DT * coefficient * 2 * STIFFNESS * DEPTH)


@pytest.mark.parametrize(("mended", "shift"), [("nothing", SHIFT), ("distance", 0.0)])
def test_distance_of_finger_and_box(mended, shift):
    found = step(mended, FLYING, finger=(*INSIDE, 0.0, 0.0))
    force = STIFFNESS * (0.01 - shift)
    close(found.fingers[0, 2:], [DT * force / 0.1, -DT * G])
    close(found.box[3:5], [-DT * force, -DT * G])


@pytest.mark.parametrize(("mended", "axis"), [("nothing", [1, 0]), ("normals", [0, 1])])
def test_normal_of_a_flat_box_near_its_upper_face(mended, axis):
    """Half sides 250 and 50 mm, the finger 50 mm from the right face and 10 mm from the upper."""
    found = step(mended, FLYING, finger=(0.2, 2.04, 0.0, 0.0), scale=(1.0, 0.2))
    close(found.fingers[0, 2:], DT * (STIFFNESS * (0.01 - SHIFT) * np.array(axis) / 0.1 - [0, G]))


def test_the_square_boxs_sectors_are_those_of_its_nearest_faces():
    for x, z in np.random.default_rng(0).uniform(-HALF, HALF, (64, 2)):
        found = [step(mended, FLYING, (0, 0, 1), (x, 2 + z, 0.1, 0.2)) for mended in ("nothing", "normals")]
        for sector, face in zip(*found, strict=True):
            close(sector, face)


@pytest.mark.parametrize("speed", [0.3, 1.0])
def test_friction_of_finger_and_box(speed):
    normal = STIFFNESS * (0.01 - SHIFT)
    regular = FRICTION * speed / (np.hypot(1e-3, speed + 1e-3) + 1e-3)
    expected = {
        "nothing": SLOPE * speed if speed < FRICTION / SLOPE else regular,
        "friction regularisation": min(SLOPE * speed, FRICTION),
    }
    for mended, coefficient in expected.items():
        found = step(mended, FLYING, finger=(*INSIDE, 0.0, speed)).fingers[0, 3]
        close(found, speed - DT * (coefficient * normal / 0.1 + G + 2.0 * speed / 0.1))


def test_friction_without_regularisation_has_a_gradient_at_rest():
    def speed(v):
        return step("friction regularisation", FLYING, finger=(*INSIDE, 0.0, v)).fingers[0, 3]

    close(jax.grad(speed)(0.0), 1 - DT * (SLOPE * STIFFNESS * (0.01 - SHIFT) + 2.0) / 0.1)


def test_precision_is_float64_where_it_is_asked():
    dtypes = []
    for options in ({}, {"mended": "pulling"}, {"mended": "precision"}):
        with precision("released", **options):
            dtypes.append(jnp.zeros(()).dtype)
    assert dtypes == [jnp.float32, jnp.float32, jnp.float64]


@pytest.mark.parametrize("mended", [quirk for quirk in MENDED if quirk != "integrator"])
def test_what_moves_freely_at_rest_knows_no_quirk(mended):
    expected = ReleasedState(jnp.array([*FLYING, 0, 0, -DT * G, 0]), jnp.array([[1.0, 3.0, 0.0, -DT * G]]))
    for found, free in zip(step(mended, FLYING), expected, strict=True):
        np.testing.assert_array_equal(found, free)


def test_nothing_mended_is_the_released_program_bit_for_bit():
    scene = get_task("grasp").scene
    state = ReleasedState(jnp.array([0.0, 0.249, 0.02, 0.1, -0.2, 0.3]), jnp.array([[0.245, 0.3, -0.1, 0.4]]))
    found = [
        jax.jit(make_simulator("released", scene, **options).step)(state, jnp.array([0.1, 0.3]))
        for options in ({}, {"mended": "nothing"})
    ]
    for plain, named in zip(*found, strict=True):
        np.testing.assert_array_equal(plain, named)


def test_undamped_contacts_do_not_lift_and_the_released_ones_not_from_a_guess_1_mm_off(tmp_path):
    study = STUDIES["released_quirks"]
    table = study.run(True, Store(tmp_path, resume=False), lambda *_: contextlib.nullcontext(lambda _: None))
    found = study.summary(table).set_index(["task", "method", "mended", "symmetric", "noise"]).sort_index()
    flip, grasp = found.loc["flip", "exact, plain"], found.loc["grasp", "exact, plain"]
    assert (flip.success == 1).all()
    assert grasp.success["nothing", False, 0.0] == 1
    assert grasp.success["nothing", False, 1e-3] == 0
    assert (grasp.success["contact damping"] == 0).all()
    assert (found.loc["grasp", "stochastic, plain"].success == 0).all()
    np.testing.assert_allclose(grasp["J best"]["nothing", False, 0.0], published("grasp", "exact").cost_best, atol=5e-4)
