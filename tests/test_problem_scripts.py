"""A problem that lives in a file of its own, at the command line: its verdict, its motion, and what is wrong in it."""

import json
import re
import socket

import jax
import numpy as np
import pytest
from PIL import Image, ImageSequence

import tog_mjx as tog

# As a user would write it: a ball that pushes a puck along a rail, for its place, and for little effort on the way.
PUSH = """
import mujoco
import tog_mjx as tog

XML = '''<mujoco model="push"><option timestep="0.005" gravity="0 0 0" iterations="50" tolerance="1e-12"/>
  <worldbody>
    <body name="puck" pos="0.3 0 0"><joint type="slide" axis="1 0 0" damping="1"/><geom size="0.1" mass="0.5"/></body>
    <body name="ball"><joint name="ball" type="slide" axis="1 0 0"/><geom size="0.1" mass="0.2"/></body>
  </worldbody>
  <actuator><motor name="motor" joint="ball" ctrlrange="-2 2"/></actuator></mujoco>'''

def push():
    return tog.Problem(
        mujoco.MjSpec.from_string(XML), steps=60, variables=tog.Controls(), guess=[1.5],
        cost=lambda last: (last.body("puck")[0] - 0.6) ** 2, running_cost=lambda state: 1e-3 * state.ctrl @ state.ctrl)

def broken():
    return tog.Problem(
        mujoco.MjSpec.from_string(XML), 5, cost=lambda last: last.body("cube")[0])

def misshapen():
    return tog.Problem(mujoco.MjSpec.from_string(XML), 5, guess=[1.5, 2.0], cost=lambda last: last.qpos[0])

def uncalled():
    return tog.Problem(mujoco.MjSpec.from_string(XML), 5, tog.Controls, cost=lambda last: last.qpos[0])

def none():
    return 3
"""


@pytest.fixture
def file(tmp_path):
    (tmp_path / "my_problem.py").write_text(PUSH)
    return tmp_path / "my_problem.py"


def test_it_gets_a_verdict_and_a_motion_to_look_at(run_script, file, tmp_path, monkeypatch):
    monkeypatch.setenv("MUJOCO_GL", "disable")
    status, said, complaint = run_script("check_gradients.py", f"{file}:push", "--json", tmp_path / "verdict.json")
    found = json.loads((tmp_path / "verdict.json").read_text())
    assert status == {"trust": 0, "trust with care": 1, "do not trust": 3}[found["verdict"]], complaint
    assert "my_problem: J of push in 1 variables" in said
    assert found["variables"] == ["motor"]
    with jax.enable_x64():
        J, h = tog.objective(tog.Problem.load(f"{file}:push")), 1e-6
        expected = (J([1.5 + h]) - J([1.5 - h])) / (2 * h)
    np.testing.assert_allclose(found["gradient"], [[expected]], rtol=1e-4)

    np.save(tmp_path / "x.npy", [2.0])
    moved = []
    for x in ([], ["--x", tmp_path / "x.npy"]):
        status, said, complaint = run_script("view_scene.py", f"{file}:push", "--gif", tmp_path / "push.gif", *x)
        assert status == 0, complaint
        assert re.match(r"on \w+: a gradient takes .* ms on C MuJoCo", said)
        with Image.open(tmp_path / "push.gif") as image:
            moved.append([np.asarray(frame.convert("RGB")) for frame in ImageSequence.Iterator(image)])
    guess, pushed = moved
    assert len(guess) == len(pushed) > 5
    assert (guess[-1] != pushed[-1]).any()


def test_the_page_that_shows_a_problem_has_a_speed(run_script, file):
    """It gets as far as the port, which is taken."""
    with socket.create_server(("", 0)) as taken:
        port = taken.getsockname()[1]
        status, _, complaint = run_script("view_scene.py", f"{file}:push", "--web", "--speed", 0.5, "--port", port)
    assert status == 2
    assert "the page cannot be served" in complaint.splitlines()[-1]


@pytest.mark.parametrize(
    ("script", "arguments", "message"),
    [
        ("check_gradients.py", ["{}:none"], "returns is of type int; give a tog.Problem"),
        ("check_gradients.py", ["{}:pusch"], "my_problem.py has no pusch; did you mean push?"),
        ("check_gradients.py", ["{}:push", "--steps", "3"], "argument --steps: a problem says that itself"),
        ("check_gradients.py", ["{}:broken"], "no body named cube; choose from world, puck, ball"),
        ("view_scene.py", ["{}:push", "--duration", "3"], "argument --duration: a problem has its own"),
        ("view_scene.py", ["flip", "--x", "x.npy"], "argument --x: it is of a problem"),
        ("view_scene.py", ["{}:push", "--x", "{}", "--gif", "new.gif"], "is no .npy file"),
    ],
)
def test_bad_input_is_one_line_and_status_2(run_script, file, tmp_path, monkeypatch, script, arguments, message):
    monkeypatch.chdir(tmp_path)
    status, said, complaint = run_script(script, *(argument.format(file) for argument in arguments))
    assert (status, said) == (2, "")
    assert message in complaint.splitlines()[-1]


@pytest.mark.parametrize(
    ("problem", "places", "told"),
    [
        ("broken", ["in <lambda>"], "J of push fails: cost fails: the scene has no body named cube"),
        ("misshapen", ["in misshapen"], "fails: x has the shape [2]; push takes [1]: motor"),
        ("uncalled", ["in uncalled"], "fails: a variable is the class Controls; give one of it, as Controls()"),
    ],
)
def test_of_the_lines_that_failed_those_in_the_file_alone_are_shown(
    run_script, file, tmp_path, monkeypatch, problem, places, told
):
    monkeypatch.chdir(tmp_path)
    _, _, complaint = run_script("check_gradients.py", f"{file}:{problem}", "--engine", "mujoco")
    *own, last = complaint.splitlines()
    frames = [line for line in own if line.startswith("  File ")]
    assert [frame.rpartition(", ")[2] for frame in frames] == places
    assert all(str(file) in frame for frame in frames)
    assert told in last
