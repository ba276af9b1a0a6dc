"""What the README, the guide and the page on the paper show is so."""

import re
from pathlib import Path

import numpy as np
import pytest
from test_pages import PAGES
from test_rooms import ROOMS

import tog_mjx as tog

RAILS = {"x": "1 0 0", "y": "0 1 0"}
ROOT = Path(__file__).parent.parent
README = (ROOT / "README.md").read_text()
FINDINGS = ROOT / "scripts" / "findings"
DOCUMENTS = [ROOT / "README.md", ROOT / "CHANGELOG.md", *(FINDINGS / f"{page}.md" for page in PAGES)]


def fenced(language: str, path: Path = ROOT / "README.md") -> list[str]:
    return re.findall(rf"^```{language}\n(.*?)^```$", path.read_text(), re.MULTILINE | re.DOTALL)


def test_it_is_read_in_five_minutes():
    assert len(README.splitlines()) <= 150


def test_its_two_commands_are_a_line_each():
    assert [len(command.splitlines()) for command in fenced("sh")] == [1, 1]


def test_the_guides_example_runs_and_both_codes_agree():
    (example,) = fenced("python", FINDINGS / "guide.md")
    names: dict = {}
    exec(compile(example, "guide.md", "exec"), names)
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
    (example,) = fenced("python")
    made, _, rest = example.partition("print(tog.check(push))")
    assert "tog.solve(push" in rest
    names: dict = {}
    exec(compile(made, "README.md", "exec"), names)
    forces = np.tile([0.3, -0.1], 5)
    there = np.array([0.3, -0.1]) / 2 * 0.01**2 * 200 * 201 / 2
    expected = ((there - [0.3, 0.1]) ** 2).sum()
    np.testing.assert_allclose(tog.objective(names["push"])(forces), expected, rtol=1e-5)


def test_the_layout_names_every_room_and_no_other():
    (package,) = re.findall(r"^tog_mjx/.*?\n(.*?)^tests/", README, re.MULTILINE | re.DOTALL)
    assert re.findall(r"^  (\S+)/ ", package, re.MULTILINE) == ROOMS


def test_the_results_table_is_that_of_the_published_runs():
    page = (FINDINGS / "paper.md").read_text()
    table = re.findall(r"^\| (?:\w+, \w+)? ?\| (?:published|released) \| (.*?) \|$", page, re.MULTILINE)
    published, released = table[::2], table[1::2]
    assert len(published) == 4
    for ours, theirs in zip(released, published, strict=True):
        assert ours.split(" | ")[:3] == theirs.split(" | ")[:3]


def test_every_number_of_the_main_results_is_on_the_page_that_it_leads_to():
    (table,) = re.findall(r"^## What was found\n(.*?)^## ", README, re.MULTILINE | re.DOTALL)
    rows = [row for row in table.splitlines() if "](" in row]
    assert len(rows) > 5
    for row in rows:
        (page,) = re.findall(r"\]\((scripts/findings/\w+\.md)", row)
        known = re.findall(r"[\d.,]+(?:e[-+]?\d+)?", (ROOT / page).read_text())
        known = [number.strip(".,") for number in known]
        assert [
            number
            for number in re.findall(r"\d[\d.,]*(?:e[-+]?\d+)?", row.rpartition("|")[0].rpartition("|")[0])
            if number.strip(".,") not in known
        ] == [], row


def anchor(heading: str) -> str:
    return re.sub(r"[^\w\- ]", "", heading.lower()).replace(" ", "-")


@pytest.mark.parametrize("path", DOCUMENTS, ids=lambda path: path.stem)
def test_no_link_leads_nowhere(path):
    for target in re.findall(r"\]\(([^)]*)\)", path.read_text()):
        if target.startswith("http"):
            continue
        name, _, part = target.partition("#")
        there = path.parent / name if name else path
        assert there.exists(), target
        if part:
            assert part in map(anchor, re.findall(r"^#+ (.*)$", there.read_text(), re.MULTILINE)), target
