"""Whether exact descent keeps the grasp's symmetry, or only begins with it.

u = (x1, z1, x2, z2) is symmetric where finger 2 is the mirror image of finger 1: x1 = -x2 and z1 = z2. There the
gradient of J is symmetric too, so exact descent stays symmetric but for rounding. Whether that is worth anything is
a matter of stability: to first order an antisymmetric error e becomes (I - alpha H_a) e in one plain update, where H_a
is the Hessian of J restricted to antisymmetric changes of u. That holds as long as e crosses none of the jumps of J.
"""

import dataclasses
import functools
from collections.abc import Callable, Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pandas as pd
from jaxtyping import Array, Float

from tog_mjx.engines import SIMULATORS, precision
from tog_mjx.engines.objective import objective
from tog_mjx.gradients import Objective
from tog_mjx.paper.tasks import get_task
from tog_mjx.running.digests import made_with
from tog_mjx.solving.methods import traces
from tog_mjx.solving.solve import step_size
from tog_mjx.studies.study import Store

ANTISYMMETRIC = np.array([[1.0, 0.0, 1.0, 0.0], [0.0, 1.0, 0.0, -1.0]]) / np.sqrt(2)
"""Orthonormal rows: both fingers to the same side; one up and the other down."""
UPDATES = 52
"""Of the plain rule: the exact descent is at its best at 50 and lost at 52."""
BROKEN = 0.01
"""Antisymmetric part, in m, from which on symmetry counts as lost."""
SIZES, QUICK_SIZES = (1e-8, 1e-7, 1e-6, 1e-5, 1e-4, 1e-3, 1e-2), (1e-8, 1e-2)
LISTED = (10, 20, 40, 50)
"""Iterations whose growth the summary gives."""

Points = Float[np.ndarray, "N n"]
Basis = Float[np.ndarray, "k n"]
Matrices = Float[np.ndarray, "N k k"]


def hessians(J: Objective, points: Points, basis: Basis) -> Matrices:
    """The Hessian of J along the rows of `basis` at each point, by forward mode through forward mode."""

    def at(u: Float[Array, " n"]) -> Float[Array, "k k"]:
        return jax.jacfwd(jax.jacfwd(lambda s: J(u + s @ basis)))(jnp.zeros(len(basis)))

    return np.asarray(jax.jit(jax.vmap(at))(points))


def differenced_hessians(J: Objective, points: Points, basis: Basis, steps: Sequence[float]) -> list[Matrices]:
    """The same by central differences of the exact gradient, once for each step (in the units of u)."""
    slope = jax.vmap(lambda u: jax.jacfwd(lambda s: J(u + s @ basis))(jnp.zeros(len(basis))))

    def at(u: Float[Array, " n"], step: Float[Array, ""]) -> Float[Array, "k k"]:
        return (slope(u + step * basis) - slope(u - step * basis)) / (2 * step)

    batch = jax.jit(jax.vmap(at, (0, None)))
    return [np.asarray(batch(points, jnp.array(step))) for step in steps]


def predicted_growth(matrices: Matrices, step: float, direction: Float[np.ndarray, " k"]) -> Float[np.ndarray, " N"]:
    """Norm of an error of that direction at each iterate over the first one's, to first order."""
    norms, error = [], direction / np.linalg.norm(direction)
    for matrix in matrices:
        norms.append(np.linalg.norm(error))
        error = error - step * matrix @ error
    return np.array(norms)


def curvatures(matrices: Matrices) -> tuple[Float[np.ndarray, " N"], Float[np.ndarray, " N"]]:
    """The least and the greatest eigenvalue of each."""
    values = np.linalg.eigvalsh((matrices + matrices.swapaxes(1, 2)) / 2)
    return values[:, 0], values[:, -1]


def worst_factor(matrices: Matrices, step: float) -> Float[np.ndarray, " N"]:
    """The largest |1 - alpha lambda| of each matrix."""
    return np.maximum(*(np.abs(1 - step * value) for value in curvatures(matrices)))


@dataclasses.dataclass(frozen=True)
class Asymmetry:
    """Implements `Study`. A row each size and direction of the guess's error, update rule and iteration."""

    question: str = "How does an antisymmetric error of the grasp's guess grow?"

    def run(self, quick: bool, store: Store, piece: Callable) -> pd.DataFrame:
        members = [(0.0, "none"), *((size, name) for size in (QUICK_SIZES if quick else SIZES) for name in "xz")]
        task, charge = get_task("grasp"), SIMULATORS["penalty"].GRADIENT_CHARGE
        along = {"none": np.zeros(4), "x": ANTISYMMETRIC[0], "z": ANTISYMMETRIC[1]}
        guesses = task.initial_guess + np.array([size * along[name] for size, name in members])
        updates = int(get_task("grasp").budget / charge) - 1
        rules = {"plain": ("exact, plain", task.exact.step_size, UPDATES)}
        rules["solve"] = ("solve", step_size(task, updates + 1), updates)
        settings = {"guesses": guesses.tolist(), "rules": rules, **made_with(task.scene.model, __name__)}
        tables = []
        with precision("penalty"):
            J = objective(task, "penalty")
            for rule, (method, step, number) in rules.items():
                with piece(f"grasp penalty, {rule}", number) as report:
                    make = functools.partial(traces, J, method, step, 0.0, guesses, number)
                    shapes = {"costs": (len(guesses), number + 1), "iterates": (len(guesses), number + 1, 4)}
                    found = store.finish_part(f"asymmetry_{rule}", settings, make, shapes)
                    report(number)
                table = _rows(members, **found).assign(rule=rule)
                if rule == "plain":
                    points = found["iterates"][0]
                    with piece("grasp penalty, Hessians", len(points)) as report:
                        predicted = store.finish_table(
                            "asymmetry_hessians", settings, functools.partial(_predictions, J, points, step)
                        )
                        table = table.merge(predicted, on=["direction", "iteration"])
                        report(len(points))
                tables.append(table)
        return pd.concat(tables, ignore_index=True)

    def summary(self, table: pd.DataFrame) -> pd.DataFrame:
        """One row each rule, size and direction: when symmetry is lost, what is found, and the growth of the error."""
        found = [
            {**dict(zip(("rule", "size", "direction"), group, strict=True)), **_outcome(rows)}
            for group, rows in table.groupby(["rule", "size", "direction"], sort=False)
        ]
        return pd.DataFrame(found)


def _rows(members: list[tuple[float, str]], costs: np.ndarray, iterates: np.ndarray) -> pd.DataFrame:
    """One row each member and iteration. Growth is observed where there was an error to grow."""
    parts = np.linalg.norm(iterates @ ANTISYMMETRIC.T, axis=2)
    tables = []
    for (size, direction), cost, part in zip(members, costs, parts, strict=True):
        table = pd.DataFrame({"iteration": np.arange(len(cost)), "J": cost, "antisymmetric": part})
        observed = part / part[0] if size else np.nan
        tables.append(table.assign(size=size, direction=direction, observed=observed))
    return pd.concat(tables, ignore_index=True)


def _predictions(J: Objective, points: Points, step: float) -> pd.DataFrame:
    """By direction and iteration: growth to first order, the worst factor of the update, the curvatures of J, and how
    far its Hessian is from central differences over 1 um and 0.1 mm, relative to its norm: longer ones see jumps."""
    found = hessians(J, points, ANTISYMMETRIC)
    size = np.linalg.norm(found, axis=(1, 2))
    steps = {"apart 1e-6": 1e-6, "apart 1e-4": 1e-4}
    others = differenced_hessians(J, points, ANTISYMMETRIC, list(steps.values()))
    shared = {name: np.linalg.norm(found - x, axis=(1, 2)) / size for name, x in zip(steps, others, strict=True)}
    shared |= {"iteration": np.arange(len(points)), "worst": worst_factor(found, step)}
    shared |= dict(zip(("least", "greatest"), curvatures(found), strict=True))
    growth = {
        "none": np.full(len(points), np.nan),
        **{name: predicted_growth(found, step, np.eye(2)[i]) for i, name in enumerate("xz")},
    }
    return pd.concat([pd.DataFrame({**shared, "direction": name, "predicted": x}) for name, x in growth.items()])


def _outcome(rows: pd.DataFrame) -> dict[str, Any]:
    rows = rows.set_index("iteration")
    lost = rows.index[rows.antisymmetric > BROKEN]
    growth = {
        f"{name} {k}": rows[name].get(k, np.nan) for k in LISTED for name in ("predicted", "observed") if name in rows
    }
    return {
        "lost at": float(lost[0]) if len(lost) else np.nan,
        "cm, most": 100 * rows.antisymmetric.max(),
        "cm, last": 100 * rows.antisymmetric.iloc[-1],
        "J best": rows.J.min(),
        "J last": rows.J.iloc[-1],
        **growth,
    }
