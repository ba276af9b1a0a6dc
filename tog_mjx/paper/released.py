"""The paper's released program, restated quirk by quirk, so that the published numbers can be checked.

It differs from the paper's text, and from good physics, on purpose: nothing else in the package depends on it. The
quirks:

1. explicit Euler: positions advance with the old velocities;
2. finger damping k_d = 2 N s/m whatever the stiffness;
3. a contact damper, active in penetration, and a normal force that is not clipped and so can pull;
4. the rotational velocity of a corner is sqrt(2) times the rigid body's; contact points stay at the full penetration;
5. finger and box: a distance with a floor of 1 mm inside the norm, the normal of the diagonal sector, a tangent
   regularised by adding 1 mm/s to each component of the velocity;
6. fingers are points. The scene's fingers are spheres whose surface plays that point's part, so `init` moves each
   finger by its radius towards the box. The states of this simulator are those of the points.

The published numbers are float32. Friction is -mu(v) f_n with mu(v) = c v up to psi_s = mu_d / c, and mu_d sign(v)
beyond.

To ask what depends on a quirk, `mended` names one that the paper's text, or rigid-body mechanics, replaces: see
`MENDED`.
"""

import dataclasses
import functools
from collections.abc import Callable
from typing import ClassVar, NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from tog_mjx.engines import SIMULATORS
from tog_mjx.engines.penalty import in_default_precision
from tog_mjx.mjcf.scene import Physics, Scene
from tog_mjx.running.types import AnyArray, Box, Fingers, Scalar, Setpoints, Vector
from tog_mjx.stepping.safe import safe_norm

FINGER_DAMPING = 2.0
"""k_d [N s/m] in both tasks."""
REGULARISER = 1e-3
"""Added to the distances [m] and the speeds [m/s] of finger and box."""

MENDED = {
    "nothing": "the released program",
    "integrator": "semi-implicit Euler: positions advance with the new velocities",
    "finger damping": "k_d = 2 sqrt(m k_p)",
    "contact damping": "contacts are springs, without a damper",
    "pulling": "the normal force is clipped at zero",
    "corner speed": "omega x r, as a rigid body's",
    "distance": "finger and box: max(d_x, d_z), without the 1.4 mm",
    "normals": "finger and box: that of the face of least penetration",
    "friction regularisation": "finger and box: v_t / |v_t|, without the 1 mm/s",
    "precision": "float64, where `tog_mjx.engines.precision` is asked",
}
"""What takes a quirk's place, by the quirk's name."""


class ReleasedState(NamedTuple):
    """Box (x, z, theta, vx, vz, omega) [6] and fingers (x, z, vx, vz) [F, 4]."""

    box: Box
    fingers: Fingers


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class ReleasedSimulator:
    """Parameters are leaves; the mended quirk is static. Implements `tog_mjx.engines.simulator.Simulator`."""

    OPTIONS: ClassVar[dict[str, tuple[str, ...]]] = {"mended": tuple(MENDED)}
    CHUNK: ClassVar[int] = 4096
    GRADIENT_CHARGE: ClassVar[float] = 3.5

    physics: Physics
    mended: str = dataclasses.field(default="nothing", metadata={"static": True})

    @classmethod
    def from_scene(cls, scene: Scene, mended: str = "nothing") -> "ReleasedSimulator":
        return cls(in_default_precision(scene.physics), mended)

    @staticmethod
    def in_float32(mended: str = "nothing") -> bool:
        """Whether its numbers are told in that precision, as they were published."""
        return mended != "precision"

    def init(self, box: Box, fingers: Fingers) -> ReleasedState:
        box, fingers = jnp.asarray(box, float), jnp.asarray(fingers, float)
        towards_box = jnp.sign(box[0] - fingers[:, 0])
        return ReleasedState(box, fingers.at[:, 0].add(towards_box * self.physics.finger_radius))

    def observe(self, state: ReleasedState) -> tuple[Box, Fingers]:
        return state

    # Reverse mode keeps the state of each step and computes the rest again: half the time, an eighth of the memory.
    @functools.partial(jax.checkpoint, prevent_cse=False)
    def step(self, state: ReleasedState, setpoints: Setpoints) -> ReleasedState:
        """Advances by one time step under the setpoints [2F]."""
        p = self.physics
        box, fingers = state
        targets = jnp.reshape(setpoints, (fingers.shape[0], 2))

        wrench = jnp.array([0.0, -p.gravity * p.box_mass, 0.0])
        wrench += self._each(self._corner_floor, box, p.corners).sum(0)
        on_fingers, by_fingers = self._each(self._finger_box, box, fingers)
        wrench += by_fingers.sum(0)
        forces = jnp.array([0.0, -p.gravity * p.finger_mass])
        damping = p.finger_damping if self.mended == "finger damping" else FINGER_DAMPING
        forces += p.finger_stiffness * (targets - fingers[:, :2]) - damping * fingers[:, 2:]
        forces += jax.vmap(self._finger_floor)(fingers) + on_fingers

        acceleration = wrench / jnp.array([p.box_mass, p.box_mass, p.box_inertia])
        return ReleasedState(self._advance(box, acceleration), self._advance(fingers, forces / p.finger_mass))

    def _advance(self, body: Float[AnyArray, "*batch n"], acceleration: Float[AnyArray, "*batch m"]):
        """Positions and velocities, the two halves of `body`, one time step later."""
        dt = self.physics.timestep
        velocity = jnp.split(body, 2, axis=-1)[1]
        if self.mended == "integrator":
            velocity = velocity + dt * acceleration
        return body + dt * jnp.concatenate([velocity, acceleration], axis=-1)

    @staticmethod
    def _each(contact: Callable, box: Box, others: Float[AnyArray, "contacts n"]):
        """`contact(box, other)` for each other, every force and every derivative rounded before it enters a sum.

        The published grasp depends on it. Its state is mirror-symmetric, so the sums over mirrored contacts cancel
        exactly, iteration after iteration. A compiler that fuses the last product of a contact with the sum (a fused
        multiply-add) rounds one of two mirrored contacts and not the other; the descent amplifies that 1e-8 until,
        around iteration 57, it leaves the solution.
        """
        boxes = jax.lax.optimization_barrier(jnp.tile(box, (others.shape[0], 1)))
        return jax.lax.optimization_barrier(jax.vmap(contact)(boxes, others))

    def _normal_force(self, phi: Scalar, normal_speed: Scalar) -> Scalar:
        """The damped spring for phi <= 0; it may pull."""
        law = self.physics.corner_floor
        damping = 0.0 if self.mended == "contact damping" else law.damping
        force = -law.stiffness * phi - damping * normal_speed * (phi < 0)
        return jnp.maximum(0.0, force) if self.mended == "pulling" else force

    def _floor_force(self, height: Scalar, velocity: Vector) -> Vector:
        """Force (x, z) of the floor on a point."""
        law = self.physics.corner_floor
        normal = self._normal_force(jnp.minimum(0.0, height), velocity[1])
        sticking = jnp.abs(velocity[0]) <= law.friction / law.slope
        mu = jnp.where(sticking, law.slope * velocity[0], law.friction * jnp.sign(velocity[0]))
        return jnp.array([-mu * normal, normal])

    def _corner_floor(self, box: Box, corner: Vector) -> Float[Array, "3"]:
        """Force and torque on the box at one corner, given in the box's frame."""
        arm = rotate(box[2], corner)
        factor = 1.0 if self.mended == "corner speed" else jnp.sqrt(2.0)
        velocity = factor * box[5] * perpendicular(arm) + box[3:5]
        force = self._floor_force(arm[1] + box[1], velocity)
        return jnp.append(force, cross(arm, force))

    def _finger_floor(self, finger: Float[AnyArray, "4"]) -> Vector:
        """Force of the floor on a finger."""
        return self._floor_force(finger[1], finger[2:])

    def _finger_box(self, box: Box, finger: Float[AnyArray, "4"]) -> tuple[Vector, Float[Array, "3"]]:
        """Force on a finger, and force and torque on the box."""
        arm = finger[:2] - box[:2]
        point = rotate(-box[2], arm)
        velocity = rotate(-box[2], finger[2:] - box[3:5]) - box[5] * perpendicular(point)

        phi, normal = self._distance(point)
        normal_speed = velocity @ normal
        normal_force = self._normal_force(jnp.minimum(0.0, phi), normal_speed)
        mu = self._friction(velocity - normal_speed * normal)
        force = rotate(box[2], normal_force * (normal - mu))
        return force, -jnp.append(force, cross(arm, force))

    def _distance(self, point: Vector) -> tuple[Scalar, Vector]:
        """Signed distance of a point from the box, and its normal, in the box's frame."""
        beyond = jnp.abs(point) - self.physics.box_half
        phi = beyond.max()
        if self.mended != "distance":
            phi = jnp.minimum(0.0, phi) + jnp.linalg.norm(jnp.maximum(REGULARISER, beyond))
        if self.mended != "normals":
            return phi, diagonal_sector(point)
        axis = jnp.where(beyond[0] > beyond[1], jnp.array([1.0, 0.0]), jnp.array([0.0, 1.0]))
        return phi, axis * jnp.where(point < 0, -1.0, 1.0)

    def _friction(self, velocity: Vector) -> Vector:
        """The coefficient mu, along the tangential velocity of a finger on the box."""
        law = self.physics.finger_box
        sticking_speed = law.friction / law.slope
        if self.mended == "friction regularisation":
            return law.friction * velocity / jnp.maximum(safe_norm(jnp.asarray(velocity)), sticking_speed)
        shifted = jnp.linalg.norm(velocity + REGULARISER)
        sliding = law.friction * velocity / (shifted + REGULARISER)
        return jnp.where(shifted <= sticking_speed, law.slope * velocity, sliding)


SIMULATORS["released"] = ReleasedSimulator


def diagonal_sector(point: Vector) -> Vector:
    """The axis, out of +x, -x, +z and -z, of the sector between the box's diagonals in which a point lies."""
    x, z = point
    right_or_up, left_or_up = z > -x, z > x
    upright = right_or_up == left_or_up
    sign = jnp.where(right_or_up, 1.0, -1.0)
    return sign * jnp.where(upright, jnp.array([0.0, 1.0]), jnp.array([1.0, 0.0]))


def rotate(angle: Scalar, vector: Vector) -> Vector:
    """`vector` turned counter-clockwise by `angle` [rad]."""
    cos, sin = jnp.cos(angle), jnp.sin(angle)
    return jnp.array([cos * vector[0] - sin * vector[1], sin * vector[0] + cos * vector[1]])


def perpendicular(vector: Vector) -> Vector:
    """`vector` turned counter-clockwise by a right angle: the velocity of that point under unit angular speed."""
    return jnp.array([-vector[1], vector[0]])


def cross(a: Vector, b: Vector) -> Scalar:
    """The plane's cross product: the counter-clockwise torque of force b with lever arm a."""
    return a[0] * b[1] - a[1] * b[0]
