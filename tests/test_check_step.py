"""The command that judges one step of any scene."""

from pathlib import Path

import pytest

NAME = "check_step.py"
SCENES = Path(__file__).parent / "scenes"


def test_it_prints_a_table_in_markdown(run_script):
    status, said, _ = run_script(NAME, SCENES / "sliding_block.xml")
    assert status == 0
    (row,) = (line for line in said.splitlines() if line.startswith("| sliding_block"))
    forward, reverse, native_forward, native_reverse, one_iteration = (cell.strip() for cell in row.split("|")[2:-1])
    assert forward.startswith("right")
    assert reverse.startswith("right")
    assert native_forward.startswith("right")
    assert native_reverse == "error"
    assert one_iteration.startswith("wrong")


@pytest.mark.parametrize(
    ("arguments", "message"),
    [([], "the following arguments are required: scene"), (["nowhere.xml"], "nowhere.xml: no such scene or file")],
)
def test_bad_input_is_one_line_and_status_2(run_script, arguments, message):
    status, said, complaint = run_script(NAME, *arguments)
    assert (status, said) == (2, "")
    assert message in complaint
    assert complaint.count("\n") == 1
