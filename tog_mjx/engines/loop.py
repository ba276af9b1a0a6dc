"""The loop over time steps, under controls that are constant, known beforehand, or an answer to the state."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from tog_mjx.problems.state import State

Now = tuple[Any, Float[Array, " nu"]]
"""What an engine carries, and the controls in force."""


@dataclass(frozen=True)
class Loop:
    """`step(carry, ctrl) -> (carry, State at its beginning)` and `state(carry, ctrl)` are an engine's.

    `controls` are constant [nu], one row a step [steps, nu], or a law, which is asked every so many steps. `watch` is
    called with the State in which each step begins.
    """

    step: Callable[[Any, Array], tuple[Any, State]]
    state: Callable[[Any, Array], State]
    controls: Array | Callable[[State], Array]
    every: int
    watch: Callable[[State], Any]

    def run(self, now: Now, steps: int, checkpoint: int | None = None) -> tuple[Now, Any]:
        """The last moment, and what `watch` returned, with a leading axis [steps].

        With `checkpoint` reverse mode keeps one moment in so many, and computes the others again.
        """
        rows = None if callable(self.controls) or self.controls.ndim == 1 else self.controls
        if checkpoint is None:
            return self._steps(now, rows, steps)
        segment = jax.checkpoint(lambda now, rows: self._steps(now, rows, checkpoint))
        return _blocks(segment, now, rows, steps // checkpoint)

    def _steps(self, now: Now, rows: Array | None, steps: int) -> tuple[Now, Any]:
        if not callable(self.controls):
            return self._period(now, rows, steps)
        periods, rest = divmod(steps, self.every)
        now, seen = _blocks(lambda now, _: self._period(now, None, self.every), now, None, periods)
        if rest:
            now, more = self._period(now, None, rest)
            seen = jax.tree.map(lambda *parts: jnp.concatenate(parts), seen, more)
        return now, seen

    def _period(self, now: Now, rows: Array | None, steps: int) -> tuple[Now, Any]:
        """So many steps under given rows, or under one control."""
        carry, ctrl = now
        if callable(self.controls):
            ctrl = self.controls(self.state(carry, ctrl))
        elif rows is None:
            ctrl = self.controls

        def advance(carry: Any, row: Array | None) -> tuple[Any, Any]:
            carry, state = self.step(carry, ctrl if row is None else row)
            return carry, self.watch(state)

        carry, seen = jax.lax.scan(advance, carry, rows, length=steps)
        return (carry, ctrl if rows is None else rows[-1]), seen


def _blocks(run: Callable, now: Now, rows: Array | None, number: int) -> tuple[Now, Any]:
    """`run(now, its rows)` so many times, one after the other; what they return is joined along the first axis."""
    if rows is not None:
        rows = rows.reshape(number, -1, rows.shape[-1])
    now, seen = jax.lax.scan(run, now, rows, length=number)
    return now, jax.tree.map(lambda leaf: leaf.reshape(-1, *leaf.shape[2:]), seen)
