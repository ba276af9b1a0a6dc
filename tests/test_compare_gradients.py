"""The command that compares gradients: what it finds, what it writes and keeps, and what it says of bad input."""

import json
import re
from pathlib import Path

import numpy as np
import pytest

from tog_mjx.paper import gradient_agreement as agreement
from tog_mjx.paper.gradient_agreement import METHODS, REFERENCE, Gradients, Piece

NAME = "compare_gradients.py"
POINTS = 25
KEYS = {
    "task",
    "method",
    "points",
    "finite",
    "cosine_median",
    "relative_error_median",
    "relative_error_p90",
    "ms_per_gradient",
    "seconds_compile",
}


@pytest.fixture(scope="module")
def study(run_script, tmp_path_factory) -> tuple[Path, str, dict[str, dict]]:
    """A finished run on the grasp: its folder, what it said, and its summary by method."""
    out = tmp_path_factory.mktemp("gradients")
    status, said, complaint = run_script(NAME, "--task", "grasp", "--points", POINTS, "--out", out)
    assert (status, complaint) == (0, "")
    entries = json.loads((out / "summary.json").read_text())
    return out, said, {entry["method"]: entry for entry in entries}


def test_the_summary_has_every_method(study):
    _, _, summary = study
    assert tuple(summary) == METHODS
    for entry in summary.values():
        assert set(entry) >= KEYS
        assert (entry["task"], entry["points"]) == ("grasp", POINTS)
        assert entry["ms_per_gradient"] > 0


def test_what_it_finds(study):
    _, _, summary = study
    assert summary[REFERENCE]["settled"] >= 0.95
    implicit, single, penalty = (summary[name] for name in ("mjx, implicit", "mjx, implicit, float32", "penalty"))
    assert implicit["finite"] == 1
    assert implicit["within"] >= 0.95
    assert single["relative_error_p90"] <= 0.01
    assert penalty["relative_error_median"] <= 1e-3
    assert penalty["relative_error_p90"] <= 1e-2
    assert penalty["cosine_p10"] >= 0.9999
    # On the elliptic cone stock MJX has no gradient; another friction law is another problem.
    assert (summary["mjx, native"]["finite"], summary["mjx, native"]["cosine_median"]) == (0, None)
    assert summary["penalty, paper's friction"]["relative_error_median"] > 0.1


def printed_rows(said: str) -> dict[str, list[str]]:
    """The cells of the first table by method, without the last two, which are times: a machine's, like their widths."""
    _, first, _ = said.split("grasp: gradients against")
    rows = [re.split(r"\s{2,}", line.strip()) for line in first.splitlines()]
    found = {method: cells[:-2] for method, *cells in rows if method in METHODS}
    assert tuple(found) == METHODS
    assert {len(cells) for cells in found.values()} == {7}
    return found


def test_it_keeps_what_is_finished_and_computes_what_is_damaged_again(study, run_script):
    out, said, _ = study
    assert (out / "grasp.png").stat().st_size > 10_000
    path = Piece("grasp", REFERENCE, POINTS, 0).path(out)
    before = agreement.load(Piece("grasp", REFERENCE, POINTS, 0), out)
    path.write_bytes(path.read_bytes()[:-100])
    status, again, _ = run_script(NAME, "--task", "grasp", "--points", POINTS, "--out", out)
    assert status == 0
    assert again.count("finished before, kept") == len(METHODS) - 1
    assert "damaged result, computing it again" in again
    np.testing.assert_array_equal(agreement.load(Piece("grasp", REFERENCE, POINTS, 0), out).gradients, before.gradients)
    assert printed_rows(said) == printed_rows(again)


def test_results_of_other_points_are_refused(study, run_script):
    out, _, _ = study
    status, said, complaint = run_script(NAME, "--task", "grasp", "--points", POINTS + 1, "--out", out)
    assert (status, said) == (2, "")
    assert "was made with other points or another seed; choose another --out, or --force to replace it" in complaint


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--task", "juggle"], "invalid choice: 'juggle'"),
        (["--points", "0"], "argument --points: 0 is not from 1 to 10000000"),
        (["--points", "many"], "invalid int value: 'many'"),
        (["--seed", "-1"], "argument --seed: -1 is not from 0 to 4294967295"),
        (["--out", "/dev/null/results"], "cannot be written"),
    ],
)
def test_bad_input_is_one_line_and_status_2(run_script, arguments, message, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    status, said, complaint = run_script(NAME, *arguments)
    assert (status, said) == (2, "")
    assert message in complaint
    assert complaint.count("\n") == 1
    assert not list(tmp_path.iterdir())


def made(gradients) -> Gradients:
    found = np.array(gradients, float)
    return Gradients(np.zeros_like(found), found, np.zeros(len(found)), 0.0, 0.0)


def test_the_statistics_are_those_of_hand_made_gradients():
    expected = made([[1, 0], [0, 2], [0, 0], [3, 4]])._replace(change=np.array([0, 0, 0, 1.0]))
    found = made([[1, 1e-3], [0, 2], [5, 5], [np.nan, 0]])
    agreed = agreement.compare(found, expected)
    # The third has no gradient to compare with, and the fourth's differences have not settled.
    assert (agreed.points, agreed.finite, agreed.compared, agreed.within) == (4, 0.75, 2, 0.5)
    assert agreed.relative_error_worst == pytest.approx(1e-3)
    assert agreed.cosine_median == pytest.approx((1 + 1 / np.sqrt(1 + 1e-6)) / 2, rel=1e-12)
    right = agreement.angles(np.array([[1.0, 0.0], [0.0, 0.0]]), np.array([[1.0, 1.0], [1.0, 0.0]]))
    np.testing.assert_allclose(right, [45.0])
    nothing = agreement.compare(made([[np.nan, 0.0]]), made([[1.0, 0.0]]))
    assert (nothing.finite, nothing.compared, nothing.cosine_median) == (0, 0, None)
