"""Two independent codes: the penalty simulator coincides with MJX as its contacts soften to the penalty limit.

The bars are those of the project's design, over 64 random setpoints of each landscape window, in float64.
"""

import dataclasses
import itertools

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from conftest import positions

from tog_mjx.engines import MjxSimulator, make_simulator, objective
from tog_mjx.engines.penalty import box_distance
from tog_mjx.engines.plane import Plane
from tog_mjx.engines.program import Motion
from tog_mjx.mjcf.scene import Physics

MEDIAN = 0.05e-3  # m
NINETY_PERCENT = 0.2e-3  # m


def with_impedance(simulator: MjxSimulator, impedance: float) -> MjxSimulator:
    """The same model with another constant impedance d in every pair."""
    solimp = simulator.model.pair_solimp.at[:, :2].set(impedance)
    return dataclasses.replace(simulator, model=simulator.model.replace(pair_solimp=solimp))


@pytest.fixture(scope="module")
def motions(compiled) -> dict[float | None, Motion]:
    """Motions on MJX by impedance, and those of the penalty simulator under None."""
    simulator = make_simulator("mjx", compiled.task.scene)
    assert isinstance(simulator, MjxSimulator)
    found: dict[float | None, Motion] = {
        d: compiled.motions(with_impedance(simulator, d), compiled.setpoints) for d in (1e-2, 1e-3, 1e-4)
    }
    return found | {None: compiled.motions(make_simulator("penalty", compiled.task.scene), compiled.setpoints)}


def difference(motions, impedance) -> np.ndarray:
    """The largest difference of a position from the penalty simulator's, [setpoints, T], in m."""
    return np.abs(positions(motions[impedance]) - positions(motions[None])).max(-1)


def touching(motion: Motion, p: Physics) -> np.ndarray:
    """Which contacts touch, [setpoints, T, contacts]: corners and floor, fingers and box, fingers and floor."""

    def gaps(box, fingers):
        corners = [box[1] + Plane.of(corner).turned(box[2]).z - p.corner_radius for corner in p.corners]
        offsets = [Plane.of(finger[:2] - box[:2]).turned(-box[2]) for finger in fingers]
        on_box = [box_distance(Plane.of(p.box_half), offset)[0] - p.finger_radius for offset in offsets]
        return jnp.concatenate([jnp.array(corners + on_box), fingers[:, 1] - p.finger_radius])

    return np.asarray(jax.vmap(jax.vmap(gaps))(motion.box, motion.fingers)) < 0


def test_motions_coincide(motions):
    worst = difference(motions, 1e-4).max(1)
    assert np.median(worst) <= MEDIAN
    assert np.percentile(worst, 90) <= NINETY_PERCENT


def test_the_difference_is_of_first_order_in_the_impedance(motions):
    by_impedance = [difference(motions, d).max(1) for d in (1e-2, 1e-3, 1e-4)]
    for coarse, fine in itertools.pairwise(by_impedance):
        assert 8 < np.median(coarse / fine) < 12


def test_the_worst_setpoints_are_those_where_a_touch_falls_on_another_time_step(compiled, motions):
    # A contact's damper makes its force jump at the touch, so a touch one step earlier or later is a finite difference.
    # While the same contacts touch, the difference is of first order, in the worst case as in the median.
    physics = compiled.task.scene.physics
    together = touching(motions[None], physics)
    same = {d: np.cumprod((touching(motions[d], physics) == together).all(-1), axis=1) for d in (1e-3, 1e-4)}
    both = same[1e-3] * same[1e-4]
    coarse, fine = ((difference(motions, d) * both).max() for d in (1e-3, 1e-4))
    assert 8 < coarse / fine < 12
    assert fine < 0.5e-3
    # The flip's worst setpoints, the grasp having none: each has had such a touch.
    apart = difference(motions, 1e-4).max(1) > 0.5e-3
    assert apart.any() == (compiled.task.name == "flip")
    assert not same[1e-4][apart, -1].any()


def test_gradients_agree(compiled):
    mjx, penalty = (
        np.asarray(compiled.gradients(make_simulator(name, compiled.task.scene), compiled.setpoints))
        for name in ("mjx", "penalty")
    )
    moves = np.linalg.norm(mjx, axis=1) > 1e-9
    relative = np.linalg.norm(mjx - penalty, axis=1)[moves] / np.linalg.norm(mjx, axis=1)[moves]
    cosine = (mjx * penalty).sum(1)[moves] / (np.linalg.norm(mjx, axis=1) * np.linalg.norm(penalty, axis=1))[moves]
    assert np.median(relative) < 1e-3
    assert np.percentile(relative, 90) < 1e-2
    assert np.percentile(cosine, 10) > 0.9999
    np.testing.assert_allclose(penalty[~moves], 0, atol=1e-9)


def test_the_gradient_of_c_mujoco_is_that_of_mjx(compiled):
    mjx = np.asarray(compiled.gradients(make_simulator("mjx", compiled.task.scene), compiled.setpoints))
    found = np.asarray(jax.jit(jax.vmap(jax.grad(objective(compiled.task, "mujoco"))))(compiled.setpoints))
    moves = np.linalg.norm(mjx, axis=1) > 1e-9
    relative = np.linalg.norm(mjx - found, axis=1)[moves] / np.linalg.norm(mjx, axis=1)[moves]
    assert np.median(relative) < 1e-6
    assert np.percentile(relative, 90) < 1e-4
    np.testing.assert_allclose(found[~moves], 0, atol=1e-9)


def test_the_papers_friction_is_another_law(compiled):
    scene = compiled.task.scene
    paper, mujoco = (
        compiled.motions(make_simulator("penalty", scene, friction=law), compiled.setpoints).box
        for law in ("paper", "mujoco")
    )
    assert jnp.median(jnp.abs(paper - mujoco).max((1, 2))) > 1e-3
