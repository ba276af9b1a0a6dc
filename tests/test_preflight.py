"""What a scene has that spoils gradients is told at once, with names and lines; and it does what is said of it."""

from pathlib import Path

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest

import tog_mjx as tog
from tog_mjx.checks.file.preflight import Remark, preflight
from tog_mjx.checks.told.finding import Level
from tog_mjx.stepping._mjx import make_data, mjx, put_model

SCENE = """<mujoco>
  <option timestep="0.002" iterations="100" ls_iterations="50" OPTION=""><flag FLAG="enable"/></option>
  <worldbody>
    <geom name="floor" type="plane" size="5 5 .1" FLOOR=""/>
    <body name="arm" pos="0 0 2">
      <joint name="hinge" axis="0 1 0" damping=".1" stiffness="1" JOINT=""/>
      <geom name="rod" type="capsule" size="0.02" fromto="0 0 0 0.3 0 0" mass="0.4" ROD=""/>
    </body>
    <body name="ball" pos="0 0 .099" BODY="">
      <joint name="x" type="slide" axis="1 0 0"/><joint name="z" type="slide" axis="0 0 1"/>
      <geom name="ball" size=".1" mass="1" BALL=""/>
    </body>
    EXTRA
  </worldbody>
  <tendon>
    <fixed name="cord" stiffness="2" damping=".1" springlength="0.1" TENDON=""><joint joint="hinge" coef="1"/></fixed>
  </tendon>
  <actuator>
    <general name="motor" joint="hinge" ACTUATOR=""/>
  </actuator>
  <custom><numeric name="NUMERIC" data="1"/></custom>
</mujoco>
"""
ATTRIBUTES = ("OPTION", "FLOOR", "JOINT", "ROD", "BODY", "BALL", "TENDON", "ACTUATOR")


def written(edits: dict[str, str]) -> str:
    """The scene, with attributes added or replaced."""
    xml = SCENE.replace("FLAG=", f"{edits.get('FLAG', 'warmstart')}=").replace("EXTRA", edits.get("EXTRA", ""))
    xml = xml.replace("NUMERIC", edits.get("NUMERIC", "unused"))
    if "DISABLE" in edits:
        xml = xml.replace('warmstart="enable"', f'{edits["DISABLE"]}="disable"')
    for word in ATTRIBUTES:
        added = edits.get(word, "")
        lines = xml.split("\n")
        for i, line in enumerate(lines):
            if f' {word}=""' in line:
                for name in (part.split("=")[0] for part in added.split('" ') if part):
                    line = drop(line, name)  # An attribute is given once.
                lines[i] = line.replace(f' {word}=""', f" {added}" if added else "")
        xml = "\n".join(lines)
    return xml


def drop(line: str, name: str) -> str:
    before, mark, after = line.partition(f' {name}="')
    return before + after.partition('"')[2] if mark else line


def remarks(folder: Path, edits: dict[str, str], wrt: str = "", ctrl: float = 0.0, **options) -> list[Remark]:
    path = folder / "scene.xml"
    path.write_text(written(edits))
    model = mujoco.MjModel.from_xml_path(str(path))
    data = mujoco.MjData(model)
    data.ctrl[:] = ctrl
    return preflight(model, path, data, wrt, **options)


IGNORED = {
    "the delay of actuator motor": {"ACTUATOR": 'delay="0.02" nsample="20"'},
    "the damping of actuator motor": {"ACTUATOR": 'damping="1"'},
    "the armature of actuator motor": {"ACTUATOR": 'armature="1"'},
    "<option actuatorgroupdisable>": {"ACTUATOR": 'group="1"', "OPTION": 'actuatorgroupdisable="1"'},
    "the higher powers of the stiffness of joint hinge": {"JOINT": 'stiffness="1 5 5"'},
    "the higher powers of the damping of joint hinge": {"JOINT": 'damping=".1 1 1"'},
    "the springyield of joint hinge": {"JOINT": 'springyield="0.01"'},
    "the higher powers of the stiffness of tendon cord": {"TENDON": 'stiffness="2 5 5"'},
    "the higher powers of the damping of tendon cord": {"TENDON": 'damping=".1 1 1"'},
    "the springyield of tendon cord": {"TENDON": 'springyield="0.01"'},
    "the surfacevel of geom floor": {"FLOOR": 'surfacevel="1 0 0 0 0 0"'},
    "the adhesion of geom ball": {"BALL": 'adhesion="50"'},
    "fluidshape='ellipsoid' of geom rod": {"ROD": 'fluidshape="ellipsoid"', "OPTION": 'density="1000"'},
}
LINES = {"motor": 19, "hinge": 6, "cord": 16, "floor": 4, "ball": 11, "rod": 7, "<option": 2}


@pytest.mark.parametrize("what", IGNORED)
def test_what_mjx_ignores_is_told_with_its_line(tmp_path, what):
    assert [r.what for r in remarks(tmp_path, IGNORED[what])] == [what]
    (remark,) = remarks(tmp_path, IGNORED[what])
    line = next(number for word, number in LINES.items() if what.startswith(word) or what.endswith(f" {word}"))
    assert (remark.where, remark.level, remark.blocks) == (f"scene.xml:{line}", Level.FAULT, False)
    assert remarks(tmp_path, {}) == []


@pytest.fixture(scope="module")
def moved():
    """The positions and velocities after 40 steps of MJX."""

    @jax.jit
    def after(model: mjx.Model, data: mjx.Data) -> tuple[jax.Array, jax.Array]:
        end, _ = tog.simulate(model, data, data.ctrl, 40, differentiation="native")
        return end.qpos, end.qvel

    def run(model: mujoco.MjModel) -> np.ndarray:
        on_mjx = put_model(model)
        data = make_data(on_mjx).replace(qvel=jnp.linspace(1, 0.5, model.nv), ctrl=jnp.full(model.nu, 0.3))
        return np.concatenate(after(on_mjx, data))

    return run


def moved_in_c(model: mujoco.MjModel) -> np.ndarray:
    data = mujoco.MjData(model)
    data.qvel[:], data.ctrl[:] = np.linspace(1, 0.5, model.nv), 0.3
    for _ in range(40):
        mujoco.mj_step(model, data)
    return np.concatenate([data.qpos, data.qvel])


def test_what_is_told_as_ignored_moves_c_mujoco_and_not_mjx(moved):
    density = {"OPTION": 'density="1000"'}
    for what, edits in IGNORED.items():
        model = mujoco.MjModel.from_xml_string(written(edits))
        plain = mujoco.MjModel.from_xml_string(written(density if "fluid" in what else {}))
        np.testing.assert_allclose(moved(plain), moved_in_c(plain), atol=1e-7)  # Of the solver's tolerance.
        np.testing.assert_allclose(moved(model), moved(plain), atol=1e-7, err_msg=what)
        assert np.abs(moved_in_c(model) - moved_in_c(plain)).max() > 1e-3, what


# Edits, variables, control; the remark and its place. The truth of each is in the gallery or in a test below.
KNOWN = [
    ({"OPTION": 'iterations="2"'}, "", 0.0, "<option iterations='2'>", "scene.xml:2"),
    ({"OPTION": 'iterations="10" solver="CG"'}, "", 0.0, "<option iterations='10'>", "scene.xml:2"),
    ({"OPTION": 'ls_iterations="3"'}, "", 0.0, "<option ls_iterations='3'>", "scene.xml:2"),
    ({"OPTION": 'tolerance="0.001"'}, "", 0.0, "<option tolerance='0.001'>", "scene.xml:2"),
    ({"FLAG": "sleep"}, "", 0.0, "<flag sleep='enable'>", "scene.xml:2"),
    ({"BALL": 'type="box" size=".1 .1 .1"'}, "", 0.0, "plane) with geom ball (box): MJX", "scene.xml:4, scene.xml:11"),
    (
        {"EXTRA": '<geom name="pole" type="cylinder" size=".1 1" pos="3 0 0"/>'}, "", 0.0,
        "the contact of geom ball (sphere) with geom pole (cylinder): MJX finds", "scene.xml:11, scene.xml:13",
    ),
    ({"NUMERIC": "max_contact_points"}, "", 0.0, "max_contact_points", ""),
    (
        {"ACTUATOR": 'dyntype="filter" dynprm="1" actearly="true"'}, "", 0.0, "actearly of actuator motor",
        "scene.xml:19",
    ),
    ({"JOINT": 'range="-5 5" margin="0.2"'}, "", 0.0, "within the margin of both limits", "scene.xml:6"),
    ({"BODY": 'pos="0 0 5000"'}, "", 0.0, "body ball is 5e+03 m from the origin", "scene.xml:9"),
    ({"BALL": 'solref="0.001 1" priority="1"'}, "", 0.0, "its time constant 0.001 s is taken as 2", "scene.xml:11"),
    ({"BALL": 'solref="-1e6 -10"'}, "", 0.0, "a vibration of 1e+03 rad/s, 2 rad a time step", "scene.xml:11"),
    ({"JOINT": 'stiffness="1e4"'}, "", 0.0, "stiffness of joint hinge", "scene.xml:6"),
    (
        {"ACTUATOR": 'gainprm="1e4" biastype="affine" biasprm="0 -1e4 0"'}, "", 0.0, "kp of actuator motor",
        "scene.xml:19",
    ),
    ({"ACTUATOR": 'ctrlrange="-1 1"'}, "ctrl", 1.0, "another derivative to either side", "scene.xml:19"),
    ({"ACTUATOR": 'ctrlrange="-1 1"'}, "ctrl", 2.0, "control of actuator motor, 2, is at its limit", "scene.xml:19"),
    ({"ACTUATOR": 'forcerange="-1 1"'}, "", 2.0, "the force of actuator motor, 1, is at its limit", "scene.xml:19"),
    ({"BODY": 'pos="0 0 0.1"'}, "", 0.0, "geom floor with geom ball: they touch exactly", "scene.xml:4, scene.xml:11"),
    (
        {"BODY": 'pos="0 0 0.11"', "BALL": 'margin="0.01"'}, "", 0.0, "geom floor with geom ball: they touch exactly",
        "scene.xml:4, scene.xml:11",
    ),
    ({"JOINT": 'range="-90 0"'}, "", 0.0, "joint hinge: exactly at its limit", "scene.xml:6"),
    (
        {"JOINT": 'range="-90 10" margin="0.17453292519943295"'}, "", 0.0, "joint hinge: exactly at its limit",
        "scene.xml:6",
    ),
    ({}, "geom_friction", 0.0, "is equal, and a contact takes the larger", "scene.xml:4, scene.xml:7"),
    ({}, "dof_frictionloss", 0.0, "3 of its entries are of no constraint", ""),
    (
        {"EXTRA": '<body name="top" pos="2 0 1"><joint type="ball"/><geom size=".1"/></body>'}, "", 0.0,
        "body top: a force at its centre does not move it", "scene.xml:13",
    ),
    (
        {"EXTRA": '<body pos="2 0 .299"><freejoint/><geom name="post" type="capsule" size=".1 .2"/></body>'}, "", 0.0,
        "geom post (capsule) stands on geom floor", "scene.xml:13",
    ),
    ({"DISABLE": "spring"}, "", 0.0, "<flag spring='disable'>", "scene.xml:2"),
]  # fmt: skip


@pytest.mark.parametrize(("edits", "wrt", "ctrl", "what", "where"), KNOWN)
def test_what_is_known_to_spoil_gradients_is_told_with_its_line(tmp_path, edits, wrt, ctrl, what, where):
    found = [remark for remark in remarks(tmp_path, edits, wrt, ctrl) if what in remark.what]
    assert len(found) == 1
    assert where in found[0].where if where else found[0].where == ""
    assert found[0].level == (Level.FAULT if "<flag spring" in what else Level.CARE)
    assert found[0].remedy
    assert remarks(tmp_path, {}) == []


def test_a_solver_without_constraints_may_stop_at_once(tmp_path):
    edits = {"OPTION": 'iterations="2"'}
    assert len(remarks(tmp_path, edits)) == 1
    assert remarks(tmp_path, {**edits, "DISABLE": "constraint"}) == []
    assert len(remarks(tmp_path, {**edits, "DISABLE": "contact", "JOINT": 'range="-50 50"'})) == 1
    assert remarks(tmp_path, {**edits, "DISABLE": "contact"}) == []


def test_a_joint_that_leaves_its_limit_at_once_is_at_a_kink_for_positions_alone(tmp_path):
    """The arm falls from a limit that is above it, and rests at that of a joint without any force."""
    for gravity, wrt, told in (("-9.81", "ctrl", 0), ("-9.81", "qpos", 1), ("0", "ctrl", 1)):
        edits = {"OPTION": f'gravity="0 0 {gravity}"', "JOINT": 'range="0 90" springref="0"'}
        found = [
            remark
            for remark in remarks(tmp_path, {**edits, "TENDON": 'springlength="0"'}, wrt)
            if "exactly" in remark.what
        ]
        assert len(found) == told


@pytest.mark.parametrize(
    ("edits", "wrt", "ctrl", "what", "others"),
    [
        ({}, "body_mass[2]", 0.0, "moves along", ()),
        ({"ACTUATOR": 'ctrlrange="-1 1"'}, "ctrl[0]", 2.0, "control of actuator motor, 2, is at", ("qpos[0]",)),
        ({}, "geom_friction[1, 0]", 0.0, "is equal, and a contact takes the larger", ()),
        ({"BALL": 'friction="1 .1 .2"'}, "geom_friction[2, 0]", 0.0, "is equal", ("geom_friction[2, 1]",)),
        ({"JOINT": 'frictionloss="1"'}, "dof_frictionloss[1]", 0.0, "1 of its entries", ("dof_frictionloss[0]",)),
        ({"JOINT": 'range="-90 90"'}, "jnt_range[2, 1]", 0.0, "1 of its entries", ("jnt_range[0, 1]",)),
        ({"JOINT": 'range="0 90" springref="0"'}, "qpos[0]", 0.0, "exactly at its limit", ("qpos[1]",)),
    ],
)
def test_of_one_number_the_same_is_told_and_of_its_neighbours_nothing(tmp_path, edits, wrt, ctrl, what, others):
    """The arm falls from its limit, so that only a derivative in its own position meets the kink."""

    def told(wrt: str) -> list[str]:
        falling = {"TENDON": 'springlength="0"', **edits}
        return [remark.what for remark in remarks(tmp_path, falling, wrt, ctrl) if what in remark.what]

    assert len(told(wrt)) == 1
    assert [some for other in others for some in told(other)] == []


def test_an_index_that_is_not_in_the_array_is_refused(tmp_path):
    with pytest.raises(tog.InputError, match=r"'ctrl\[1\]': ctrl has the shape \[1\]"):
        remarks(tmp_path, {}, "ctrl[1]")


def test_the_control_is_within_its_range(tmp_path):
    assert remarks(tmp_path, {"ACTUATOR": 'ctrlrange="-1 1" forcerange="-3 3"'}, "ctrl", ctrl=0.5) == []


def test_native_differentiation_has_faults_of_its_own(tmp_path):
    free = {"EXTRA": '<body pos="2 0 1"><freejoint name="loose"/><geom size=".1"/></body>', "OPTION": 'cone="elliptic"'}
    found = remarks(tmp_path, free, differentiation="native")
    assert [(r.level, r.where) for r in found] == [(Level.FAULT, "scene.xml:2"), (Level.CARE, "scene.xml:13")]
    assert "NaN" in found[0].what
    assert "joint loose does not rotate" in found[1].what
    assert remarks(tmp_path, free) == []
    resting = {"TENDON": 'springlength="0"'}
    assert [r.what for r in remarks(tmp_path, resting, differentiation="native")] == [
        "tendon cord is at its rest length: stock mjx.step drops its spring's derivative"
    ]
    assert remarks(tmp_path, resting) == []


def test_everything_unsupported_is_told_at_once(tmp_path):
    edits = {
        "OPTION": 'integrator="discrete" solver="PGS" noslip_iterations="3"',
        "FLAG": "energy",
        "ACTUATOR": 'dyntype="user"',
        "EXTRA": '<geom name="pole" type="cylinder" size=".1 1" pos="5 0 0"/><body name="b"><freejoint/>'
        '<geom name="crate" type="box" size=".1 .1 .1"/><geom name="other" type="box" size=".1 .1 .1"/></body>',
    }
    found = remarks(tmp_path, edits)
    assert {(remark.what, remark.where) for remark in found} == {
        ("<option integrator='discrete'>", "scene.xml:2"),
        ("<option solver='pgs'>", "scene.xml:2"),
        ("<flag energy='enable'>", "scene.xml:2"),
        ("actuator motor (dyntype user)", "scene.xml:19"),
        ("the collision of geom pole (cylinder) with geom crate (box) and 1 more such pairs", "scene.xml:13"),
        ("<option noslip_iterations='3'>", "scene.xml:2"),
    }
    assert [remark.blocks for remark in found] == [True] * 5 + [False]
