"""A cost of a user's own that fails, through `scripts/check_gradients.py`: one line says so, after the user's own."""

from pathlib import Path

import pytest

SCENE = Path(__file__).parent / "scenes" / "verdicts" / "smooth_arm.xml"
COSTS = """
import sys
import jax.numpy as jnp
import numpy as np

def missing(data):
    return deeper(data)["wings"]

def deeper(data):
    return {"qpos": data.qpos}

def misshapen(data):
    return jnp.dot(data.qpos, jnp.ones(7))  # Fails inside JAX.

def concrete(data):
    return 1.0 if data.qpos[0] > 0 else 2.0

def numpys(data):
    return np.sin(data.qpos).sum()

def leaving(data):
    sys.exit(7)

def text(data):
    return "far"

def nothing(data):
    data.qpos.sum()

def vector(data):
    return data.qpos

def phase(data):
    return data.qpos[0] * 1j
"""


@pytest.mark.parametrize(
    ("cost", "lines", "told"),
    [
        ("missing", ["line 7, in missing"], "the cost missing fails: KeyError: 'wings'"),
        ("misshapen", ["line 13, in misshapen"], "the cost misshapen fails: TypeError: dot_general"),
        ("concrete", ["line 16, in concrete"], "the cost concrete fails: TracerBoolConversionError: Attempted"),
        ("numpys", ["line 19, in numpys"], "the cost numpys fails: TracerArrayConversionError: "),
        ("leaving", ["line 22, in leaving"], "the cost leaving fails: it calls sys.exit(7)"),
        ("text", [], "the cost text returns a str; give one number"),
        ("nothing", [], "the cost nothing returns a NoneType; give one number"),
        ("vector", [], "the cost vector returns an array of shape [2]; give one number"),
        ("phase", [], "the cost phase returns a complex number; give a real one"),
    ],
)
def test_a_cost_that_fails_is_told_with_its_own_lines(run_script, tmp_path, monkeypatch, cost, lines, told):
    module = f"costs_{cost}"
    (tmp_path / f"{module}.py").write_text(COSTS)
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(str(tmp_path))
    status, said, complaint = run_script("check_gradients.py", SCENE, "--cost", f"{module}:{cost}")
    *own, last = complaint.splitlines()
    assert (status, said) == (2, "")
    assert last.startswith(f"check_gradients.py: {told}")
    assert ("compute with jax.numpy in place of numpy" in last) == (cost in ("concrete", "numpys"))
    frames = [line for line in own if line.startswith("  File ")]
    assert frames == [f'  File "{tmp_path / module}.py", {line}' for line in lines]


@pytest.mark.parametrize(
    ("text", "frames", "told"),
    [
        ("import sys\nsys.exit(7)", 1, "it calls sys.exit(7)"),
        ("def f():\n    1 / 0\nf()", 2, "ZeroDivisionError: division by zero"),
        ("def f(:", 0, "SyntaxError: "),
        ("f = 3", 0, "is no function but a int"),
    ],
)
def test_a_module_that_fails_is_told_with_its_own_lines(run_script, tmp_path, monkeypatch, text, frames, told):
    name = f"module_that_fails_{len(text)}"
    (tmp_path / f"{name}.py").write_text(text)
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(str(tmp_path))
    status, said, complaint = run_script("check_gradients.py", SCENE, "--cost", f"{name}:f")
    *own, last = complaint.splitlines()
    assert (status, said) == (2, "")
    assert last.startswith(f"check_gradients.py: cost '{name}:f' ")
    assert told in last
    assert sum(line.startswith("  File ") for line in own) == frames
