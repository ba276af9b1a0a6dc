"""The page: what it says is computed from the runs, and what it carries are the simulators' motions."""

import html.parser
import json
import re

import numpy as np
import pytest

import tog_mjx as tog
from tog_mjx.drawing.report import Picture, Section
from tog_mjx.drawing.report.packed import FARTHEST, QUANTUM, pack, unpack
from tog_mjx.paper.answer import answers, write_report
from tog_mjx.paper.comparison import Run
from tog_mjx.paper.gallery import draw_common
from tog_mjx.paper.scenario import EVERY, GRID, ITERATES, scenario, thinned
from tog_mjx.paper.tasks import get_task
from tog_mjx.solving.descent import Descent, Status
from tog_mjx.studies.landscape import landscape


def descent(costs: list[float], setpoints: np.ndarray | None = None) -> Descent:
    setpoints = np.zeros((len(costs), 2)) if setpoints is None else setpoints
    return Descent(np.array(costs), setpoints, np.zeros_like(setpoints), Status.EXHAUSTED, 0.0, 0.0)


def runs(task: str, by_simulator: dict[str, tuple[list[float], list[float]]]) -> dict[Run, Descent]:
    return {
        Run(simulator, task, method): descent(costs)
        for simulator, pair in by_simulator.items()
        for method, costs in zip(("exact", "stochastic"), pair, strict=True)
    }


def test_the_answer_follows_the_numbers():
    grasp = runs(
        "grasp", {"penalty": ([0.57, 0.05], [0.57, 0.5]), "mjx": ([0.57, 0.3, 0.0423, 0.9], [0.57, 0.5686, 0.6])}
    )
    (answer,) = answers(grasp)
    assert "exact descent on mjx reaches J = 0.042 at update 2 of 3" in answer
    assert "stochastic one never leaves the plateau (best 0.569, from 0.570)" in answer
    assert "on both simulators" in answer
    flip = runs("flip", {"mjx": ([2.7, 0.15], [2.7, 1.0, 0.08]), "released": ([2.7, 0.04], [2.7, 0.06])})
    first, second = answers(flip | grasp)
    assert "On the flip, stochastic descent on mjx reaches J = 0.080 at update 2 of 2" in first
    assert "the exact one gets down to 0.150 at update 1; stochastic descent finds the lower cost on mjx only" in first
    assert second == answer
    assert answers({Run("mjx", "flip", "exact"): descent([1.0])}) == []


def test_motions_survive_packing_and_what_flies_away_is_held():
    rng = np.random.default_rng(0)
    poses = rng.uniform(-2, 2, (5, 7, 7))
    expected = poses.copy()
    poses[0, 3, 0], poses[1, 2, 1], poses[2, 5, 2] = 100, np.nan, -np.inf
    found = unpack(pack(poses), (5, 7, 7))
    expected[0, 3, 0], expected[1, 2, 1], expected[2, 5, 2] = FARTHEST, 0, -FARTHEST
    np.testing.assert_allclose(found, expected, rtol=0, atol=QUANTUM / 2 + 1e-12)


@pytest.mark.parametrize("number", [1, 2, ITERATES, 10_000])
def test_thinned_iterates_keep_the_first_and_the_last(number):
    kept = thinned(number)
    assert kept[0] == 0
    assert kept[-1] == number - 1
    assert len(kept) == min(number, ITERATES)
    assert np.all(np.diff(kept) > 0)


@pytest.fixture(scope="module")
def played(tmp_path_factory):
    """A page of the flip on the penalty simulator, its scenario, and the descent that it shows."""
    out, task = tmp_path_factory.mktemp("report"), get_task("flip")
    found = descent([2.68, 0.5], np.array([[0.0, 0.25], [0.2, 0.6]]))
    content = scenario(task, "penalty", landscape(task, "penalty", task.plane, 20, out), {"exact": found})
    path, run = out / "report.html", Run("penalty", "flip", "exact", iterations=1)
    sections = [Section("The <tasks>", draw_common([task], out))]
    write_report(path, {run: found}, sections, [content], [task])
    return path, content, found


def test_a_scenario_carries_the_simulators_motions(played):
    _, content, found = played
    shape = (len(content["setpoints"]), len(content["seconds"]), 5)
    assert len(content["setpoints"]) == GRID**2 + 2
    poses = unpack(content["motions"], shape)
    for index, u in [(GRID**2 + 1, found.setpoints[1]), (GRID * 20 + 7, content["setpoints"][GRID * 20 + 7])]:
        motion = tog.rollout("flip", u, "penalty")
        kept = [*range(0, 600, EVERY), 599]
        np.testing.assert_allclose(content["seconds"], np.asarray(motion.time)[kept], atol=1e-9)
        np.testing.assert_allclose(poses[index, :, :3], np.asarray(motion.box)[kept, :3], atol=1e-3)
        np.testing.assert_allclose(poses[index, :, 3:], np.asarray(motion.fingers)[kept, 0, :2], atol=1e-3)
        np.testing.assert_allclose(content["costs"][index], tog.objective("flip", "penalty")(u), atol=1e-3)


class Page(html.parser.HTMLParser):
    """What the page refers to, and whether its elements nest."""

    VOID = ("meta", "link", "img", "input", "br")

    def __init__(self):
        super().__init__()
        self.open: list[str] = []
        self.images: list[dict] = []
        self.addresses: list[str] = []

    def handle_starttag(self, tag, attrs):
        attributes = dict(attrs)
        if tag == "img":
            self.images.append(attributes)
        self.addresses += [value for name, value in attrs if name in ("src", "href", "action", "srcset")]
        if tag not in self.VOID:
            self.open.append(tag)

    def handle_endtag(self, tag):
        assert self.open.pop() == tag


def test_the_page_is_whole_and_needs_nothing_else(played):
    path, _, _ = played
    text = path.read_text()
    page = Page()
    page.feed(text)
    assert page.open == []
    assert page.addresses
    assert all(address.startswith("data:") for address in page.addresses)
    assert set(re.findall(r"https?://[^\s\"')]*", text)) == {"http://www.w3.org/2000/svg"}
    assert [image["alt"].partition(". ")[0] for image in page.images] == ["Figure 1"]
    assert "The &lt;tasks&gt;" in text
    assert len(text) < 15e6
    (embedded,) = re.findall(r'id="scenarios">(.*?)</script>', text, re.DOTALL)
    assert json.loads(embedded)[0]["task"] == "flip"
    for number in ("2.7594", "0.0429", "0.5000"):  # Published, and this run's.
        assert f"<td>{number}</td>" in text


def test_captions_cannot_break_out_of_the_page(played, tmp_path):
    path, content, _ = played
    evil = '"><script>alert(1)</script>'
    picture = Picture(path.parent / "figure_1.png", evil, evil)
    write_report(tmp_path / "page.html", {}, [Section(evil, [picture])], [{**content, "task": "</script>"}], [])
    text = (tmp_path / "page.html").read_text()
    assert "<script>alert" not in text
    assert text.count("</script>") == 2
