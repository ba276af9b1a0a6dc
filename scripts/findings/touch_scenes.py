"""The gradient with the jumps of touch-downs on MJX, scene by scene: the second table of `touch.md`.

Scenes, what moves and what is watched: `tests/scenes/touch/scenes.toml`. Over each window, at three time steps, the
mean of both gradients is held against the slope of C MuJoCo's motion. That slope is of least squares: the mean of the
landscape's derivative with weights 1 - (x / half)^2, so the gradients are averaged with these. Leaves
`touch_scenes.csv`; takes a quarter of an hour on one core, most of it to compile.
"""

if __name__ == "__main__":  # Ctrl-C while libraries load, which takes a second or two, leaves no traceback.
    import signal

    if signal.getsignal(signal.SIGINT) is signal.default_int_handler:
        signal.signal(signal.SIGINT, signal.SIG_DFL)

import tomllib
from argparse import ArgumentParser
from collections.abc import Callable
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pandas as pd
from jaxtyping import Array, Float

import tog_mjx as tog
from tog_mjx.checks.step_check import compile_quickly
from tog_mjx.mjcf.scene import compile_model
from tog_mjx.problems.scene_function import SceneFunction
from tog_mjx.running.console import run_main
from tog_mjx.stepping._mjx import put_model
from tog_mjx.stepping.mjx_state import copy_of, on_mjx, state_of

HERE = Path(__file__).parent
FOLDER = HERE.parent.parent / "tests" / "scenes" / "touch"
BARS = {0.0005: 0.95, 0.002: 0.9, 0.005: 0.8}
"""How much of autodiff's error the jumps are to remove, by time step [s]."""
RIGHT = 0.05
"""An error of autodiff, of the slope, of which no share is asked for."""
TIMESTEPS = tuple(BARS)
GRADIENTS = {"autodiff": "implicit", "saltation": "saltation"}
POINTS, VALUES = 128, 1600
"""Gradients and values of C MuJoCo over a window."""
Scene = dict[str, Any]


def main() -> None:
    parser = ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--out", type=Path, default=HERE, metavar="FOLDER")
    args = parser.parse_args()
    found = []
    with jax.enable_x64():
        for scene in scenes():
            found += rows(scene)
            print(page(pd.DataFrame(found[-len(TIMESTEPS) :])), flush=True)
            pd.DataFrame(found).to_csv(args.out / "touch_scenes.csv", index=False, float_format="%.6g")


def page(table: pd.DataFrame) -> str:
    """The rows of the page's table; a star marks what stays below its bar."""
    lines = []
    for row in table.itertuples():
        numbers = " | ".join(f"{number:#.3g}" for number in (row.slope, row.autodiff, row.saltation))
        share = f"{100 * row.removed:.1f} %" + "*" * (row.removed < BARS[row.timestep])
        if abs(row.autodiff - row.slope) <= RIGHT * abs(row.slope):
            share = "-"
        lines.append(f"| {row.scene} | {1e3 * row.timestep:g} ms | {numbers} | {share} |")
    return "\n".join(lines)


def scenes() -> list[Scene]:
    return tomllib.loads((FOLDER / "scenes.toml").read_text())["scene"]


def function_of(scene: Scene, timestep: float = TIMESTEPS[0]) -> SceneFunction:
    """What is watched of a scene, as a function of what moves."""
    model = compile_model(FOLDER / scene["file"])
    model.opt.timestep = timestep
    for name in ("solref", "solimp", "margin", "gap"):
        if name in scene:
            getattr(model, f"geom_{name}")[:] = scene[name]
    if "cone" in scene:
        model.opt.cone = getattr(mujoco.mjtCone, f"mjCONE_{scene['cone'].upper()}")
    start = mujoco.MjData(model)
    mujoco.mj_resetDataKeyframe(model, start, model.key(scene.get("keyframe", "start")).id)
    return SceneFunction(model, start, round(scene["time"] / timestep), scene["wrt"], scene["output"])


def derivatives(function: SceneFunction, differentiation: str) -> Callable:
    """Values [N] and derivatives [N] at points [N], for a time step and a number of steps: compiled once for all."""
    model = put_model(function.model)
    start = on_mjx(model, function.start)

    def value(x: Array, timestep: float, steps: int) -> Array:
        timed = model.replace(opt=model.opt.replace(timestep=timestep))
        placed, data = function.place(timed, start, x[None])

        def advance(_: Array, state: dict) -> dict:
            return state_of(tog.step(placed, data.replace(**state), differentiation=differentiation))

        state = jax.lax.fori_loop(0, steps, advance, state_of(data))
        return function.y.observe(placed, data.replace(**state))[0]

    def each(points: Array, timestep: float, steps: int) -> tuple[Array, Array]:
        return jax.vmap(lambda x: jax.jvp(lambda x: value(x, timestep, steps), (x,), (jnp.ones_like(x),)))(points)

    return compile_quickly(each)


def in_c(function: SceneFunction, points: Float[np.ndarray, " N"]) -> Float[np.ndarray, " N"]:
    """What C MuJoCo says of the same."""
    model, (name, i) = function.model, function.wrt.removesuffix("]").split("[")
    found = []
    for x in points:
        data = copy_of(model, function.start)
        change = np.zeros(model.nv)
        change[int(i)] = x
        if name == "qvel":
            data.qvel += change
        else:
            mujoco.mj_integratePos(model, data.qpos, change, 1)
        mujoco.mj_step(model, data, function.steps)
        mujoco.mj_kinematics(model, data)
        assert isinstance(function.output, str)
        site, axis = function.output.removesuffix("]").split("[")
        found.append(data.site(site).xpos[int(axis)])
    return np.array(found)


def window(half: float, count: int) -> Float[np.ndarray, " count"]:
    """A random point of each of so many parts of it: no phase of the time grid is met more often than others."""
    return half * (2 * (np.arange(count) + np.random.default_rng(0).uniform(size=count)) / count - 1)


def slope(scene: Scene, timestep: float) -> float:
    """Of C MuJoCo's motion over the window."""
    at = window(scene["half"], VALUES)
    return float(np.polyfit(at, in_c(function_of(scene, timestep), at), 1)[0])


def mean(scene: Scene, derivatives: Float[np.ndarray, " N"]) -> float:
    """Of derivatives over the window, as the slope is one."""
    return float(np.average(derivatives, weights=1 - (window(scene["half"], len(derivatives)) / scene["half"]) ** 2))


def rows(scene: Scene) -> list[dict[str, Any]]:
    """For each time step the slope, both means, and how much of autodiff's error the jumps remove."""
    compiled = {name: derivatives(function_of(scene), how) for name, how in GRADIENTS.items()}
    at, found = jnp.asarray(window(scene["half"], POINTS)), []
    for timestep in TIMESTEPS:
        steps = round(scene["time"] / timestep)
        each = {name: np.asarray(function(at, timestep, steps)[1]) for name, function in compiled.items()}
        means = {name: mean(scene, slopes) for name, slopes in each.items()}
        wide = slope(scene, timestep)
        left, before = (abs(means[name] - wide) for name in ("saltation", "autodiff"))
        largest = {f"largest, {name}": np.abs(slopes).max() for name, slopes in each.items()}
        told = {"scene": scene["name"], "timestep": timestep, "slope": wide, **means, "removed": 1 - left / before}
        found.append({**told, **largest})
    return found


if __name__ == "__main__":
    run_main(main)
