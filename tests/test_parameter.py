"""A number of the model moves what follows from it: against the MJCF text, changed and compiled again."""

import copy

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest

import tog_mjx as tog
from tog_mjx.checks.measured.recorded import Simulation
from tog_mjx.mjcf.followers import LEADERS
from tog_mjx.problems.scene_function import SceneFunction
from tog_mjx.stepping._mjx import float_fields, make_data, put_model
from tog_mjx.stepping.mjx_state import default_start, on_mjx

TREE = """<mujoco>
  <compiler angle="radian"/>
  <default><geom contype="0" conaffinity="0"/></default>
  <option timestep="0.002" cone="elliptic"/>
  <worldbody>
    <geom name="floor" type="plane" size="5 5 .1"/>
    <body name="trunk" pos="0 0 .4"><freejoint/>
      <geom name="rod" type="capsule" size="{rod}" fromto="0 0 0 .4 .1 0" density="700"/>
      <geom name="block" type="box" size=".05 .08 .03" pos="{place} .1 .05" euler=".2 .3 .4" density="{density}"/>
      <body name="arm" pos="{arm} 0 0"><joint name="hinge" axis="0 1 0" armature="{armature}"/>
        <inertial pos=".1 0 0" mass="{mass}" diaginertia=".01 .02 .025"/>
        <geom name="hand" size=".04" pos=".2 0 0" euler=".1 .2 .3"/><site name="tip" pos=".25 0 0"/></body>
    </body>
    <body name="cart" pos="1 0 .5"><joint name="slide" type="slide" axis="1 0 0"/>
      <geom name="wheel" type="cylinder" size=".1 {height}" mass="2"/><site name="hook" pos="0 0 .1"/></body>
  </worldbody>
  <tendon><spatial name="cord" stiffness="10" armature=".1"><site site="tip"/><site site="hook"/></spatial></tendon>
  <equality><connect body1="arm" body2="cart" anchor=".5 0 0" active="false"/></equality>
  <actuator><position name="servo" joint="hinge" kp="{kp}" dampratio="1" gear="{gear}"/>
    <velocity joint="slide" kv="{kv}"/></actuator>
</mujoco>"""
TEXT = {
    "rod": 0.03, "place": 0.1, "density": 500.0, "arm": 0.4, "armature": 0.01, "mass": 0.7, "height": 0.05, "gear": 1.5,
    "kp": 30.0, "kv": 4.0,
}  # fmt: skip
TREE_SPEC = mujoco.MjSpec.from_string(TREE.format(**TEXT))


def compiled(**numbers: float) -> dict[str, np.ndarray]:
    """Arrays of the model compiled from the text; principal axes, which may be swapped, as an inertia tensor."""
    model = mujoco.MjModel.from_xml_string(TREE.format(**{**TEXT, **numbers}))
    return arrays(model)


def arrays(model) -> dict[str, np.ndarray]:
    found = {name: np.array(getattr(model, name, 0)) for name in float_fields() if "." not in name}
    found = {name: value for name, value in found.items() if value.dtype.kind == "f" and value.size}
    quaternions, moments = found.pop("body_iquat"), found.pop("body_inertia")
    axes = np.zeros((len(quaternions), 9))
    for row, quaternion in zip(axes, quaternions, strict=True):
        mujoco.mju_quat2Mat(row, quaternion / np.linalg.norm(quaternion))
    turned = axes.reshape(-1, 3, 3)
    return {**found, "tensor": (turned * moments[:, None]) @ turned.swapaxes(1, 2)}


def mass_matrix(model: mujoco.MjModel) -> np.ndarray:
    """Of the bodies and joints alone."""
    model.tendon_armature[:] = 0.0
    data, found = mujoco.MjData(model), np.zeros((model.nv, model.nv))
    mujoco.mj_forward(model, data)
    mujoco.mj_fullM(model, data, found)
    return found


@pytest.mark.parametrize(
    ("text", "parameter", "follows"),
    [
        ("rod", "geom_size[1, 0]", {"body_mass", "body_inertia", "body_ipos", "body_iquat", "body_invweight0"}),
        ("place", "geom_pos[2, 0]", {"body_ipos", "body_inertia", "body_iquat", "dof_invweight0"}),
        ("arm", "body_pos[2, 0]", {"dof_invweight0", "tendon_length0", "tendon_lengthspring"}),
        ("armature", "dof_armature[6]", {"dof_invweight0", "actuator_acc0", "actuator_biasprm"}),
        ("mass", "body_mass[2]", {"dof_invweight0", "actuator_acc0", "actuator_biasprm", "body_subtreemass"}),
        ("height", "geom_size[4, 1]", {"body_inertia", "geom_rbound"}),
        ("gear", "actuator_gear[0, 0]", {"actuator_acc0", "actuator_biasprm"}),
        ("kp", "actuator_gainprm[0, 0]", {"actuator_biasprm"}),
        ("kv", "actuator_gainprm[1, 0]", {"actuator_biasprm"}),
    ],
)
def test_all_moves_as_when_the_text_is_compiled_again(text, parameter, follows):
    h = 1e-4 * TEXT[text]
    found = tog.Parameter(TREE_SPEC, parameter)
    assert follows <= set(found.followers.rates)
    assert found.followers.behind == ()
    np.testing.assert_allclose(found.value, TEXT[text], rtol=1e-6)
    ahead, behind, here = (compiled(**{text: TEXT[text] + step}) for step in (h, -h, 0.0))
    ours, theirs, in_c = arrays(found(found.value + h)), arrays(found(found.value - h)), found.in_c(found.value + h)
    for name, value in here.items():
        expected = (ahead[name] - behind[name]) / (2 * h)
        moved = (ours[name] - theirs[name]) / (2 * h)
        reach = max(np.abs(value).max() / TEXT[text], np.abs(expected).max())
        np.testing.assert_allclose(moved, expected, rtol=0, atol=1e-6 * reach, err_msg=name)
        if name == "dof_M0":  # Of the arrays as they are, not to first order.
            exact = mass_matrix(copy.copy(in_c)).diagonal()
        else:
            exact = ahead[name] if name in ("geom_rbound", "geom_aabb") else ours[name]  # Lest C overlooks a contact.
        np.testing.assert_allclose(arrays(in_c)[name], exact, rtol=0, atol=1e-12 * reach, err_msg=name)


@pytest.mark.parametrize(
    ("name", "number", "speed"),
    [("body_gravcomp[1]", 1.0, [0, 0, 0]), ("field:body_mass[1]", 2.0, [0.005, 0, -0.01962])],
)
def test_what_c_skips_by_what_was_compiled_moves_too(name, number, speed):
    """In free fall with a force of 5 N: what gravity is compensated by, and a mass matrix that is constant."""
    text = """<mujoco><worldbody><body><freejoint/><geom size="0.1" mass="1"/></body></worldbody></mujoco>"""
    model = tog.Parameter(mujoco.MjModel.from_xml_string(text), name).in_c(np.array([number]))
    data = mujoco.MjData(model)
    data.qfrc_applied[0] = 5.0 * (number == 2.0)
    mujoco.mj_step(model, data)
    np.testing.assert_allclose(data.qvel[:3], speed, rtol=1e-12, atol=1e-15)


def test_a_geom_moves_away_from_its_bodys_frame():
    text = """<mujoco><worldbody><body><freejoint/><geom size="0.1" mass="1"/></body></worldbody></mujoco>"""
    model = tog.Parameter(mujoco.MjModel.from_xml_string(text), "field:geom_pos[0, 0]").in_c(np.array([0.3]))
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    np.testing.assert_allclose(data.geom_xpos[0], [0.3, 0, 0], atol=1e-15)


def test_a_mass_of_geoms_is_their_density():
    """Of both geoms of the trunk: inertia and mass keep their ratio, and the centre stays."""
    found = tog.Parameter(TREE_SPEC, "body_mass[1]")
    model, rates = found.model, found.followers.rates
    ratio = model.body_inertia[1] / model.body_mass[1]
    np.testing.assert_allclose(rates["body_inertia"][3:6, 0], ratio, rtol=1e-6)
    assert not {"body_ipos", "body_iquat"} & set(rates)


def test_what_leads_no_other_array_is_known():
    model = mujoco.MjModel.from_xml_string(TREE.format(**TEXT))
    others = [name for name in sorted(float_fields() - LEADERS) if "." not in name]
    moved = []
    for name in others:
        changed = mujoco.MjModel.from_xml_string(TREE.format(**TEXT))
        value = getattr(changed, name, None)
        if value is None or value.dtype.kind != "f" or not value.size:
            continue
        value += 1e-3
        mujoco.mj_setConst(changed, mujoco.MjData(changed))
        for other, before in arrays(model).items():
            after = arrays(changed)[other]
            if other != name and not np.allclose(after, before, rtol=1e-12, atol=0):
                moved.append((name, other))
    assert moved == []


BOX = """<mujoco>
  <option timestep="0.001" cone="elliptic"/>
  <default><geom solref="-3000 -60" friction=".6"/></default>
  <worldbody>
    <geom name="ground" type="plane" size="5 5 .1"/>
    <body name="box" pos="0 0 .2" euler="10 20 0"><freejoint/>
      <geom type="box" size=".1 .15 .05" mass="{}" contype="0" conaffinity="0"/>
      <geom size=".01" pos="-.09 -.14 -.04" mass="0"/><geom size=".01" pos=".09 -.14 -.04" mass="0"/></body>
  </worldbody>
</mujoco>"""
BALL = """<mujoco>
  <option timestep="0.002" cone="elliptic"/>
  <worldbody>
    <geom name="floor" type="plane" size="20 20 .1" friction=".2"/>
    <body name="ball" pos="0 0 .0998"><joint type="slide" axis="1 0 0"/><joint type="slide" axis="0 0 1"/>
      <geom name="ball" size="{}" density="500" friction=".1"/></body>
  </worldbody>
  <actuator><motor name="push" joint="x"/></actuator>
  <keyframe><key ctrl="8"/></keyframe>
</mujoco>""".replace('<joint type="slide" axis="1 0 0"/>', '<joint name="x" type="slide" axis="1 0 0"/>')
LINK = """<mujoco>
  <option timestep="0.002"/>
  <worldbody><body name="link" pos="0 0 1" gravcomp="{}"><joint axis="0 1 0"/>
    <geom type="capsule" size=".02 .2" pos=".2 0 0" euler="0 90 0" mass=".5"/></body></worldbody>
</mujoco>"""
ROD = LINK.replace("{}", "0").replace(".02 .2", ".02 {}")


def end_in_c(text: str, number: float, steps: int) -> np.ndarray:
    model = mujoco.MjModel.from_xml_string(text.format(repr(number)))
    data = default_start(model)
    mujoco.mj_step(model, data, steps)
    return data.qpos.copy()


@pytest.mark.parametrize(
    ("text", "number", "parameter", "steps", "entry", "known"),
    [
        (BOX, 3.0, "body_mass[1]", 300, 0, 0.0),
        (BALL, 0.1, "geom_size[1, 0]", 200, 0, -9.34),
        (ROD, 0.2, "geom_size[0, 1]", 100, 0, None),
    ],
)
def test_a_motion_moves_as_that_of_the_text_compiled_again(text, number, parameter, steps, entry, known):
    spec = mujoco.MjSpec.from_string(text.format(number))
    model = spec.compile()
    scene = SceneFunction(model, default_start(model), steps, parameter, "qpos", origin=spec)
    motion = Simulation(scene, np.eye(1), states=False).run()
    h = 1e-5 * number
    values = [end_in_c(text, number + i * h, steps) for i in (0, 1, -1)]
    expected = (values[1] - values[2]) / (2 * h)
    np.testing.assert_allclose(motion.value, values[0], atol=1e-6)
    np.testing.assert_allclose(motion.slopes[:, 0], expected, rtol=1e-5, atol=1e-7)
    if known is not None:
        np.testing.assert_allclose(motion.slopes[entry, 0], known, rtol=5e-3, atol=1e-7)


def test_forces_that_the_scene_has_none_of_begin():
    """Gravity compensation, from zero: a flag of the compiler leaves it out there, on C MuJoCo and on MJX."""
    spec = mujoco.MjSpec.from_string(LINK.format(0))
    verdict = tog.check_scene(spec, wrt="body_gravcomp[1]", quick=True)
    values = [end_in_c(LINK, i * 1e-5, 100) for i in range(3)]  # Ahead: below zero there is none.
    expected = (-3 * values[0] + 4 * values[1] - values[2]) / 2e-5
    np.testing.assert_allclose(verdict.gradient, expected[None], rtol=1e-5)
    np.testing.assert_allclose(verdict.gradient, [[-0.68]], rtol=5e-3)
    assert (verdict.word, verdict.variables) == ("trust", ("body_gravcomp[1]",)), verdict.line


@pytest.mark.parametrize("field", ["density", "viscosity"])
def test_a_fluid_begins(field):
    """Of one step: it brakes the ball."""
    xml = f"""<mujoco><option {field}="{{}}"/><worldbody><body><freejoint/><geom size=".1"/></body></worldbody>
      <keyframe><key qvel="3 0 0 0 1 0"/></keyframe></mujoco>"""
    model = mujoco.MjModel.from_xml_string(xml.format(0))
    scene = SceneFunction(model, default_start(model), 1, f"opt.{field}", "qvel")
    model_at, start = put_model(model), on_mjx(put_model(model), scene.start)

    def end(x):
        placed, data = scene.place(model_at, start, x)
        return tog.step(placed, data).qvel

    slope = jax.jit(jax.jacfwd(end))(jnp.zeros(1))[:, 0]
    after = []
    for value in (0.0, 1e-3):
        changed = tog.Parameter(model, f"opt.{field}").in_c(np.array([value]))
        assert getattr(changed.opt, field) == value
        data = default_start(changed)
        mujoco.mj_step(changed, data)
        after.append(data.qvel.copy())
    expected = (after[1] - after[0]) / 1e-3
    assert np.abs(expected[0]) > 1e-6
    np.testing.assert_allclose(slope, expected, rtol=0, atol=1e-4 * np.abs(expected).max())


def test_axes_of_equal_moments_cannot_turn():
    """Four balls at the corners of a square: pushed along a side, one of them turns the axes by 45 degrees at once."""
    xml = """<mujoco><worldbody><body><freejoint/><geom size=".02" pos="{0} 0 0"/><geom size=".02" pos="-{0} 0 0"/>
      <geom size=".02" pos="0 .1 0"/><geom size=".02" pos="0 -.1 0"/></body></worldbody></mujoco>"""
    found = [
        tog.Parameter(mujoco.MjSpec.from_string(xml.format(place)), "geom_pos[0, 1]").followers for place in (0.1, 0.15)
    ]
    assert [some.behind for some in found] == [("body_iquat",), ()]
    assert ["body_iquat" in some.rates for some in found] == [False, True]


def test_a_field_alone_moves_alone_and_a_mass_moves_a_motion():
    """A pendulum's period does not know its mass, but with the inertia of another one it does."""
    xml = """<mujoco><option timestep="0.01"/><worldbody><body><joint axis="0 1 0"/>
      <geom size=".1" pos=".5 0 0" mass="2"/></body></worldbody></mujoco>"""
    spec = mujoco.MjSpec.from_string(xml)
    model = put_model(spec.compile())
    slopes = []
    for name in ("body_mass[1]", "field:body_mass[1]"):
        mass = tog.Parameter(spec, name)
        np.testing.assert_array_equal(mass.value, [2.0])

        def end(x, mass=mass):
            return tog.simulate(mass(x), make_data(model), jnp.zeros(0), 20)[0].qpos[0]

        slopes.append(jax.jit(jax.grad(end))(mass.value)[0])
    assert abs(slopes[0]) < 1e-9  # What is read from differences of the compiler is right to that.
    assert slopes[1] > 1e-5
