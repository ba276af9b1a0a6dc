"""Many steps of any MJX model: the same as stepping by hand, whatever the form of the controls."""

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest

import tog_mjx as tog
from tog_mjx.stepping._mjx import mjx

# A driven pendulum that swings into its joint limit.
XML = """<mujoco><option timestep="0.005" tolerance="1e-14" iterations="50"/><worldbody>
  <body><joint name="hinge" axis="0 1 0" range="-20 20" limited="true"/>
    <geom type="capsule" size="0.02" fromto="0 0 0 0 0 -0.5" mass="1"/><site name="tip" pos="0 0 -0.5"/>
  </body></worldbody>
  <actuator><motor joint="hinge"/><motor joint="hinge" gear="0.5"/></actuator></mujoco>"""
STEPS = 60


@pytest.fixture(scope="module")
def model():
    return mjx.put_model(mujoco.MjModel.from_xml_string(XML))


@pytest.fixture(scope="module")
def rows():
    return jnp.array(np.random.default_rng(0).normal(2, 1, (STEPS, 2)))


@pytest.fixture(scope="module")
def by_hand(model, rows):
    step, data, seen = jax.jit(mjx.step), mjx.make_data(model), []
    for ctrl in rows:
        data = step(model, data.replace(ctrl=ctrl))
        seen.append((float(data.qpos[0]), float(data.qvel[0])))
    return np.array(seen)


def test_it_steps_with_one_row_a_step(model, rows, by_hand):
    last, (qpos, qvel) = tog.simulate(model, mjx.make_data(model), rows, STEPS)
    np.testing.assert_allclose(np.c_[qpos, qvel], by_hand, atol=1e-12)
    np.testing.assert_allclose([last.qpos[0], last.time], [by_hand[-1, 0], STEPS * 0.005], atol=1e-12)
    assert by_hand[:, 0].max() > np.deg2rad(20)


def test_constant_controls_are_rows_that_repeat(model, rows):
    constant = tog.simulate(model, mjx.make_data(model), rows[0], STEPS)[1]
    repeated = tog.simulate(model, mjx.make_data(model), jnp.tile(rows[0], (STEPS, 1)), STEPS)[1]
    np.testing.assert_array_equal(constant[0], repeated[0])


def test_a_batch_is_its_members(model, rows, by_hand):
    data = jax.vmap(lambda q: mjx.make_data(model).replace(qpos=q))(jnp.array([[0.0], [0.1]]))
    shared = tog.simulate(model, data, rows, STEPS)[1][0]
    own = tog.simulate(model, data, jnp.stack([rows, rows]), STEPS)[1][0]
    np.testing.assert_allclose(shared[0, :, 0], by_hand[:, 0], atol=1e-12)
    np.testing.assert_array_equal(shared, own)
    assert shared.shape == (2, STEPS, 1)


def test_gradients_are_differences_with_and_without_checkpoints(model, rows):
    def tip_height(rows, **options):
        def height(data):
            return data.site_xpos[0, 2]

        return tog.simulate(model, mjx.make_data(model), rows, STEPS, observe=height, **options)[1].sum()

    both = jax.jit(jax.value_and_grad(tip_height))
    plain, kept = both(rows)[1], jax.jit(jax.grad(lambda rows: tip_height(rows, checkpoint=12)))(rows)
    np.testing.assert_allclose(kept, plain, rtol=1e-10, atol=1e-14)
    direction = jnp.array(np.random.default_rng(1).normal(size=rows.shape))
    difference = (both(rows + 1e-6 * direction)[0] - both(rows - 1e-6 * direction)[0]) / 2e-6
    np.testing.assert_allclose((plain * direction).sum(), difference, rtol=1e-6)


@pytest.mark.parametrize("whole", [False, True])
def test_a_batch_of_models_is_its_members(model, rows, by_hand, whole):
    """As domain randomisation makes it: some fields have an axis more; or all, out of vmap, and a policy drives."""
    gears = jnp.array([1.0, 0.0])[:, None, None] * model.actuator_gear
    data = jax.vmap(lambda q: mjx.make_data(model).replace(qpos=q))(jnp.zeros((2, 1)))
    if whole:
        models = jax.vmap(lambda gear: model.tree_replace({"actuator_gear": gear}))(gears)
        controls = lambda state, time: rows[jnp.round(time / 0.005).astype(int)] + 0 * state.qpos  # noqa: E731
    else:
        models, controls = model.tree_replace({"actuator_gear": gears}), rows
    qpos, qvel = tog.simulate(models, data, controls, STEPS)[1]
    np.testing.assert_allclose(np.c_[qpos[0], qvel[0]], by_hand, atol=1e-12)
    np.testing.assert_array_equal(qpos[1], 0)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"controls": jnp.zeros(3)}, r"controls have shape \(3,\); give \[2\] or \[60, 2\]"),
        ({"controls": lambda *_: jnp.zeros(3)}, r"returns an array of shape \(3,\); give \[2\]"),
        ({"controls": lambda *_: None}, r"controls\(state, time\) returns no array of numbers; give"),
        ({"differentiation": "magic"}, "differentiation='magic' is unknown"),
        ({"steps": 0}, "steps is 0"),
        ({"checkpoint": 7}, "give a divisor of the 60 steps"),
    ],
)
def test_bad_input_is_one_line(model, changes, message):
    given = {"controls": jnp.zeros(2), "steps": STEPS} | changes
    with pytest.raises(tog.InputError, match=message):
        tog.simulate(model, mjx.make_data(model), **given)


def test_batches_that_do_not_match_are_one_line(model):
    models = model.tree_replace({"body_mass": jnp.ones((3, 2))})
    data = jax.vmap(lambda q: mjx.make_data(model).replace(qpos=q))(jnp.zeros((2, 1)))
    with pytest.raises(tog.InputError, match="body_mass of the model has 3 members, and the data 2: give as many"):
        tog.simulate(models, data, jnp.zeros(2), STEPS)
    single = r"body_mass of the model has the shape \[3, 2\]: it is a batch of models; take them one by one"
    with pytest.raises(tog.InputError, match=single):
        tog.simulate(models, mjx.make_data(model), jnp.zeros(2), STEPS)
    with pytest.raises(tog.InputError, match=single):
        tog.step(models, mjx.make_data(model))
