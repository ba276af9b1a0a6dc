"""Shared by all tests: float64, the compilation cache, and each simulator compiled once.

Compilation is what these tests cost. A compiled function takes the simulator as an argument, so that switching a
physical parameter does not compile again, and always the same number of setpoints.
"""

import contextlib
import gc
import io
import runpy
import signal
import sys
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest
from hypothesis import HealthCheck, settings
from states import state_of_box
from xdist.scheduler import LoadScopeScheduling

from tog_mjx.__main__ import main
from tog_mjx.engines import Simulator
from tog_mjx.engines.objective import final_cost, trajectory
from tog_mjx.engines.program import Motion
from tog_mjx.paper.tasks import Task, get_task
from tog_mjx.running import console
from tog_mjx.running.console import enable_compilation_cache
from tog_mjx.running.xla_flags import tune_compiler

jax.config.update("jax_enable_x64", True)
jax.config.update("jax_num_cpu_devices", 1)  # Whichever script a test starts first.
enable_compilation_cache()
tune_compiler()  # As scripts do, and so is the collector of garbage set.
gc.set_threshold(100_000)
# The first example of a test compiles; a machine's speed is no property of the code.
settings.register_profile("tog_mjx", deadline=None, derandomize=True, suppress_health_check=[HealthCheck.too_slow])
settings.load_profile("tog_mjx")

if signal.getsignal(signal.SIGINT) == signal.SIG_IGN:  # As in a shell's background job: scripts would inherit it.
    signal.signal(signal.SIGINT, signal.default_int_handler)

POINTS = 64
TOGETHER = ("test_agreement", "test_mjx", "test_released")
"""Files whose tests share `compiled`."""
ALONE = ("test_check_scene", "test_features")
"""Files whose tests share nothing that is compiled."""
LONGEST = (*TOGETHER, *ALONE, "test_penalty", "test_check_function", "test_random_states")
"""Files that begin first, so that all processes end together."""


class Groups(LoadScopeScheduling):
    """Tests that share what is compiled run in one process: those of a file, or of several."""

    def _split_scope(self, nodeid: str) -> str:
        name = Path(nodeid.partition("::")[0]).stem
        return nodeid if name in ALONE else TOGETHER[0] if name in TOGETHER else name


def pytest_xdist_make_scheduler(config: pytest.Config, log) -> LoadScopeScheduling:
    return Groups(config, log)


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    items.sort(key=lambda item: LONGEST.index(item.path.stem) if item.path.stem in LONGEST else len(LONGEST))


class Compiled(NamedTuple):
    """A task, random setpoints [POINTS, 2F] of its landscape window, and its functions of (simulator, setpoints)."""

    task: Task
    setpoints: jax.Array
    motions: Callable[[Simulator, jax.Array], Motion]
    gradients: Callable[[Simulator, jax.Array], jax.Array]


@pytest.fixture(scope="session", params=["flip", "grasp"])
def compiled(request) -> Compiled:
    task = get_task(request.param)
    low, high = np.array(task.window).T
    points = np.random.default_rng(20).uniform(low, high, (POINTS, 2))

    def gradient(simulator: Simulator, u: jax.Array) -> jax.Array:
        return jax.jacfwd(lambda u: final_cost(task, simulator, u))(u)

    return Compiled(
        task,
        jnp.array([task.expand(point) for point in jnp.array(points)]),
        jax.jit(jax.vmap(lambda simulator, u: trajectory(task, simulator, u), (None, 0))),
        jax.jit(jax.vmap(gradient, (None, 0))),
    )


@pytest.fixture(scope="session")
def run_script() -> Callable[..., tuple[int, str, str]]:
    """Runs a script of the project, or `tog`, in this process: name, arguments -> (status, standard output, error)."""

    def run(name: str, *arguments) -> tuple[int, str, str]:
        path = Path(__file__).parent.parent / "scripts" / name
        said, complaint, status = io.StringIO(), io.StringIO(), 0
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(sys, "argv", [str(path), *map(str, arguments)])
            patch.setattr(console, "_leave", sys.exit)  # This process goes on.
            before = signal.getsignal(signal.SIGINT)
            with contextlib.redirect_stdout(said), contextlib.redirect_stderr(complaint):
                try:
                    main() if name == "tog" else runpy.run_path(str(path), run_name="__main__")
                except SystemExit as end:
                    status = int(end.code or 0)
                finally:
                    signal.signal(signal.SIGINT, before)
        return status, said.getvalue(), complaint.getvalue()

    return run


def simulate_in_c(task: Task, u: np.ndarray, model: mujoco.MjModel | None = None) -> tuple[np.ndarray, np.ndarray]:
    """Positions and velocities [T, 3 + 2F] of C MuJoCo, in the order of `Scene.joints`."""
    model = model or task.scene.model
    data = mujoco.MjData(model)
    data.ctrl[task.scene.actuators] = u
    states = [(data.qpos.copy(), data.qvel.copy())]
    for _ in range(task.steps):
        mujoco.mj_step(model, data)
        states.append((data.qpos.copy(), data.qvel.copy()))
    positions, velocities = (np.array(x)[:, task.scene.joints] for x in zip(*states, strict=True))
    return positions, velocities


def cost_in_c(task: Task, u: np.ndarray) -> float:
    """J of C MuJoCo."""
    positions, velocities = simulate_in_c(task, u)
    return float(task.cost(state_of_box(task, [*positions[-1, :3], *velocities[-1, :3]])))


def positions(motion: Motion) -> np.ndarray:
    """Box (x, z) and fingers (x, z) of a batch of motions: [batch, T, 2 + 2F]."""
    fingers = motion.fingers[..., :2]
    return np.concatenate([motion.box[..., :2], fingers.reshape(*fingers.shape[:2], -1)], axis=-1)
