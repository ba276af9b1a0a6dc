"""Functions of NumPy arrays as functions of JAX arrays.

`jax.pure_callback` would do, but it copies its arguments into JAX again, in the callback's own thread: where float64
may be off, and by way of threads that all may be in callbacks themselves, so that two devices with large arguments wait
for each other for ever.
"""

import functools
import math
import threading
from collections.abc import Callable, Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax.extend.core import Primitive
from jax.interpreters import batching, mlir
from jaxtyping import Array

from tog_mjx.running.interruption import come_again

Function = Callable[..., Sequence[np.ndarray]]
_WORD = np.uint32
"""What numbers travel in: JAX makes float32 of float64 where that is off."""
_outside = Primitive("outside")
_outside.multiple_results = True


def call(
    function: Function, identity: np.ndarray, shapes: Sequence[tuple[int, ...]], *given: Array
) -> tuple[Array, ...]:
    """What a function of float64 arrays with a leading axis returns, [count, *shape] each: here of one member, and
    under `vmap` of all at once. `identity` [words] stands in the program's text, which knows nothing of the function,
    so that a digest of the text is one of all that the values depend on."""
    own, dtype = [some.ndim for some in given], jnp.result_type(float)
    count = dtype.itemsize // np.dtype(_WORD).itemsize

    def host(_: Any, *words: Any) -> tuple[np.ndarray, ...]:
        parts = [np.ascontiguousarray(some).view(dtype)[..., 0].astype(float) for some in words]
        ends = [part.shape[part.ndim - n :] for part, n in zip(parts, own, strict=True)]
        lead = np.broadcast_shapes(*(part.shape[: part.ndim - n] for part, n in zip(parts, own, strict=True)))
        rows = [
            np.broadcast_to(part, (*lead, *end)).reshape(math.prod(lead), *end)
            for part, end in zip(parts, ends, strict=True)
        ]
        try:
            found = zip(function(*rows), shapes, strict=True)
        except KeyboardInterrupt as interruption:
            if threading.current_thread() is threading.main_thread():  # Else that has yet to look for signals.
                come_again(interruption)
            raise
        return tuple(some.astype(dtype).reshape(*lead, *shape, 1).view(_WORD) for some, shape in found)

    whose = jnp.asarray(identity, _WORD)
    found = _outside.bind(whose, *map(_in_words, given), host=host, shapes=tuple((*shape, count) for shape in shapes))
    return tuple(_from_words(some, dtype) for some in found)


def _in_words(x: Array) -> Array:
    """[..., numbers] as [..., numbers, words]."""
    words = jax.lax.bitcast_convert_type(x, _WORD)
    return words if words.ndim > x.ndim else words[..., None]


def _from_words(words: Array, dtype: Any) -> Array:
    return jax.lax.bitcast_convert_type(words if words.shape[-1] > 1 else words[..., 0], dtype)


@_outside.def_impl
def _(*words: Array, **how: Any) -> list[Array]:
    found: list[Array] = jax.jit(functools.partial(_outside.bind, **how))(*words)
    return found


@_outside.def_abstract_eval
def _(*words: Any, host: Function, shapes: Sequence[tuple[int, ...]]) -> list[Any]:
    del words, host
    return [jax.core.ShapedArray(shape, np.dtype(_WORD)) for shape in shapes]


def _batched(words: Sequence[Array], axes: Sequence[Any], *, host: Function, shapes: Sequence[tuple[int, ...]]) -> Any:
    """Where an argument is the same for all it has an axis of length 1."""
    (size,) = {some.shape[axis] for some, axis in zip(words, axes, strict=True) if axis is not None}
    moved = [
        some[None] if axis is None else jnp.moveaxis(some, axis, 0) for some, axis in zip(words, axes, strict=True)
    ]
    found = _outside.bind(*moved, host=host, shapes=tuple((size, *shape) for shape in shapes))
    return found, [0] * len(found)


def _lowered(context: Any, *words: Any, host: Function, shapes: Any) -> Any:
    del shapes
    of = context.avals_in, context.avals_out
    return mlir.emit_python_callback(context, host, None, list(words), *of, has_side_effect=False, returns_token=False)[
        0
    ]


batching.primitive_batchers[_outside] = _batched
mlir.register_lowering(_outside, _lowered, cacheable=False)
