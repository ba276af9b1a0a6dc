"""MJX, imported late and quietly, and everything in it that this package uses though MJX keeps it private.

It is imported where it is first used: that takes a third of a second, and what C MuJoCo moves does without it. MJX
prints to standard output on import (that the optional Warp is not installed); a program's standard output is its own.
What is private another version may rename or redefine: so only this file and `_unrolled` touch it, and `check_version`
says which versions are let in. `tests/test_mjx_private.py` holds every one of these names against C MuJoCo.
"""

import contextlib
import functools
import importlib.metadata
import io
import sys
import threading
from collections.abc import Callable, Iterator
from types import ModuleType
from typing import TYPE_CHECKING, Any, NamedTuple

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
from jaxtyping import Array, Float

from tog_mjx.stepping.safe import (
    arccos,
    arcsin,
    impedance,
    rotation_vector,
    safe_norm,
    sqrt,
    with_derivative_of,
)

OLDEST, NEXT = (3, 17), (4, 0)
FLUID = ("opt.density", "opt.viscosity", "opt.wind")
"""What a fluid is given by."""


def check_version(version: str) -> None:
    """Raises ImportError, with the remedy, for a version of mujoco-mjx outside [OLDEST, NEXT)."""
    if not OLDEST <= tuple(int(part) for part in version.split(".")[:2]) < NEXT:
        wanted = f">={'.'.join(map(str, OLDEST))},<{'.'.join(map(str, NEXT))}"
        raise ImportError(
            f"mujoco-mjx {version} is installed, tog_mjx needs {wanted}: pip install 'mujoco-mjx{wanted}'"
        )


check_version(importlib.metadata.version("mujoco-mjx"))


class _Named(type):
    """A class of MJX's, by its name: before MJX is imported nothing is of it."""

    def __instancecheck__(cls, thing: object) -> bool:
        return isinstance(thing, getattr(sys.modules.get("mujoco.mjx"), cls.__name__, ()))


class _Lazy(ModuleType):
    """`mujoco.mjx`, imported with the first name that is asked of it, but for those of the classes that signatures
    name."""

    Model, Data = _Named("Model", (), {}), _Named("Data", (), {})

    def __getattr__(self, name: str) -> Any:
        return getattr(_imported(), name)


@functools.cache
def _imported() -> ModuleType:
    with contextlib.redirect_stdout(io.StringIO()):
        return importlib.import_module("mujoco.mjx")


if TYPE_CHECKING:
    from mujoco import mjx as mjx
else:
    mjx = _Lazy("mujoco.mjx")


@functools.cache
def float_fields() -> frozenset[str]:
    """The arrays of `mjx.Model` and of its options, by name."""
    options = frozenset(f"opt.{name}" for name, kind in mjx.Option.__annotations__.items() if kind is jax.Array)
    return options | {name for name, kind in _imported().Model.__annotations__.items() if kind is jax.Array}


def has_collision_fn(first: int | mujoco.mjtGeom, second: int | mujoco.mjtGeom) -> bool:
    """Whether MJX collides geoms of two types, the smaller one first."""
    return mjx._src.collision_driver.has_collision_fn(first, second)


def put_model(model: mujoco.MjModel) -> mjx.Model:
    """The model on MJX's JAX implementation, on a device of this process: MJX's own choice may lie in another one."""
    return mjx.put_model(model, device=jax.local_devices()[0], impl="jax")


def make_data(model: mujoco.MjModel | mjx.Model) -> mjx.Data:
    """Data of the model, on the implementation and the device of `put_model`."""
    return mjx.make_data(model, device=jax.local_devices()[0], impl="jax")


class Contacts(NamedTuple):
    """The pairs that MJX watches, K of them, touching or not, sorted by condim."""

    distance: Float[Array, " K"]
    margin: Float[Array, " K"]
    friction: Float[Array, "K 5"]
    condim: np.ndarray
    geoms: Array
    position: Float[Array, "K 3"]
    frame: Float[Array, "K 3 3"]


def contacts(data: mjx.Data) -> Contacts:
    """What `mjx.fwd_position` left of them in `data`."""
    found = data._impl.contact
    of = found.dist, found.includemargin, found.friction, np.asarray(found.dim), found.geom, found.pos, found.frame
    return Contacts(*of)


class ConstraintRows(NamedTuple):
    """The constraint rows: equalities first, then friction losses, then limits and contacts, in that order."""

    jacobian: Float[Array, "nefc nv"]
    reference: Float[Array, " nefc"]
    D: Float[Array, " nefc"]
    friction_loss: Float[Array, " nefc"]
    force: Float[Array, " nefc"]
    equalities: int
    losses: int


def constraint_rows(data: mjx.Data) -> ConstraintRows:
    """What `mjx.fwd_position` left of them in `data`, and `force` what `mjx.solve` left."""
    found = data._impl
    rows = (found.efc_J, found.efc_aref, found.efc_D, found.efc_frictionloss, found.efc_force)
    return ConstraintRows(*rows, int(found.ne), int(found.nf))


def with_constraint_force(data: mjx.Data, force: Float[Array, " nefc"]) -> mjx.Data:
    """`data` with the force of each constraint row."""
    return data.tree_replace({"_impl.efc_force": force})


def with_margins(model: mjx.Model, data: mjx.Data, joint: Array, tendon: Array, contact: Array) -> mjx.Data:
    """`data` with the constraint rows that other margins make: of joints [njnt], tendons [ntendon], contacts [K]."""
    model = model.replace(jnt_margin=joint, tendon_margin=tendon)
    return mjx.make_constraint(model, data.tree_replace({"_impl.contact.includemargin": contact}))


def tendon_jacobian(data: mjx.Data) -> Float[Array, "ntendon nv"]:
    """The derivative of the tendons' lengths in the joint positions."""
    return data._impl.ten_J


def _axis_angle(stock: Callable, quaternion: Float[Array, "4"]) -> tuple[Array, Array]:
    # MJX multiplies both wherever it asks for them; where nothing turns, neither alone has the product's derivative.
    axis, angle = stock(quaternion)
    return with_derivative_of(axis * angle, rotation_vector(quaternion)), jnp.ones_like(angle)


def _constraint(stock: Callable, model: mjx.Model, solref: Array, solimp: Array, violation: Array) -> tuple:
    stiffness, damping, value = stock(model, solref, solimp, violation)
    return stiffness, damping, with_derivative_of(value, impedance(solimp, violation))


def _outward(position: Float[Array, "3"], size: Float[Array, "3"]) -> tuple[Array, Array]:
    """The derivative of a cylinder's signed distance in the position, and that in its radius and half length, negated.

    On its axis, where the distance has a kink, that in the position does not change with it.
    """
    radius = safe_norm(position[:2])
    is_off = radius > 1e-8  # As MJX has it.
    radial = jnp.where(is_off, position[:2] / jnp.where(is_off, radius, 1.0), 0.0)
    over = jnp.array([radius, jnp.abs(position[2])]) - size[:2]
    beyond = jnp.maximum(over, 0)
    length = safe_norm(beyond)
    share = jnp.where(length > 0, beyond / jnp.where(length > 0, length, 1.0), jnp.arange(2) == over.argmax())
    return jnp.append(radial, jnp.sign(position[2])) * share[np.array([0, 0, 1])], share


def _cylinder(stock: Callable, position: Float[Array, "3"], size: Float[Array, "3"]) -> Float[Array, ""]:
    # MJX's own rule leaves the size out.
    share = jax.lax.stop_gradient(_outward(position, size)[1])
    return stock(position, size) - share @ (size[:2] - jax.lax.stop_gradient(size[:2]))


def _cylinder_slope(stock: Callable, position: Float[Array, "3"], size: Float[Array, "3"]) -> Float[Array, "3"]:
    return with_derivative_of(stock(position, size), _outward(position, size)[0])


def _timescale(stock: Callable, dctrl: Array, activation: Array, deactivation: Array, width: Array) -> Array:
    # Without a width MJX divides by 1e-15, raises that to the fifth power, and does not select it.
    is_hard = width < mujoco.mjMINVAL
    smooth = stock(dctrl, activation, deactivation, jnp.where(is_hard, 1.0, width))
    return jnp.where(is_hard, jnp.where(dctrl > 0, activation, deactivation), smooth)


class _Regular:
    """`jax.numpy`, but for functions that are infinitely steep somewhere: those of tendons that wrap, and of rays."""

    sqrt, arcsin, arccos = map(staticmethod, (sqrt, arcsin, arccos))

    def __getattr__(self, name: str) -> Any:
        return getattr(jnp, name)


_lock, _inside = threading.Lock(), 0


@functools.cache
def _mends() -> tuple[tuple[ModuleType, str, Any, Any], ...]:
    """What is mended: a module of MJX's, a name in it, what stands there, and what takes its place."""
    private = mjx._src
    functions = (
        (private.math, "quat_to_axis_angle", _axis_angle),
        (private.constraint, "_kbi", _constraint),
        (private.collision_sdf, "_cylinder", _cylinder),
        (private.collision_sdf, "_cylinder_grad", _cylinder_slope),
        (private.support, "muscle_dynamics_timescale", _timescale),
    )
    of_stock = ((module, name, getattr(module, name), mend) for module, name, mend in functions)
    found = [(module, name, stock, functools.partial(mend, stock)) for module, name, stock, mend in of_stock]
    return (*found, *((module, "jp", jnp, _Regular()) for module in (private.ray, private.support)))


def _put(are_mended: bool) -> None:
    for module, name, stock, mend in _mends():
        setattr(module, name, mend if are_mended else stock)


@contextlib.contextmanager
def mended() -> Iterator[None]:
    """While this lasts MJX traces some of its functions with the same values, and derivatives that are right.

    Stock MJX has the derivative zero, or NaN, of a rotation that is at rest (springs and servos of ball and free
    joints, `refsite`), of an impedance whose power is no whole number, of a cylinder's contacts with what is round, in
    its size too, of tendons that wrap, and of muscles in float32. Any number of threads may be inside.
    """
    global _inside
    with _lock:
        _inside += 1
        _put(are_mended=True)
    try:
        yield
    finally:
        with _lock:
            _inside -= 1
            if not _inside:
                _put(are_mended=False)


def with_forces_of(model: mjx.Model, array: str) -> mjx.Model:
    """The model with the forces that an array is the measure of: MJX leaves them out where the scene has none.

    Not those of a fluid with the integrator implicitfast, which MJX cannot integrate.
    """
    if array == "body_gravcomp":
        return model.replace(flg_gravcomp=True)
    if array in FLUID and model.opt.integrator != mjx.IntegratorType.IMPLICITFAST:
        return model.tree_replace({"opt._impl.has_fluid_params": True})
    return model
