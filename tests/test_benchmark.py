"""The benchmark's own arithmetic and manners; its numbers are a machine's, and no test's."""

import runpy
import time
from pathlib import Path

import pytest


def test_each_gets_its_own_median():
    interleaved = runpy.run_path(str(Path(__file__).parent.parent / "scripts" / "benchmark.py"))["interleaved"]
    order = []

    def long():
        order.append("long")
        time.sleep(0.05)

    found = interleaved({"short": lambda: order.append("short"), "long": long}, 3)
    assert order == ["short", "long"] * 3
    assert found["long"] >= 0.05
    assert found["long"] > found["short"]


@pytest.mark.parametrize(
    ("arguments", "message"),
    [(["--repeats", "0"], "argument --repeats: 0 is too few"), (["--task", "juggle"], "invalid choice: 'juggle'")],
)
def test_bad_input_is_one_line_and_status_2(run_script, arguments, message):
    status, said, complaint = run_script("benchmark.py", *arguments)
    assert (status, said) == (2, "")
    assert message in complaint
    assert complaint.count("\n") == 1
