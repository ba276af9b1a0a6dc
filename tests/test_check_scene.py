"""`tog.check_scene` on the gallery: scenes whose fault, or lack of one, is known."""

import json
import tomllib
from importlib import resources
from pathlib import Path

import jax
import jsonschema
import mujoco
import numpy as np
import pytest

import tog_mjx as tog
from tog_mjx.checks.measured.agreement import Sweep, sweep
from tog_mjx.checks.measured.recorded import NEVER, Simulation
from tog_mjx.checks.measured.stages import contacts, growth, untouched
from tog_mjx.checks.measured.zeros import zeros
from tog_mjx.checks.told.finding import Finding, Level
from tog_mjx.mjcf.keyframes import keyframe_start, saved_start
from tog_mjx.mjcf.scene import compile_model
from tog_mjx.problems.scene_function import SceneFunction

GALLERY = Path(__file__).parent / "scenes" / "verdicts"
SCENES = tomllib.loads((GALLERY / "expected.toml").read_text())["scene"]
NOT_QUICK = ("precision", "differentiation")
"""Checks that the quick version leaves out."""


def validate_verdict(found: dict) -> None:
    """The documented schema holds, and no number is NaN."""
    schema = json.loads(resources.files("tog_mjx").joinpath("checks", "told", "verdict.schema.json").read_text())
    jsonschema.validate(json.loads(json.dumps(found, allow_nan=False)), schema)
    for finding in found["findings"]:
        assert len({len(curve) for curve in finding["curves"].values()}) <= 1


@pytest.mark.parametrize("scene", SCENES, ids=lambda scene: scene["file"])
def test_the_gallery_gets_its_verdicts(scene, monkeypatch):
    # Compiled once more for each scene, and asked for in tests of its own; as is C MuJoCo.
    monkeypatch.setattr("tog_mjx.checks.scene_verdict.reverse", lambda *_: Finding("reverse mode", Level.FINE, ""))
    monkeypatch.setattr("tog_mjx.checks.scene_verdict.answer_of_c", lambda *_: Finding("C MuJoCo", Level.FINE, ""))
    model = compile_model(GALLERY / scene["file"])
    verdict = tog.check_scene(
        model,
        keyframe_start(model),
        steps=scene["steps"],
        wrt=scene["wrt"],
        output=scene["output"],
        differentiation=scene.get("differentiation", "implicit"),
        path=GALLERY / scene["file"],
        quick=scene["check"] not in NOT_QUICK,
    )
    assert (verdict.word, verdict.engine) == (scene["verdict"], scene.get("engine", "mjx")), verdict.line
    if scene["check"]:
        named = [finding.check for finding in verdict.findings if finding.level > Level.FINE]
        assert scene["check"] in named
    if verdict.level == Level.FAULT:
        assert verdict.reason == next(some for some in verdict.findings if some.check == scene["check"]), verdict.line
    for words in scene.get("words", ()):
        assert words in verdict.line
        # What no time step mends.
        assert not any("timestep" in some.remedy or "time step" in some.remedy for some in verdict.findings)
    validate_verdict(verdict.as_json())


PENDULUM = """
<mujoco>
  <option timestep="0.001" gravity="0 0 0"/>
  <worldbody>
    <body><joint name="hinge" axis="0 1 0" damping="0.5" stiffness="4"/><geom size="0.1" pos="0 0 0.5" mass="2"/></body>
    <body pos="2 0 0"><freejoint/><geom size="0.1" mass="1"/><site name="mark" pos="0 0.2 0"/></body>
  </worldbody>
  <actuator><motor name="push" joint="hinge"/></actuator>
</mujoco>
"""


@pytest.fixture(scope="module")
def pendulum() -> mujoco.MjModel:
    return mujoco.MjModel.from_xml_string(PENDULUM)


def test_a_state_jacobian_is_that_of_c_mujoco(pendulum):
    """A hinge and a free body, turning: the product of C MuJoCo's Jacobians, step by step, in velocity space."""
    data = mujoco.MjData(pendulum)
    data.qpos[0], data.qvel[:] = 0.3, [0.5, 0.1, 0.2, -0.3, 1.0, -2.0, 0.7]
    scene = SceneFunction(pendulum, data, 20, "qvel", "mark")
    motion = Simulation(scene, np.eye(7)).run()
    expected = np.eye(14)
    for _ in range(20):
        step = np.zeros((14, 14))
        mujoco.mjd_transitionFD(pendulum, data, 1e-6, True, step, None, None, None)
        expected = step @ expected
        mujoco.mj_step(pendulum, data)
    np.testing.assert_allclose(motion.jacobians[-1], expected, rtol=0, atol=1e-6)
    mujoco.mj_kinematics(pendulum, data)
    np.testing.assert_allclose(motion.value, data.site("mark").xpos, atol=1e-12)
    assert motion.bad_value.min() == motion.bad_slope.min() == NEVER
    assert motion.times[-1] == 20


@pytest.mark.parametrize(
    ("wrt", "output", "names"),
    [
        ("ctrl", "mark.", None),
        ("ctrl[1]", "qpos", None),
        ("qpos[0]", "qpos[9]", None),
        ("geom_typo", "qpos", None),
        ("geom_type", "qpos", None),
        ("opt.gravity[2]", "mark[2]", (("opt.gravity[2]",), ("mark.z",))),
        ("opt.density", "acc[6]", (("opt.density",), ("acc[6]",))),
        ("field:body_mass[2]", "qvel[0]", (("body_mass[2]",), ("qvel[0]",))),
        ("qpos[3]", "qvel[1]", (("qpos[3]",), ("qvel[1]",))),
        ("body_mass", "qpos[0]", (("body_mass[0]", "body_mass[1]", "body_mass[2]"), ("qpos[0]",))),
    ],
)
def test_what_is_asked_has_names(pendulum, wrt, output, names):
    if names is None:
        with pytest.raises(tog.InputError):
            SceneFunction(pendulum, mujoco.MjData(pendulum), 5, wrt, output)
    else:
        scene = SceneFunction(pendulum, mujoco.MjData(pendulum), 5, wrt, output)
        assert (scene.x.names, scene.y.names) == names


def test_the_derivative_in_gravity_is_that_of_a_falling_body(pendulum):
    """Semi-implicit Euler falls by g dt^2 n (n + 1) / 2."""
    scene = SceneFunction(pendulum, mujoco.MjData(pendulum), 50, "opt.gravity[2]", lambda data: data.xpos[2, 2])
    motion = Simulation(scene, np.eye(1), states=False).run()
    np.testing.assert_allclose(motion.slopes, [[1e-6 * 50 * 51 / 2]], rtol=1e-12)


def test_an_output_that_is_never_touched_is_told():
    """The finger moves, and the puck that it is to push does not."""
    model = compile_model(GALLERY / "never_touches.xml")
    scene = SceneFunction(model, keyframe_start(model), 100, "ctrl", "qpos")
    simulation = Simulation(scene, np.eye(1), states=False)
    motion = simulation.run()
    assert motion.slopes[1] > 0.01
    differences = sweep(simulation.values, np.zeros(1), np.eye(1))
    why = lambda: untouched(simulation, motion)  # noqa: E731
    found = zeros(motion.slopes, differences, scene.x.names, scene.y.names, scene.y.bodies, why)
    assert found.level == Level.CARE
    assert found.sentence.startswith("no variable moves qpos[0] (1 of 2 outputs): nothing is touched; of what does not")
    assert "geom puck and geom finger come nearest" in found.sentence


def test_a_body_that_moves_otherwise_is_not_unmoved(pendulum):
    """The hinge is one tree of bodies, and the free body another, some of whose positions may stay by symmetry."""
    for output, bodies in (("qpos", [0] + [1] * 7), ("qvel", [0] + [1] * 6), ("qpos[7]", [1]), ("mark", [0] * 3)):
        scene = SceneFunction(pendulum, mujoco.MjData(pendulum), 1, "qvel", output)
        assert scene.y.bodies.tolist() == bodies
    slopes, still = np.array([[1.0], [0.0], [1.0]]), np.zeros((1, 3, 1))
    differences = Sweep(np.array([1e-5]), still, still, slopes == 0)
    found = [zeros(slopes, differences, ["u"], ["x", "y", "z"], np.array(bodies)) for bodies in ([0, 0, 0], [0, 1, 2])]
    assert [(some.level, some.sentence) for some in found] == [
        (Level.FINE, "no variable moves y (1 of 3 outputs), but others of the same body move"),
        (
            Level.CARE,
            "no variable moves y (1 of 3 outputs): the output does not change over steps of up to 10% of a variable's "
            "size",
        ),
    ]


@pytest.mark.parametrize(("wrt", "level"), [("qpos", Level.CARE), ("ctrl", Level.FINE)])
def test_a_start_that_dies_out_is_told_to_who_asks_for_it(wrt, level):
    """A hinge on a spring, damped critically: its exp(-w t) (1 + w t) is 1e-3 near w t = 9.2."""
    xml = """<mujoco><option timestep="0.002" gravity="0 0 0"/><worldbody><body>
      <joint name="hinge" axis="0 1 0" damping="20" stiffness="100"/>
      <inertial pos="0 0 0" mass="1" diaginertia="1 1 1"/></body></worldbody>
      <actuator><motor joint="hinge"/></actuator></mujoco>"""
    model = mujoco.MjModel.from_xml_string(xml)
    scene = SceneFunction(model, mujoco.MjData(model), 600, wrt, "qpos")
    simulation = Simulation(scene, np.eye(1))
    found = growth(simulation, simulation.run())
    assert found.level == level
    x, v, h, faded = 1.0, 0.0, 0.002, 0  # Euler's method, implicit in the damping.
    while x > 1e-3 or faded % 6:  # One step in six is recorded.
        v = (v - h * 100 * x) / (1 + h * 20)
        x, faded = x + h * v, faded + 1
    assert 0.9 < faded * h < 0.93
    assert f"dies out: it falls below 1e-03 of itself in step {faded}," in found.sentence


def test_a_contact_acts_within_its_margin():
    xml = """<mujoco><worldbody><geom name="floor" type="plane" size="1 1 1"/><body pos="0 0 0.105">
      <joint type="slide" axis="0 0 1"/><geom name="ball" size="0.1" margin="{}" condim="1"/></body>
      </worldbody></mujoco>"""
    for margin, distance in (("0", 0.005), ("0.02", -0.015)):
        model = mujoco.MjModel.from_xml_string(xml.format(margin))
        scene = SceneFunction(model, mujoco.MjData(model), 1, "qvel")
        motion = Simulation(scene, np.eye(1)).run()
        np.testing.assert_allclose(motion.distance, [distance], atol=1e-12)
        assert motion.geoms.tolist() == [[0, 1]]
        finding = contacts(Simulation(scene, np.eye(1)), motion)
        assert ("geom floor and geom ball overlap by 0.015 m at most, their margin" in finding.sentence) == (
            distance < 0
        )


@pytest.mark.parametrize(("speed", "word"), [("0", "trust"), ("6", "do not trust")])
def test_what_is_measured_overrules_what_is_feared(speed, word):
    """A limit too stiff for the time step spoils the motion that meets it, and no other.

    The scene has no actuators: what is asked for then is the derivative in the velocities.
    """
    xml = f"""<mujoco><option timestep="0.01"><flag refsafe="disable"/></option><worldbody>
      <body><joint name="x" type="slide" axis="1 0 0" limited="true" range="-1 0.3" solreflimit="-90000 -1"/>
      <geom size="0.1" mass="1"/></body></worldbody><keyframe><key qvel="{speed}"/></keyframe></mujoco>"""
    model = mujoco.MjModel.from_xml_string(xml)
    verdict = tog.check_scene(model, keyframe_start(model), steps=20, quick=True)
    assert verdict.word == word, verdict.line
    assert verdict.subject == "qpos[0] after 20 steps, by qvel, as the scene has no actuators"
    assert verdict.variables == ("qvel[0]",)
    (remark,) = [finding for finding in verdict.findings if finding.check == "preflight"]
    assert "too coarsely stepped" in remark.sentence
    assert remark.level == (Level.FINE if word == "trust" else Level.CARE)
    assert ("'time step' has measured that it does no harm" in remark.sentence) == (word == "trust")


def test_reverse_mode_is_asked_for_even_in_haste(pendulum):
    """Forward mode selects one side of a `where`, reverse mode multiplies the other one's infinity by zero."""

    def cost(data):
        x = data.qpos[0]
        return x + jax.numpy.where(x > 0.1, jax.numpy.sqrt(x), 0.0)

    verdict = tog.check_scene(pendulum, steps=1, wrt="ctrl", output=cost, quick=True)
    assert verdict.word == "do not trust"
    assert verdict.reason
    assert verdict.reason.check == "reverse mode"
    assert verdict.gradient[0][0] > 0


def test_a_start_is_a_keyframe_or_a_file(pendulum, tmp_path):
    np.savez(tmp_path / "state.npz", qvel=np.arange(7.0))
    (tmp_path / "state.json").write_text(json.dumps({"ctrl": [0.5]}))
    assert saved_start(pendulum, tmp_path / "state.npz").qvel.tolist() == list(range(7))
    assert saved_start(pendulum, tmp_path / "state.json").ctrl.tolist() == [0.5]
    for text in ('{"qvel": [1]}', "[1]", "{", '{"other": 1}', '{"ctrl": ["a"]}', '{"ctrl": [NaN]}'):
        (tmp_path / "bad.json").write_text(text)
        with pytest.raises(tog.InputError, match=r"bad\.json"):
            saved_start(pendulum, tmp_path / "bad.json")
    with pytest.raises(tog.InputError, match="no keyframe named home; its keyframes: none"):
        keyframe_start(pendulum, "home")


def test_bad_input_is_one_line(run_script, tmp_path):
    scene = GALLERY / "smooth_arm.xml"
    for arguments, words in (
        ((scene, "--wrt", "wings"), "'wings' is none of ctrl, qpos, qvel"),
        ((scene, "--output", "wings"), "no site or sensor named wings"),
        ((scene, "--steps", "0"), "steps is 0: give a whole number from 1 to 10000000"),
        ((scene, "--cost", "json:nothing"), "cost 'json:nothing': json has no nothing"),
        ((scene, "--state", tmp_path / "none.npz"), "cannot be read"),
        ((tmp_path / "none.xml",), "no such scene or file"),
    ):
        status, said, complaint = run_script("check_gradients.py", *arguments)
        assert status == 2
        assert words in complaint
        assert len(complaint.splitlines()) == 1
        assert not said


def test_the_script_writes_json_and_a_page(run_script, tmp_path):
    out = (tmp_path / "verdict.json", tmp_path / "verdict.html")
    arguments = (GALLERY / "smooth_arm.xml", "--quick", "--output", "qpos", "--json", out[0], "--html", out[1])
    status, said, heard = run_script("check_gradients.py", *arguments)
    found, page = json.loads(out[0].read_text()), out[1].read_text()
    assert status == 0
    assert said.strip().endswith("trust: no check found a fault")
    assert found["verdict"] == "trust"
    validate_verdict(found)
    for some in found["findings"]:
        level = Level[some["level"].upper()]
        assert str(Finding(some["check"], level, some["sentence"], None, some["remedy"])) in heard
    assert page.count("<img ") == 1  # How a change grows: the rest its sentences say.
    assert jax.config.values["jax_enable_x64"]
