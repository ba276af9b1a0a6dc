"""The penalty simulator with one modelling term switched, and nothing else: what does that term do to the gradient?"""

import dataclasses
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp

from tog_mjx.engines.penalty import PenaltySimulator, PlanarState
from tog_mjx.engines.plane import Plane
from tog_mjx.mjcf.scene import Scene
from tog_mjx.paper.released import ReleasedSimulator, diagonal_sector
from tog_mjx.running.types import Box, Fingers, Scalar, Setpoints


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class ExplicitEuler(PenaltySimulator):
    """Positions advance with the old velocities."""

    def _integrate(self, position: Any, velocity: Any, acceleration: Any) -> tuple[Any, Any]:
        dt = self.physics.timestep
        return position + velocity * dt, velocity + acceleration * dt


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class SectorNormals(PenaltySimulator):
    """A finger is pushed along the normal of the diagonal sector that it lies in, at the box's corners too."""

    def _distance(self, point: Plane) -> tuple[Scalar, Plane]:
        distance, _ = super()._distance(point)
        return distance, Plane.of(diagonal_sector(jnp.stack(point)))


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class PointFingers(PenaltySimulator):
    """Fingers are points, which start where the spheres' surfaces do."""

    def init(self, box: Box, fingers: Fingers) -> PlanarState:
        return super().init(*ReleasedSimulator(self.physics).init(box, fingers))

    def step(self, state: PlanarState, setpoints: Setpoints) -> PlanarState:
        point = PenaltySimulator(self.physics._replace(finger_radius=0.0), self.friction, self.differentiation)
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
