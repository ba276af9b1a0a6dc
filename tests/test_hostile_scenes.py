"""Files and names that nobody would write on purpose: one line, in which nothing moves the terminal."""

import logging
import sys
import warnings
from pathlib import Path

import mujoco
import pytest

from tog_mjx.checks.file.preflight import preflight
from tog_mjx.checks.step_check import METHODS
from tog_mjx.checks.step_check import Verdict as StepVerdict
from tog_mjx.checks.told.finding import Finding, Level, Verdict
from tog_mjx.commands import step
from tog_mjx.running.console import enable_compilation_cache, run_main
from tog_mjx.running.errors import printable

STATIC = "<mujoco><worldbody><geom name='{}' size='0.1'/></worldbody></mujoco>"


def complaint(run_script, name, *arguments) -> str:
    status, said, told = run_script(name, *arguments)
    assert (status, said) == (2, "")
    return told


def test_scenes_that_cannot_be_read_say_why(run_script, tmp_path, monkeypatch):
    compiled, latin, scene = tmp_path / "scene.mjb", tmp_path / "latin.xml", tmp_path / "scene.xml"
    mujoco.mj_saveModel(mujoco.MjModel.from_xml_string(STATIC.format("")), str(compiled), None)
    latin.write_bytes(STATIC.format("Stra\xdfe").encode("latin-1"))
    scene.write_text(STATIC.format(""))
    assert "it is a compiled model; give the MJCF file" in complaint(run_script, "check_gradients.py", compiled)
    assert "a name in it is not in UTF-8" in complaint(run_script, "check_gradients.py", latin)
    assert f"did you mean {scene}?" in complaint(run_script, "check_gradients.py", tmp_path / "sceene.xml")

    opened = Path.open

    def refuse(path, *args, **options):
        if path == scene:  # Root may read everything.
            raise PermissionError(13, "Permission denied")
        return opened(path, *args, **options)

    monkeypatch.setattr(Path, "open", refuse)
    assert f"{scene}: cannot be read (Permission denied)" in complaint(run_script, "check_gradients.py", scene)


def test_names_do_not_reach_the_terminal_raw(run_script, tmp_path):
    told = complaint(run_script, "check_gradients.py", tmp_path / "a\x1b[31m\nb\udcff.xml")
    assert r"a\x1b[31m\nb\udcff.xml: no such scene or file" in told
    assert told.count("\n") == 1
    assert "\x1b" not in told
    assert printable("Größe 3 µm, [red]") == "Größe 3 µm, [red]"


def test_a_verdict_tells_names_as_the_console_does():
    name = "a\x1b[31m\nb"
    verdict = Verdict(name, (Finding("preflight", Level.FAULT, f"geom {name}", None, f"rename {name}"),))
    for told in (str(verdict), verdict.line, str(verdict.findings[0])):
        assert r"a\x1b[31m\nb" in told
        assert "\x1b" not in told
    assert len(str(verdict).splitlines()) == 3
    assert verdict.as_json()["findings"][0]["sentence"] == f"geom {name}"  # JSON has escapes of its own.


def test_a_table_of_scenes_shows_their_names(run_script, tmp_path, monkeypatch):
    scene = tmp_path / "[red]a\x1b.xml"
    scene.write_text(STATIC.format("").replace("<geom", "<body><joint/><geom").replace("/></w", "/></body></w"))
    monkeypatch.setattr(step, "check_step", lambda *_, **__: dict.fromkeys(METHODS, StepVerdict("right", 1e-9)))
    status, said, told = run_script("check_step.py", scene)
    assert status == 0
    assert r"[red]a\x1b | right 1e-09" in said
    assert told == "[1/1] [red]a\\x1b: compiling\n"


def test_many_remarks_of_a_kind_are_told_as_one():
    joint = "<body pos='{0} 0 0'><joint name='spring{0}' type='slide' stiffness='1e9'/><geom size='0.1'/></body>"
    bodies = "".join(joint.format(i) for i in range(20))
    model = mujoco.MjModel.from_xml_string(f"<mujoco><worldbody>{bodies}</worldbody></mujoco>")
    told = [remark.what for remark in preflight(model) if remark.what.startswith("stiffness of joint")]
    assert [what.split(":")[0] for what in told] == [f"stiffness of joint spring{i}" for i in range(5)]
    assert told[-1].endswith("(and 15 more alike)")
    assert not told[-2].endswith("alike)")


def test_what_has_no_motion_has_no_derivative(run_script, tmp_path):
    scene = tmp_path / "scene.xml"
    scene.write_text(STATIC.format(""))
    told = complaint(run_script, "check_step.py", "flip", scene)
    assert told.startswith(f"check_step.py: {scene} has no joints: nothing moves in it")
    assert told.count("\n") == 1


def test_absurd_depths_are_one_line(run_script, tmp_path):
    state = tmp_path / "state.json"
    state.write_text("[" * 100_000)
    assert "nested too deeply" in complaint(run_script, "check_gradients.py", "flip", "--state", state)
    page = tmp_path.joinpath(*["d"] * 1500, "page.html")
    assert "cannot be written" in complaint(run_script, "check_gradients.py", "flip", "--html", page)


@pytest.mark.parametrize(
    ("arguments", "meant"),
    [(["run_study.py", "basin"], "basins"), (["make_figures.py", "--task", "gras"], "grasp")],
)
def test_what_was_meant_is_suggested(run_script, arguments, meant):
    assert f"; did you mean {meant}? (see --help)" in complaint(run_script, *arguments)


def test_off_is_off_in_capitals_too(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("TOG_MJX_CACHE", "OFF")
    monkeypatch.delenv("JAX_COMPILATION_CACHE_DIR", raising=False)
    enable_compilation_cache()
    assert not list(tmp_path.iterdir())


def test_libraries_warn_nobody_while_a_script_runs(monkeypatch, caplog):
    monkeypatch.setattr(sys, "warnoptions", [])
    listening = []
    loggers = [logging.getLogger(name) for name in ("jax", "matplotlib", "jax._src.xla_bridge", "matplotlib.pyplot")]
    before = [logger.level for logger in loggers]

    def main():
        warnings.warn("overflow encountered in dot", RuntimeWarning, stacklevel=1)
        for logger in loggers:
            logger.warning("building the font cache")
            logger.error("a real error of %s", logger.name)
        listening.append(mujoco.get_mju_user_warning())

    with warnings.catch_warnings(record=True) as seen:
        warnings.simplefilter("always")
        run_main(main)
    assert not seen
    assert caplog.messages == [f"a real error of {logger.name}" for logger in loggers]
    assert [logger.level for logger in loggers] == before
    assert listening[0] is not None
    assert mujoco.get_mju_user_warning() != listening[0]
