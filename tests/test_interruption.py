"""Ctrl-C and SIGTERM: one line, wherever they come, and nothing lost that was finished."""

import errno
import gc
import os
import select
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from tog_mjx.running import console
from tog_mjx.studies.study import Store

ROOT = Path(__file__).parent.parent
SIGNALS = [(signal.SIGINT, "interrupted", 130), (signal.SIGTERM, "terminated", 143)]
PATIENCE = 60
"""Seconds until what should have come has not."""
REFUSED = """<mujoco><option solver="PGS"/><worldbody><body><joint/><geom size="0.1"/></body></worldbody></mujoco>"""


class Dropper:
    """Raises a signal as it is deleted: what that raises is lost."""

    def __init__(self, number: int):
        self.number = number

    def __del__(self):
        signal.raise_signal(self.number)
        sum(range(10))  # Python looks for signals between two calls.


@pytest.mark.parametrize(("number", "word", "status"), SIGNALS)
@pytest.mark.parametrize("where", ["a callback of the collector", "__del__", "plain code"])
def test_a_signal_is_not_lost(where, number, word, status, monkeypatch, capsys):
    came: list[int] = []

    def collected(phase, _):
        if phase == "start" and not came:
            came.append(1)
            signal.raise_signal(number)

    def main():
        if where == "plain code":
            signal.raise_signal(number)
        elif where == "__del__":
            some = Dropper(number)
            del some
        else:
            gc.callbacks.append(collected)
            gc.collect()
        time.sleep(PATIENCE)

    monkeypatch.setattr(console, "_leave", sys.exit)
    monkeypatch.setattr(sys, "argv", ["script.py"])
    before = signal.getsignal(number), sys.unraisablehook
    try:
        with pytest.raises(SystemExit) as end:
            console.run_main(main, "nothing is kept")
    finally:
        if collected in gc.callbacks:
            gc.callbacks.remove(collected)
    assert end.value.code == status
    assert capsys.readouterr().err == f"script.py: {word}; nothing is kept\n"
    assert (signal.getsignal(number), sys.unraisablehook) == before


def test_what_is_ignored_stays_ignored(monkeypatch):
    """As Ctrl-C is in a job in the background."""
    before = signal.signal(signal.SIGINT, signal.SIG_IGN)
    monkeypatch.setattr(sys, "argv", ["script.py"])
    try:
        console.run_main(lambda: signal.raise_signal(signal.SIGINT))
        assert signal.getsignal(signal.SIGINT) == signal.SIG_IGN
    finally:
        signal.signal(signal.SIGINT, before)


CRASHING = """
import atexit, os, signal, sys
from tog_mjx.running.console import run_main

def main():
    atexit.register(os.kill, os.getpid(), signal.SIGSEGV)
    sys.stdout.write("as far as it came")
    os.kill(os.getpid(), signal.SIGTERM)
    signal.pause()

sys.argv = ["script.py"]
run_main(main)
"""
"""As XLA crashes, now and then, where Python ends while it computes."""


def test_an_interrupted_program_ends_without_being_taken_down():
    done = subprocess.run([sys.executable, "-c", CRASHING], capture_output=True, text=True, timeout=PATIENCE)
    assert (done.returncode, done.stdout, done.stderr) == (143, "as far as it came", "script.py: terminated\n")


SCRIPTS = [path for path in sorted((ROOT / "scripts").rglob("*.py")) if "__main__" in path.read_text()]
SCRIPTS = [
    path for path in SCRIPTS if path.parent.name != "examples"
]  # Those are to be copied, and as short as can be.


@pytest.mark.parametrize("script", SCRIPTS, ids=lambda path: path.name)
def test_ctrl_c_while_libraries_load_leaves_no_traceback(script, tmp_path):
    """Any of them: each sends the signal."""
    for name in ("jax", "matplotlib", "mujoco", "numpy", "pandas", "rich"):
        (tmp_path / f"{name}.py").write_text("import os, signal\nos.kill(os.getpid(), signal.SIGINT)")
    environment = {**os.environ, "PYTHONPATH": f"{tmp_path}{os.pathsep}{ROOT}"}
    environment.pop("MUJOCO_GL", None)  # With which MuJoCo is imported before any command can say what Ctrl-C does.
    done = subprocess.run([sys.executable, script], env=environment, capture_output=True, text=True, timeout=PATIENCE)
    assert (done.returncode, done.stderr) == (-signal.SIGINT, "")


def interrupt(*_, **__):
    raise KeyboardInterrupt


@pytest.mark.parametrize(
    ("arguments", "told"),
    [
        (["check_gradients.py", "flip"], "interrupted"),
        (["check_step.py", "flip"], "interrupted"),
        (["check_models.py", "MODEL"], "interrupted; what was finished is kept, the same command continues"),
        (["run_study.py", "seeds"], "interrupted; what was finished is kept, with --resume the same command continues"),
        (
            ["reproduce_paper.py"],
            "interrupted; what was finished is kept, the same command continues unless it has --force",
        ),
    ],
)
def test_only_what_continues_says_so(arguments, told, run_script, tmp_path, monkeypatch):
    monkeypatch.setattr(Store, "finish", interrupt)
    commands = ("check.check_scene", "step.check_step", "models.finish_file")
    for place in ("paper.comparison.compute", *(f"commands.{command}" for command in commands)):
        monkeypatch.setattr(f"tog_mjx.{place}", interrupt)
    model = tmp_path / "model.xml"
    model.write_text(REFUSED)
    name, *others = [str(model) if some == "MODEL" else some for some in arguments]
    out = () if name in ("check_gradients.py", "check_step.py") else ("--out", tmp_path / "out")
    status, _, complaint = run_script(name, *others, *out)
    assert status == 130
    assert complaint.splitlines()[-1] == f"{name}: {told}"


CHECKING = """
import os, signal, subprocess, sys
from pathlib import Path
from tog_mjx.checks import alone

started = subprocess.Popen
subprocess.Popen = lambda *args, **options: started(*args, **options, pass_fds=[int(sys.argv[1])])
alone.finish_file(Path(sys.argv[2]), Path(sys.argv[3]), report=lambda _: os.kill(os.getpid(), signal.SIGKILL))
"""
"""Is killed as soon as its child has started."""


def test_the_check_of_a_model_ends_with_the_program_that_started_it(tmp_path):
    """All that hold the other end of a pipe are gone when it is at its end."""
    read, write = os.pipe()
    command = [sys.executable, "-c", CHECKING, str(write), str(ROOT / "models" / "flip.xml"), str(tmp_path)]
    assert subprocess.run(command, pass_fds=[write]).returncode == -signal.SIGKILL
    os.close(write)
    try:
        ended, *_ = select.select([read], [], [], PATIENCE)
        assert ended
        assert os.read(read, 1) == b""
    finally:
        os.close(read)


def test_a_verdict_is_told_though_the_disk_is_full(run_script, tmp_path, monkeypatch):
    def full(_):
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(os, "fsync", full)
    scene, verdict = tmp_path / "scene.xml", tmp_path / "verdict.json"
    scene.write_text(REFUSED)
    status, said, complaint = run_script("check_gradients.py", scene, "--json", verdict)
    assert status == 2
    assert said.startswith("scene: ")
    assert "through C MuJoCo: trust" in said
    assert f"{verdict}: cannot be written (No space left on device)" in complaint.splitlines()[-1]
    assert not list(tmp_path.glob(".*.partial"))


COMPUTING = """
import os, signal, sys, time
import jax, jax.numpy as jnp, mujoco, mujoco.batch
import tog_mjx as tog
from tog_mjx.engines.c_mujoco import forward
from tog_mjx.running.console import run_main

def interrupted(function):
    def slow(*args, **options):
        if not calls:
            os.kill(os.getpid(), getattr(signal, sys.argv[2]))
        calls.append(1)
        time.sleep(0.5)
        return function(*args, **options)

    calls = []
    return slow

def main():
    J = tog.objective("flip", "mujoco")
    if what == "gradient":
        mujoco.mjd_transitionFD = interrupted(mujoco.mjd_transitionFD)
        print(jax.grad(J)(jnp.asarray(tog.get_task("flip").x0)))
    else:
        forward.AT_ONCE = 1
        mujoco.batch.Batch.rollout = interrupted(mujoco.batch.Batch.rollout)
        print(jax.vmap(J)(jnp.tile(tog.get_task("flip").x0, (2000, 1))))

what, sys.argv[0] = sys.argv[1], "script.py"
run_main(main)
"""
"""Calls that take some minutes in all, of which the first one is interrupted."""


@pytest.mark.parametrize(
    ("what", "name", "word", "status"),
    [
        ("gradient", "SIGINT", "interrupted", 130),
        ("motions", "SIGTERM", "terminated", 143),
    ],
)
@pytest.mark.parametrize("devices", [1, 2])
def test_what_c_mujoco_computes_is_interrupted(what, name, word, status, devices):
    """Also where JAX would make an error of it, or has the main thread wait for another one."""
    environment = {**os.environ, "JAX_NUM_CPU_DEVICES": str(devices)}
    done = subprocess.run(
        [sys.executable, "-c", COMPUTING, what, name], env=environment, capture_output=True, text=True, timeout=PATIENCE
    )
    assert (done.returncode, done.stdout, done.stderr) == (status, "", f"script.py: {word}\n")
