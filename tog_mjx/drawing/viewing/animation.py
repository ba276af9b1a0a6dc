"""Frames written as a GIF or as an MP4 video."""

import importlib.util
import itertools
import subprocess
import tempfile
from pathlib import Path

import numpy as np
from jaxtyping import UInt8
from PIL import Image

from tog_mjx.drawing.viewing.playback import HOLD
from tog_mjx.running.errors import InputError
from tog_mjx.running.storage import atomic_write

_COLORS = 128
"""Of a GIF: few colours make a small file."""
_SAMPLES = 8
"""Frames from which the colours are chosen."""


def write_gif(path: Path, images: UInt8[np.ndarray, "n h w 3"], fps: float) -> None:
    """Writes a GIF that repeats for ever, its last frame held. Equal frames in a row are kept as one, shown longer.

    Raises:
      InputError: if the file cannot be written.
    """
    sample = images[:: max(1, len(images) // _SAMPLES)].reshape(-1, *images.shape[2:])
    palette = Image.fromarray(sample).quantize(_COLORS, kmeans=1, dither=Image.Dither.NONE)
    frames = [Image.fromarray(image).quantize(palette=palette, dither=Image.Dither.NONE) for image in images]
    # The format counts in hundredths of a second: round the times of the frames, so that errors do not add up.
    ends = [round(100 * (i + 1) / fps) for i in range(len(frames))]
    durations = [10 * max(1, end - begin) for begin, end in itertools.pairwise([0, *ends])]
    durations[-1] += round(1000 * HOLD)
    with atomic_write(path) as file:
        frames[0].save(file, "GIF", save_all=True, append_images=frames[1:], duration=durations, loop=0, optimize=True)


def check_video(size: tuple[int, int]) -> None:
    """Fails before the work where `write_mp4` would fail after it.

    Raises:
      InputError: without the package that brings the encoder, or for a size that H.264 does not take.
    """
    if importlib.util.find_spec("imageio_ffmpeg") is None:
        raise InputError("an MP4 needs the package imageio-ffmpeg; install it with: pip install imageio-ffmpeg")
    if size[0] % 2 or size[1] % 2:
        raise InputError(f"a video of {size[0]} x {size[1]} pixels cannot be encoded; give even numbers")


def write_mp4(path: Path, images: UInt8[np.ndarray, "n h w 3"], fps: float) -> None:
    """Writes a video (H.264), with the ffmpeg that the package imageio-ffmpeg brings.

    Raises:
      InputError: if the file cannot be written, and as `check_video`.
    """
    height, width = images.shape[1:3]
    check_video((width, height))
    import imageio_ffmpeg

    with tempfile.TemporaryDirectory() as folder:
        film = Path(folder) / "film.mp4"
        # Not imageio_ffmpeg.write_frames: it forks, which JAX's threads do not bear.
        source = ["-f", "rawvideo", "-pix_fmt", "rgb24", "-s", f"{width}x{height}", "-r", str(fps), "-i", "-"]
        codec = ["-c:v", "libx264", "-pix_fmt", "yuv420p", "-movflags", "+faststart"]
        command = [imageio_ffmpeg.get_ffmpeg_exe(), "-v", "error", *source, *codec, str(film)]
        done = subprocess.run(command, input=np.ascontiguousarray(images).data, capture_output=True, check=False)
        if done.returncode:
            reason = " ".join(done.stderr.decode(errors="replace").split())
            raise InputError(f"{path}: ffmpeg cannot encode it: {reason}")
        with atomic_write(path) as file:
            file.write(film.read_bytes())
