"""Motions packed into text, which the page carries and the browser unpacks; and a landscape as an image.

A motion is poses every few time steps, in whole numbers of `QUANTUM` (m or rad): the first pose, then the differences
from one to the next, as little-endian 16-bit integers; of all motions together, gzipped, in base64.
"""

import base64
import gzip
import io

import matplotlib.image
import numpy as np
from jaxtyping import Float

QUANTUM = 2.5e-4
"""In m and rad. A body is shown where it is to a quarter of a millimetre."""
FARTHEST = 4.0
"""In m and rad. What flies farther is held there, out of sight; so every difference of two poses fits into 16 bits."""


def pack(poses: Float[np.ndarray, "N k c"]) -> str:
    """See the module's header."""
    finite = np.nan_to_num(poses, posinf=FARTHEST, neginf=-FARTHEST)
    whole = np.rint(np.clip(finite, -FARTHEST, FARTHEST) / QUANTUM).astype(np.int32)
    steps = np.diff(whole, axis=1, prepend=0)
    return base64.b64encode(gzip.compress(steps.astype("<i2").tobytes(), mtime=0)).decode()


def unpack(text: str, shape: tuple[int, int, int]) -> Float[np.ndarray, "N k c"]:
    """The poses of a packed text, as the browser reads them."""
    steps = np.frombuffer(gzip.decompress(base64.b64decode(text)), "<i2").reshape(shape)
    return np.cumsum(steps, axis=1, dtype=np.int32) * QUANTUM


def picture(costs: Float[np.ndarray, "n n"], highest: float) -> str:
    """Costs in the colours of a landscape from 0 to `highest`, a pixel a point, as the address of a PNG image."""
    file = io.BytesIO()
    matplotlib.image.imsave(file, costs, cmap="cividis", vmin=0, vmax=highest, origin="lower", format="png")
    return data_uri(file.getvalue())


def data_uri(image: bytes) -> str:
    """Of a PNG or a GIF."""
    kind = "gif" if image.startswith(b"GIF") else "png"
    return f"data:image/{kind};base64," + base64.b64encode(image).decode()
