"""What a library is given by mistake: one line says what is wrong, and nothing compiles."""

import pickle
from typing import Any

import jax
import jax.numpy as jnp
import jaxtyping
import mujoco
import numpy as np
import pytest

import tog_mjx
from tog_mjx.stepping._mjx import make_data, put_model

ARM = """<mujoco><worldbody><body><joint name="hinge" axis="0 1 0"/><geom size="0.1"/><site name="gripper"/></body>
  </worldbody><actuator><motor joint="hinge"/></actuator></mujoco>"""
BALL = "<mujoco><worldbody><body><freejoint/><geom size='0.1'/></body></worldbody></mujoco>"
tog: Any = tog_mjx  # Annotations are what is disregarded here.
X = np.array([0.3, 0.7])
arm, ball = (mujoco.MjModel.from_xml_string(xml) for xml in (ARM, BALL))
model, data, of_ball = put_model(arm), make_data(arm), make_data(ball)
backwards = mujoco.MjModel.from_xml_string(ARM)
backwards.opt.timestep = -0.002


@pytest.fixture(autouse=True)
def without_annotations():
    """As a user's program runs: these tests have annotations checked."""
    before = jaxtyping.config.jaxtyping_disable
    jaxtyping.config.update("jaxtyping_disable", True)
    yield
    jaxtyping.config.update("jaxtyping_disable", before)


@pytest.mark.parametrize(
    ("function", "message"),
    [
        ("J", "the objective is of type str; give a function of an array"),
        (lambda x: {"J": x.sum()}, "<lambda> returns a dict; give one number, or an array of them"),
        (lambda x: (x, x.sum()), "<lambda> returns a tuple; give"),
        (lambda x: jnp.round(x).astype(int), "<lambda> returns int.., which has no derivative; give"),
        (lambda x: x.sum() * 1j, "<lambda> returns a complex number; give a real one"),
        (lambda _: None, "<lambda> returns a NoneType; give"),
        (lambda _: "far", "<lambda> returns a str; give"),
        (lambda x: x[:0], r"<lambda> returns nothing: an array of shape \[0\]"),
        (lambda x: 1.0 if x[0] > 0 else 2.0, "<lambda> fails: TracerBoolConversionError: Attempted"),
    ],
)
def test_functions_that_check_cannot_differentiate(function, message):
    with pytest.raises(tog.InputError, match=message):
        tog.check(function, X)


@pytest.mark.parametrize("x", ["near", {"x": "near"}, 1j * X, None])
def test_points_that_check_cannot_take(x):
    with pytest.raises(tog.InputError, match="give a vector of finite numbers"):
        tog.check(jnp.sum, x)


@pytest.mark.parametrize(
    ("arguments", "options", "message"),
    [
        (("grasp",), {}, "the model is of type str; give the mujoco.MjModel"),
        ((model,), {}, r"the model is of type Model; give the mujoco.MjModel \(what mjx.put_model made it of\)"),
        ((arm, "start"), {}, "the start is of type str; give a mujoco.MjData"),
        ((arm, mujoco.MjData(ball)), {}, r"qpos of the data has the shape \[7\], and that of the model \[1\]"),
        ((arm,), {"steps": 1.5}, "steps is 1.5: give a whole number from 1 to"),
        ((arm,), {"steps": 3 * 10**9}, "steps is 3000000000: give a whole number from 1 to 10000000"),
        ((arm,), {"differentiation": "magic"}, "differentiation='magic' is unknown; choose from implicit, salt"),
        ((arm,), {"differentiation": "implict"}, "did you mean implicit?"),
        ((arm,), {"wrt": 3}, "wrt is of type int"),
        ((arm,), {"wrt": "field:ctrl"}, "'field:ctrl' is no field of mjx.Model; give ctrl"),
        ((arm,), {"wrt": "ctlr"}, r"'ctlr' is none of .*did you mean ctrl\?"),
        ((arm,), {"wrt": "geom_friction[0, 0"}, r"'geom_friction\[0, 0': geom_friction has the shape \[1, 3\]"),
        ((arm,), {"output": "griper"}, r"no site or sensor named griper.*did you mean gripper\?"),
        ((arm,), {"output": 3}, "output is of type int"),
        ((arm,), {"path": 3}, "path is of type int"),
        ((backwards,), {}, "<option timestep> is -0.002; give a positive number of seconds"),
    ],
)
def test_scenes_that_check_scene_cannot_take(arguments, options, message):
    with pytest.raises(tog.InputError, match=message):
        tog.check_scene(*arguments, **options)


@pytest.mark.parametrize("step", [tog.step, lambda model, data: tog.simulate(model, data, jnp.zeros(1), 3)])
@pytest.mark.parametrize(
    ("given", "message"),
    [
        ((arm, data), "the model is of type MjModel; give what mjx.put_model makes"),
        ((model, mujoco.MjData(arm)), "the data is of type MjData; give what mjx.make_data"),
        ((model, None), "the data is of type NoneType"),
        ((model, of_ball), r"qpos of the data has the shape \[7\], and that of the model \[1\]"),
    ],
)
def test_steps_that_cannot_be_made(step, given, message):
    with pytest.raises(tog.InputError, match=message):
        step(*given)


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: tog.simulate(model, data, "fast", 3), "controls are no array of numbers"),
        (lambda: tog.simulate(model, data, jnp.zeros(1), 1.5), "steps is 1.5"),
        (lambda: tog.simulate(model, data, jnp.zeros(1), 3, checkpoint=1.5), "checkpoint is 1.5"),
        (lambda: tog.simulate(model, data, jnp.zeros(1), 3, observe=3), "observe is of type int"),
        (lambda: tog.solve("flip", budget="large"), "budget is of type str"),
        (lambda: tog.objective("flip", "penalty")([1e300, 1.0]), r"x = \[1e\+300, 1.0\] is too far away"),
        (lambda: tog.load_scene(3), "the scene is of type int"),
        (lambda: tog.load_scene("grap"), "did you mean grasp?"),
        (lambda: tog.get_task("flipp"), "did you mean flip?"),
        (lambda: tog.get_task("flip", "4"), "knots is '4'"),
        (lambda: tog.get_task("flip", [4]), r"knots is \[4\]"),
        (
            lambda: tog.get_task(tog.Problem(arm, 1, tog.Start(), cost=len)),
            "model is a problem, and none of the paper's",
        ),
        (lambda: tog.make_simulator("mjx", "flip"), "the scene is of type str; give what tog.load_scene returns"),
    ],
)
def test_other_arguments(call, message):
    with pytest.raises(tog.InputError, match=message):
        call()


def test_a_batch_of_as_many_members_as_steps_must_say_what_its_controls_are():
    """[2, 1] is one control a member or one a step."""
    batch = jax.tree.map(lambda x: jnp.stack([x, x]), data)
    with pytest.raises(tog.InputError, match=r"both are 2; give \[2, 2, 1\]"):
        tog.simulate(model, batch, jnp.ones((2, 1)), 2)


@pytest.mark.parametrize("task", ["flip", tog.get_task("grasp", knots=3)])
def test_an_objective_can_be_pickled(task):
    J = tog.objective(task, "penalty")
    u = tog.get_task(task).initial_guess + 0.02
    assert pickle.loads(pickle.dumps(J))(u) == J(u)


@pytest.mark.parametrize(
    ("source", "name", "message"),
    [
        (3, "geom_size", "the source is of type int; give a mujoco.MjSpec"),
        (arm, 3, "the name is of type int"),
        (arm, "geom_siz", "'geom_siz' is not an array.*did you mean geom_size"),
        (arm, "geom_size[9]", r"'geom_size\[9\]': geom_size has the shape"),
        (arm, "pair_friction", "the model has no pair_friction"),
        (mujoco.MjSpec.from_string(BALL.replace("<geom size='0.1'/>", "")), "body_mass", "the MjSpec does not compile"),
    ],
)
def test_parameters_that_are_none(source, name, message):
    with pytest.raises(tog.InputError, match=message):
        tog.Parameter(source, name)


def test_a_model_that_cannot_be_converged():
    with pytest.raises(tog.InputError, match=r"the model is of type str; give an mjx\.Model or a mujoco\.MjModel"):
        tog.converged("scene.xml")
