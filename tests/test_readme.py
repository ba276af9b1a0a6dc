"""What the README shows is so."""

import re
from pathlib import Path

import numpy as np
from test_rooms import ROOMS

import tog_mjx as tog

RAILS = {"x": "1 0 0", "y": "0 1 0"}
ROOT = Path(__file__).parent.parent
README = (ROOT / "README.md").read_text()


def fenced(language: str) -> list[str]:
    return re.findall(rf"^```{language}\n(.*?)^```$", README, re.MULTILINE | re.DOTALL)


def test_the_python_example_runs_and_both_codes_agree():
    example, _ = fenced("python")
    names: dict = {}
    exec(compile(example, "README.md", "exec"), names)
    tog, jax, u = names["tog"], names["jax"], names["u"]
    np.testing.assert_allclose(names["J"](u), (names["motion"].box[-1, 1] - 1) ** 2, rtol=1e-2)
    mjx, penalty = (jax.grad(tog.objective("grasp", simulator))(u) for simulator in ("mjx", "penalty"))
    np.testing.assert_allclose(mjx, penalty, rtol=1e-3, atol=1e-9)


def test_the_problem_of_the_example_is_one(tmp_path, monkeypatch):
    """A cube on two rails; a verdict and a descent of such a problem have tests of their own."""
    rails = "".join(f'<joint name="{axis}" type="slide" axis="{vector}"/>' for axis, vector in RAILS.items())
    motors = "".join(f'<motor joint="{axis}"/>' for axis in RAILS)
    (tmp_path / "push.xml").write_text(f"""<mujoco><option timestep="0.01"/>
      <worldbody><body name="cube">{rails}<geom type="box" size="0.1 0.1 0.1" mass="2"/></body></worldbody>
      <actuator>{motors}</actuator></mujoco>""")
    monkeypatch.chdir(tmp_path)
    _, example = fenced("python")
    made, _, rest = example.partition("print(tog.check(push))")
    assert "tog.solve(push" in rest
    names: dict = {"tog": tog}
    exec(compile(made, "README.md", "exec"), names)
    push = names["push"]
    forces = np.tile([0.3, -0.1], 5)
    there = np.array([0.3, -0.1]) / 2 * 0.01**2 * 200 * 201 / 2
    expected = ((there - [0.3, 0.1]) ** 2).sum() + 1e-3 * (0.3**2 + 0.1**2)
    np.testing.assert_allclose(tog.objective(push)(forces), expected, rtol=1e-5)


def test_the_layout_names_every_room_and_no_other():
    scripts, package = re.findall(r"^scripts/ (.*?)^tog_mjx/.*?\n(.*?)^tests/", README, re.MULTILINE | re.DOTALL)[0]
    assert set(re.findall(r"\w+\.py", scripts)) == {path.name for path in (ROOT / "scripts").glob("*.py")}
    assert re.findall(r"^  (\S+)/ ", package, re.MULTILINE) == ROOMS


def test_the_results_table_is_that_of_the_published_runs():
    table = re.findall(r"^\| (?:\w+, \w+)? ?\| (?:published|released) \| (.*?) \|$", README, re.MULTILINE)
    published, released = table[::2], table[1::2]
    assert len(published) == 4
    for ours, theirs in zip(released, published, strict=True):
        assert ours.split(" | ")[:3] == theirs.split(" | ")[:3]
