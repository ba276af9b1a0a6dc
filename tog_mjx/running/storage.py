"""Results on disk: written whole or not at all, and read only if undamaged.

A result is an `.npz` of arrays with a JSON text of settings and scalars under the name `attributes`; no pickles. The
CRC-32 that the zip format keeps of every member is checked on reading.
"""

import contextlib
import errno
import functools
import json
import os
import tempfile
import time
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import IO, Any

import numpy as np

from tog_mjx.running.errors import InputError

_ATTRIBUTES = "attributes"
_LONG_AGO = 3600
"""Seconds after which nobody writes on an unfinished file any more."""


class DamagedFileError(Exception):
    """A file that was not written by this module, or not wholly, or that has changed since."""


@contextlib.contextmanager
def atomic_write(path: Path) -> Iterator[IO[bytes]]:
    """A file to write that takes the place of `path` only when the block ends well, after reaching the disk.

    Raises:
      InputError: where the folder or the file cannot be written.
    """
    partial: Path | None = None
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        _sweep(path.parent.resolve())
        # A name of its own, so that two programs that write the same file do not mix: the last one wins, whole.
        handle, name = tempfile.mkstemp(prefix=f".{path.name}.", suffix=".partial", dir=path.parent)
        partial = Path(name)
        with os.fdopen(handle, "wb") as file:
            yield file
            file.flush()
            os.fsync(file.fileno())
        partial.chmod(0o666 & ~_umask())
        partial.replace(path)
    except (OSError, RecursionError) as error:  # Python makes folders in folders by recursion.
        why = getattr(error, "strerror", "too many folders in folders")
        raise InputError(f"{path}: cannot be written ({why}); choose another place") from None
    finally:
        if partial is not None:
            partial.unlink(missing_ok=True)


@functools.cache
def _sweep(folder: Path) -> None:
    """Once in a process: removes what killed programs have left of files that they were writing."""
    for left in folder.glob(".*.????????.partial"):
        with contextlib.suppress(OSError):  # Another program may do the same.
            if time.time() - left.stat().st_mtime > _LONG_AGO:
                left.unlink()


def check_writable(*paths: Path, inputs: Sequence[Path] = ()) -> None:
    """Fails before the work where `atomic_write` would fail after it, or replace what is needed.

    Raises:
      InputError: where a folder or a file cannot be written, or two files or one of the `inputs` have the same name.
    """
    files = [path.resolve() for path in (*inputs, *paths)]
    for i, path in enumerate(paths, len(inputs)):
        if files[i] in files[:i]:
            why = "it is read" if files[i] in files[: len(inputs)] else "two files would have that name"
            raise InputError(f"{paths[i - len(inputs)]}: {why}; choose another name")
        _check_writable(path)


def _check_writable(path: Path) -> None:
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        tempfile.TemporaryFile(dir=path.parent).close()
        if path.is_dir():
            raise IsADirectoryError(errno.EISDIR, "it is a folder")
    except (OSError, RecursionError) as error:  # Python makes folders in folders by recursion.
        why = getattr(error, "strerror", "too many folders in folders")
        raise InputError(f"{path}: cannot be written ({why}); choose another place") from None


def _umask() -> int:
    mask = os.umask(0)
    os.umask(mask)
    return mask


def save_result(path: Path, arrays: Mapping[str, np.ndarray], attributes: Mapping[str, Any]) -> None:
    """Writes arrays and JSON-able attributes, atomically.

    Raises:
      TypeError: for an array of Python objects, which could not be read again.
    """
    # NumPy's own refusal, allow_pickle, is younger than the lowest NumPy here, which keeps it as one more array.
    if objects := [name for name, array in arrays.items() if np.asarray(array).dtype.hasobject]:
        raise TypeError(f"{path}: {', '.join(objects)}: an array of Python objects is not a result")
    whole: dict[str, Any] = {_ATTRIBUTES: np.array(json.dumps(attributes)), **arrays}
    with atomic_write(path) as file:
        np.savez(file, **whole)


def load_result(path: Path) -> tuple[dict[str, np.ndarray], dict[str, Any]]:
    """The arrays and attributes of a result.

    Raises:
      FileNotFoundError: if there is none.
      DamagedFileError: if it is not whole.
    """
    try:
        with path.open("rb") as file, np.load(file, allow_pickle=False) as archive:
            arrays = {name: archive[name] for name in archive.files}
        attributes = json.loads(str(arrays.pop(_ATTRIBUTES)))
        return arrays, dict(attributes.items())
    except FileNotFoundError:
        raise
    except Exception as error:  # A damaged zip file makes its reader fail in more ways than it documents.
        raise DamagedFileError(f"{path}: {' '.join(str(error).split())}") from None


def of_shapes(path: Path, arrays: Mapping[str, np.ndarray], **shapes: tuple[int | None, ...]) -> list[np.ndarray]:
    """The arrays of these names, of a result from `path`; None in a shape is any length.

    Raises:
      DamagedFileError: if one is missing, of another shape, or not of real numbers.
    """
    for name, shape in shapes.items():
        found = arrays.get(name, np.zeros(0, bool))
        fits = len(found.shape) == len(shape) and all(b in (a, None) for a, b in zip(found.shape, shape, strict=True))
        if not fits or found.dtype.kind != "f":
            raise DamagedFileError(f"{path}: {name} are not numbers of shape {list(shape)}")
    return [arrays[name] for name in shapes]


def save_json(path: Path, content: Any) -> None:
    """Writes JSON, atomically. NaN and infinity are refused: they are not JSON."""
    with atomic_write(path) as file:
        file.write((json.dumps(content, indent=2, allow_nan=False) + "\n").encode())
