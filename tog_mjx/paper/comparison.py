"""The paper's controlled comparison: exact against stochastic descent, on both tasks, with Table I's settings.

A run is one descent: a simulator, a task, a method and a seed. Its result is a file that is made once, kept, and read
again.
"""

import contextlib
import dataclasses
import itertools
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import Any, NamedTuple

import jax

from tog_mjx.engines import precision
from tog_mjx.engines.objective import objective
from tog_mjx.gradients import exact, stochastic
from tog_mjx.paper.published import published
from tog_mjx.paper.tasks import TASKS, Rule, get_task
from tog_mjx.running.digests import program_digest, scene_digest
from tog_mjx.running.errors import InputError
from tog_mjx.running.storage import DamagedFileError
from tog_mjx.solving.descent import Descent, Status, descend
from tog_mjx.solving.record import load_descent, save_descent

METHODS = ("exact", "stochastic")


@dataclasses.dataclass(frozen=True)
class Run:
    """One descent of the comparison. `iterations` replaces Table I's number where given."""

    simulator: str
    task: str
    method: str
    seed: int = 0
    iterations: int | None = None

    @property
    def rule(self) -> Rule:
        """Table I's row, with the number of iterations that this run asks for."""
        rule: Rule = getattr(get_task(self.task), self.method)
        return rule if self.iterations is None else rule._replace(iterations=self.iterations)

    def path(self, out: Path) -> Path:
        return out / self.simulator / self.task / f"{self.method}.npz"

    def settings(self) -> dict[str, Any]:
        """All that the result depends on: two runs with equal settings are the same run."""
        task = get_task(self.task)
        return {
            "simulator": self.simulator,
            "task": self.task,
            "method": self.method,
            "seed": self.seed if self.method == "stochastic" else None,
            **self.rule._asdict(),
            "steps": task.steps,
            "scene": scene_digest(task.scene.model),
            "program": program_digest(__name__),
            "precision": "float32" if self.simulator == "released" else "float64",
        }


def compute(run: Run, report: Callable[[int], None] | None = None) -> Descent:
    """Descends. `report` is called with the number of iterates evaluated so far.

    The released program is run as it was: float32, and JAX's former stream of random numbers. The others run in
    float64.
    """
    rule, task = run.rule, get_task(run.task)
    with _conditions(run.simulator):
        cost = objective(task, run.simulator)
        is_exact = run.method == "exact"
        return descend(
            exact(cost) if is_exact else stochastic(cost, rule.sigma),
            task.initial_guess,
            step_size=rule.step_size,
            iterations=rule.iterations,
            key=jax.random.key(run.seed),
            tolerance=0.0 if is_exact else None,
            report=report,
        )


def save(run: Run, descent: Descent, out: Path) -> None:
    """Writes a run's result."""
    save_descent(run.path(out), descent, run.settings())


def load(run: Run, out: Path) -> Descent:
    """Reads a run's result.

    Raises:
      FileNotFoundError, DamagedFileError: if there is none, or not a whole one.
      InputError: if the file holds the result of other settings.
    """
    descent, settings = load_descent(run.path(out))
    for name, wanted in run.settings().items():
        if settings.get(name) != wanted:
            is_digest = name in ("scene", "program")
            found = f"another version of the {name}" if is_digest else f"{name} {settings.get(name)}, not {wanted}"
            raise InputError(f"{run.path(out)} was made with {found}; choose another --out, or --force to replace it")
    wanted, is_whole = run.rule.iterations, descent.status != Status.EXHAUSTED
    if not (descent.iterations == wanted or (is_whole and descent.iterations < wanted)):
        raise DamagedFileError(f"{run.path(out)}: {descent.iterations} iterations, not {wanted}")
    if descent.setpoints.shape[1] != (size := get_task(run.task).initial_guess.size):
        raise DamagedFileError(f"{run.path(out)}: {descent.setpoints.shape[1]} setpoints, not {size}")
    return descent


def load_all(runs: Iterable[Run], out: Path) -> dict[Run, Descent]:
    """Reads the results of runs that were finished a moment ago.

    Raises:
      InputError: if one of them is gone, or is of other settings.
    """
    try:
        return {run: load(run, out) for run in runs}
    except (FileNotFoundError, DamagedFileError) as error:
        raise InputError(
            f"{out} has changed while this ran ({error}); the same command makes what is missing"
        ) from None


def summarise(run: Run, descent: Descent) -> dict[str, Any]:
    """One entry of summary.json."""
    best = descent.best_iteration
    return {
        "simulator": run.simulator,
        "task": run.task,
        "method": run.method,
        "iterations": descent.iterations,
        "cost_first": float(descent.costs[0]),
        "cost_last": float(descent.costs[-1]),
        "cost_best": float(descent.costs[best]),
        "best_iteration": best,
        "setpoints_best": descent.best.tolist(),
        "status": descent.status.value,
        "seconds_compile": descent.seconds_compile,
        "seconds_run": descent.seconds_run,
    }


class Row(NamedTuple):
    """Costs of the first, last and best iterate of a descent; `source` is "published" or a simulator."""

    task: str
    method: str
    source: str
    costs: tuple[float, float, float]
    best_at: str

    @property
    def descent(self) -> str:
        return f"{self.task} {self.method}"


def table_rows(descents: Mapping[Run, Descent]) -> list[Row]:
    """These runs beside the published numbers, grouped by task and method, the published ones first."""
    rows = []
    for task, method in dict.fromkeys((run.task, run.method) for run in descents):
        known = published(task, method)
        at = f"{known.costs.argmin() if known.costs.size else '?'} of {known.iterations}"
        rows.append(Row(task, method, "published", (known.cost_first, known.cost_last, known.cost_best), at))
        for run, descent in descents.items():
            if (run.task, run.method) == (task, method):
                costs = float(descent.costs[0]), float(descent.costs[-1]), float(descent.costs.min())
                at = f"{descent.best_iteration} of {descent.iterations}"
                rows.append(Row(task, method, run.simulator, costs, at))
    return rows


@contextlib.contextmanager
def _conditions(simulator: str):
    """The precision and the random stream of a simulator's runs; JAX's settings are restored afterwards."""
    with contextlib.ExitStack() as stack:
        stack.enter_context(precision(simulator))
        if simulator == "released":
            stack.enter_context(jax.threefry_partitionable(False))
        yield


def all_runs(
    simulators: list[str], tasks: list[str], methods: list[str], seed: int = 0, iterations: int | None = None
) -> list[Run]:
    """Every combination, once, the quick simulators first."""
    quick_first = ("released", "penalty", "mjx")
    chosen = itertools.product(quick_first, TASKS, METHODS)
    return [
        Run(simulator, task, method, seed, iterations)
        for simulator, task, method in chosen
        if simulator in simulators and task in tasks and method in methods
    ]
