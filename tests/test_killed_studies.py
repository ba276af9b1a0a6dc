"""Nothing that a study has finished is lost by a kill, and nothing else is kept."""

import signal
import subprocess
import sys
from pathlib import Path

SCRIPT = Path(__file__).parent.parent / "scripts" / "run_study.py"

STUDY = """
import os, signal, sys
from pathlib import Path
import numpy as np, pandas as pd
from tog_mjx.studies.study import Store

folder, killed_at = Path(sys.argv[1]), sys.argv[2]
store = Store(folder, resume=True)

def arrays(name):
    (folder / f"made_{name}").touch(exist_ok=False)
    if name == killed_at:
        os.kill(os.getpid(), signal.SIGKILL)
    return {"x": np.random.default_rng(len(name)).normal(size=3), "n": np.arange(2)}

def table():
    x = arrays("the table")["x"]
    return pd.DataFrame({"name, m": ["a", "b", "longer"], "x": x, "good": x > 0, "n": np.arange(3), "odd": np.nan})

first = store.finish_part("a part, the first", {"of": [1, 2.5]}, lambda: arrays("first"))
last = store.finish_table("the table", {"of": "it"}, table)
last.assign(sum=first["x"].sum()).to_csv(folder / "table.csv")
print(last.dtypes.astype(str).tolist())
"""
"""A study of two parts. It leaves a file for each part that it begins to make."""


def test_a_killed_part_is_made_again_and_a_finished_one_is_not(tmp_path):
    def run(out: str, killed_at: str = "") -> subprocess.CompletedProcess:
        (tmp_path / out).mkdir(exist_ok=True)
        return subprocess.run([sys.executable, "-c", STUDY, tmp_path / out, killed_at], capture_output=True, text=True)

    whole = run("whole")
    assert whole.returncode == 0, whole.stderr
    assert run("killed", killed_at="the table").returncode == -signal.SIGKILL
    assert [path.name.rpartition("_")[0] for path in (tmp_path / "killed").glob("*.npz")] == ["a-part-the-first"]
    (tmp_path / "killed" / "made_the table").unlink()
    again = run("killed")  # Making the first part again would find its mark and fail.
    assert again.returncode == 0, again.stderr
    read = run("killed")
    assert whole.stdout == again.stdout == read.stdout
    assert (tmp_path / "killed" / "table.csv").read_bytes() == (tmp_path / "whole" / "table.csv").read_bytes()


KILLED = """
import os, runpy, signal, sys
from tog_mjx.studies import study

script, cells, *arguments = sys.argv[1:]
save = study.save_result

def save_or_die(path, *content):
    if len(list(path.parent.glob("[!.]*.npz"))) == int(cells):
        os.fsync = lambda _: os.kill(os.getpid(), signal.SIGKILL)
    save(path, *content)

study.save_result = save_or_die
sys.argv = [script, *arguments]
runpy.run_path(script, run_name="__main__")
"""
"""A script of the project, killed while it writes the cell that comes after so many."""


def test_a_killed_study_continues_to_the_same_table(tmp_path):
    def run(out: str, *program: str) -> int:
        command = [sys.executable, *program, "seeds", "--quick", "--resume", "--out", str(tmp_path / out)]
        return subprocess.run(command, stdout=subprocess.DEVNULL).returncode

    assert run("whole", str(SCRIPT)) == 0
    table = (tmp_path / "whole" / "seeds_quick" / "table.csv").read_bytes()
    cells = tmp_path / "killed" / "cells"
    made: dict[Path, int] = {}
    for number in (2, 6):
        assert run("killed", "-c", KILLED, str(SCRIPT), str(number)) == -signal.SIGKILL
        assert list(cells.glob(".*.partial"))
        made |= {path: path.stat().st_mtime_ns for path in cells.glob("[!.]*.npz") if path not in made}
        assert len(made) == number
        assert not (tmp_path / "killed" / "seeds_quick").exists()
    assert run("killed", str(SCRIPT)) == 0
    assert (tmp_path / "killed" / "seeds_quick" / "table.csv").read_bytes() == table
    assert {path: path.stat().st_mtime_ns for path in made} == made
