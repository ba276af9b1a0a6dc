"""The command that shows scenes and motions: its files, and bad input. Its viewers have tests of their own."""

import socket
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from PIL import Image, ImageSequence
from saved_run import save_run

from tog_mjx.drawing.viewing.film import film
from tog_mjx.engines.objective import rollout
from tog_mjx.mjcf.scene import compile_model, scene_path
from tog_mjx.running.errors import InputError

NAME = "view_scene.py"
SCENES = Path(__file__).parent / "scenes"
PIXELS = 1.6
"""How far an edge may be from where the motion puts it: it is drawn a pixel wide, and smoothed."""
U = [0.1, 1.0]


@pytest.fixture
def result(tmp_path) -> Path:
    """A run of the flip on the penalty simulator. It flips; nothing leaves the view."""
    return save_run(tmp_path / "runs", np.array([[0.0, 0.25], U, [-0.6, 0.3]]))


def box_edges(image: np.ndarray) -> np.ndarray:
    """Left, right, top and bottom of what is blue, in pixels."""
    red, green, blue = np.moveaxis(image.astype(int), 2, 0)
    blue = (blue - red > 40) & (blue - green > 25)
    rows, columns = np.flatnonzero(blue.any(axis=1)), np.flatnonzero(blue.any(axis=0))
    return np.array([columns[0], columns[-1] + 1, rows[0], rows[-1] + 1])


def expected_edges(box: np.ndarray, width: int, height: int, backend: str) -> np.ndarray:
    """The same of a box in state (x, z, theta), through the camera of the scene.

    OpenGL hides what has sunk into the floor; in the drawing the box is in front of it.
    """
    model = compile_model(scene_path("flip"))
    camera = model.camera("plane")
    scale = height / camera.fovy[0]
    x, z, theta = box
    reach = 0.25 * (abs(np.cos(theta)) + abs(np.sin(theta)))
    left, top = width / 2 + scale * (x - camera.pos[0]), height / 2 - scale * (z - camera.pos[2])
    edges = np.array([left, left, top, top]) + scale * reach * np.array([-1, 1, -1, 1])
    if backend != "disable":
        edges[3] = min(edges[3], height / 2 + scale * camera.pos[2])
    return edges


@pytest.fixture(params=["egl", "osmesa", "disable"])
def backend(request, monkeypatch) -> str:
    monkeypatch.setenv("MUJOCO_GL", request.param)
    return request.param


def written(run_script, backend, *arguments) -> str:
    """Runs the script, which must render as `backend` says, or the test is skipped for want of it."""
    status, said, complaint = run_script(NAME, *arguments)
    assert (status, complaint) == (0, "")
    if backend != "disable" and "without OpenGL" in said:
        pytest.skip(f"no OpenGL here: {said.strip().splitlines()[-1]}")
    assert ("rendered by MuJoCo with OpenGL" if backend != "disable" else "drawn from the side") in said
    return said


def test_a_gif_shows_the_box_where_the_motion_is(run_script, result, tmp_path, backend):
    gif = tmp_path / "a.gif"
    said = written(run_script, backend, "flip", "--run", result, "--gif", gif, "--fps", 10, "--size", 480, 270)
    assert "iterate 1 on penalty: setpoints (0.1, 1), J = 1" in said
    motion = np.asarray(rollout("flip", U, "penalty").box)[:, :3]
    assert np.ptp(motion[:, 2]) > 1.5
    with Image.open(gif) as film:
        assert film.size == (480, 270)
        images = [np.asarray(frame.convert("RGB")) for frame in ImageSequence.Iterator(film)]
    assert len(images) == 25
    for i, image in enumerate(images):
        edges = box_edges(image)
        np.testing.assert_allclose(edges, expected_edges(motion[min(25 * i, 599)], 480, 270, backend), atol=PIXELS)
    assert gif.stat().st_size < 100_000
    assert sorted(path.name for path in tmp_path.iterdir()) == ["a.gif", "runs"]


def test_a_video_shows_the_box_where_the_motion_is(run_script, result, tmp_path, monkeypatch):
    ffmpeg = pytest.importorskip("imageio_ffmpeg").get_ffmpeg_exe()
    monkeypatch.setenv("MUJOCO_GL", "disable")
    film = tmp_path / "a.mp4"
    arguments = ["--mp4", film, "--fps", 10, "--size", 480, 270, "--speed", 0.5]
    written(run_script, "disable", "flip", "--run", result, *arguments)
    command = [ffmpeg, "-v", "error", "-i", film, "-f", "rawvideo", "-pix_fmt", "rgb24", "-"]
    frames = np.frombuffer(subprocess.run(command, capture_output=True, check=True).stdout, np.uint8)
    frames = frames.reshape(-1, 270, 480, 3)
    assert len(frames) == 13
    motion = np.asarray(rollout("flip", U, "penalty").box)[:, :3]
    for i, frame in enumerate(frames):
        expected, found = expected_edges(motion[min(50 * i, 599)], 480, 270, "disable"), box_edges(frame)
        np.testing.assert_allclose(found[::2] + found[1::2], expected[::2] + expected[1::2], atol=2 * PIXELS)
        np.testing.assert_allclose(found, expected, atol=2 * PIXELS)  # H.264 keeps colour at half the resolution.


def test_any_scene_is_shown_also_one_that_mjx_rejects(run_script, tmp_path, backend):
    scene = tmp_path / "scene.xml"
    scene.write_text(
        """<mujoco><option noslip_iterations="3"/><visual><headlight ambient="1 1 1"/></visual><worldbody>
        <body pos="0 0 1"><joint type="slide" axis="1 0 0"/><geom type="cylinder" size="0.2 0.3" rgba="0 0 1 1"/></body>
        </worldbody></mujoco>"""
    )
    said = written(run_script, backend, scene, "--gif", tmp_path / "a.gif", "--duration", 0.1, "--size", 64, 48)
    assert "4 frames" in said
    with Image.open(tmp_path / "a.gif") as film:
        left, right, top, bottom = box_edges(np.asarray(film.convert("RGB")))
    assert 0 < left < 32 < right < 64
    assert 0 < top < 24 < bottom < 48


def test_a_backend_that_fails_is_told_and_done_without(run_script, tmp_path, monkeypatch):
    for name in ("DISPLAY", "WAYLAND_DISPLAY"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setenv("MUJOCO_GL", "none such")
    gif = tmp_path / "a.gif"
    status, said, _ = run_script(NAME, SCENES / "box.xml", "--gif", gif, "--duration", 0.1, "--size", 64, 48)
    assert status == 0
    assert "drawn from the side without OpenGL (none such: " in said
    assert "MUJOCO_GL" in said
    assert gif.is_file()


def test_without_a_display_one_line_names_the_flags(run_script, monkeypatch):
    for name in ("DISPLAY", "WAYLAND_DISPLAY"):
        monkeypatch.delenv(name, raising=False)
    status, said, complaint = run_script(NAME, "flip")
    assert (status, said) == (2, "")
    assert complaint.startswith("view_scene.py: no window can be opened here")
    assert complaint.count("\n") == 1
    assert all(flag in complaint for flag in ("--web", "--gif", "--mp4"))


BAD = [
    (["walk"], "walk: no such scene or file"),
    ([SCENES.parent / "test_view_scene.py"], "MuJoCo cannot read it"),
    (["flip", "--setpoints", 1], "1 setpoints given; the scene takes 2"),
    (["grasp", "--setpoints", 1, 2, 3, 4, 5], "5 setpoints given; the scene takes 4"),
    ([SCENES / "box.xml", "--setpoints", 1, 2], "2 setpoints given; the scene takes"),
    (["flip", "--setpoints", "nan", 1], "not finite"),
    (["flip", "--setpoints", "left", 1], "invalid float value: 'left'"),
    (["flip", "--fps", 0], "argument --fps: 0 is not from 1 to 100"),
    (["flip", "--fps", "many"], "argument --fps: invalid"),
    (["flip", "--speed", "nan"], "argument --speed: nan is not from"),
    (["flip", "--size", 8, 9000], "argument --size: 8 is not from"),
    (["flip", "--duration", -1], "argument --duration: -1 is not from"),
    (["flip", "--duration", 60, "--speed", 0.01], "frames of 640 x 360 pixels are too many"),
    (["flip", "--iterate", 1], "argument --iterate: it needs --run"),
    (["flip", "--port", 1], "argument --port: it needs --web"),
    (["flip", "--web"], "argument --web: give it, or --gif and --mp4"),
    (["flip", "--run", "nowhere.npz"], "nowhere.npz: no such file"),
    (["flip", "--run", SCENES / "box.xml"], "damaged"),
    (["flip", "--run", "RESULT", "--setpoints", 0, 0], "not allowed with argument --run"),
    (["grasp", "--run", "RESULT"], "is a run of the task flip"),
    ([SCENES / "box.xml", "--run", "RESULT"], "is a run of the task flip"),
    (["flip", "--run", "RESULT", "--iterate", 3], "has no iterate 3; it has 0 to 2, best and last"),
    (["flip", "--run", "RESULT", "--iterate", "first"], "first is neither best nor last"),
    (["flip", "--gif", "/dev/null/a.gif"], "/dev/null/a.gif: cannot be written"),
    (["flip", "--gif", SCENES], "it is a folder"),
    (["flip", "--mp4", "odd.mp4", "--size", 63, 48], "63 x 48 pixels cannot be encoded; give even numbers"),
]


@pytest.mark.parametrize(("arguments", "message"), BAD)
def test_bad_input_is_one_line_and_status_2(run_script, result, tmp_path, monkeypatch, arguments, message):
    monkeypatch.chdir(tmp_path)
    arguments = [result if argument == "RESULT" else argument for argument in arguments]
    output = [] if "--gif" in arguments or "--mp4" in arguments else ["--gif", "a.gif"]
    status, said, complaint = run_script(NAME, *arguments, *output)
    assert (status, said) == (2, "")
    assert message in complaint
    assert complaint.startswith("view_scene.py: ")
    assert complaint.count("\n") == 1
    assert [path.name for path in tmp_path.iterdir()] == ["runs"]


def test_a_film_of_another_ending_is_refused_before_anything_moves(tmp_path):
    with pytest.raises(InputError, match=r"a\.mp4: a film is a GIF; give a name that ends in \.gif"):
        film("flip", U, tmp_path / "a.mp4")
    assert not list(tmp_path.iterdir())


def test_a_damaged_result_is_told(run_script, result, tmp_path):
    content = result.read_bytes()
    result.write_bytes(content[: len(content) // 2])
    status, _, complaint = run_script(NAME, "flip", "--run", result, "--gif", tmp_path / "a.gif")
    assert status == 2
    assert "damaged" in complaint
    assert complaint.count("\n") == 1


def test_without_the_video_extra_one_line_names_it(run_script, tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "imageio_ffmpeg", None)
    status, _, complaint = run_script(NAME, "flip", "--mp4", tmp_path / "a.mp4")
    assert status == 2
    assert "pip install imageio-ffmpeg" in complaint
    assert complaint.count("\n") == 1


def test_a_port_that_is_taken_is_told(run_script):
    with socket.create_server(("", 0)) as taken:
        status, _, complaint = run_script(NAME, "flip", "--web", "--port", taken.getsockname()[1])
    assert status == 2
    assert "the page cannot be served" in complaint
    assert complaint.count("\n") == 1
