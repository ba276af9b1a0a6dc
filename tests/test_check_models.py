"""`scripts/check_models.py`: one row a model, whatever becomes of it, and what is finished is not done again."""

import csv
import json
from pathlib import Path

import pytest

from tog_mjx.checks import alone

REFUSED = """<mujoco><option solver="PGS"/><worldbody><body><joint/><geom size="0.1"/></body></worldbody></mujoco>"""


@pytest.fixture
def models(tmp_path) -> Path:
    """A folder with a model that MJX refuses, one that MuJoCo does, one that cannot move, and what is no model."""
    folder = tmp_path / "models"
    (folder / "robots").mkdir(parents=True)
    (folder / "robots" / "refused.xml").write_text(REFUSED)
    (folder / "broken.xml").write_text("<mujoco><worldbody><nonsense/></worldbody></mujoco>")
    (folder / "still.xml").write_text("<mujoco><worldbody><geom size='1'/></worldbody></mujoco>")
    (folder / "defaults.xml").write_text("<mujoco><default/></mujoco>")
    (folder / "other.xml").write_text("<html/>")
    return folder


def test_each_model_is_a_row_and_is_checked_once(models, tmp_path, run_script):
    def run() -> list[dict[str, str]]:
        status, said, _ = run_script("check_models.py", models, "--quick", "--steps", "2", "--out", tmp_path / "out")
        assert status == 0
        assert said.count("\n|") == 5
        return list(csv.DictReader((tmp_path / "out" / "models.csv").read_text().splitlines()))

    rows = run()
    assert [(row["model"], row["nv"], row["verdict"], row["check"]) for row in rows] == [
        ("broken.xml", "", "not checked", ""),
        ("robots/refused.xml", "1", "trust", ""),
        ("still.xml", "0", "not checked", ""),
    ]
    assert [row["sentence"].partition(" (")[0] for row in rows[1:]] == [
        "no check found a fault",
        "the scene has no qvel: differentiate with respect to something else",
    ]
    assert "nonsense" in rows[0]["sentence"]
    assert [row["engine"] for row in rows] == ["", "mujoco", ""]
    assert all(float(row["seconds"]) > 0 and int(row["peak_mb"]) > 10 for row in rows)
    kept = {path.name.partition("_")[0]: path for path in (tmp_path / "out" / "models").glob("*.json")}
    before = {name: path.stat().st_mtime_ns for name, path in kept.items()}
    kept["refused"].write_text(kept["refused"].read_text()[:50])
    again = run()
    assert [row["verdict"] for row in again] == [row["verdict"] for row in rows]
    refused = json.loads(kept["refused"].read_text())["findings"][0]
    assert (refused["check"], refused["level"]) == ("preflight", "fine")
    assert refused["sentence"].startswith("MJX does not support <option solver='pgs'>")
    changed = {name for name, path in kept.items() if path.stat().st_mtime_ns != before[name]}
    assert changed == {"refused"}


def test_what_ends_badly_is_a_row_too(models, tmp_path, monkeypatch):
    file = models / "robots" / "refused.xml"
    checks = alone._PROGRAM
    monkeypatch.setattr(alone, "_PROGRAM", ("-c", "import time; time.sleep(1e6)"))
    late = alone.finish_file(file, tmp_path, limit=1e-6)
    assert (late["verdict"], late["nq"]) == (alone.OUT_OF_TIME, None)
    assert alone.finish_file(file, tmp_path, limit=1e-6) == late
    monkeypatch.setattr(alone, "_PROGRAM", checks)
    assert alone.finish_file(file, tmp_path)["verdict"] == "trust"
    for program, sentence in (("import os; os.abort()", "ended by SIGABRT"), ("1/0", "ZeroDivisionError: ")):
        monkeypatch.setattr(alone, "_PROGRAM", ("-c", program))
        found = alone.finish_file(file, tmp_path / program[:3])
        assert found["verdict"] == alone.CRASHED
        assert found["sentence"].startswith(sentence)


def test_bad_input_is_one_line(tmp_path, run_script):
    for arguments, words in (
        ((tmp_path / "none.xml",), "no such file or folder"),
        ((tmp_path,), "no MJCF file under this folder"),
        ((tmp_path, "--steps", "0"), "argument --steps: 0 is not from 1 to 10000000"),
        ((tmp_path, "--limit", "nan"), "a limit above zero"),
    ):
        status, said, complaint = run_script("check_models.py", *arguments, "--out", tmp_path / "out")
        assert status == 2
        assert words in complaint
        assert len(complaint.splitlines()) == 1
        assert not said
