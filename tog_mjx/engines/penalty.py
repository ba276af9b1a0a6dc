"""The custom penalty simulator: planar rigid bodies, one spring and one damper a contact.

It restates in one page what MuJoCo does to these scenes in the limit of soft contact (`friction="mujoco"`, see
`tog_mjx.mjcf.contact`), so that two independent codes check each other; or the paper's friction law
(`friction="paper"`). Integration is semi-implicit Euler, as MuJoCo's: the new velocities move the positions. A contact
acts at the point midway through the penetration, in forces, velocities and lever arms alike.

The state is made of single numbers, see `tog_mjx.engines.plane`. Angles are counter-clockwise; omega x r = omega
(-r_z, r_x).
"""

import dataclasses
import functools
from typing import Any, ClassVar, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from tog_mjx.engines.plane import Plane
from tog_mjx.mjcf.contact import PenaltyLaw
from tog_mjx.mjcf.scene import Physics, Scene
from tog_mjx.running.types import Box, Fingers, Scalar, Setpoints
from tog_mjx.stepping.touch import box_width, switch


class Body(NamedTuple):
    """The box: position, angle theta, velocity, angular speed omega."""

    position: Plane
    angle: Scalar
    velocity: Plane
    spin: Scalar


class Finger(NamedTuple):
    """A point mass with the surface of a sphere."""

    position: Plane
    velocity: Plane


class PlanarState(NamedTuple):
    """The box, and the fingers in the order of their numbers."""

    box: Body
    fingers: tuple[Finger, ...]


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class PenaltySimulator:
    """Parameters are leaves; the friction law is static. Implements `tog_mjx.engines.simulator.Simulator`.

    `differentiation="native"` is what JAX makes of the steps: the derivative between two jumps of the motion;
    `"saltation"` has the jumps of touch-downs and partings in it, see `tog_mjx.stepping.touch`. The values are the
    same.
    """

    OPTIONS: ClassVar[dict[str, tuple[str, ...]]] = {
        "friction": ("mujoco", "paper"),
        "differentiation": ("native", "saltation"),
    }
    CHUNK: ClassVar[int] = 4096
    GRADIENT_CHARGE: ClassVar[float] = 4.0
    SALTATION_CHARGE: ClassVar[float] = 5.0

    physics: Physics
    friction: str = dataclasses.field(default="mujoco", metadata={"static": True})
    differentiation: str = dataclasses.field(default="native", metadata={"static": True})

    @classmethod
    def from_scene(cls, scene: Scene, friction: str = "mujoco", differentiation: str = "native") -> "PenaltySimulator":
        return cls(in_default_precision(scene.physics), friction, differentiation)

    def init(self, box: Box, fingers: Fingers) -> PlanarState:
        box, fingers = jnp.asarray(box, float), jnp.asarray(fingers, float)
        return PlanarState(
            Body(Plane.of(box[:2]), box[2], Plane.of(box[3:5]), box[5]),
            tuple(Finger(Plane.of(finger[:2]), Plane.of(finger[2:])) for finger in fingers),
        )

    def observe(self, state: PlanarState) -> tuple[Box, Fingers]:
        numbers, fingers = jax.tree.leaves(state.box), [jax.tree.leaves(finger) for finger in state.fingers]
        return jnp.stack(numbers), jnp.array(fingers)

    # Reverse mode keeps the state of each step and computes the rest again: half the time, an eighth of the memory.
    @functools.partial(jax.checkpoint, prevent_cse=False)
    def step(self, state: PlanarState, setpoints: Setpoints) -> PlanarState:
        """Advances by one time step under the setpoints [2F]."""
        p, box = self.physics, state.box
        weight = Plane(0.0, -p.gravity)
        force, torque = Plane(0.0, 0.0), jnp.zeros(())
        for corner in p.corners:
            by_floor, turning = self._corner_floor(box, Plane.of(corner))
            force, torque = force + by_floor, torque + turning
        fingers = []
        for finger, setpoint in zip(state.fingers, jnp.reshape(setpoints, (-1, 2)), strict=True):
            by_box, arm = self._finger_box(box, finger)
            force, torque = force - by_box, torque - arm.cross(by_box)
            control = (Plane.of(setpoint) - finger.position) * p.finger_stiffness - finger.velocity * p.finger_damping
            total = by_box + self._finger_floor(finger) + control
            fingers.append(
                Finger(*self._integrate(finger.position, finger.velocity, total * (1 / p.finger_mass) + weight))
            )
        position, velocity = self._integrate(box.position, box.velocity, force * (1 / p.box_mass) + weight)
        angle, spin = self._integrate(box.angle, box.spin, torque / p.box_inertia)
        return PlanarState(Body(position, angle, velocity, spin), tuple(fingers))

    def _integrate(self, position: Any, velocity: Any, acceleration: Any) -> tuple[Any, Any]:
        """Position and velocity one time step later: of vectors, or of angles."""
        dt = self.physics.timestep
        velocity = velocity + acceleration * dt
        return position + velocity * dt, velocity

    def _corner_floor(self, box: Body, corner: Plane) -> tuple[Plane, Scalar]:
        """Force and torque on the box where the floor meets one corner, given in the box's frame."""
        arm = corner.turned(box.angle)
        distance = box.position.z + arm.z - self.physics.corner_radius
        arm = Plane(arm.x, distance / 2 - box.position.z)
        velocity = box.velocity + arm.perpendicular() * box.spin
        inverse_inertia = 1 / self.physics.box_mass + arm.x**2 / self.physics.box_inertia
        law = self.physics.corner_floor
        normal, tangential = self._force(law, distance, velocity.z, velocity.x, inverse_inertia)
        force = Plane(tangential, normal)
        return force, arm.cross(force)

    def _finger_floor(self, finger: Finger) -> Plane:
        """Force on a finger where it meets the floor."""
        law, velocity = self.physics.finger_floor, finger.velocity
        distance = finger.position.z - self.physics.finger_radius
        normal, tangential = self._force(law, distance, velocity.z, velocity.x, 1 / self.physics.finger_mass)
        return Plane(tangential, normal)

    def _finger_box(self, box: Body, finger: Finger) -> tuple[Plane, Plane]:
        """Force on a finger where it meets the box, which feels its opposite; and its lever arm about the box."""
        p = self.physics
        offset = finger.position - box.position
        distance, normal = self._distance(offset.turned(-box.angle))
        normal = normal.turned(box.angle)
        gap = distance - p.finger_radius
        arm = offset - normal * (p.finger_radius + gap / 2)
        velocity = finger.velocity - box.velocity - arm.perpendicular() * box.spin
        tangent = normal.perpendicular()
        inverse_inertia = 1 / p.finger_mass + 1 / p.box_mass + arm.cross(normal) ** 2 / p.box_inertia
        speeds = velocity.dot(normal), velocity.dot(tangent)
        along_normal, along_tangent = self._force(p.finger_box, gap, *speeds, inverse_inertia)
        return normal * along_normal + tangent * along_tangent, arm

    def _distance(self, point: Plane) -> tuple[Scalar, Plane]:
        """Signed distance of a point in the box's frame, and the normal along which a finger is pushed."""
        return box_distance(Plane.of(self.physics.box_half), point)

    def _force(
        self,
        law: PenaltyLaw,
        distance: Scalar,
        normal_speed: Scalar,
        tangential_speed: Scalar,
        inverse_inertia: Scalar | float,
    ) -> tuple[Scalar, Scalar]:
        """(f_n, f_t) of the chosen law; zero where bodies are apart, with no gradient but that of the switch.

        `inverse_inertia` [1/kg]: the normal acceleration of the bodies from each other by a normal force of 1 N.
        """
        kernel = mujoco_limit_force if self.friction == "mujoco" else paper_force
        normal, tangential = kernel(law, -distance, normal_speed, tangential_speed)
        if self.differentiation == "saltation":
            s = switch(distance, box_width(normal_speed, normal * inverse_inertia, self.physics.timestep))
            return s * normal, s * tangential
        touching = distance < 0
        return jnp.where(touching, normal, 0.0), jnp.where(touching, tangential, 0.0)


def in_default_precision(physics: Physics) -> Physics:
    """The same parameters with arrays of JAX's default float type; numbers stay Python's, and take any type."""
    return jax.tree.map(lambda x: jnp.asarray(x, float) if isinstance(x, np.ndarray) else x, physics)


def mujoco_limit_force(
    law: PenaltyLaw, penetration: Scalar, normal_speed: Scalar, tangential_speed: Scalar
) -> tuple[Scalar, Scalar]:
    """(f_n, f_t) [N] to which MuJoCo's elliptic contact tends: a penalty force, projected onto the friction cone.

    Inside the cone the force stands; in the polar cone it is zero; else the nearest point of the cone's edge. The
    gradient at an edge is that of the side named first.
    """
    normal = law.stiffness * penetration - law.damping * normal_speed
    tangential = -law.viscosity * tangential_speed
    size, mu = jnp.abs(tangential), law.friction
    on_edge = (normal + mu * size) / (1 + mu**2)
    inside, polar = size <= mu * normal, normal <= -mu * size
    return (
        jnp.where(inside, normal, jnp.where(polar, 0.0, on_edge)),
        jnp.where(inside, tangential, jnp.where(polar, 0.0, mu * jnp.sign(tangential) * on_edge)),
    )


def paper_force(
    law: PenaltyLaw, penetration: Scalar, normal_speed: Scalar, tangential_speed: Scalar
) -> tuple[Scalar, Scalar]:
    """(f_n, f_t) [N] of the paper: a friction coefficient c |v_t| up to psi_s = mu / c, and mu beyond it.

    The normal force is the damped spring's, and never pulls.
    """
    normal = jnp.maximum(0.0, law.stiffness * penetration - law.damping * normal_speed)
    coefficient = jnp.clip(law.slope * tangential_speed, -law.friction, law.friction)
    return normal, -coefficient * normal


def box_distance(half: Plane, point: Plane) -> tuple[Scalar, Plane]:
    """Signed distance [m] of a point from a box of half sides `half`, both in the box's frame, and its unit gradient.

    Inside, the nearest face gives both. The gradient of the normal is zero inside and beside a face; at the centre,
    where all faces are equally near, a face is chosen.
    """
    beyond = Plane(jnp.abs(point.x), jnp.abs(point.z)) - half
    outside = Plane(jnp.maximum(beyond.x, 0.0), jnp.maximum(beyond.z, 0.0))
    squared = outside.dot(outside)
    is_inside, faces_x = squared == 0, beyond.x > beyond.z
    distance_outside = jnp.sqrt(jnp.where(is_inside, 1.0, squared))
    distance = jnp.where(is_inside, jnp.maximum(beyond.x, beyond.z), distance_outside)
    normal_x = jnp.where(is_inside, jnp.where(faces_x, 1.0, 0.0), outside.x / distance_outside)
    normal_z = jnp.where(is_inside, jnp.where(faces_x, 0.0, 1.0), outside.z / distance_outside)
    return distance, Plane(jnp.where(point.x < 0, -1.0, 1.0) * normal_x, jnp.where(point.z < 0, -1.0, 1.0) * normal_z)
