"""The command that draws the paper's figures."""

import pytest

NAME = "make_figures.py"
QUICK = ["--simulator", "penalty", "--task", "flip", "--iterations", "2", "--size", "12"]


def test_it_draws_every_figure_of_a_task_and_keeps_what_it_computed(run_script, tmp_path):
    status, said, _ = run_script(NAME, *QUICK, "--out", tmp_path)
    assert status == 0
    drawn = {path.relative_to(tmp_path).as_posix() for path in tmp_path.rglob("*.p[nd][gf]")}
    names = ["figure_1", "penalty/figure_2", "penalty/figure_3", "penalty/figure_4"]
    assert drawn == {f"{name}.{suffix}" for name in names for suffix in ("png", "pdf")}
    assert (tmp_path / "penalty/figure_2.pdf").read_bytes().startswith(b"%PDF")
    assert "| sigma (m) | 0.5 |" in (tmp_path / "table_1.md").read_text()
    assert str(tmp_path / "penalty" / "figure_4.png") in said

    kept = {path: path.stat().st_mtime_ns for path in tmp_path.rglob("*.npz")}
    assert {path.name for path in kept} == {"exact.npz", "stochastic.npz", "landscape_12.npz"}
    run_script(NAME, *QUICK, "--out", tmp_path)
    assert kept == {path: path.stat().st_mtime_ns for path in tmp_path.rglob("*.npz")}


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--size", "1"], "argument --size: 1 is not from 2 to 3000"),
        (["--simulator", "bullet"], "invalid choice: 'bullet'"),
    ],
)
def test_bad_input_is_one_line_and_status_2(run_script, arguments, message):
    status, said, complaint = run_script(NAME, *arguments)
    assert (status, said) == (2, "")
    assert message in complaint
    assert complaint.count("\n") == 1
