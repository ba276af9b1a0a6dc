"""Verdicts on gradients through C MuJoCo: of scenes whose fault, or lack of one, is known, also of those that MJX
refuses."""

import json
import tomllib
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest
from c_mujoco_scenes import BODIES
from test_check_scene import validate_verdict

import tog_mjx as tog
from tog_mjx.checks.measured.linearised import Linearised
from tog_mjx.checks.told.finding import Level
from tog_mjx.mjcf.keyframes import keyframe_start
from tog_mjx.mjcf.scene import compile_model
from tog_mjx.problems.scene_function import SceneFunction
from tog_mjx.stepping.mjx_state import copy_of, default_start

GALLERY = Path(__file__).parent / "scenes" / "verdicts"
SCENES = {scene["file"]: scene for scene in tomllib.loads((GALLERY / "expected.toml").read_text())["scene"]}
OTHERWISE = {
    "native_elliptic.xml": ("do not trust", "agreement"),  # Bounces, which NaN of stock MJX hides.
    "far_from_origin.xml": ("trust with care", "agreement"),  # It bounces, and float64 has all the digits it needs.
    "one_iteration.xml": ("trust", ""),  # One iteration of C MuJoCo's solver is enough.
    "box_on_plane.xml": ("trust with care", "agreement"),
}
"""Scenes of which C MuJoCo's gradient deserves another verdict than MJX's."""
LONG = ("humanoid.xml", "throw.xml", "two_balls.xml", "chaotic_pendulum.xml")


@pytest.fixture(scope="module")
def compilations() -> list[str]:
    """What JAX compiles from now on."""
    found: list[str] = []

    def heard(event: str, duration_secs: float, **_: str | int) -> None:
        del duration_secs
        if "backend_compile" in event:
            found.append(event)

    jax.monitoring.register_event_duration_secs_listener(heard)
    jax.jit(lambda x: x + 1)(1.0)
    assert found
    return found


@pytest.mark.parametrize("file", [file for file in SCENES if file not in LONG])
def test_the_gallery_gets_its_verdicts_without_compiling(file, compilations):
    scene, path = SCENES[file], GALLERY / file
    model = compile_model(path)
    compilations.clear()
    asked = {name: scene[name] for name in ("steps", "wrt", "output")}
    verdict = tog.check_scene(model, keyframe_start(model), path=path, engine="mujoco", **asked)
    assert not compilations
    word, check = OTHERWISE.get(file, (scene["verdict"], scene["check"]))
    assert (verdict.word, verdict.reason.check if verdict.reason else "") == (word, check), verdict.line
    assert verdict.subject.endswith(", through C MuJoCo")
    assert verdict.engine == "mujoco"
    for words in scene.get("words", ()):
        assert words in verdict.line
    validate_verdict(verdict.as_json())


def gradients(start, model, kinds, weights, steps=20) -> tuple[np.ndarray, np.ndarray]:
    """That of the weighted outputs by the engine, in reverse mode, and that of verdicts."""

    def cost(last: tog.State) -> jax.Array:
        outputs = {"qpos": last.qpos, "qvel": last.qvel, "acc": last.qacc, "tip": last.site("tip")}
        return jnp.stack([weights[name] @ output for name, output in outputs.items()]).sum()

    problem = tog.Problem(model, steps, [*kinds.values()], cost=cost, start=start)
    expected = np.asarray(jax.grad(tog.objective(problem, "mujoco"))(jnp.asarray(problem.x0)))
    slopes = []
    for name in kinds:
        scenes = {output: SceneFunction(model, start, steps, name, output) for output in weights}
        found = {output: Linearised(scene, np.eye(len(scene.x.names))).run().slopes for output, scene in scenes.items()}
        slopes.append(sum(weights[output] @ some for output, some in found.items()))
    return expected, np.concatenate(slopes)


def test_the_gradient_is_the_one_that_the_engine_gives():
    """In controls, positions in velocity space, velocities and activations; of positions, velocities, accelerations
    and a site, all weighted; bodies turn."""
    model = mujoco.MjModel.from_xml_string(BODIES.format(integrator="implicitfast"))
    rng, start = np.random.default_rng(0), mujoco.MjData(model)
    mujoco.mj_integratePos(model, start.qpos, rng.normal(size=model.nv), 1.0)
    start.qvel[:], start.act[:], start.ctrl[:] = rng.normal(size=model.nv), 0.3, (0.2, -0.4)
    weights = {name: rng.normal(size=k) for name, k in (("qpos", model.nq), ("qvel", 10), ("acc", 10), ("tip", 3))}
    kinds = {"ctrl": tog.Controls(), **{name: tog.Start(name) for name in ("qpos", "qvel", "act")}}
    expected, found = gradients(start, model, kinds, weights)
    assert np.abs(expected).min() > 1e-2  # Each variable counts.
    np.testing.assert_allclose(found, expected, rtol=1e-9, atol=1e-9)


LED = """
<mujoco>
  <option timestep="0.005" integrator="RK4" tolerance="1e-12"/>
  <worldbody>
    <body name="hand" mocap="true" pos="0 0 1" quat="0.8 0.6 0 0"/>
    <body name="cube" pos="0.05 0 0.9"><freejoint/><geom type="box" size="0.1 0.2 0.3" mass="1"/>
      <site name="tip" pos="0.1 0.1 0.1"/></body>
  </worldbody>
  <equality><weld body1="hand" body2="cube" relpose="0 0 0 1 0 0 0" solref="0.1 1"/></equality>
</mujoco>"""


def test_what_is_held_has_the_engines_gradient_too():
    """A mocap body that leads another by a weld: its place and orientation, a mass, and gravity; by RK4."""
    model = mujoco.MjModel.from_xml_string(LED)
    rng, start = np.random.default_rng(0), mujoco.MjData(model)
    start.qvel[:], start.xfrc_applied[2] = rng.normal(size=6), 20.0
    weights = {name: rng.normal(size=k) for name, k in (("qpos", 7), ("qvel", 6), ("acc", 6), ("tip", 3))}
    kinds: dict[str, Any] = {name: tog.Start(name) for name in ("mocap_pos", "mocap_quat")}
    kinds |= {name: tog.Parameters(name) for name in ("body_mass[2]", "opt.gravity")}
    expected, found = gradients(start, model, kinds, weights)
    assert np.abs(expected).min() > 1e-4
    np.testing.assert_allclose(found, expected, rtol=1e-7, atol=1e-9)
    verdict = tog.check_scene(model, start, steps=20, wrt="mocap_quat", engine="mujoco")
    assert (verdict.word, verdict.variables) == ("trust", ("mocap_quat[0, 0]", "mocap_quat[0, 1]", "mocap_quat[0, 2]"))


REFUSED = """
<mujoco>
  <option timestep="0.005" integrator="implicitfast" cone="elliptic" tolerance="1e-12"/>
  <worldbody>
    <geom name="table" type="box" size="1 1 0.1" pos="0 0 -0.1" solref="0.05 1"/>
    <body pos="0 0 0.0495"><joint name="x" type="slide" axis="1 0 0" damping="0.1"/><joint type="slide" axis="0 0 1"/>
      <geom name="can" type="cylinder" size="0.1 0.05" mass="1" solref="0.05 1"/></body>
  </worldbody>
  <actuator><motor name="push" joint="x" gear="20"/></actuator>
  <keyframe><key ctrl="1"/></keyframe>
</mujoco>"""
"""A cylinder that slides on a box, pushed harder than friction holds."""


def refused() -> tuple[mujoco.MjModel, mujoco.MjData]:
    """With a state in which it neither bounces nor sticks."""
    model = mujoco.MjModel.from_xml_string(REFUSED)
    data = default_start(model)
    mujoco.mj_step(model, data, 200)
    return model, data


def test_a_scene_that_mjx_refuses_is_judged():
    """Its gradient is the difference of two whole motions. From where it slides evenly it is trusted; it bounces where
    it is let fall."""
    model, sliding = refused()
    verdict = tog.check_scene(model, sliding, engine="mujoco", steps=40)
    ends = []
    for push in (1 + 1e-4, 1 - 1e-4):
        data = copy_of(model, sliding, ctrl=np.array([push]))
        mujoco.mj_step(model, data, 40)
        ends.append(data.qpos[0])
    assert ends[0] > sliding.qpos[0] + 0.1
    np.testing.assert_allclose(verdict.gradient[0], (ends[0] - ends[1]) / 2e-4, rtol=1e-5)
    assert verdict.word == "trust", str(verdict)
    assert "preflight" not in [some.check for some in verdict.findings]
    verdict = tog.check_scene(model, engine="mujoco", steps=40)
    assert verdict.line.startswith("do not trust: the derivative is that between two jumps: d qpos[1] / d push is ")
    assert "; geom table and geom can begin or cease to touch in step 17, at 0.085 s" in verdict.line


def test_what_mjx_cannot_is_told_and_what_neither_can_weighs():
    model, sliding = refused()
    verdict, on_c = (tog.check_scene(model, sliding, steps=40, engine=engine) for engine in ("mjx", "mujoco"))
    refusal, *others = verdict.findings
    assert (refusal.check, refusal.level) == ("preflight", Level.FINE)
    assert refusal.sentence.startswith(
        "MJX does not support the collision of geom can (cylinder) with geom table (box)"
    )
    assert (tuple(others), verdict.word, verdict.subject) == (on_c.findings, on_c.word, on_c.subject)
    spec = mujoco.MjSpec.from_string(REFUSED)
    spec.actuators[0].delay, spec.actuators[0].nsample = 0.02, 5
    verdict = tog.check_scene(spec, steps=40)
    assert (verdict.word, verdict.engine, verdict.gradient) == ("do not trust", "", ())
    assert verdict.reason == verdict.findings[0]
    last = verdict.findings[-1]
    assert (last.check, last.level) == ("C MuJoCo", Level.FINE)
    assert "engine mujoco has no state for delays" in last.sentence


@pytest.mark.parametrize(
    ("asked", "message"),
    [
        ({"output": lambda data: data.qpos[0]}, "engine mujoco has no mjx.Data for a cost to see"),
        ({"differentiation": "native"}, "differentiation='native' is unknown; choose from implicit, saltation"),
        ({"engine": "penalty"}, "engine='penalty' is unknown; choose from mjx, mujoco"),
    ],
)
def test_what_it_cannot_judge_is_one_line(asked, message):
    with pytest.raises(tog.InputError, match=message) as caught:
        tog.check_scene(mujoco.MjModel.from_xml_string(REFUSED), steps=2, **{"engine": "mujoco", **asked})
    assert "\n" not in str(caught.value)


def test_a_burst_is_told_with_its_step():
    """A spring with which Euler's method swings a hundred times farther at each step, until MuJoCo gives up."""
    xml = """<mujoco><option timestep="1" integrator="Euler"/><worldbody><body><joint type="slide" stiffness="1e2"/>
      <geom size="0.1" mass="1"/></body></worldbody></mujoco>"""
    model = mujoco.MjModel.from_xml_string(xml)
    start = mujoco.MjData(model)
    start.qpos[:] = 1.0
    verdict = tog.check_scene(model, start, engine="mujoco", steps=10)
    step = 0
    while not start.warning.number.any():
        mujoco.mj_step(model, start)
        step += 1
    assert 1 < step < 10
    assert verdict.reason
    assert verdict.reason.sentence == f"the value is NaN or infinite from step {step} on"


def test_a_problem_is_judged_on_c_mujoco():
    """Of a scene that MJX refuses; its gradient is that of J."""
    model, sliding = refused()
    problem = tog.Problem(model, 40, cost=lambda last: (last.qpos[0] - 1) ** 2, start=sliding)
    verdict = tog.check(problem, np.array([1.2]), engine="mujoco")
    J = tog.objective(problem, "mujoco")
    np.testing.assert_allclose(verdict.gradient[0], (J(np.array([1.2001])) - J(np.array([1.1999]))) / 2e-4, rtol=1e-5)
    assert (verdict.word, verdict.subject) == ("trust", "J of model in 1 variables, through C MuJoCo")
    assert "precision" not in [some.check for some in verdict.findings]
    by_itself = tog.check(problem, np.array([1.2]))
    assert (by_itself.gradient, by_itself.engine) == (verdict.gradient, "mujoco")
    refusal, *others = by_itself.findings
    assert tuple(others) == verdict.findings
    assert refusal.sentence.startswith(
        "model: MJX does not support the collision of geom can (cylinder) with geom table"
    )
    with pytest.raises(tog.InputError, match="engine='mujoco' is for a Problem"):
        tog.check(lambda x: x @ x, np.ones(2), engine="mujoco")


SLIDING = """<mujoco><option timestep="0.005" tolerance="{}"/><worldbody>
  <geom type="plane" size="2 2 0.1" solref="0.04 1" solimp="0 0.9 0.02" priority="1"/>
  <body name="box" pos="0 0 0.09"><freejoint/><geom type="box" size="0.1 0.1 0.1" mass="1"/></body></worldbody>
  <keyframe><key qpos="0 0 0.09 1 0 0 0" qvel="1 0.5 0 0 0 2"/></keyframe></mujoco>"""


def test_of_a_problem_whose_solver_stops_early_the_remedy_mends_the_gradient():
    def verdict(tolerance: str):
        model, far = mujoco.MjSpec.from_string(SLIDING.format(tolerance)), lambda last: last.body("box")[0]
        return tog.check(tog.Problem(model, 20, tog.Start("qvel[0]"), far, guess=[1.0]), engine="mujoco")

    judged = verdict("1e-2")
    assert (judged.word, judged.reason.check) == ("do not trust", "agreement")
    assert "<option tolerance='1e-12'/>" in judged.reason.remedy
    assert verdict("1e-12").word == "trust"


def test_the_script_judges_on_c_mujoco_and_writes_json_and_a_page(run_script, tmp_path):
    out = tmp_path / "verdict.json", tmp_path / "verdict.html"
    how = "--engine", "mujoco", "--json", out[0], "--html", out[1]
    status, said, heard = run_script("check_gradients.py", GALLERY / "bounce.xml", "--wrt", "qpos", *how)
    found, page = json.loads(out[0].read_text()), out[1].read_text()
    assert (status, found["engine"], found["reason"]) == (3, "mujoco", "agreement")
    assert ", through C MuJoCo: do not trust: the derivative is that between two jumps" in said
    assert "fault agreement: " in heard
    assert ", through C MuJoCo" in page
    validate_verdict(found)
