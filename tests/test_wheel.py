"""What is installed without the repository: a wheel and a source distribution, each in an environment of its own."""

import csv
import importlib.util
import json
import os
import subprocess
import sys
import sysconfig
import tarfile
from pathlib import Path

import numpy as np
import pytest
from PIL import Image, ImageSequence

from tog_mjx.paper.published import published

ROOT = Path(__file__).parent.parent
BUILDERS = ("hatchling", "pip")
pytestmark = pytest.mark.skipif(
    not all(map(importlib.util.find_spec, BUILDERS)), reason="it takes pip and hatchling: pip install '.[test]'"
)
LARGEST = 100_000
"""Bytes of a file: what is longer is a picture or a result. Of all, compressed, ten times as much."""


def python(*arguments) -> None:
    done = subprocess.run([sys.executable, "-m", *map(str, arguments)], cwd=ROOT, capture_output=True, text=True)
    assert done.returncode == 0, done.stdout + done.stderr


@pytest.fixture(scope="module")
def built(tmp_path_factory) -> dict[str, Path]:
    """By kind."""
    folder = tmp_path_factory.mktemp("built")
    python("hatchling", "build", "-t", "wheel", "-t", "sdist", "-d", folder)
    (wheel,), (sdist,) = folder.glob("*.whl"), folder.glob("*.tar.gz")
    return {"wheel": wheel, "sdist": sdist}


@pytest.fixture(scope="module")
def environments(built, tmp_path_factory) -> dict[str, Path]:
    """By kind, environments that have it and, of this one, all but this package."""
    found = {}
    for kind, file in built.items():
        folder = tmp_path_factory.mktemp(kind)
        python("venv", "--without-pip", folder)
        (site,) = folder.glob("lib/python*/site-packages")
        (site / "others.pth").write_text("\n".join({sysconfig.get_path("purelib"), sysconfig.get_path("platlib")}))
        how = ("--no-deps", "--no-index", "--no-build-isolation", "--quiet", "--disable-pip-version-check")
        python("pip", "--python", folder / "bin" / "python", "install", *how, file)
        found[kind] = folder
    return found


@pytest.fixture
def tog(environments, tmp_path):
    """Runs the `tog` of the wheel, in an empty folder: arguments to (status, what it prints)."""

    def run(*arguments, **environment: str) -> tuple[int, str]:
        known = {name: value for name, value in os.environ.items() if name != "PYTHONPATH"}
        command = [environments["wheel"] / "bin" / "tog", *map(str, arguments)]
        done = subprocess.run(command, cwd=tmp_path, env=known | environment, capture_output=True, text=True)
        return done.returncode, done.stdout

    return run


def record(environment: Path) -> dict[str, str]:
    """The digest of each file of the package that is installed there."""
    (file,) = environment.glob("lib/python*/site-packages/tog_mjx-*.dist-info/RECORD")
    rows = csv.reader(file.read_text().splitlines())
    return {name: digest for name, digest, _ in rows if name.startswith("tog_mjx/") and digest}


def test_both_bring_the_same_package_and_all_of_it(environments):
    wheel = record(environments["wheel"])
    assert record(environments["sdist"]) == wheel
    here = {path.relative_to(ROOT).as_posix() for path in (ROOT / "tog_mjx").rglob("*.*") if path.suffix != ".pyc"}
    scenes = {f"tog_mjx/models/{path.name}" for path in (ROOT / "models").glob("*.xml")}
    examples = {f"tog_mjx/examples/{path.name}" for path in (ROOT / "scripts" / "examples").glob("*.py")}
    assert set(wheel) == here | scenes | examples


def test_the_source_holds_what_is_needed_to_build_and_to_test_and_nothing_large(built):
    with tarfile.open(built["sdist"]) as archive:
        sizes = {member.name.partition("/")[2]: member.size for member in archive.getmembers() if member.isfile()}
    assert {"pyproject.toml", "README.md", "LICENSE", "models/flip.xml", "tests/conftest.py"} <= set(sizes)
    assert {name.partition("/")[0] for name in sizes if "/" in name} == {"models", "scripts", "tests", "tog_mjx"}
    assert not [name for name in sizes if name.endswith((".png", ".gif", ".npz", ".partial", ".pyc"))]
    assert max(sizes.values()) < LARGEST
    assert built["sdist"].stat().st_size < 10 * LARGEST


def test_a_verdict_on_the_example(tog):
    status, said = tog("check", "tog_mjx.examples.push:push", "--engine", "mujoco")
    verdict = "J of push in 6 variables, through C MuJoCo: trust: no check found a fault"
    assert (status, said) == (0, f"tog_mjx.examples: {verdict}\n")


def test_a_short_reproduction(tog, tmp_path):
    asked = ("--engine", "released", "--task", "flip", "--method", "exact", "--iterations", 1, "--landscape", 0)
    status, _ = tog("reproduce", *asked)
    assert status == 0
    (entry,) = json.loads((tmp_path / "results" / "summary.json").read_text())
    trace = published("flip", "exact").costs[:2]
    np.testing.assert_allclose([entry["cost_first"], entry["cost_last"]], trace, rtol=1e-4)
    assert (tmp_path / "results" / "report.html").is_file()


def test_a_view(tog, tmp_path):
    how = ("--duration", 0.2, "--fps", 10, "--speed", 1, "--size", 64, 48)
    status, said = tog("view", "grasp", "--gif", "a.gif", *how, MUJOCO_GL="disable")
    assert status == 0
    assert said.startswith("a.gif: 3 frames, ")
    with Image.open(tmp_path / "a.gif") as film:
        assert [frame.size for frame in ImageSequence.Iterator(film)] == [(64, 48)] * 3
