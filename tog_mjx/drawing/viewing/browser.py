"""MuJoCo Studio's viewer, in a web browser."""

import time

from tog_mjx.drawing.viewing.playback import Live, Playback
from tog_mjx.running.errors import InputError

_FRAME = 1 / 60
"""Seconds between frames."""


def show_in_browser(playback: Playback, port: int = 0) -> None:
    """Serves a page that shows `playback` in real time, until Ctrl-C is pressed. MuJoCo prints its address.

    A live simulation is paused until it is run from the page, which also sets its speed. The server listens on all
    interfaces of the machine: MuJoCo 4.0 offers no other choice.

    Args:
      playback: what to show.
      port: of the server; 0 takes the first free one from 8080 on.

    Raises:
      InputError: where MuJoCo Studio is missing or the port is taken.
    """
    try:
        from mujoco.studio import app, launch_web, messages, sim, viewer_protocol
    except ImportError as error:
        raise InputError(f"MuJoCo Studio cannot be imported ({error}); install mujoco-studio") from None
    live = isinstance(playback, Live)
    config = viewer_protocol.ViewerConfig(gfx="web", http_port=port)
    try:
        with launch_web.launch(config, plugins=[app.App(), *(app.SIM_PLUGINS if live else ())]) as handle:
            try:
                handle.set_model(playback.model, data=playback.data)
                if live:  # Else the motion is over before a browser shows it.
                    handle.dispatch(messages.RequestPauseEvent(pause_state=sim.PauseState.NORMAL_PAUSED))
                    print("The simulation is paused: press Run on the page.", flush=True)
                before = time.monotonic()
                while handle.is_running():
                    if not live:
                        now = time.monotonic()
                        playback.advance(now - before)
                        before = now
                        time.sleep(_FRAME)
                    handle.sync()
            except KeyboardInterrupt:  # Inside the block, so that the page is told of an ordinary end.
                pass
    except RuntimeError as error:  # The thread that serves the page could not start.
        raise InputError(f"the page cannot be served: {' '.join(str(error).split())}") from None
