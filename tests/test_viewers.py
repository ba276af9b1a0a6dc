"""The viewers start, show the scene, and close cleanly: in a window, and as a page."""

import http.client
import os
import re
import shutil
import signal
import socket
import struct
import subprocess
import sys
import threading
import time
from pathlib import Path

import mujoco
import numpy as np
import pytest
from saved_run import save_run

from tog_mjx.mjcf.scene import compile_model, scene_path

SCRIPT = Path(__file__).parent.parent / "scripts" / "view_scene.py"
PATIENCE = 600
"""Seconds after which a process that hangs is killed, which fails its test."""


@pytest.fixture
def result(tmp_path) -> Path:
    return save_run(tmp_path / "runs", np.array([[0.0, 0.25], [0.1, 1.0], [-0.6, 0.3]]))


class Started:
    """The script, running in a process of its own."""

    def __init__(self, *arguments, display: str | None = None):
        hidden = ("DISPLAY", "WAYLAND_DISPLAY")
        environment = {name: value for name, value in os.environ.items() if name not in hidden}
        if display:
            environment["DISPLAY"] = display
        command = [sys.executable, str(SCRIPT), *map(str, arguments)]
        self.process = subprocess.Popen(
            command, env=environment, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
        )
        assert self.process.stdout is not None
        self._lines = self.process.stdout
        self._timer = threading.Timer(PATIENCE, self.process.kill)
        self._timer.start()
        self.said = ""

    def wait_for(self, text: str) -> bool:
        """Reads standard output up to a line with that text. False if the process ended without it."""
        while text not in self.said:
            line = self._lines.readline()
            if not line:
                return False
            self.said += line
        return True

    def interrupt(self) -> tuple[int, str]:
        """Presses Ctrl-C. Returns the status and what was on standard error."""
        self.process.send_signal(signal.SIGINT)
        return self.end()

    def end(self) -> tuple[int, str]:
        said, complaint = self.process.communicate()
        self._timer.cancel()
        self._timer.join()
        self.said += said
        return self.process.returncode, complaint


def screen(path: Path) -> np.ndarray:
    """The pixels [height, width, 3] of a virtual display, from its file in the format XWD."""
    content = path.read_bytes()
    header = struct.unpack(">25I", content[:100])
    width, height, stride, colors = header[4], header[5], header[12], header[19]
    first = header[0] + 12 * colors
    pixels = np.frombuffer(content[first : first + stride * height], np.uint8).reshape(height, stride // 4, 4)
    return pixels[:, :width, 2::-1]


@pytest.fixture
def display(tmp_path):
    """A virtual display: its name, and the file that holds its pixels."""
    if shutil.which("Xvfb") is None:
        pytest.skip("Xvfb, a virtual display, is not installed")
    folder = tmp_path / "screen"
    folder.mkdir()
    read, write = os.pipe()
    command = ["Xvfb", "-displayfd", str(write), "-screen", "0", "900x600x24", "-fbdir", str(folder)]
    with subprocess.Popen(command, pass_fds=[write], stderr=subprocess.DEVNULL) as server:
        os.close(write)
        with os.fdopen(read) as told:
            number = told.readline().strip()
        try:
            assert number, "Xvfb did not start"
            yield f":{number}", folder / "Xvfb_screen0"
        finally:
            server.terminate()


@pytest.mark.parametrize("source", ["simulation", "run"])
def test_a_window_shows_the_scene_and_closes_on_ctrl_c(display, result, source):
    name, pixels = display
    script = Started("flip", *(["--run", result] if source == "run" else []), display=name)
    if not script.wait_for("Close the window"):
        status, complaint = script.end()
        assert (status, complaint.count("\n")) == (2, 1), complaint
        pytest.skip(f"no OpenGL on the virtual display: {complaint}")
    deadline = time.monotonic() + PATIENCE
    blue = 0
    while blue < 1000 and time.monotonic() < deadline:  # The box is blue.
        time.sleep(0.1)
        image = screen(pixels).astype(int)
        blue = int((image[:, :, 2] - image[:, :, 0] > 60).sum())
    status, complaint = script.interrupt()
    assert blue >= 1000
    assert (status, complaint) == (0, "")


def test_a_window_shows_a_scene_without_light_colour_or_background(display, tmp_path):
    name, pixels = display
    scene = tmp_path / "scene.xml"
    scene.write_text(
        """<mujoco><worldbody><geom type="plane" size="3 3 0.1"/>
        <body pos="0 0 0.05"><joint type="slide" axis="1 0 0"/><geom type="box" size="0.05 0.05 0.05"/></body>
        </worldbody></mujoco>"""
    )
    script = Started(scene, display=name)
    if not script.wait_for("Close the window"):
        status, complaint = script.end()
        assert (status, complaint.count("\n")) == (2, 1), complaint
        pytest.skip(f"no OpenGL on the virtual display: {complaint}")
    deadline = time.monotonic() + PATIENCE
    seen = sky = 0
    while not (seen >= 1000 and sky >= 1000) and time.monotonic() < deadline:
        time.sleep(0.1)
        image = screen(pixels).astype(int)
        seen = int(((image[:, :, 0] > 180) & (image[:, :, 0] - image[:, :, 2] > 80)).sum())  # The cube is orange.
        sky = int((image > 200).all(axis=2).sum())
    status, complaint = script.interrupt()
    assert min(seen, sky) >= 1000
    assert (status, complaint) == (0, "")


@pytest.mark.parametrize("source", ["simulation", "run"])
def test_a_page_is_served_until_ctrl_c(result, source):
    # By default it takes the first free port, which another process may take after it; one of its own nobody does.
    with socket.create_server(("", 0)) as probe:
        own = str(probe.getsockname()[1])
    script = Started("flip", "--web", *(["--run", result, "--port", own] if source == "run" else []))
    assert script.wait_for("Model changed"), script.end()
    (port,) = set(re.findall(r"http://localhost:(\d+)/", script.said))
    answers = {}
    for path in ("/", "/model"):
        connection = http.client.HTTPConnection("127.0.0.1", int(port), timeout=PATIENCE)
        connection.request("GET", path)
        answer = connection.getresponse()
        answers[path] = answer.status, answer.read()
        connection.close()
    status, complaint = script.interrupt()
    assert answers["/"][0] == answers["/model"][0] == 200
    assert b"<html" in answers["/"][1].lower()
    model = compile_model(scene_path("flip"))
    assert len(answers["/model"][1]) >= mujoco.mj_sizeModel(model)
    assert status == 0
    assert "Traceback" not in complaint
    assert ("paused" in script.said) == (source == "simulation")
    if source == "run":
        assert port == own
        with pytest.raises(ConnectionRefusedError):
            http.client.HTTPConnection("127.0.0.1", int(port), timeout=PATIENCE).connect()
