"""What of the start and of the model can be a problem's variable, against closed forms."""

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest

import tog_mjx as tog
from tog_mjx.checks.step_check import compile_quickly

# A hand that is led, with a mark on it, and a filter that forgets.
DT, TAU, STEPS = 0.01, 0.05, 6
MARK, TURN = np.array([0.3, -0.1, 0.2]), np.array([0.5, 0.5, 0.5, 0.5])
LED = f"""
<mujoco model="led">
  <option timestep="{DT}"/>
  <worldbody>
    <body name="hand" mocap="true" pos="1 2 3" quat=".5 .5 .5 .5">
      <geom size="0.1"/><site name="mark" pos="0.3 -0.1 0.2"/></body>
    <body><joint name="hinge" axis="0 1 0"/><geom size="0.1" mass="1"/></body>
  </worldbody>
  <actuator><general joint="hinge" dyntype="filter" dynprm="{TAU}"/></actuator>
</mujoco>"""


@pytest.fixture(scope="module")
def led() -> mujoco.MjModel:
    return mujoco.MjModel.from_xml_string(LED)


def test_activations_and_mocap_bodies_are_variables_of_the_start(led):
    """Activations and places stand for themselves, a rotation for one from the start's own, in the body's frame."""
    of_act, of_hand, of_mark = 2.0, np.array([1.0, -2.0, 0.5]), np.array([0.3, 0.7, -1.1])

    def cost(last: tog.State) -> jax.Array:
        return of_act * last.act[0] + of_hand @ last.body("hand") + of_mark @ last.site("mark")

    kinds = [tog.Start("act"), tog.Start("mocap_pos[0, 1]"), tog.Start("mocap_quat")]
    problem = tog.Problem(led, STEPS, kinds, cost=cost)
    assert problem.bound.names == ("act[0]", "mocap_pos[0, 1]", *(f"mocap_quat[0, {i}]" for i in range(3)))
    np.testing.assert_array_equal(problem.x0, [0, 2, 0, 0, 0])
    act, y, turn = 0.4, 5.0, np.array([0.02, -0.3, 0.1])
    run = compile_quickly(jax.value_and_grad(tog.objective(problem)))
    value, slope = run(jnp.array([act, y, 0, 0, 0]))
    rotation, quaternion = np.zeros(9), TURN.copy()
    mujoco.mju_quat2Mat(rotation, quaternion)
    kept, place = (1 - DT / TAU) ** STEPS, np.array([1, y, 3])
    ways = rotation.reshape(3, 3).copy()
    np.testing.assert_allclose(value, of_act * act * kept + of_hand @ place + of_mark @ (place + ways @ MARK))
    np.testing.assert_allclose(slope[:2], [of_act * kept, of_hand[1] + of_mark[1]], rtol=1e-12)
    np.testing.assert_allclose(slope[2:], np.cross(MARK, of_mark @ ways), rtol=1e-12)
    mujoco.mju_quatIntegrate(quaternion, turn, 1.0)
    mujoco.mju_quat2Mat(rotation, quaternion)
    moved = of_mark @ (rotation.reshape(3, 3) - ways) @ MARK
    np.testing.assert_allclose(run(jnp.array([act, y, *turn]))[0] - value, moved, rtol=1e-10)


def test_starts_may_place_a_mocap_body(led):
    def sample(key: jax.Array) -> dict[str, jax.Array]:
        return {"mocap_pos": jax.random.normal(key, (1, 3))}

    problem = tog.Problem(led, STEPS, cost=lambda last: last.body("hand")[2], start=tog.Starts(sample, 3))
    key = jax.random.key(2)
    drawn = jax.vmap(sample)(jax.random.split(key, 3))["mocap_pos"]
    np.testing.assert_allclose(tog.objective(problem).each(problem.x0, key), drawn[:, 0, 2], rtol=1e-12)


def nothing(_: tog.State) -> jax.Array:
    return jnp.zeros(())


def test_parameters_have_one_name_a_number(led):
    """That of an array without axes is its own."""
    bound = tog.Problem(led, STEPS, tog.Parameters("opt.timestep", "opt.gravity[2]"), cost=nothing).bound
    assert bound.names == ("opt.timestep", "opt.gravity[2]")
    np.testing.assert_array_equal(bound.guess, [DT, -9.81])


def test_a_start_without_such_numbers_is_told():
    model = mujoco.MjModel.from_xml_string("<mujoco><worldbody><geom size='1'/></worldbody></mujoco>")
    with pytest.raises(tog.InputError, match="the scene has no mocap_pos"):
        tog.Problem(model, STEPS, tog.Start("mocap_pos"), cost=nothing)
