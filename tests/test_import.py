"""What importing the package takes, each time in a process of its own."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

import tog_mjx
from tog_mjx import api

SCRIPTS = Path(__file__).parent.parent / "scripts"
SCENE = Path(__file__).parent / "scenes" / "box.xml"


def run(*arguments, **environment: str) -> subprocess.CompletedProcess:
    command = [sys.executable, *map(str, arguments)]
    return subprocess.run(command, capture_output=True, text=True, env=os.environ | environment)


def test_the_library_alone_needs_nothing_that_draws_or_prints():
    """None of it can be imported here, and a step is differentiated all the same: dqvel/dqvel of one damped slide."""
    program = """
import sys
others = ("matplotlib", "rich", "PIL", "jinja2", "pandas", "evosax")
sys.modules.update(dict.fromkeys(others))  # Their import fails.
import jax, mujoco, tog_mjx as tog
from mujoco import mjx
xml = '<mujoco><option timestep="0.1"/><worldbody><body><joint type="slide" damping="2"/>'
model = mjx.put_model(mujoco.MjModel.from_xml_string(xml + '<geom size="1" mass="1"/></body></worldbody></mujoco>'))
data = mjx.make_data(model)
print(jax.jit(jax.jacfwd(lambda v: tog.step(model, data.replace(qvel=v)).qvel))(data.qvel).item())
"""
    found = run("-c", program)
    assert found.returncode == 0, found.stderr
    assert float(found.stdout.splitlines()[-1]) == pytest.approx(1 / (1 + 0.1 * 2), rel=1e-6)


def test_the_package_loads_when_a_name_of_it_is_used():
    program = """
import sys, tog_mjx
print("jax" in sys.modules, tog_mjx.running.__name__, "jax" in sys.modules)
from tog_mjx import *
print(step is tog_mjx.step, "Problem" in dir(tog_mjx), hasattr(tog_mjx, "nonsense"), "jax" in sys.modules)
"""
    found = run("-c", program, MUJOCO_GL="")
    assert found.stdout == "False tog_mjx.running False\nTrue True False True\n", found.stderr


def test_every_public_name_is_the_one_of_api():
    hook = {"jaxtyping"}  # Of these tests: it imports that into every module.
    assert dir(tog_mjx) == sorted({name for name in vars(api) if name[0] != "_"} - hook)
    for name in dir(tog_mjx):
        assert getattr(tog_mjx, name) is getattr(api, name)
    with pytest.raises(AttributeError, match="has no attribute 'objectiv'"):
        _ = tog_mjx.objectiv  # type: ignore[attr-defined]


SLIDE = """
<mujoco>
  <option timestep="0.1"/>
  <worldbody><geom type="plane" size="9 9 1"/>
    <body pos="0 0 1"><joint name="x" type="slide" axis="1 0 0"/><geom size="0.1" mass="2"/></body></worldbody>
  <actuator><motor joint="x"/></actuator>
</mujoco>"""


def test_a_gradient_and_a_verdict_of_c_mujoco_load_neither_mjx_nor_what_draws_and_descends():
    """MJX comes when it is asked for, also inside a transformation. Three steps under a force u end at 6 dt^2 u / m."""
    program = """
import sys
import jax, mujoco, tog_mjx as tog
spec = mujoco.MjSpec.from_string(sys.argv[1])
problem = tog.Problem(spec, 3, cost=lambda last: last.joint("x"))
print(jax.grad(tog.objective(problem, "mujoco"))(problem.x0).item())
print(tog.check_scene(spec.compile(), steps=100, engine="mujoco").level.name)
others = ("mujoco.mjx", "trimesh", "scipy", "optax", "matplotlib", "pandas", "rich")
print([name for name in others if name in sys.modules])
print(jax.jit(lambda x: tog.Parameter(spec, "body_mass[1]")(x).body_mass[1])(jax.numpy.full(1, 5.0)).item())
from tog_mjx.stepping._mjx import mjx
print(isinstance(mjx.put_model(spec.compile()), mjx.Model), isinstance(spec, mjx.Model))
"""
    found = run("-c", program, SLIDE)
    assert found.returncode == 0, found.stderr
    gradient, *others = found.stdout.splitlines()
    assert float(gradient) == pytest.approx(6 * 0.1**2 / 2, rel=1e-5)
    assert others == ["FINE", "[]", "5.0", "True False"]


def test_a_part_imported_alone_knows_the_names_that_the_paper_gives():
    program = """
from tog_mjx.engines.simulator import gradient_charge
from tog_mjx.problems.library import get_problem
print(get_problem("grasp").name, gradient_charge("released") > 1)
"""
    found = run("-c", program)
    assert found.stdout == "grasp True\n", found.stderr


def test_commands_do_without_the_extras():
    """All but the studies: whoever installs the package alone has none of these."""
    program = """
import importlib, sys
from tog_mjx.__main__ import commands
sys.modules.update(dict.fromkeys(("pandas", "evosax", "imageio_ffmpeg", "cma", "brax", "mujoco_playground")))
for name in set(commands()) - {"study"}:
    importlib.import_module(f"tog_mjx.commands.{name}")
"""
    found = run("-c", program)
    assert found.returncode == 0, found.stderr


def test_an_opengl_that_does_not_work_is_told_in_one_line_and_done_without(tmp_path):
    gif = tmp_path / "a.gif"
    arguments = (SCRIPTS / "view_scene.py", SCENE, "--gif", gif, "--duration", 0.1, "--size", 64, 48)
    found = run(*arguments, MUJOCO_GL="nonsense")
    assert found.returncode == 0, found.stderr
    (line,) = found.stderr.splitlines()
    assert "MUJOCO_GL=nonsense does not work here" in line
    assert "choose egl, osmesa, glfw or disable" in line
    assert "drawn from the side without OpenGL (nonsense: " in found.stdout
    assert gif.is_file()


def test_the_wish_for_opengl_is_left_as_it_is():
    program = "import os, tog_mjx, mujoco; print(os.environ['MUJOCO_GL'], hasattr(mujoco, 'GLContext'))"
    for wish, is_there in (("nonsense", False), ("glfw", True)):
        assert run("-W", "ignore", "-c", program, MUJOCO_GL=wish).stdout.splitlines()[-1] == f"{wish} {is_there}"
