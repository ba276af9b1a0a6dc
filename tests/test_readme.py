"""What the README shows is so."""

import re
from pathlib import Path

import numpy as np

ROOT = Path(__file__).parent.parent
README = (ROOT / "README.md").read_text()
SMALL = {"errors.py", "types.py", "safe.py", "console.py", "published.py"}
"""What the layout leaves out."""


def fenced(language: str) -> list[str]:
    return re.findall(rf"^```{language}\n(.*?)^```$", README, re.MULTILINE | re.DOTALL)


def test_the_python_example_runs_and_both_codes_agree():
    (example,) = fenced("python")
    names: dict = {}
    exec(compile(example, "README.md", "exec"), names)
    tog, jax, u = names["tog"], names["jax"], names["u"]
    np.testing.assert_allclose(names["J"](u), (names["motion"].box[-1, 1] - 1) ** 2, rtol=1e-2)
    mjx, penalty = (jax.grad(tog.objective("grasp", simulator))(u) for simulator in ("mjx", "penalty"))
    np.testing.assert_allclose(mjx, penalty, rtol=1e-3, atol=1e-9)


def test_the_layout_names_every_file_and_no_other():
    scripts, package = re.findall(r"^scripts/ (.*?)^tog_mjx/\n(.*?)^tests/", README, re.MULTILINE | re.DOTALL)[0]
    assert set(re.findall(r"\w+\.py", scripts)) == {path.name for path in (ROOT / "scripts").glob("*.py")}
    files = {path.name for path in (ROOT / "tog_mjx").glob("[a-z]*.py")}
    folders = {f"{path.parent.name}/" for path in (ROOT / "tog_mjx").glob("*/*.py")}
    assert set(re.findall(r"^  (\S+)", package, re.MULTILINE)) == (files | folders) - SMALL


def test_the_results_table_is_that_of_the_published_runs():
    table = re.findall(r"^\| (?:\w+, \w+)? ?\| (?:published|released) \| (.*?) \|$", README, re.MULTILINE)
    published, released = table[::2], table[1::2]
    assert len(published) == 4
    for ours, theirs in zip(released, published, strict=True):
        assert ours.split(" | ")[:3] == theirs.split(" | ")[:3]
