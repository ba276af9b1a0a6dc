"""MuJoCo's own viewer, in a window."""

import re
import threading
import time

import mujoco

from tog_mjx.drawing.viewing.camera import axes_of
from tog_mjx.drawing.viewing.child import run_python
from tog_mjx.drawing.viewing.gl_frames import add_marks, add_sky, add_tiles
from tog_mjx.drawing.viewing.playback import Playback
from tog_mjx.running.errors import InputError

_FRAME = 1 / 60
"""Seconds between frames."""
_CLOSING = 10.0
"""Seconds that a window gets to close."""
_PROBE = """
import sys, warnings, glfw
warnings.simplefilter("error", glfw.GLFWError)
if not glfw.init():
    sys.exit("GLFW does not start")
glfw.window_hint(glfw.VISIBLE, glfw.FALSE)
if not glfw.create_window(64, 64, "", None, None):
    sys.exit("it opens no window")
glfw.terminate()
"""


def check_display() -> None:
    """Opens a hidden window, in a process of its own: MuJoCo's viewer waits for ever for one that does not open.

    Raises:
      InputError: if there is no display, or none with OpenGL.
    """
    if complaint := run_python("-c", _PROBE):
        quoted = re.search(r"b['\"](.*)['\"]", complaint)  # GLFW's own words.
        raise InputError(
            f"no window can be opened here ({quoted[1] if quoted else complaint}); give --web for a page in a browser, "
            "--gif FILE or --mp4 FILE for an animation"
        )


def show_in_window(playback: Playback) -> None:
    """Shows `playback` in real time until the window is closed or Ctrl-C is pressed. Call `check_display` first.

    Raises:
      InputError: where MuJoCo's viewer wants its own launcher (macOS).
    """
    import mujoco.viewer  # Not before: where GLFW is missing, it cannot be imported.

    others = set(threading.enumerate())
    try:
        handle = mujoco.viewer.launch_passive(playback.model, playback.data)
    except RuntimeError as error:
        raise InputError(f"MuJoCo's viewer does not start: {error}") from None
    threads = set(threading.enumerate()) - others
    with handle.lock():
        mujoco.mjv_defaultFreeCamera(playback.model, handle.cam)  # The view that the playback has chosen.
    print("Close the window or press Ctrl-C to end.", flush=True)
    try:
        before = time.monotonic()
        while handle.is_running():
            now = time.monotonic()
            lookat = playback.lookat
            with handle.lock():
                playback.advance(now - before)
                handle.cam.lookat[:] += playback.lookat - lookat  # Whoever has turned the camera keeps it so.
                _add_scenery(handle.user_scn, handle.cam, playback)
            handle.sync()
            before = now
            time.sleep(max(0.0, now + _FRAME - time.monotonic()))
    except KeyboardInterrupt:
        pass
    finally:
        handle.close()
        for thread in threads:  # Python must not end while the viewer's thread still draws.
            thread.join(_CLOSING)


def _add_scenery(scene: mujoco.MjvScene, camera: mujoco.MjvCamera, playback: Playback) -> None:
    """In place of that of the frame before."""
    scenery, scene.ngeom = playback.scenery, 0
    if not scenery.has_sky and camera.type == mujoco.mjtCamera.mjCAMERA_FREE:
        forward = axes_of(camera.azimuth, camera.elevation)[:, 2]
        add_sky(scene, playback.model, camera.lookat - camera.distance * forward, forward)
    add_marks(scene, scenery.marks, scenery.radius)
    for floor in scenery.floors:
        add_tiles(scene, playback.model, playback.data, floor, playback.lookat, scenery.tile)
