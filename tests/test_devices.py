"""A batch over many devices, in one process and in two: the numbers of one device."""

import os
import socket
import subprocess
import sys

import numpy as np
import pytest

from tog_mjx.paper.tasks import get_task
from tog_mjx.running.batches import CHUNK
from tog_mjx.running.devices import cores
from tog_mjx.studies.landscape import landscape

# The program of every process: a landscape whose points fill no chunk evenly.
PROGRAM = """
import sys, jax, numpy as np
jax.config.update("jax_enable_compilation_cache", False)
address, process, processes, folder = sys.argv[1:5]
if int(processes) > 1:
    jax.distributed.initialize(address, int(processes), int(process))
from pathlib import Path
from tog_mjx.studies.landscape import landscape
from tog_mjx.engines import PenaltySimulator
from tog_mjx.paper.tasks import get_task
PenaltySimulator.CHUNK = 64
said = []
costs = landscape(get_task("flip"), "penalty", get_task("flip").plane, 31, Path(folder) / "kept", said.append).costs
np.savez(Path(folder) / f"process_{process}.npz", costs=costs, said=said, devices=jax.device_count())
"""
POINTS = 31**2


def run(folder, processes: int, devices: int) -> list[dict[str, np.ndarray]]:
    """What each process found. Each has `devices` virtual ones."""
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        address = f"127.0.0.1:{probe.getsockname()[1]}"
    environment = os.environ | {
        "XLA_FLAGS": f"--xla_force_host_platform_device_count={devices}",
        "JAX_PLATFORMS": "cpu",
    }
    started = [
        subprocess.Popen(
            [sys.executable, "-c", PROGRAM, address, str(i), str(processes), str(folder)],
            env=environment,
            stderr=subprocess.PIPE,
            text=True,
        )
        for i in range(processes)
    ]
    complaints = [process.communicate(timeout=300)[1] for process in started]
    assert [process.returncode for process in started] == [0] * processes, complaints
    return [dict(np.load(folder / f"process_{i}.npz")) for i in range(processes)]


@pytest.fixture(scope="module")
def alone(tmp_path_factory) -> np.ndarray:
    """The landscape of this process, which has one device."""
    return landscape(get_task("flip"), "penalty", get_task("flip").plane, 31, tmp_path_factory.mktemp("alone")).costs


@pytest.mark.parametrize(("processes", "devices"), [(1, 8), (2, 2)])
def test_many_devices_give_the_numbers_of_one(tmp_path, alone, processes, devices):
    total = processes * devices
    found = run(tmp_path, processes, devices)
    for one in found:
        assert one["devices"] == total
        np.testing.assert_allclose(one["costs"], alone, rtol=0, atol=1e-12)
        chunks = int(np.ceil(POINTS / (CHUNK * total)))
        size = total * int(np.ceil(POINTS / (chunks * total)))
        np.testing.assert_array_equal(one["said"], np.minimum(size * np.arange(1, chunks + 1), POINTS))
    # What was kept is read by all processes, the second of which could not read it itself.
    again = run(tmp_path, processes, devices)
    for one in again:
        assert one["said"].size == 0
        np.testing.assert_array_equal(one["costs"], found[0]["costs"])


@pytest.mark.parametrize(("jaxlib", "devices"), [("0.10.2", 3), ("0.11.2", 1)])
def test_each_core_is_a_device_also_where_the_system_does_not_tell_which_are_ours(jaxlib, devices):
    """As macOS does not. The jaxlib that crashes on several devices has one."""
    program = f"""
import os
del os.sched_getaffinity
import jax, jaxlib.version
from tog_mjx.running.devices import use_all_cores
jaxlib.version.__version__ = "{jaxlib}"
os.cpu_count = lambda: 3
use_all_cores()
print(jax.local_device_count())
"""
    found = subprocess.run(
        [sys.executable, "-c", program],
        capture_output=True,
        text=True,
        env=os.environ | {"JAX_PLATFORMS": "cpu", "XLA_FLAGS": ""},
    )
    assert found.stdout == f"{devices}\n", found.stderr


def test_cores_are_those_that_this_process_may_use(monkeypatch):
    monkeypatch.setattr(os, "sched_getaffinity", lambda _: {1, 4, 5}, raising=False)
    assert cores() == 3


def test_no_command_starts_jax_before_it_has_set_devices_and_compiler():
    """Afterwards both settings have no effect, and nothing says so: studies once ran on one core of all."""
    program = """
import importlib, sys, jax
from tog_mjx.__main__ import commands
for number, name in enumerate(commands(), 1):
    importlib.import_module(f"tog_mjx.commands.{name}")
    try:
        jax.config.update("jax_num_cpu_devices", number)
    except RuntimeError:
        sys.exit(f"{name} has started JAX")
assert jax.device_count() == number > 1
"""
    found = subprocess.run(
        [sys.executable, "-c", program], capture_output=True, text=True, env=os.environ | {"JAX_PLATFORMS": "cpu"}
    )
    assert found.returncode == 0, found.stderr
