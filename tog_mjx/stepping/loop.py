"""The loop over time steps, under controls that are constant, known beforehand, or an answer to the state."""

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

Now = tuple[Any, Float[Array, " nu"]]
"""What a step carries on, and the controls in force."""
Step = Callable[[Any, Array], tuple[Any, Any]]
Law = Callable[[Any, Array], Array]


def run(
    step: Step, controls: Array | Law, now: Now, steps: int, every: int = 1, checkpoint: int | None = None
) -> tuple[Now, Any]:
    """The last moment, and what the steps returned, with a leading axis [steps].

    Args:
      step: `(carry, controls [nu]) -> (carry, what is to be kept)`.
      controls: constant [nu]; one row a step [steps, nu]; or a law `(carry, controls so far) -> controls`, which is
        asked every so many steps.
      checkpoint: with it reverse mode keeps one moment in so many, and computes the others again; a divisor of the
        steps, and a multiple of `every`.
    """
    rows = None if callable(controls) or controls.ndim == 1 else controls

    def advance(now: Now, row: Array | None) -> tuple[Now, Any]:
        ctrl = controls(*now) if callable(controls) else controls if row is None else row
        carry, seen = step(now[0], ctrl)
        return (carry, ctrl), seen

    if not callable(controls) or every == 1:
        return _scan(advance, now, rows, steps, checkpoint)
    law = controls

    def period(now: Now, length: int) -> tuple[Now, Any]:
        ctrl = law(*now)
        carry, seen = jax.lax.scan(lambda carry, _: step(carry, ctrl), now[0], length=length)
        return (carry, ctrl), seen

    return _periods(period, now, steps, every, checkpoint)


def run_stretches(
    stretch: Step, controls: Array | Law, now: Now, steps: int, every: int = 1, checkpoint: int | None = None
) -> tuple[Now, Any]:
    """As `run`, of what takes many steps at once: `stretch(carry, rows [k, nu]) -> (carry, what is to be kept [k])`.

    A stretch is the whole motion under controls known beforehand, or what lies between two checkpoints, and the steps
    for which a law's answer is held.
    """

    def advance(now: Now, rows: Array) -> tuple[Now, Any]:
        carry, seen = stretch(now[0], rows)
        return (carry, rows[-1]), seen

    if not callable(controls):
        rows = jnp.broadcast_to(controls, (steps, controls.shape[-1]))
        if checkpoint is None:
            return advance(now, rows)
        folded = rows.reshape(steps // checkpoint, checkpoint, rows.shape[1])
        now, seen = jax.lax.scan(jax.checkpoint(advance), now, folded)
        return now, _joined(seen)
    law = controls

    def period(now: Now, length: int) -> tuple[Now, Any]:
        ctrl = law(*now)
        return advance(now, jnp.broadcast_to(ctrl, (length, *ctrl.shape)))

    return _periods(period, now, steps, every, checkpoint)


def _periods(period: Callable, now: Now, steps: int, every: int, checkpoint: int | None) -> tuple[Now, Any]:
    """Of so many steps `period(now, length)`, and what is left."""
    periods, rest = divmod(steps, every)
    now, seen = _scan(lambda now, _: period(now, every), now, None, periods, checkpoint and checkpoint // every)
    seen = _joined(seen)
    if rest:
        now, more = period(now, rest)
        seen = jax.tree.map(lambda *parts: jnp.concatenate(parts), seen, more)
    return now, seen


def _scan(advance: Callable, now: Now, rows: Array | None, steps: int, checkpoint: int | None) -> tuple[Now, Any]:
    """`jax.lax.scan`, with checkpoints."""
    if checkpoint is None:
        return jax.lax.scan(advance, now, rows, length=steps)
    segments = steps // checkpoint
    folded = jax.tree.map(lambda leaf: leaf.reshape(segments, checkpoint, *leaf.shape[1:]), rows)
    segment = jax.checkpoint(lambda now, rows: jax.lax.scan(advance, now, rows, length=checkpoint))
    now, seen = jax.lax.scan(segment, now, folded, length=segments)
    return now, _joined(seen)


def _joined(blocks: Any) -> Any:
    """Arrays [N, n, ...] as [N * n, ...], also where they hold nothing."""
    return jax.tree.map(lambda leaf: leaf.reshape(leaf.shape[0] * leaf.shape[1], *leaf.shape[2:]), blocks)
