"""Slopes of steps of C MuJoCo from inverse dynamics are those of `mj_step`, and are not taken where they cannot be."""

import copy

import mujoco
import numpy as np
import pytest
from random_models import model_of, state_of, structure_of

from tog_mjx.engines.c_mujoco import inverse
from tog_mjx.engines.c_mujoco.forward import Forward
from tog_mjx.engines.c_mujoco.linearise import slopes
from tog_mjx.engines.c_mujoco.one_step import Given, one_step

STATES = 4
DRIVES = ("damper", "motor", "position", "root", "site", "velocity")
"""Actuators without activations."""


def of_steps(forward: Forward, data: mujoco.MjData, given: Given) -> np.ndarray:
    """Centred differences of `mj_step`, in velocity space, of a solver that goes on until nothing improves: where that
    with a tolerance of 1e-14 ends an iteration too early they are off by 1e-5."""
    model = copy.copy(forward.model)
    model.opt.tolerance = 0
    return one_step(Forward(model, data, threads=1), given, 1e-6, True, False).mean(0)[:, 1:]


def assert_agree(found: np.ndarray, expected: np.ndarray, nv: int) -> None:
    """Derivatives in positions, in velocities, and in what drives are of different sizes."""
    for columns in (slice(nv), slice(nv, 2 * nv), slice(2 * nv, None)):
        error, size = (np.linalg.norm(some[..., columns], axis=(1, 2)) for some in (found - expected, expected))
        np.testing.assert_array_less(error, 1e-6 * size)


@pytest.mark.parametrize("integrator", ["Euler", "implicit", "implicitfast"])
@pytest.mark.parametrize("cone", ["pyramidal", "elliptic"])
@pytest.mark.parametrize(("seed", "half"), [(0, 1), (1, 0), (4, 1)])
def test_whatever_joins_stops_and_drives_bodies_slopes_are_those_of_steps(seed, half, cone, integrator):
    """Free, ball, slide and hinge joints, contacts of all kinds, limits, friction, fluid, tendons and equalities."""
    structure, rng = structure_of(seed, half, cone, integrator), np.random.default_rng(seed)
    drives = [name for name in DRIVES if name in structure.actuators and (name != "damper" or integrator == "Euler")]
    model = model_of(structure._replace(actuators=tuple(drives)), rng)
    data, drawn = mujoco.MjData(model), np.array([state_of(model, rng) for _ in range(STATES)])
    forward, end = Forward(model, data, threads=1), model.nq + model.nv
    before, controls = np.zeros((STATES, len(forward.start))), drawn[:, end:].copy()
    before[:, 1 : 1 + end] = drawn[:, :end]
    given = before, controls, np.tile(forward.row, (STATES, 1))
    assert inverse.is_for(forward)
    both, done = by_inverse(forward, given)
    assert done.all()
    assert_agree(both.mean(0)[:, 1:], of_steps(forward, data, given), model.nv)


def chain(option: str = "", actuators: str = "", joint: str = "", damping: str = "0.1") -> mujoco.MjModel:
    """Seven balls on a floor, in a row on hinges, two of them driven; by default the controls are limited to 1."""
    link = '<body pos="0.2 0 0"><joint name="h{}" axis="0 1 0" damping="{}" {}/><geom size="0.05" mass="0.3"/>'
    links = "".join(link.format(i, damping, joint) for i in range(6)) + 6 * "</body>"
    actuators = actuators or '<motor joint="h0" ctrlrange="-1 1"/><motor joint="h3" gear="2" ctrlrange="-1 1"/>'
    return mujoco.MjModel.from_xml_string(f"""<mujoco>
      <option timestep="0.005" {option}/>
      <worldbody><geom type="plane" size="9 9 1"/>
        <body pos="0 0 0.0495"><joint type="slide" axis="1 0 0"/><joint type="slide" axis="0 0 1"/>
          <geom size="0.05" mass="0.3"/>{links}</body></worldbody>
      <actuator>{actuators}</actuator></mujoco>""")


def somewhere(model: mujoco.MjModel, data: mujoco.MjData, controls: tuple[float, ...]) -> tuple[Forward, Given]:
    """States near the start, in the floor, with the same controls in all."""
    forward, rng = Forward(model, data, threads=1), np.random.default_rng(0)
    before, (_, q, _, last) = np.tile(forward.start, (STATES, 1)), forward.ends
    before[:, 1:q] += rng.normal(size=(STATES, model.nq)) * 3e-4
    before[:, q:last] += rng.normal(size=(STATES, last - q)) * 0.1
    return forward, (before, np.tile(controls, (STATES, 1)), np.tile(forward.row, (STATES, 1)))


def by_inverse(forward: Forward, given: Given) -> tuple[np.ndarray, np.ndarray]:
    return inverse.transitions(forward.precise, given, forward.motions(given[0], given[1][:, None])[:, 0])


@pytest.mark.parametrize(
    ("model", "controls", "is_for"),
    [
        (chain(), (0.5, -0.3), True),
        (chain('noslip_iterations="5"'), (0.5, -0.3), False),
        (chain(joint='actuatorfrcrange="-0.2 0.2"'), (0.5, -0.05), False),
        (chain(actuators='<general joint="h0" dyntype="filter" dynprm="0.1"/>'), (0.5,), False),
        (chain('integrator="implicitfast"', '<damper joint="h0" kv="2" ctrlrange="0 1"/>'), (0.5,), False),
    ],
)
def test_where_they_cannot_be_taken_slopes_are_those_of_steps_still(model, controls, is_for):
    assert_slopes(model, mujoco.MjData(model), controls, is_for)


@pytest.mark.parametrize(
    "model",
    [chain('iterations="2"'), chain(damping="1e6"), chain('integrator="implicitfast"', damping="1e6")],
    ids=["few iterations", "damping is all", "damping is all, implicit"],
)
def test_neither_a_solver_cut_short_nor_damping_that_is_all_is_asked_for_its_inverse(model):
    forward, given = somewhere(model, mujoco.MjData(model), (0.5, -0.3))
    assert not inverse.is_for(forward)
    expected = of_steps(forward, mujoco.MjData(model), given)
    size = np.abs(expected).max((1, 2))
    for found, agrees in ((slopes_of(forward, given), True), (by_inverse(forward, given)[0].mean(0)[:, 1:], False)):
        errors = np.abs(found - expected).max((1, 2)) / size
        assert (errors < 1e-5).all() == agrees


def test_forces_in_space_do_not_turn_with_bodies():
    model = chain()
    data = mujoco.MjData(model)
    data.xfrc_applied[1:, 0], data.xfrc_applied[1:, 2] = 20, -3
    assert_slopes(model, data, (0.5, -0.3), False)


def assert_slopes(model: mujoco.MjModel, data: mujoco.MjData, controls: tuple[float, ...], is_for: bool) -> None:
    forward, given = somewhere(model, data, controls)
    assert inverse.is_for(forward) == is_for
    assert_agree(slopes_of(forward, given), of_steps(forward, data, given), model.nv)


def slopes_of(forward: Forward, given: Given) -> np.ndarray:
    found = slopes(forward, given[0], forward.motions(given[0], given[1][:, None])[:, 0], given[1])
    return np.concatenate([found.state, found.controls], axis=2)


def test_a_solver_that_stops_short_is_differenced(monkeypatch):
    model = chain('cone="elliptic" iterations="1"')
    forward, given = somewhere(model, mujoco.MjData(model), (0.5, -0.3))
    monkeypatch.setattr(inverse, "ITERATIONS", 1)
    assert inverse.is_for(forward)
    stops = ~by_inverse(forward, given)[1]
    assert stops.any()
    found = slopes_of(forward, given)
    monkeypatch.setattr(inverse, "LARGE", model.nv + 1)
    np.testing.assert_array_equal(found[stops], slopes_of(forward, given)[stops])


def test_at_a_limit_the_slope_in_a_control_is_that_inside_and_beyond_there_is_none():
    model, found = chain(), []
    for controls in ((0.99, -0.99), (1.0, -1.0), (1.5, -2.0)):
        both, done = by_inverse(*somewhere(model, mujoco.MjData(model), controls))
        assert done.all()
        found.append(both[..., 2 * model.nv :])
    inside, at, beyond = found
    assert np.abs(inside).max() > 1e-2
    np.testing.assert_allclose(at, inside, rtol=1e-6, atol=1e-7)
    np.testing.assert_array_equal(beyond, 0.0)
