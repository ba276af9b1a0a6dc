"""Each thing that MJX keeps private and `stepping._mjx` reads is what it is taken for: C MuJoCo's, at one state."""

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest

from tog_mjx.checks import step_check
from tog_mjx.mjcf.pairs import geom_pairs
from tog_mjx.stepping._mjx import (
    constraint_rows,
    contacts,
    has_collision_fn,
    make_data,
    mjx,
    put_model,
    tendon_jacobian,
    with_constraint_force,
)

# One row of each kind at least, all of them active: an equality, a friction loss, a limit, two contacts of different
# condim; and a tendon whose Jacobian depends on the state.
XML = """
<mujoco>
  <option cone="elliptic" jacobian="dense"/>
  <default><geom margin="0.01"/></default>
  <worldbody>
    <geom name="floor" type="plane" size="1 1 0.1" condim="1" friction="0.2"/>
    <site name="anchor" pos="0 0.3 0.5"/>
    <body pos="0 0 0.095">
      <joint name="x" type="slide" axis="1 0 0" frictionloss="0.3"/>
      <joint name="z" type="slide" axis="0 0 1"/>
      <geom type="sphere" conaffinity="0" size="0.1" mass="1" condim="3" friction="0.7 0.02 0.003"/>
      <site name="end"/>
    </body>
    <body pos="1 0 0.092">
      <joint name="y" type="slide" axis="0 0 1"/>
      <joint name="turn" type="hinge" axis="0 1 0" range="-30 10" limited="true"/>
      <geom type="sphere" conaffinity="0" size="0.1" mass="2" condim="4" friction="0.5 0.01 0.004"/>
    </body>
  </worldbody>
  <tendon><spatial stiffness="5"><site site="anchor"/><site site="end"/></spatial></tendon>
  <equality><joint joint1="z" joint2="y" polycoef="0.001 1 0 0 0"/></equality>
</mujoco>
"""


@pytest.fixture(scope="module")
def both() -> tuple[mujoco.MjModel, mujoco.MjData, mjx.Data]:
    """The model, C MuJoCo's data after `mj_forward`, and MJX's."""
    model = mujoco.MjModel.from_xml_string(XML)
    data = mujoco.MjData(model)
    data.qpos[:], data.qvel[:] = [0.02, 0.003, -0.001, 0.3], [0.4, -0.1, 0.2, 0.5]
    mujoco.mj_forward(model, data)
    start = make_data(model).replace(qpos=jnp.array(data.qpos), qvel=jnp.array(data.qvel))
    return model, data, jax.jit(mjx.forward)(put_model(model), start)


def test_the_constraint_rows(both):
    _, expected, data = both
    found = constraint_rows(data)
    assert (found.equalities, found.losses) == (expected.ne, expected.nf) == (1, 1)
    assert expected.nefc == 1 + 1 + 1 + 3 + 4
    np.testing.assert_allclose(found.jacobian.ravel(), expected.efc_J, rtol=0, atol=1e-12)
    np.testing.assert_allclose(found.reference, expected.efc_aref, rtol=1e-10, atol=1e-10)
    np.testing.assert_allclose(found.D, expected.efc_D, rtol=1e-10)
    np.testing.assert_allclose(found.friction_loss, expected.efc_frictionloss, rtol=1e-12)
    np.testing.assert_allclose(found.force, expected.efc_force, rtol=1e-6, atol=1e-6)
    assert np.count_nonzero(expected.efc_force) == 7  # The planar scene has none sideways.


def test_the_contacts(both):
    model, expected, data = both
    found = contacts(data)
    np.testing.assert_array_equal(found.condim, [3, 4])
    for i, contact in enumerate(expected.contact):
        assert found.condim[i] == contact.dim
        np.testing.assert_array_equal(found.geoms[i], contact.geom)
        np.testing.assert_allclose(found.distance[i], contact.dist, rtol=0, atol=1e-12)
        np.testing.assert_allclose(found.position[i], contact.pos, rtol=0, atol=1e-12)
        np.testing.assert_allclose(found.frame[i].ravel(), contact.frame, rtol=0, atol=1e-12)
        np.testing.assert_allclose(found.margin[i], contact.includemargin, rtol=1e-12)
        np.testing.assert_allclose(found.friction[i], contact.friction, rtol=1e-12)
    assert geom_pairs(model) == [(0, 1, -1), (0, 2, -1)]


PAIRS = """
<mujoco>
  <option><flag filterparent="{filter}"/></option>
  <worldbody>
    <geom name="floor" type="plane" size="1 1 0.1"/>
    <geom name="wall" type="plane" size="1 1 0.1" zaxis="1 0 0"/>
    <body><geom name="post" type="box" size="0.1 0.1 0.1"/>
      <body name="arm"><joint/><geom name="upper" size="0.1"/><geom name="deaf" size="0.1" contype="0" conaffinity="2"/>
        <body><geom name="welded" type="capsule" size="0.1 0.1"/>
          <body name="hand"><joint/><geom name="palm" type="box" size="0.1 0.1 0.1"/></body></body></body></body>
    <body name="cube"><freejoint/><geom name="cube" type="box" size="0.1 0.1 0.1"/><geom name="tip" size="0.1"/></body>
    <body name="ghost"><freejoint/><geom name="ghost" size="0.1" contype="0" conaffinity="0"/></body>
    <body name="bit"><freejoint/><geom name="bit" size="0.1" contype="2" conaffinity="0"/></body>
  </worldbody>
  <contact><exclude body1="cube" body2="hand"/>
    <pair geom1="cube" geom2="upper"/><pair geom1="ghost" geom2="floor"/></contact>
</mujoco>
"""


@pytest.mark.parametrize("filters", ["enable", "disable"])
def test_the_pairs_of_geoms_are_those_that_mjx_collides(filters):
    model = mujoco.MjModel.from_xml_string(PAIRS.format(filter=filters))
    theirs = mjx._src.collision_driver.geom_pairs(model)
    assert geom_pairs(model) == [(int(first), int(second), int(pair)) for first, second, pair in theirs]
    named = [{model.geom(first).name, model.geom(second).name} for first, second, _ in geom_pairs(model)]
    assert named[:2] == [{"floor", "ghost"}, {"upper", "cube"}]
    assert named.count({"upper", "cube"}) == 1
    assert [{"deaf", "bit"} in named, {"post", "upper"} in named, {"cube", "palm"} in named] == [True, True, False]
    assert ({"welded", "palm"} in named) == (filters == "disable")


def test_which_shapes_collide():
    sphere, cylinder, mesh = mujoco.mjtGeom.mjGEOM_SPHERE, mujoco.mjtGeom.mjGEOM_CYLINDER, mujoco.mjtGeom.mjGEOM_MESH
    assert has_collision_fn(sphere, sphere)
    assert not has_collision_fn(cylinder, mesh)


def test_the_tendons_jacobian(both):
    model, expected, data = both
    dense = np.zeros((model.ntendon, model.nv))
    mujoco.mju_sparse2dense(
        dense, np.ravel(expected.ten_J), model.ten_J_rownnz, model.ten_J_rowadr, np.ravel(model.ten_J_colind)
    )
    np.testing.assert_allclose(tendon_jacobian(data), dense, rtol=0, atol=1e-12)
    assert np.abs(dense[0, :2]).min() > 1e-3


def test_the_constraint_force_can_be_replaced_alone(both):
    _, _, data = both
    force = jnp.arange(10.0)
    changed = with_constraint_force(data, force)
    np.testing.assert_array_equal(constraint_rows(changed).force, force)
    same = with_constraint_force(changed, constraint_rows(data).force)
    assert jax.tree.all(jax.tree.map(lambda a, b: bool(jnp.array_equal(a, b)), same, data))


def test_data_are_on_the_models_implementation_whatever_mjx_would_choose(monkeypatch):
    # On a GPU machine with Warp MJX may choose Warp; where there is none, another choice stands for it.
    monkeypatch.setattr("mujoco.mjx._src.io._resolve_impl", lambda _: mjx.Impl.CPP)
    model = mujoco.MjModel.from_xml_string(XML)
    assert make_data(put_model(model)).impl == make_data(model).impl == mjx.Impl.JAX
    function, used = step_check.step_function(model), []

    def step(model: mjx.Model, data: mjx.Data) -> mjx.Data:
        used.append((model.impl, data.impl))
        return data

    function.after(step, function.x)
    assert used == [(mjx.Impl.JAX, mjx.Impl.JAX)]
