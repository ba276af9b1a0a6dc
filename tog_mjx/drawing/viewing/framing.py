"""How far away a camera stands, and where it looks, so that all points stay in the picture and fill it.

Points are [n, k, 3], of n moments, in the camera's axes: right, up, forward. Four numbers of each moment say all that a
fit needs: how far the points reach towards each side of the picture. A fit to the greatest of several moments holds for
each of them, and so does one to a mean of such fits: a window of moments that slides makes the camera follow smoothly.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float
from scipy.ndimage import maximum_filter1d, uniform_filter1d

MOST, LEAST = 0.85, 0.3
"""Of the picture's width or height: what the points fill at most, and at least: in every moment where the camera
follows, on average where it stands."""
_FOLLOWED = 0.55
"""What they fill at most where the camera follows, so that the surroundings are seen."""


class Fit(NamedTuple):
    """Of each moment: the camera's place [n, 3] in its own axes. Of an orthographic view the place is the centre of the
    picture, and `height` [n] that of what it shows; else 0."""

    place: Float[np.ndarray, "n 3"]
    height: Float[np.ndarray, " n"]


def follow(points: Float[np.ndarray, "n k 3"], aspect: float, fovy: float | None = None) -> Fit:
    """The steadiest camera in which the points are never small.

    It stands still where that is enough. Else the window that slides over the moments is halved until it is; then it
    comes nearer and goes back, too.

    Args:
      aspect: width of the picture over its height.
      fovy: vertical field of view in degrees; None is an orthographic view.
    """
    slope = _slope(fovy)
    still = _fit(points, len(points), aspect, slope, MOST, is_level=True)
    share = filled(points, still, aspect, fovy)
    if share.mean() >= LEAST and share.min() >= LEAST / 2:  # As of an arm, which is folded at times.
        return still
    widths = [len(points) >> i for i in range(len(points).bit_length() + 1)]
    for is_level in (True, False):  # Better a camera that follows than one that comes and goes.
        for width in widths:
            found = _fit(points, width, aspect, slope, _FOLLOWED, is_level)
            if filled(points, found, aspect, fovy).min() >= LEAST:
                return found
    return found


def shares(points: Float[np.ndarray, "n k 3"], fit: Fit, aspect: float, fovy: float | None = None) -> np.ndarray:
    """Where the points are in the picture, [n, k, 2]: from -1, its left and lower edge, to 1."""
    ahead = _slope(fovy) * (points[:, :, 2:] - fit.place[:, None, 2:]) if fovy else fit.height[:, None, None] / 2
    return (points[:, :, :2] - fit.place[:, None, :2]) / (ahead * np.array([aspect, 1]))


def filled(points: Float[np.ndarray, "n k 3"], fit: Fit, aspect: float, fovy: float | None = None) -> np.ndarray:
    """What the points fill [n] of the picture's width or of its height, whichever is more."""
    return (np.ptp(shares(points, fit, aspect, fovy), axis=1) / 2).max(axis=1)


def _slope(fovy: float | None) -> float:
    return 0.0 if fovy is None else float(np.tan(np.deg2rad(fovy) / 2))


def _reach(points: Float[np.ndarray, "n k 3"], slopes: Float[np.ndarray, " 2"]) -> Float[np.ndarray, "n 4"]:
    """Towards right, up, left and down, along lines that spread by `slopes` as they go forward."""
    across, depth = points[:, :, :2], slopes * points[:, :, 2:]
    return np.concatenate([(across - depth).max(axis=1), (-across - depth).max(axis=1)], axis=1)


def _fit(
    points: Float[np.ndarray, "n k 3"], width: int, aspect: float, slope: float, most_filled: float, is_level: bool
) -> Fit:
    """Of the greatest reach within `width` moments, smoothed over as many: it is never less than the reach itself.

    With `is_level`, always as far from the points, or as high.
    """
    reach = _reach(points, most_filled * slope * np.array([aspect, 1]))
    most = _smooth(maximum_filter1d(reach, 2 * width + 1, axis=0, mode="nearest"), width)
    sides = np.array([aspect, 1])
    middle, half = (most[:, :2] - most[:, 2:]) / 2, (most[:, :2] + most[:, 2:]) / 2
    depth = _smooth(points[:, :, 2].mean(axis=1), width)
    if not slope:
        height = 2 * (half / sides).max(axis=1) / most_filled
        return Fit(np.column_stack([middle, depth]), np.full_like(height, height.max()) if is_level else height)
    back = depth + (half / (most_filled * slope * sides)).max(axis=1)
    back = np.full_like(back, back.max()) if is_level else back
    return Fit(np.column_stack([middle, depth - back]), np.zeros(len(points)))


def _smooth(values: np.ndarray, width: int) -> np.ndarray:
    if width >= len(values):
        return np.broadcast_to(values.mean(axis=0), values.shape)
    for _ in range(2):  # The mean of a mean: its speed does not jump.
        values = uniform_filter1d(values, width // 2 * 2 + 1, axis=0, mode="nearest")
    return values
