"""A batch over all devices: of this process, and of the others where `jax.distributed` has joined several.

Each device gets an equal part of a batch and works through it alone (SPMD); only results travel. So a solver's loop on
one device never waits for another. There is no scheduler here: processes are started by whatever starts them.
"""

import contextlib
import os
from collections.abc import Callable
from typing import Any

import jax
import jaxlib.version
import numpy as np
from jax.experimental import multihost_utils
from jax.sharding import Mesh, NamedSharding, PartitionSpec

_AXIS = "points"
_CRASH_ON_MANY = ("0.11.2",)
"""Versions of jaxlib that crash as they compile a batch of MJX for several devices of a CPU."""


def cores() -> int:
    """Those that this process may use, where the system tells (macOS does not), else those of the machine."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def use_all_cores() -> None:
    """Makes each core of this machine a device of JAX's CPU backend, unless somebody chose a number of devices, or
    jaxlib crashes on several.

    Without effect once JAX has started.
    """
    is_chosen = jax.config.values["jax_num_cpu_devices"] > 0 or "host_platform_device_count" in os.environ.get(
        "XLA_FLAGS", ""
    )
    if not is_chosen and jaxlib.version.__version__ not in _CRASH_ON_MANY:
        with contextlib.suppress(RuntimeError):
            jax.config.update("jax_num_cpu_devices", cores())


def over_devices(function: Callable) -> Callable[[Any], Any]:
    """`function` of a batch, compiled, each device with its part: NumPy arrays to NumPy arrays, or pytrees of them.

    Arguments and results have the batch as their leading axis, and rows must not depend on each other. The length of
    the batch must be a multiple of `jax.device_count()`. With several processes, each must call it with the same batch,
    and each gets all results.
    """
    mesh = Mesh(np.array(jax.devices()), (_AXIS,))
    split = PartitionSpec(_AXIS)
    # A loop whose length depends on the data is beyond the check that every device agrees on what is replicated.
    parts = jax.shard_map(function, mesh=mesh, in_specs=split, out_specs=split, check_vma=False)
    run = jax.jit(parts)

    def place(values: np.ndarray) -> jax.Array:
        values = np.asarray(values, jax.dtypes.canonicalize_dtype(values.dtype))
        return jax.make_array_from_callback(values.shape, NamedSharding(mesh, split), values.__getitem__)

    return lambda batch: jax.tree.map(_gather, run(jax.tree.map(place, batch)))


def agree(values: np.ndarray | None, shape: tuple[int, ...], dtype: Any) -> np.ndarray:
    """The values [N, *shape] that the first process has, on every process; None stands for N = 0."""
    none = np.zeros((0, *shape), dtype)
    values = none if values is None else values
    if jax.process_count() == 1:
        return values
    count = int(multihost_utils.broadcast_one_to_all(np.array(len(values))))
    if jax.process_index() or count == 0:
        values = np.zeros((count, *shape), dtype)
    return np.asarray(multihost_utils.broadcast_one_to_all(values)) if count else values


def is_first_process() -> bool:
    """Of several processes one writes files."""
    return jax.process_index() == 0


def _gather(values: jax.Array) -> np.ndarray:
    if jax.process_count() == 1:
        return np.asarray(values)
    return np.asarray(multihost_utils.process_allgather(values, tiled=True))
