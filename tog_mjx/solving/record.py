"""Descents on disk."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from tog_mjx.running.storage import DamagedFileError, load_result, of_shapes, save_result
from tog_mjx.solving.descent import Descent, Status


def save_descent(path: Path, descent: Descent, settings: Mapping[str, Any]) -> None:
    """Writes a descent over a vector, atomically, and the JSON-able settings that it was made with."""
    fields = descent._asdict()
    arrays = {name: value for name, value in fields.items() if isinstance(value, np.ndarray)}
    seconds = {name: fields[name] for name in ("seconds_compile", "seconds_run")}
    save_result(path, arrays, {"settings": settings, "status": descent.status.value, **seconds})


def load_descent(path: Path) -> tuple[Descent, dict[str, Any]]:
    """The descent in a file, and the settings that it was made with.

    Raises:
      FileNotFoundError, DamagedFileError: if there is none, or not a whole one.
    """
    arrays, attributes = load_result(path)
    try:
        count, n = arrays["setpoints"].shape
        of_shapes(path, arrays, setpoints=(count, n), gradients=(count, n))
        of_shapes(path, {"held_out": arrays["costs"], **arrays}, costs=(count,), held_out=(count,))
        if not (count and np.isfinite(arrays["costs"]).all() and np.isfinite(arrays["setpoints"]).all()):
            raise ValueError("costs and setpoints are not finite ones of an iterate or more")
        seconds = {name: float(attributes[name]) for name in ("seconds_compile", "seconds_run")}
        if not all(0 <= some < np.inf for some in seconds.values()):
            raise ValueError("seconds are none")
        fields: dict[str, Any] = {**arrays, **seconds, "status": Status(attributes["status"])}
        return Descent(**fields), dict(attributes["settings"].items())
    except (KeyError, TypeError, ValueError, AttributeError) as error:
        raise DamagedFileError(f"{path}: {error}") from None
