"""The checks of an MJCF file in a process of its own, so that whatever ends it ends no other; what is finished is kept.

`python -m tog_mjx.checks.alone FILE RESULT STEPS QUICK` is that process. It writes RESULT whenever a check begins.
"""

import hashlib
import json
import os
import signal
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import mujoco

from tog_mjx.checks.file.preflight import preflight
from tog_mjx.checks.scene_verdict import check_scene
from tog_mjx.checks.told.finding import Finding
from tog_mjx.mjcf.scene import compile_model
from tog_mjx.running.console import run_main
from tog_mjx.running.digests import program_digest
from tog_mjx.running.errors import InputError
from tog_mjx.running.storage import save_json
from tog_mjx.stepping._mjx import contacts, make_data, put_model
from tog_mjx.stepping.mjx_state import default_start

COLUMNS = ("nq", "nv", "nu", "contacts", "engine", "verdict", "check", "sentence", "seconds", "peak_mb")
"""Of a result: sizes of the model; the engine that moved it, C MuJoCo where MJX cannot; the verdict, or one of the
words below; the check that weighs most and its sentence; what it took. What is not known is None."""
NOT_CHECKED, CRASHED, OUT_OF_TIME = "not checked", "crashed", "out of time"
_PROGRAM = ("-m", __name__)
_MB = 1024.0**2 if sys.platform == "darwin" else 1024.0
"""In units of `ru_maxrss`."""


def finish_file(
    path: Path,
    folder: Path,
    steps: int = 100,
    quick: bool = False,
    limit: int | float = float("inf"),
    report: Callable[[str], None] = lambda _: None,
) -> dict[str, Any]:
    """The result of a file, by COLUMNS, with the `seconds_of` each check and all `findings`: read, or made and kept.

    What ran out of time is run again where
    there is more of it now.

    Args:
      folder: of the results. Each is named after the content of the file and of what it includes, and the program.
      limit: minutes.
      report: called with the name of the check that is running.
    """
    result = folder / f"{path.stem}_{_digest(path, steps, quick)}.json"
    kept = _read(result)
    if set(COLUMNS) <= set(kept) and (kept["verdict"] != OUT_OF_TIME or kept["seconds"] >= 60 * limit):
        return kept
    result.unlink(missing_ok=True)
    with tempfile.TemporaryFile("w+") as complaints:
        began = time.monotonic()
        arguments = [str(path), str(result), str(steps), str(int(quick))]
        command = [sys.executable, *_PROGRAM, *arguments]
        with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=complaints, stderr=complaints) as process:
            try:
                status, peak = _wait(process, 60 * limit, lambda: report(_read(result).get("running", "start")))
            finally:
                process.kill()
        complaints.seek(0)
        lines = complaints.read().strip().splitlines()
    found = {**dict.fromkeys(COLUMNS), **_read(result)}
    found |= {"seconds": round(time.monotonic() - began, 1), "peak_mb": round(peak / _MB)}
    if found["verdict"] is None:
        found |= _ended(status, lines[-1] if lines else "", found)
    save_json(result, found)
    return found


def _ended(status: int | None, complaint: str, found: dict[str, Any]) -> dict[str, str]:
    """The verdict on a process that came to none; its `status` is None if it was out of time."""
    running = str(found.get("running", ""))
    if status is None:
        return {"verdict": OUT_OF_TIME, "check": running, "sentence": f"not finished after {found['seconds']:.0f} s"}
    if status < 0:
        killed = ", as a system without memory left does" if status == -signal.SIGKILL else ""
        complaint = f"ended by {signal.Signals(-status).name}{killed}"
    return {"verdict": CRASHED, "check": running, "sentence": complaint or f"ended with status {status}"}


def _wait(process: subprocess.Popen, seconds: int | float, beat: Callable[[], None]) -> tuple[int | None, int]:
    """The exit status of a process, None if it had to be ended, and its largest memory, in units of `ru_maxrss`."""
    ends, is_late = time.monotonic() + seconds, False
    while True:
        pid, status, usage = os.wait4(process.pid, os.WNOHANG)
        if pid:
            process.returncode = os.waitstatus_to_exitcode(status)
            return None if is_late else process.returncode, usage.ru_maxrss
        if time.monotonic() > ends:
            is_late = True
            process.kill()
        beat()
        time.sleep(0.2)


def _digest(path: Path, steps: int, quick: bool) -> str:
    """Of all that a result depends on: the file with its meshes and inclusions, the program, and what is asked."""
    try:
        files = {Path(file) for file in mujoco.mju_getXMLDependencies(str(path))} | {path}
    except (ValueError, RuntimeError, mujoco.FatalError):  # Of what is no MJCF.
        files = {path}
    digest = hashlib.sha256(f"{program_digest(__name__)} {steps} {quick}".encode())
    for file in sorted(files):
        digest.update(file.read_bytes() if file.is_file() else b"")
    return digest.hexdigest()[:12]


def _read(path: Path) -> dict[str, Any]:
    """A result, maybe unfinished; an empty one if there is none, or none that is whole."""
    try:
        return dict(json.loads(path.read_text()).items())
    except (OSError, ValueError, AttributeError):
        return {}


def _check(path: Path, result: Path, steps: int, quick: bool) -> None:
    """What the process does."""
    found: dict[str, Any] = {"running": "MuJoCo's compiler", "seconds_of": {}}
    began = time.monotonic()

    def say(name: str, finding: Finding | None) -> None:
        nonlocal began
        now, times = time.monotonic(), found["seconds_of"]
        # What comes between two checks is the preparation of the second; the motion has no finding of its own.
        whose = name if finding or found["running"] in times else found["running"]
        times[whose] = round(times.get(whose, 0.0) + now - began, 1)
        found["running"], began = name, now
        save_json(result, found)

    save_json(result, found)
    try:
        model = compile_model(path)
        found |= {"nq": model.nq, "nv": model.nv, "nu": model.nu}
        start = default_start(model)
        if not any(remark.blocks for remark in preflight(model, path, start)):
            found["contacts"] = contacts(make_data(put_model(model))).distance.size
        verdict = check_scene(model, start, steps=steps, path=path, quick=quick, report=say)
    except InputError as error:
        found |= {"verdict": NOT_CHECKED, "check": "", "sentence": str(error)}
    else:
        reason = verdict.reason
        found |= {"engine": verdict.engine, "verdict": verdict.word, "check": reason.check if reason else ""}
        found |= {"sentence": reason.sentence if reason else "no check found a fault"}
        found["findings"] = verdict.as_json()["findings"]
    save_json(result, found)


def _end_with_parent() -> None:
    """Ends this process as soon as its standard input is closed, as it is when the parent is killed."""

    def watch() -> None:
        os.read(0, 1)  # Not `sys.stdin`: Python would not end while a thread holds it.
        os._exit(1)

    threading.Thread(target=watch, daemon=True).start()


def _main() -> None:
    _end_with_parent()
    path, result, steps, quick = sys.argv[1:]
    _check(Path(path), Path(result), int(steps), quick == "1")


if __name__ == "__main__":
    run_main(_main)
