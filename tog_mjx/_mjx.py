"""MJX, imported quietly, and everything in it that this package uses though MJX keeps it private.

MJX prints to standard output on import (that the optional Warp is not installed); a program's standard output is its
own. What is private another version may rename or redefine: so only this file touches it, and `check_version` says
which versions are let in. `tests/test_mjx_private.py` holds every one of these names against C MuJoCo.
"""

import contextlib
import importlib.metadata
import io
import threading
from collections.abc import Iterator
from typing import NamedTuple

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
from jaxtyping import Array, Float

from tog_mjx.safe import impedance, rotation_vector, with_derivative_of

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
with contextlib.redirect_stdout(io.StringIO()):
    from mujoco import mjx as mjx
    from mujoco.mjx._src import constraint as _constraint
    from mujoco.mjx._src import math as _math
    from mujoco.mjx._src.collision_driver import geom_pairs as geom_pairs
    from mujoco.mjx._src.collision_driver import has_collision_fn as has_collision_fn


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


def contacts(data: mjx.Data) -> Contacts:
    """What `mjx.fwd_position` left of them in `data`."""
    found = data._impl.contact
    return Contacts(found.dist, found.includemargin, found.friction, np.asarray(found.dim), found.geom)


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


def _axis_angle(quaternion: Float[Array, "4"]) -> tuple[Array, Array]:
    # MJX multiplies both wherever it asks for them; where nothing turns, neither alone has the product's derivative.
    axis, angle = _stock_axis_angle(quaternion)
    return with_derivative_of(axis * angle, rotation_vector(quaternion)), jnp.ones_like(angle)


def _stiffness_damping_impedance(model: mjx.Model, solref: Array, solimp: Array, violation: Array) -> tuple:
    stiffness, damping, stock = _stock_stiffness_damping_impedance(model, solref, solimp, violation)
    return stiffness, damping, with_derivative_of(stock, impedance(solimp, violation))


_stock_axis_angle, _stock_stiffness_damping_impedance = _math.quat_to_axis_angle, _constraint._kbi
_lock, _inside = threading.Lock(), 0


@contextlib.contextmanager
def mended() -> Iterator[None]:
    """While this lasts MJX traces two of its functions with the same values, and derivatives that are right.

    Stock MJX has the derivative zero, or NaN, of a rotation that is at rest (springs and servos of ball and free
    joints, `refsite`) and of an impedance whose power is no whole number. Any number of threads may be inside.
    """
    global _inside
    with _lock:
        _inside += 1
        _math.quat_to_axis_angle, _constraint._kbi = _axis_angle, _stiffness_damping_impedance
    try:
        yield
    finally:
        with _lock:
            _inside -= 1
            if not _inside:
                _math.quat_to_axis_angle, _constraint._kbi = _stock_axis_angle, _stock_stiffness_damping_impedance


def with_forces_of(model: mjx.Model, array: str) -> mjx.Model:
    """The model with the forces that an array is the measure of: MJX leaves them out where the scene has none.

    Not those of a fluid with the integrator implicitfast, which MJX cannot integrate.
    """
    if array == "body_gravcomp":
        return model.replace(flg_gravcomp=True)
    if array in FLUID and model.opt.integrator != mjx.IntegratorType.IMPLICITFAST:
        return model.tree_replace({"opt._impl.has_fluid_params": True})
    return model
