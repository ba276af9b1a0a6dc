"""The custom penalty simulator: planar rigid bodies, one spring and one damper a contact.

It restates in one page what MuJoCo does to these scenes in the limit of soft contact (`friction="mujoco"`, see
`tog_mjx.contact`), so that two independent codes check each other; or the paper's friction law (`friction="paper"`).
Integration is semi-implicit Euler, as MuJoCo's: the new velocities move the positions. A contact acts at the point
midway through the penetration, in forces, velocities and lever arms alike.

Plane vectors are (x, z); angles are counter-clockwise; omega x r = omega (-r_z, r_x).
"""

import dataclasses
from typing import ClassVar, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from tog_mjx.contact import PenaltyLaw
from tog_mjx.safe import safe_norm
from tog_mjx.scene import Physics, Scene
from tog_mjx.types import AnyArray, Box, Fingers, Scalar, Setpoints, Vector


class PlanarState(NamedTuple):
    """Box (x, z, theta, vx, vz, omega) [6] and fingers (x, z, vx, vz) [F, 4]."""

    box: Box
    fingers: Fingers


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class PenaltySimulator:
    """Parameters are leaves; the friction law is static. Implements `tog_mjx.simulators.simulator.Simulator`."""

    OPTIONS: ClassVar[dict[str, tuple[str, ...]]] = {"friction": ("mujoco", "paper")}

    physics: Physics
    friction: str = dataclasses.field(default="mujoco", metadata={"static": True})

    @classmethod
    def from_scene(cls, scene: Scene, friction: str = "mujoco") -> "PenaltySimulator":
        return cls(in_default_precision(scene.physics), friction)

    def init(self, box: Box, fingers: Fingers) -> PlanarState:
        return PlanarState(jnp.asarray(box, float), jnp.asarray(fingers, float))

    def observe(self, state: PlanarState) -> tuple[Box, Fingers]:
        return state

    def step(self, state: PlanarState, setpoints: Setpoints) -> PlanarState:
        """Advances by one time step under the setpoints [2F]."""
        p = self.physics
        box, fingers = state
        targets = jnp.reshape(setpoints, (fingers.shape[0], 2))
        weight = jnp.array([0.0, -p.gravity])

        on_corners = jax.vmap(self._corner_floor, (None, 0))(box, p.corners)
        on_fingers, by_fingers = jax.vmap(self._finger_box, (None, 0))(box, fingers)
        wrench = on_corners.sum(0) + by_fingers.sum(0)
        forces = on_fingers + jax.vmap(self._finger_floor)(fingers)
        forces += p.finger_stiffness * (targets - fingers[:, :2]) - p.finger_damping * fingers[:, 2:]

        inertia = jnp.array([p.box_mass, p.box_mass, p.box_inertia])
        return self._integrate(state, wrench / inertia + jnp.append(weight, 0.0), forces / p.finger_mass + weight)

    def _integrate(
        self, state: PlanarState, box_acceleration: Float[AnyArray, "3"], finger_acceleration: Float[AnyArray, "F 2"]
    ) -> PlanarState:
        box, fingers = state
        dt = self.physics.timestep
        box_velocity = box[3:] + dt * box_acceleration
        finger_velocity = fingers[:, 2:] + dt * finger_acceleration
        return PlanarState(
            jnp.concatenate([box[:3] + dt * box_velocity, box_velocity]),
            jnp.concatenate([fingers[:, :2] + dt * finger_velocity, finger_velocity], axis=1),
        )

    def _corner_floor(self, box: Box, corner: Vector) -> Float[Array, "3"]:
        """Force and torque on the box where the floor meets one corner, given in the box's frame."""
        arm = rotate(box[2], corner)
        distance = box[1] + arm[1] - self.physics.corner_radius
        arm = jnp.array([arm[0], distance / 2 - box[1]])
        velocity = box[3:5] + box[5] * perpendicular(arm)
        force = self._force(self.physics.corner_floor, distance, velocity[1], velocity[0])[::-1]
        return jnp.append(force, cross(arm, force))

    def _finger_floor(self, finger: Float[AnyArray, "4"]) -> Vector:
        """Force on a finger where it meets the floor."""
        distance = finger[1] - self.physics.finger_radius
        return self._force(self.physics.finger_floor, distance, finger[3], finger[2])[::-1]

    def _finger_box(self, box: Box, finger: Float[AnyArray, "4"]) -> tuple[Vector, Float[Array, "3"]]:
        """Force on a finger, and force and torque on the box, where the two meet."""
        p = self.physics
        offset = finger[:2] - box[:2]
        distance, normal = self._distance(rotate(-box[2], offset))
        normal = rotate(box[2], normal)
        gap = distance - p.finger_radius
        arm = offset - normal * (p.finger_radius + gap / 2)
        velocity = finger[2:] - box[3:5] - box[5] * perpendicular(arm)
        tangent = perpendicular(normal)
        along_normal, along_tangent = self._force(p.finger_box, gap, velocity @ normal, velocity @ tangent)
        force = along_normal * normal + along_tangent * tangent
        return force, -jnp.append(force, cross(arm, force))

    def _distance(self, point: Vector) -> tuple[Scalar, Vector]:
        """Signed distance of a point in the box's frame, and the normal along which a finger is pushed."""
        return box_distance(self.physics.box_half, point)

    def _force(self, law: PenaltyLaw, distance: Scalar, normal_speed: Scalar, tangential_speed: Scalar) -> Vector:
        """(f_n, f_t) of the chosen law; zero, with zero gradient, where the bodies are apart."""
        kernel = mujoco_limit_force if self.friction == "mujoco" else paper_force
        return jnp.where(distance < 0, kernel(law, -distance, normal_speed, tangential_speed), 0.0)


def in_default_precision(physics: Physics) -> Physics:
    """The same parameters with arrays of JAX's default float type; numbers stay Python's, and take any type."""
    return jax.tree.map(lambda x: jnp.asarray(x, float) if isinstance(x, np.ndarray) else x, physics)


def mujoco_limit_force(law: PenaltyLaw, penetration: Scalar, normal_speed: Scalar, tangential_speed: Scalar) -> Vector:
    """(f_n, f_t) [N] to which MuJoCo's elliptic contact tends: a penalty force, projected onto the friction cone.

    Inside the cone the force stands; in the polar cone it is zero; else the nearest point of the cone's edge. The
    gradient at an edge is that of the side named first.
    """
    normal = law.stiffness * penetration - law.damping * normal_speed
    tangential = -law.viscosity * tangential_speed
    size, mu = jnp.abs(tangential), law.friction
    on_edge = (normal + mu * size) / (1 + mu**2) * jnp.array([1.0, mu * jnp.sign(tangential)])
    inside, polar = size <= mu * normal, normal <= -mu * size
    return jnp.where(inside, jnp.array([normal, tangential]), jnp.where(polar, 0.0, on_edge))


def paper_force(law: PenaltyLaw, penetration: Scalar, normal_speed: Scalar, tangential_speed: Scalar) -> Vector:
    """(f_n, f_t) [N] of the paper: a friction coefficient c |v_t| up to psi_s = mu / c, and mu beyond it.

    The normal force is the damped spring's, and never pulls.
    """
    normal = jnp.maximum(0.0, law.stiffness * penetration - law.damping * normal_speed)
    coefficient = jnp.clip(law.slope * tangential_speed, -law.friction, law.friction)
    return jnp.array([normal, -coefficient * normal])


def box_distance(half: Vector, point: Vector) -> tuple[Scalar, Vector]:
    """Signed distance [m] of a point from a box of half sides `half`, both in the box's frame, and its unit gradient.

    Inside, the nearest face gives both. The gradient of the normal is zero inside and beside a face; at the centre,
    where all faces are equally near, a face is chosen.
    """
    beyond = jnp.abs(point) - half
    side = jnp.where(point < 0, -1.0, 1.0)
    outside = jnp.maximum(beyond, 0.0)
    distance_outside = safe_norm(outside)
    face = jnp.where(beyond[0] > beyond[1], jnp.array([1.0, 0.0]), jnp.array([0.0, 1.0]))
    is_inside = distance_outside == 0
    distance = jnp.where(is_inside, beyond.max(), distance_outside)
    normal = jnp.where(is_inside, face, outside / jnp.where(is_inside, 1.0, distance_outside))
    return distance, side * normal


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
