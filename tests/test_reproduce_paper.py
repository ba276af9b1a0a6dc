"""The main command: what it writes, what it keeps, and what it says of bad input."""

import functools
import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

from tog_mjx.commands import reproduce
from tog_mjx.paper import comparison
from tog_mjx.paper.comparison import Run
from tog_mjx.running.errors import InputError
from tog_mjx.solving.record import load_descent

SCRIPT = Path(__file__).parent.parent / "scripts" / "reproduce_paper.py"
QUICK = ["--simulator", "penalty", "--task", "flip", "--iterations", "2"]
KEYS = [
    "simulator",
    "task",
    "method",
    "iterations",
    "cost_first",
    "cost_last",
    "cost_best",
    "best_iteration",
    "setpoints_best",
    "status",
    "seconds_compile",
    "seconds_run",
]


@pytest.fixture
def script(run_script):
    return functools.partial(run_script, SCRIPT.name)


def test_it_writes_results_a_summary_and_a_figure_and_keeps_them(script, tmp_path):
    status, said, _ = script(*QUICK, "--out", tmp_path)
    assert status == 0
    assert "flip exact        published   2.7594   0.0446   0.0429" in said
    summary = json.loads((tmp_path / "summary.json").read_text())
    assert [(entry["simulator"], entry["task"], entry["method"]) for entry in summary] == [
        ("penalty", "flip", "exact"),
        ("penalty", "flip", "stochastic"),
    ]
    descent, settings = load_descent(tmp_path / "penalty" / "flip" / "exact.npz")
    assert list(summary[0]) == KEYS
    assert summary[0]["cost_best"] == descent.costs.min()
    assert summary[0]["setpoints_best"] == descent.setpoints[descent.best_iteration].tolist()
    assert settings["step_size"] == 0.1
    assert (tmp_path / "penalty" / "figure_3.png").stat().st_size > 10_000

    times = {path: path.stat().st_mtime_ns for path in tmp_path.rglob("*.npz")}
    status, said, _ = script(*QUICK, "--out", tmp_path)
    assert said.count("finished before, kept") == 2
    assert times == {path: path.stat().st_mtime_ns for path in tmp_path.rglob("*.npz")}

    # Another simulator joins the picture; nothing of the first one is lost.
    status, said, _ = script("--simulator", "released", *QUICK[2:], "--method", "exact", "--out", tmp_path)
    assert len(json.loads((tmp_path / "summary.json").read_text())) == 3

    script(*QUICK, "--out", tmp_path, "--method", "exact", "--force")
    changed = {path.name for path, then in times.items() if path.stat().st_mtime_ns != then}
    assert changed == {"exact.npz"}


def test_it_writes_a_page_that_holds_every_figure_and_the_motions(script, tmp_path):
    _, said, _ = script(*QUICK, "--out", tmp_path)
    assert "with --landscape 100" in said
    without = (tmp_path / "report.html").read_text()
    assert "Figure 3." in without
    assert 'id="scenarios"' not in without
    status, said, _ = script(*QUICK, "--landscape", "12", "--out", tmp_path)
    assert "with --landscape" not in said
    page = (tmp_path / "report.html").read_text()
    assert status == 0
    assert 'id="scenarios"' in page
    assert [f"Figure {number}.</strong>" in page for number in range(1, 6)] == [True] * 4 + [False]
    assert "On the flip, " in page


def test_the_results_are_those_of_the_library(script, tmp_path):
    script(*QUICK, "--out", tmp_path, "--seed", 5)
    run = Run("penalty", "flip", "stochastic", seed=5, iterations=2)
    np.testing.assert_array_equal(comparison.load(run, tmp_path).setpoints, comparison.compute(run).setpoints)


def test_a_damaged_result_is_told_and_computed_again(script, tmp_path):
    script(*QUICK, "--method", "exact", "--out", tmp_path)
    path = tmp_path / "penalty" / "flip" / "exact.npz"
    whole = load_descent(path)[0]
    path.write_bytes(path.read_bytes()[:-200])
    status, said, _ = script(*QUICK, "--method", "exact", "--out", tmp_path)
    assert status == 0
    assert "damaged result, computing it again" in said
    assert str(path) in said
    np.testing.assert_array_equal(load_descent(path)[0].costs, whole.costs)


def test_results_that_vanish_while_it_runs_are_told(tmp_path, monkeypatch):
    def finish_and_lose(runs, out, *_):
        for run in runs:
            comparison.save(run, comparison.compute(run), out)
        runs[0].path(out).unlink()

    monkeypatch.setattr(reproduce, "finish_runs", finish_and_lose)
    monkeypatch.setattr(sys, "argv", [SCRIPT.name, *QUICK, "--method", "exact", "--out", str(tmp_path)])
    with pytest.raises(InputError, match=r"has changed while this ran .*exact\.npz"):
        reproduce.main()
    assert not (tmp_path / "summary.json").exists()


def test_a_result_of_other_settings_is_not_replaced(script, tmp_path):
    script(*QUICK, "--out", tmp_path)
    before = {path: path.read_bytes() for path in tmp_path.rglob("*.*")}
    status, _, complaint = script(*QUICK, "--out", tmp_path, "--seed", 1)
    assert status == 2
    assert "stochastic.npz was made with seed 0, not 1; choose another --out, or --force" in complaint
    assert before == {path: path.read_bytes() for path in tmp_path.rglob("*.*")}


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--task", "fly"], "invalid choice: 'fly'"),
        (["--simulator", "mjx", "bullet"], "invalid choice: 'bullet'"),
        (["--method", "guess"], "invalid choice: 'guess'"),
        (["--iterations", "-3"], "argument --iterations: -3 is not from 0 to 10000000"),
        (["--seed", "-1"], "argument --seed: -1 is not from 0 to 4294967295"),
        (["--seed", "4294967296"], "argument --seed: 4294967296 is not from 0 to 4294967295"),
        (["--landscape", "1000000"], "argument --landscape: 1000000 is not from 0 to 3000"),
        (["--seed", "one"], "invalid int value: 'one'"),
        (["--out", "/dev/null/results"], "cannot be written"),
    ],
)
def test_bad_input_is_one_line_and_status_2(script, tmp_path, monkeypatch, arguments, message):
    monkeypatch.chdir(tmp_path)
    status, said, complaint = script(*arguments)
    assert (status, said) == (2, "")
    assert message in complaint
    assert complaint.startswith("reproduce_paper.py: ")
    assert complaint.count("\n") == 1
    assert not list(tmp_path.iterdir())


def test_killed_in_the_middle_it_starts_again_cleanly(tmp_path):
    options = [*QUICK[:4], "--method", "stochastic", "--out", tmp_path]
    command = [sys.executable, SCRIPT, *options, "--iterations"]
    environment = os.environ | {"PYTHONUNBUFFERED": "1"}
    log = tmp_path.with_suffix(".log")
    with log.open("w") as said, subprocess.Popen([*command, "10000000"], stdout=said, env=environment) as process:
        while "running" not in log.read_text() and process.poll() is None:
            time.sleep(0.1)
        process.send_signal(signal.SIGKILL)
    assert "running" in log.read_text()
    assert process.returncode == -signal.SIGKILL
    assert not list(tmp_path.rglob("*.npz"))
    done = subprocess.run([*command, "2"], capture_output=True, text=True, check=True)
    assert "iterations exhausted" in done.stdout
    assert done.stderr == ""
    figures = ["figure_1", "penalty/figure_3", "penalty/figure_4"]
    expected = [f"{figure}.{suffix}" for figure in figures for suffix in ("png", "pdf")]
    expected += ["penalty/flip/stochastic.npz", "report.html", "summary.json", "table_1.md"]
    assert {str(path.relative_to(tmp_path)) for path in tmp_path.rglob("*") if path.is_file()} == set(expected)
