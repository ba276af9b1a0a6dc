"""What autodiff loses at touch-downs, and what the derivative of their switch gives back: the numbers of `touch.md`.

Both gradients of J on `penalty`, over the window of each task's landscape (so on the grasp of mirrored setpoints),
against that of J smoothed by normal perturbations: at random setpoints (`touch.csv`, a row each), and along two lines
(`touch_flip.png`, `touch_grasp.png`). Takes a few minutes on two cores; `--figures` makes the figures alone.
"""

if __name__ == "__main__":  # Ctrl-C while libraries load, which takes a second or two, leaves no traceback.
    import signal

    if signal.getsignal(signal.SIGINT) is signal.default_int_handler:
        signal.signal(signal.SIGINT, signal.SIG_DFL)

from argparse import ArgumentParser
from collections.abc import Callable
from pathlib import Path
from typing import Any

import jax
import numpy as np
import pandas as pd
from jaxtyping import Float
from matplotlib import rc_context
from matplotlib.axes import Axes

from tog_mjx.drawing.figures.style import BEST, GUESS, RC, new_figure, save_figure
from tog_mjx.engines import SIMULATORS, precision
from tog_mjx.engines.objective import objective
from tog_mjx.gradients.local import cosine, noise_of_mean, relative_error, zeroth_terms
from tog_mjx.paper.tasks import get_task
from tog_mjx.running.batches import map_points
from tog_mjx.running.console import run_main

HERE = Path(__file__).parent
GRADIENTS = {"autodiff": "native", "saltation": "saltation"}
ON_MJX = "saltation on mjx"
POINTS, PAIRS, SIGMAS = 50, 2**12, (0.001, 0.003, 0.01)
SIGMA = 0.003
"""Of the figures [m]."""
LENGTHS = (0.0003, 0.001, 0.003, 0.01, 0.03)
"""Over which J is smoothed where the box is lifted [m]."""
RESOLVED, FLAT = 0.1, 1e-6
"""A smoothed gradient whose relative standard error is less, and that is longer [1/m], is a reference."""
LIFTING = 46
"""The iteration at which the paper's exact descent of the grasp lifts the box."""
LOOKS: tuple[dict[str, Any], ...] = (
    {"color": "#1b1b1b", "linewidth": 1.6},
    {"color": "#d55e00", "linewidth": 2.2},
    {"color": "#0072b2", "linewidth": 1.6, "linestyle": "--"},
)
Point = Float[np.ndarray, " 2"]


def main() -> None:
    parser = ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--figures", action="store_true", help="the figures alone")
    parser.add_argument("--out", type=Path, default=HERE, metavar="FOLDER")
    args = parser.parse_args()
    with precision("penalty"):
        if not args.figures:
            found = pd.concat([slopes(task, points(task)) for task in ("flip", "grasp")])
            found.to_csv(args.out / "touch.csv", index=False, float_format="%.6g")
            at = lifting_point()[None]
            print(f"iterate {LIFTING} of the grasp {at}: {gradients('grasp', at)}")
            print(f"smoothed over {LENGTHS} m, relative errors: {smoothed('grasp', at, LENGTHS, 4 * PAIRS)}\n")
        table = pd.read_csv(args.out / "touch.csv")
        table_of_page = summary(table)
        table_of_page.to_csv(args.out / "touch_table.csv", index=False, float_format="%.5g")
        print(table_of_page.to_string(index=False))
        print(f"\ngrasp, dJ/dx over 30 cm about {points('grasp')[0]}: {across(points('grasp')[0])}")
        draw_flip(args.out / "touch_flip.png", table)
        draw_grasp(args.out / "touch_grasp.png")


def points(task: str) -> Float[np.ndarray, "N 2"]:
    low, high = np.array(get_task(task).window).T
    return np.random.default_rng(0).uniform(low, high, (POINTS, 2))


def cost(task: str, differentiation: str = "native", simulator: str = "penalty") -> Callable:
    """J of a point of the window."""
    J, expand = objective(task, simulator, differentiation=differentiation), get_task(task).expand
    return lambda point: J(expand(point))


def gradients(task: str, at: Float[np.ndarray, "N 2"]) -> dict[str, Float[np.ndarray, "N 2"]]:
    return {name: map_points(jax.vmap(jax.grad(cost(task, how))), at) for name, how in GRADIENTS.items()}


def gradients_on_mjx(task: str, at: Float[np.ndarray, "N 2"]) -> Float[np.ndarray, "N 2"]:
    # One point at a time: in a batch no step could leave out the work of contacts that do not switch.
    gradient = jax.jit(jax.jacfwd(cost(task, "saltation", "mjx")))
    return np.array([gradient(point) for point in at])


def smoothed(
    task: str, at: Float[np.ndarray, "N 2"], sigmas: tuple[float, ...] = SIGMAS, pairs: int = PAIRS
) -> tuple[Float[np.ndarray, "N S 2"], Float[np.ndarray, "N S"]]:
    """The gradients of J smoothed over each sigma [m], from antithetic pairs, and their relative standard errors.

    The slope of a linear fit has the same mean as the estimate of order zero, and none of its noise where J is linear.
    """
    normals = np.random.default_rng(1).standard_normal((pairs, 2))
    steps = np.array(sigmas)[:, None, None] * normals
    both = at[:, None, None, None] + np.stack([steps, -steps], axis=1)
    found = map_points(jax.vmap(cost(task)), both.reshape(-1, 2), chunk=SIMULATORS["penalty"].CHUNK)
    rises = found.reshape(len(at), len(sigmas), 2, pairs)
    rises = (rises[:, :, 0] - rises[:, :, 1]) / 2
    gradients, noises = np.zeros((*rises.shape[:2], 2)), np.zeros(rises.shape[:2])
    for (i, k), _ in np.ndenumerate(noises):
        fit = np.linalg.lstsq(steps[k], rises[i, k])[0]
        rest = zeroth_terms(rises[i, k] - steps[k] @ fit, normals, sigmas[k])
        gradients[i, k], noises[i, k] = fit, noise_of_mean(fit + rest)
    return gradients, noises


def slopes(task: str, at: Float[np.ndarray, "N 2"]) -> pd.DataFrame:
    """A row each point and sigma: the smoothed gradient with its relative standard error, and the derivatives."""
    found, (truth, noise) = gradients(task, at), smoothed(task, at)
    found[ON_MJX] = gradients_on_mjx(task, at)
    rows = []
    for (i, k), error in np.ndenumerate(noise):
        named = {"smoothed": truth[i, k], **{name: each[i] for name, each in found.items()}}
        parts = {f"{name}, {axis}": g[j] for name, g in named.items() for j, axis in enumerate("xz")}
        rows.append({"task": task, "x": at[i, 0], "z": at[i, 1], "sigma": SIGMAS[k], "noise": error, **parts})
    return pd.DataFrame(rows)


def summary(table: pd.DataFrame) -> pd.DataFrame:
    """Errors of the gradients relative to the smoothed one, where that is resolved."""
    rows = []
    for (task, sigma), all_points in table.groupby(["task", "sigma"]):
        is_steep = np.hypot(all_points["smoothed, x"], all_points["smoothed, z"]) > FLAT
        some = all_points[is_steep & (all_points.noise < RESOLVED)]
        truth = some[["smoothed, x", "smoothed, z"]].to_numpy()
        for name in (*GRADIENTS, ON_MJX):
            g = some[[f"{name}, x", f"{name}, z"]].to_numpy()
            errors = [relative_error(a, b) for a, b in zip(g, truth, strict=True)]
            angles = [cosine(a, b) for a, b in zip(g, truth, strict=True)]
            rows.append(
                {
                    "task": task,
                    "sigma": sigma,
                    "gradient": name,
                    "points": len(some),
                    "noise": some.noise.median(),
                    "error": np.median(errors),
                    "90 %": np.quantile(errors, 0.9),
                    "cosine": np.median(angles),
                    "worst tenth": np.quantile(angles, 0.1),
                    "largest ratio": np.max(np.linalg.norm(g, axis=1) / np.linalg.norm(truth, axis=1)),
                    "largest": np.hypot(all_points[f"{name}, x"], all_points[f"{name}, z"]).max(),
                }
            )
    return pd.DataFrame(rows)


def lifting_point() -> Point:
    """The iterate of the paper's exact descent of the grasp from which it lifts the box, as a point of the window."""
    task = get_task("grasp")
    gradient = jax.jit(jax.grad(objective("grasp", "penalty")))
    u = task.initial_guess
    for _ in range(LIFTING):
        u = u - task.exact.step_size * np.asarray(gradient(u))
    return u[:2]


def across(at: Point, reach: float = 0.15, number: int = 50) -> dict[str, float]:
    """The grasp's slope in x from one end of a line to the other, and the means of both derivatives along it."""
    x = at[0] + reach * np.linspace(-1, 1, number)
    line = np.stack([x, np.full(number, at[1])], axis=1)
    J = map_points(jax.vmap(cost("grasp")), line)
    means = {name: float(g[:, 0].mean()) for name, g in gradients("grasp", line).items()}
    return {"J": float((J[-1] - J[0]) / (2 * reach)), **means}


def draw_flip(path: Path, table: pd.DataFrame) -> None:
    """The flip's landscape where autodiff errs as much as at half of the setpoints, and where it errs most."""
    some = table[(table.task == "flip") & (table.sigma == SIGMA)]
    truth = some[["smoothed, x", "smoothed, z"]].to_numpy()
    errors = np.linalg.norm(some[["autodiff, x", "autodiff, z"]].to_numpy() - truth, axis=1)
    order = np.argsort(errors / np.linalg.norm(truth, axis=1))
    chosen = some[["x", "z"]].to_numpy()[[order[len(order) // 2], order[-1]]]
    with rc_context(RC):
        figure = new_figure(6.4, 2.9)
        panels = figure.subplots(1, 2)
        for axes, at, title in zip(panels, chosen, ("a typical setpoint", "the worst of 50"), strict=True):
            _draw_line(axes, "flip", at, (-0.01, 0.01), 2e-5)
            axes.set_title(title, loc="left")
        panels[0].set_ylabel("J of the flip")
        figure.legend(*axes.get_legend_handles_labels(), loc="outside lower center", ncols=4, frameon=False)
    save_figure(figure, path)


def draw_grasp(path: Path) -> None:
    """The grasp's landscape along the paper's exact descent, where it lifts the box: near, and as far as it steps."""
    at = lifting_point()
    task = get_task("grasp")
    with rc_context(RC):
        figure = new_figure(6.4, 2.9)
        near, far = figure.subplots(1, 2)
        gradient = _draw_line(near, "grasp", at, (-0.002, 0.002), 1e-5)
        # A finger's share of the gradient of mirrored setpoints is half of it.
        step = task.exact.step_size * float(np.linalg.norm(gradient)) / 2
        _draw_line(far, "grasp", at, (-0.02, step), 1e-4)
        after = cost("grasp")(at - step * gradient / np.linalg.norm(gradient))
        far.plot(step * 1e3, after, label=f"iterate {LIFTING + 1}", **BEST, color="#1b1b1b")
        near.set_ylabel("J of the grasp")
        near.set_title(f"iterate {LIFTING} of the exact descent", loc="left")
        far.set_title("as far as its step goes", loc="left")
        figure.legend(*far.get_legend_handles_labels(), loc="outside lower center", ncols=5, frameon=False)
    save_figure(figure, path)


def _draw_line(axes: Axes, task: str, at: Point, reach: tuple[float, float], step: float) -> Point:
    """J along autodiff's way down, every `step` m, and the three slopes at the point; gives autodiff's gradient."""
    found = {name: each[0] for name, each in gradients(task, at[None]).items()}
    slopes = {**found, f"smoothed over {SIGMA * 1e3:.0f} mm": smoothed(task, at[None], (SIGMA,))[0][0, 0]}
    down = -found["autodiff"] / np.linalg.norm(found["autodiff"])
    along = np.arange(*reach, step)
    costs = map_points(jax.vmap(cost(task)), at + along[:, None] * down, chunk=SIMULATORS["penalty"].CHUNK)
    axes.plot(along * 1e3, costs, color="#888888", linewidth=0.8, label="J")
    axes.set_ylim(*axes.get_ylim())
    here = cost(task)(at)
    for (name, slope), look in zip(slopes.items(), LOOKS, strict=True):
        axes.plot(along * 1e3, here + slope @ down * along, label=name, **look)
    axes.plot(0, here, **GUESS | {"label": None, "color": "#1b1b1b", "marker": "o"})
    axes.set_xlabel("along autodiff's descent (mm)")
    return found["autodiff"]


if __name__ == "__main__":
    run_main(main)
