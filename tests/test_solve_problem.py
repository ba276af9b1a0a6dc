"""The command that descends on a problem: what it says, what it keeps, and its page."""

import base64
import re
from pathlib import Path

import jax
import numpy as np
import pytest
from PIL import Image, ImageSequence

import tog_mjx as tog
from tog_mjx.solving.record import load_descent
from tog_mjx.studies import landscape

NAME = "solve_problem.py"
PUSH = f"{Path(__file__).parent.parent}/scripts/examples/push.py:push"
FLIP = ("flip", "--engine", "penalty", "--budget", "40", "--size", "5")


@pytest.fixture(scope="module")
def flipped(run_script, tmp_path_factory):
    """A finished run, and what it said."""
    out = tmp_path_factory.mktemp("flip")
    status, said, complaint = run_script(NAME, *FLIP, "--out", out)
    assert status == 0, complaint
    return out, said


def test_it_says_what_is_kept(flipped):
    out, said = flipped
    J = tog.objective("flip", "penalty")
    best, (descent, _) = np.load(out / "best.npy"), load_descent(out / "descent.npz")
    first, least = float(J(tog.get_task("flip").x0)), float(J(best))
    np.testing.assert_allclose([descent.costs[0], descent.costs.min()], [first, least], rtol=1e-9)
    assert least < first / 10
    line = f"J of flip on penalty: {first:.4g} at the guess, {least:.4g} at the best iterate: solved, below 0.1."
    assert line in said
    assert f"There finger1_x = {best[0]:.4g}, finger1_z = {best[1]:.4g}." in said
    page = (out / "index.html").read_text()
    assert line in page
    images = {kind: base64.b64decode(data) for kind, data in re.findall(r'src="data:image/(\w+);base64,([^"]+)"', page)}
    assert images["gif"] == (out / "motion.gif").read_bytes()
    assert images["png"] in [(out / f"{name}.png").read_bytes() for name in ("descent", "landscape")]
    assert "//" not in page.replace("/" * 2 + '"', "").split("<style>")[0]


def test_its_landscape_is_the_cost_around_the_best(flipped):
    out, _ = flipped
    best, costs = np.load(out / "best.npy"), np.load(out / "landscape_5.npz")["values"]
    iterates = load_descent(out / "descent.npz")[0].setpoints
    low = np.minimum(best - tog.get_task("flip").bound.scale, iterates.min(axis=0))
    J = tog.objective("flip", "penalty")
    np.testing.assert_allclose(costs[0], J(low), rtol=1e-9)


def test_resuming_reads_what_is_finished_and_only_of_the_same_problem(run_script, flipped):
    out, said = flipped
    kept = {path.name: path.stat().st_mtime_ns for path in out.glob("*.npz")}
    assert sorted(kept) == ["descent.npz", "gradient_field_10.npz", "landscape_5.npz"]
    status, again, _ = run_script(NAME, *FLIP, "--out", out, "--resume")
    assert status == 0
    assert "descent on flip" not in again
    assert [line for line in again.splitlines() if line.startswith(("J of", "The best"))] == [
        line for line in said.splitlines() if line.startswith(("J of", "The best"))
    ]
    assert kept == {path.name: path.stat().st_mtime_ns for path in out.glob("*.npz")}
    _, again, _ = run_script(NAME, *FLIP[:4], "8", "--size", "0", "--out", out, "--resume")
    assert "of another problem, or of other settings: descending again" in again


def test_a_run_killed_in_its_landscape_has_kept_its_descent(run_script, tmp_path, monkeypatch):
    def die(*_):
        raise KeyboardInterrupt

    monkeypatch.setattr(landscape, "map_kept", die)
    status, _, complaint = run_script(NAME, *FLIP, "--out", tmp_path)
    assert (status, complaint) == (
        130, "solve_problem.py: interrupted; what was finished is kept, with --resume the same command continues\n"
    )  # fmt: skip
    best = load_descent(tmp_path / "descent.npz")[0].best
    np.testing.assert_array_equal(np.load(tmp_path / "best.npy"), best)


def test_the_example_is_solved_and_shown(run_script, tmp_path):
    """A ball pushes a cube over a table, on MJX, as a user would write it. It starts 45 cm from where it should be."""
    assert len(Path(PUSH.rpartition(":")[0]).read_text().splitlines()) <= 25
    status, said, complaint = run_script(NAME, PUSH, "--budget", "100", "--size", "0", "--out", tmp_path)
    assert status == 0, complaint
    assert "solved, below 0.01" in said
    costs = load_descent(tmp_path / "descent.npz")[0].costs
    assert costs.min() < costs[0] / 20
    with jax.enable_x64():
        problem = tog.Problem.load(PUSH)
        qpos = np.asarray(tog.objective(problem).motion(np.load(tmp_path / "best.npy")).qpos)
    ball = np.array([-0.3, 0, 0.1]) + np.pad(qpos[:, 7:], [(0, 0), (0, 1)])
    np.testing.assert_allclose(qpos[-1, :2], [0.4, 0.2], atol=0.1)
    moving = np.flatnonzero(np.linalg.norm(qpos[:, :2], axis=1) > 1e-3)[0]
    assert np.linalg.norm(ball[moving] - qpos[moving, :3]) < 0.05 + 0.1 * np.sqrt(3)  # It is pushed, not pulled.
    with Image.open(tmp_path / "motion.gif") as film:
        frames = [np.asarray(frame.convert("RGB"), int) for frame in ImageSequence.Iterator(film)]
    cube = [np.argwhere(frame[..., 0] > frame[..., 2] + 60).mean(axis=0)[1] for frame in (frames[0], frames[-1])]
    assert cube[1] > cube[0] + 50  # Pixels to the right.


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["push.xml"], "push.xml is a scene; give a function that returns a tog.Problem of it"),
        (["flop"], "problem 'flop': give package.module:function or file.py:function"),
        (["flip", "--size", "1"], "argument --size: 1 is too small"),
        (["flip", "--landscape", "finger1_x", "finger1_y"], "did you mean finger1_"),
        (["flip", "--landscape", "0", "2"], "there is no variable 2"),
        (["flip", "--engine", "penalty", "--budget", "2"], "budget is 2.0: one gradient of flip on penalty takes"),
        (["flip", "--engine", "released", "--differentiation", "saltation"], "has no option 'differentiation'"),
        (["flip", "--out", "{file}"], "cannot be written"),
    ],
)
def test_bad_input_is_one_line_and_status_2(run_script, tmp_path, monkeypatch, arguments, message):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "file").write_text("no folder")
    arguments = [argument.format(file=tmp_path / "file") for argument in arguments]
    status, _, complaint = run_script(NAME, *arguments)
    assert status == 2
    assert message in complaint.splitlines()[-1]
