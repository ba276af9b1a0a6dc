"""A kept result depends on the code that computes it, on the libraries that this uses, and on nothing else."""

import importlib.metadata
import re
import sys
from collections.abc import Callable
from pathlib import Path

import mujoco
import pytest

import tog_mjx
from tog_mjx.paper.comparison import Run
from tog_mjx.running.digests import COMPUTES, function_digest, lowered, modules_behind, program_digest

PACKAGE = Path(tog_mjx.__file__).parent
QUESTIONS = ("paper.questions.why", "paper.questions.asymmetry")
STUDIES = ("studies.cell", *QUESTIONS)
MAKERS = ("paper.comparison", "paper.gradient_agreement", *STUDIES, "checks.alone")
"""Modules that keep results."""


def digests(package: Path = PACKAGE) -> dict[str, str]:
    return {maker: program_digest.__wrapped__(f"tog_mjx.{maker}", package) for maker in MAKERS}


def edited(folder: Path, edit: Callable[[str], str], chosen: str = "") -> Path:
    """The package with one of its files edited, or all of them; the others are links."""
    for file in PACKAGE.rglob("*.py"):
        new = folder / "any_name" / file.relative_to(PACKAGE)
        new.parent.mkdir(parents=True, exist_ok=True)
        if chosen in ("", file.relative_to(PACKAGE).as_posix()):
            text = file.read_text()
            assert edit(text) != text
            new.write_text(edit(text))
        else:
            new.symlink_to(file)
    return folder / "any_name"


def test_text_in_the_code_does_not_count(tmp_path):
    """Comments, docstrings and blank lines, in every file."""

    def explain(text: str) -> str:
        text = re.sub(r'^( *)"""(?=[A-Z])', r'\1"""Indeed: ', text, flags=re.MULTILINE)
        return text.replace("\ndef ", "\n\n# To explain:\ndef ") + "\n# The end.\n"

    assert digests(edited(tmp_path, explain)) == digests()


@pytest.mark.parametrize(
    ("file", "old", "new", "changed"),
    [
        ("stepping/implicit.py", "/ 2", "/ 3", MAKERS),
        ("engines/penalty.py", "dt", "delta", MAKERS),
        ("solving/descent.py", "tolerance", "limit", {"paper.comparison", *STUDIES}),
        ("gradients/mixed.py", "key", "keys", set(STUDIES)),
        ("checks/measured/zeros.py", "slopes", "inclines", {"checks.alone"}),
        ("studies/study.py", "quick", "fast", set(QUESTIONS)),
        ("drawing/figures/predictions.py", "axes", "frame", set()),
        ("api.py", "Task as Task", "Task as Work", set()),
    ],
)
def test_code_counts_where_it_has_a_part(tmp_path, file, old, new, changed):
    before, after = digests(), digests(edited(tmp_path, lambda text: text.replace(old, new), file))
    assert {maker for maker in MAKERS if after[maker] != before[maker]} == set(changed)


@pytest.mark.parametrize(
    ("library", "changed"),
    [
        ("jaxlib", MAKERS),
        ("mujoco-mjx", MAKERS),
        ("optax", {"paper.comparison", *STUDIES}),
        ("evosax", set(STUDIES)),
        ("scipy", set(QUESTIONS)),
        ("matplotlib", set()),
    ],
)
def test_a_library_counts_where_it_is_used(monkeypatch, library, changed):
    before, version = digests(), importlib.metadata.version
    monkeypatch.setattr(importlib.metadata, "version", lambda name: "9.9" if name == library else version(name))
    after = digests()
    assert {maker for maker in MAKERS if after[maker] != before[maker]} == set(changed)


def test_every_library_is_known_to_compute_or_not_to():
    files = [file.relative_to(PACKAGE).with_suffix("") for file in PACKAGE.rglob("*.py")]
    used = set[str]().union(*(modules_behind(f"tog_mjx.{'.'.join(file.parts)}") for file in files))
    used = {name for name in used if not name.startswith("tog_mjx")}
    others = {"jaxtyping", "pandas", "matplotlib", "rich", "packaging", "jinja2", "PIL", "imageio_ffmpeg"}
    assert {name for name in used if name not in COMPUTES} - others <= sys.stdlib_module_names


def test_a_descent_made_with_another_optax_is_another(monkeypatch):
    run, version = Run("penalty", "flip", "exact"), importlib.metadata.version
    before = run.settings()
    program_digest.cache_clear()
    monkeypatch.setattr(importlib.metadata, "version", lambda name: "9.9" if name == "optax" else version(name))
    after = run.settings()
    program_digest.cache_clear()
    assert {name for name in before if before[name] != after[name]} == {"program"}


def test_a_digest_of_j_knows_the_model_that_its_program_leaves_to_c_mujoco():
    """Kept landscapes are read again by it."""

    def digest(mass: float) -> str:
        body = f'<body><joint type="slide"/><geom size="1" mass="{mass}"/></body>'
        model = mujoco.MjModel.from_xml_string(f"<mujoco><worldbody>{body}</worldbody></mujoco>")
        problem = tog_mjx.Problem(model, 2, tog_mjx.Start("qvel"), cost=lambda last: last.qpos[0])
        return function_digest(lowered(tog_mjx.objective(problem, "mujoco"), problem.x0))

    assert digest(1) == digest(1)
    assert digest(1) != digest(2)
