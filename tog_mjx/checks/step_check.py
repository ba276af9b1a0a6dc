"""Is the derivative of one step right? Any MJCF scene, at one state, against differences of stock `mjx.step`.

The derivative is that of the next (qpos, qvel, act) in n numbers: (qpos, qvel, act, ctrl), and one number for each
array of floats of the model (masses, sizes, friction coefficients, solref, ...), which moves it along a fixed random
direction. Nothing of this package is in the reference.
"""

import functools
from collections.abc import Callable
from typing import NamedTuple

import jax
import jax.flatten_util
import jax.numpy as jnp
import mujoco
import numpy as np
from jaxtyping import Array, Float

from tog_mjx.gradients.differences import halvings, settled_differences
from tog_mjx.gradients.reversible import unless_refused
from tog_mjx.running.errors import InputError
from tog_mjx.stepping._mjx import mjx, put_model
from tog_mjx.stepping.implicit import STEPS
from tog_mjx.stepping.mjx_state import MOVING, default_start, on_mjx

TOLERANCE = 1e-6
"""Of the error of a derivative, relative to the largest entry of its column."""
_STEPS = halvings(2e-4, 10)
_SHORT, _BEND = 1e-6, 1e-3
"""Steps, and what the slopes to either side may differ by as the step goes to zero: by more, and there is a kink."""
_METHODS: dict[str, tuple[str, Callable, int | None]] = {
    "implicit, forward": ("implicit", jax.jacfwd, None),
    "implicit, reverse": ("implicit", jax.jacrev, None),
    "native, forward": ("native", jax.jacfwd, None),
    "native, reverse": ("native", jax.jacrev, None),
    "native, reverse, 1 iteration": ("native", jax.jacrev, 1),
}
METHODS = tuple(_METHODS)
_ORDERS: dict[str, tuple[Callable, Callable]] = {
    "forward over forward": (jax.jacfwd, jax.jacfwd),
    "forward over reverse": (jax.jacfwd, jax.jacrev),
    "reverse over forward": (jax.jacrev, jax.jacfwd),
}
ORDERS = tuple(_ORDERS)
"""Of modes, for second derivatives."""


class Verdict(NamedTuple):
    """`word` is right, wrong, NaN or error; `error` the largest relative error of a finite column, where there is one.

    NaN means a column of the state or the controls. `nan` names the model's parameters whose columns alone are NaN,
    `kinks` the numbers in which the state is at a kink, so that there is nothing to compare with.
    """

    word: str
    error: float | None = None
    nan: tuple[str, ...] = ()
    kinks: tuple[str, ...] = ()


class StepFunction(NamedTuple):
    """One step of a scene as a function x [n] -> [m] of the state, the controls and the model's parameters.

    `names` [n] says what each number is, states and controls with their index in brackets. `after(step, x)` takes
    either `step`.
    """

    names: list[str]
    x: Float[Array, " n"]
    after: Callable[[Callable, Array], Array]


def require_joints(model: mujoco.MjModel, what: str) -> None:
    """Raises InputError, of `what`, for a model in which nothing moves."""
    if not model.nv:
        raise InputError(f"{what} has no joints: nothing moves in it, and there is no derivative to check")


def step_function(model: mujoco.MjModel, iterations: int | None = None, parameters: bool = True) -> StepFunction:
    """The step of `model` at its `tog_mjx.stepping.mjx_state.default_start`; `iterations` replaces the solver's number.

    Without `parameters` it is one of the state and the controls alone.
    """
    require_joints(model, "the scene")
    mjx_model = put_model(model)
    if iterations is not None:
        mjx_model = mjx_model.replace(opt=mjx_model.opt.replace(iterations=iterations))
    start = on_mjx(mjx_model, default_start(model))
    state = {name: getattr(start, name) for name in (*MOVING, "ctrl")}
    leaves, tree = jax.tree_util.tree_flatten_with_path(mjx_model)
    moving = [i for i, (_, leaf) in enumerate(leaves) if parameters and leaf.size and leaf.dtype == jnp.zeros(0).dtype]
    rng = np.random.default_rng(0)
    directions = [_direction(leaves[i][1], rng) for i in moving]
    x, unravel = jax.flatten_util.ravel_pytree((state, jnp.zeros(len(moving))))

    def after(step: Callable, x: Array) -> Array:
        state, parameters = unravel(x)
        values = [leaf for _, leaf in leaves]
        for k, i in enumerate(moving):
            values[i] = values[i] + parameters[k] * directions[k]
        moved = jax.tree.unflatten(tree, values)
        data = step(moved, start.replace(**state))
        return jnp.concatenate([data.qpos, data.qvel, data.act])

    names = [f"{name}[{i}]" for name in sorted(state) for i in range(state[name].size)]
    names += [jax.tree_util.keystr(leaves[i][0], simple=True, separator=".") for i in moving]
    return StepFunction(names, x, after)


def _direction(leaf: Array, rng: np.random.Generator) -> np.ndarray:
    """Relative where the model gives a number, and absolute where it gives zero."""
    value = np.asarray(leaf)
    return np.asarray(rng.uniform(0.5, 1.5, value.shape) * np.where(value == 0, 0.1, value))


def reference(function: StepFunction) -> tuple[np.ndarray, np.ndarray]:
    """The value [m] of stock `mjx.step` and its Jacobian [m, n], by differences of fourth order.

    Columns are NaN in which the state is at a kink: the differences to either side disagree, and neither is right.
    """
    values = compile_quickly(jax.vmap(functools.partial(function.after, mjx.step)))
    # Each column has a step of its own: a problem in one number, of which two points are asked for at a time.
    directions = np.repeat(np.eye(function.x.size), 2, axis=0)
    columns = settled_differences(
        lambda t: values(function.x + t * directions), np.zeros((function.x.size, 1)), _STEPS, order=4
    )
    jacobian, value = columns.jacobian[:, :, 0].T, np.asarray(values(function.x + 0 * directions)[0])

    def bend(h: float) -> np.ndarray:
        """The slope ahead minus the slope behind, of each column: it shrinks with h, but for a kink."""
        signs = np.resize([[h], [-h]], (len(directions), 1))
        found = np.asarray(values(function.x + signs * directions))
        return (found[::2] - 2 * value + found[1::2]).T / h

    kink = np.abs(2 * bend(_SHORT / 2) - bend(_SHORT)).max(0)
    jacobian[:, kink > _BEND * _scale(jacobian)] = np.nan
    return value, jacobian


def check_step(
    model: mujoco.MjModel, methods: tuple[str, ...] = METHODS, report: Callable[[int], None] = lambda _: None
) -> dict[str, Verdict]:
    """Whether the derivative of one step is right, by method. Run it in float64.

    `report` is called with the number of methods done.

    Raises:
      InputError: for a state from which the step itself is not finite.
    """
    value, expected = reference(step_function(model))
    if not np.isfinite(value).all():
        raise InputError(
            "a step of mjx.step is not finite here, so there is no derivative to check; choose another state"
        )
    verdicts = {}
    for i, method in enumerate(methods):
        report(i)
        verdicts[method] = judge(model, method, expected)
    return verdicts


def judge(model: mujoco.MjModel, method: str, expected: Float[np.ndarray, "m n"]) -> Verdict:
    """The verdict on one method of `METHODS`, given the Jacobian expected."""
    differentiation, jacobian, iterations = _METHODS[method]
    function = step_function(model, iterations)
    derivative = compile_quickly(jacobian(functools.partial(function.after, STEPS[differentiation])))
    if (found := unless_refused(lambda: np.asarray(derivative(function.x)))) is None:
        return Verdict("error")
    is_finite = np.isfinite(found).all(0)
    nan = tuple(name for name, finite in zip(function.names, is_finite, strict=True) if not finite)
    if any("[" in name for name in nan):
        return Verdict("NaN")
    is_known = np.isfinite(expected).all(0)
    kinks = tuple(name for name, known in zip(function.names, is_known, strict=True) if not known)
    error = float(column_errors(found, expected)[is_finite & is_known].max())
    return Verdict("right" if error <= TOLERANCE else "wrong", error, nan, kinks)


def check_second_order(model: mujoco.MjModel, orders: tuple[str, ...] = ORDERS) -> dict[str, float]:
    """The largest error of the Hessian of one `tog.step`, by order of modes, relative to its largest entry.

    It is that of a fixed random sum of the next state, in the state and the controls, against differences of its
    gradient; the Hessian's distance from its own transpose counts as error too. Run it in float64.
    """
    function = step_function(model, parameters=False)
    weights = jnp.asarray(np.random.default_rng(0).normal(size=model.nq + model.nv + model.na))

    def number(x: Array) -> Array:
        return weights @ function.after(STEPS["implicit"], x)

    gradients = compile_quickly(jax.vmap(jax.jacfwd(number)))
    differences = settled_differences(
        lambda points: np.asarray(gradients(jnp.asarray(points))), np.asarray(function.x)[None], _STEPS, order=4
    )
    expected, errors = differences.jacobian[0], {}
    for order in orders:
        outer, inner = _ORDERS[order]
        found = np.asarray(compile_quickly(outer(inner(number)))(function.x))
        errors[order] = float(
            max(np.abs(found - other).max() for other in (expected, found.T)) / np.abs(expected).max()
        )
    return errors


def compile_quickly(function: Callable) -> jax.stages.Wrapped:
    """`jax.jit` of what runs only a few times: with little of LLVM's optimisation, which takes longer than it saves.

    With none (level 0) a second derivative of `tests/scenes/sliding_block.xml` comes out 64 % too large, on jaxlib
    0.10.2; with level 1, 2 and 3 it is right.
    """
    is_cpu = jax.default_backend() == "cpu"  # Elsewhere it is another compiler's.
    return jax.jit(function, compiler_options={"xla_backend_optimization_level": 1} if is_cpu else None)


def column_errors(found: Float[np.ndarray, "m n"], expected: Float[np.ndarray, "m n"]) -> Float[np.ndarray, " n"]:
    """The largest error of each column, relative to its largest entry, but to no less than 1e-4 of the Jacobian's."""
    return np.abs(found - expected).max(0) / _scale(expected)


def _scale(jacobian: Float[np.ndarray, "m n"]) -> Float[np.ndarray, " n"]:
    scale = np.abs(jacobian).max(0)
    return np.maximum(scale, 1e-4 * np.nanmax(scale))
