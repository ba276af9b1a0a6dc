"""`tog`: which commands there are, and what each calls itself, however it was started."""

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

from tog_mjx.__main__ import commands

SCRIPTS = Path(__file__).parent.parent / "scripts"
LISTED = """
import sys
from tog_mjx.__main__ import main
sys.argv = ["/anywhere/bin/tog", "--help"]
main()
print([name for name in ("jax", "mujoco", "numpy", "rich") if name in sys.modules])
"""


def test_help_lists_every_command_and_loads_none():
    found = subprocess.run(
        [sys.executable, "-c", LISTED], capture_output=True, text=True, env=os.environ | {"COLUMNS": "200"}
    )
    assert found.returncode == 0, found.stderr
    *lines, loaded = found.stdout.splitlines()
    assert lines[0] == "usage: tog COMMAND ..."
    assert dict(re.findall(r"^  (\w+) +(.+)$", "\n".join(lines), re.MULTILINE)) == commands()
    assert commands()["check"].startswith("Can the gradient of this scene be trusted? ")
    assert loaded == "[]"


def test_a_slip_in_a_name_is_one_line_and_status_2(run_script):
    assert run_script("tog", "chek", "flip") == (2, "", "tog: no command chek; did you mean check? (see --help)\n")
    assert run_script("tog", "a\nb")[2] == "tog: no command a\\nb (see --help)\n"


@pytest.mark.parametrize("name", commands())
def test_a_command_says_what_was_typed(name, run_script):
    status, said, complaint = run_script("tog", name, "--help")
    assert (status, complaint) == (0, "")
    assert said.startswith(f"usage: tog {name} [-h]")
    assert " ".join(said.split("\n\n")[1].split()) == commands()[name]


def test_complaints_name_the_command_as_it_was_typed(run_script):
    for typed, name in ((("tog", "check"), "tog check"), (("check_gradients.py",), "check_gradients.py")):
        assert run_script(*typed, "flop")[2].startswith(f"{name}: flop: no such scene or file")
        assert run_script(*typed)[2].startswith(f"{name}: the following arguments are required: scene")
    found = subprocess.run([sys.executable, "-m", "tog_mjx", "check"], capture_output=True, text=True)
    assert found.returncode == 2
    assert found.stderr.startswith("python -m tog_mjx check: the following arguments are required: scene")


def test_a_package_that_a_command_lacks_is_one_line(run_script, monkeypatch):
    monkeypatch.delitem(sys.modules, "tog_mjx.commands.study", raising=False)
    monkeypatch.setitem(sys.modules, "pandas", None)
    told = "the package pandas is not installed: pip install pandas; tog doctor says what else is missing\n"
    assert run_script("tog", "study", "seeds") == (2, "", f"tog study: {told}")
    assert run_script("run_study.py", "seeds") == (2, "", f"run_study.py: {told}")


def test_every_command_but_the_doctor_is_a_script_too():
    called = [re.findall(r'^run\("(\w+)"\)$', path.read_text(), re.MULTILINE) for path in SCRIPTS.glob("*.py")]
    assert sorted(name for (name,) in called) == sorted(set(commands()) - {"doctor"})
