"""The penalty simulator with one modelling term switched, and nothing else: what does that term do to the gradient?"""

import dataclasses
from collections.abc import Callable

import jax
import jax.numpy as jnp
from jaxtyping import Float

from tog_mjx.scene import Scene
from tog_mjx.simulators.penalty import PenaltySimulator, PlanarState, box_distance
from tog_mjx.simulators.released import ReleasedSimulator, diagonal_sector
from tog_mjx.types import AnyArray, Box, Fingers, Scalar, Setpoints, Vector


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class ExplicitEuler(PenaltySimulator):
    """Positions advance with the old velocities."""

    def _integrate(
        self, state: PlanarState, box_acceleration: Float[AnyArray, "3"], finger_acceleration: Float[AnyArray, "F 2"]
    ) -> PlanarState:
        box, fingers = state
        dt = self.physics.timestep
        return PlanarState(
            box + dt * jnp.concatenate([box[3:], box_acceleration]),
            fingers + dt * jnp.concatenate([fingers[:, 2:], finger_acceleration], axis=1),
        )


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class SectorNormals(PenaltySimulator):
    """A finger is pushed along the normal of the diagonal sector that it lies in, at the box's corners too."""

    def _distance(self, point: Vector) -> tuple[Scalar, Vector]:
        distance, _ = box_distance(self.physics.box_half, point)
        return distance, diagonal_sector(point)


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class PointFingers(PenaltySimulator):
    """Fingers are points, which start where the spheres' surfaces do."""

    def init(self, box: Box, fingers: Fingers) -> PlanarState:
        return ReleasedSimulator(self.physics).init(box, fingers)

    def step(self, state: PlanarState, setpoints: Setpoints) -> PlanarState:
        point = PenaltySimulator(self.physics._replace(finger_radius=0.0), self.friction)
        return point.step(state, setpoints)


def _doubled_viscosity(scene: Scene) -> PenaltySimulator:
    simulator = PenaltySimulator.from_scene(scene)
    laws = {name: getattr(simulator.physics, name) for name in ("corner_floor", "finger_floor", "finger_box")}
    doubled = {name: law._replace(viscosity=2 * law.viscosity) for name, law in laws.items()}
    return dataclasses.replace(simulator, physics=simulator.physics._replace(**doubled))


TERMS: dict[str, Callable[[Scene], PenaltySimulator]] = {
    "penalty, friction slope doubled": _doubled_viscosity,
    "penalty, explicit Euler": ExplicitEuler.from_scene,
    "penalty, sector normals": SectorNormals.from_scene,
    "penalty, point fingers": PointFingers.from_scene,
}
"""By name: a scene's penalty simulator with that term switched."""
