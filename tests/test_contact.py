"""The penalty law and MuJoCo's contact parameters say the same."""

import math

import mujoco
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tog_mjx.mjcf.contact import PairParameters, PenaltyLaw, from_mjcf, inverse_weight, to_mjcf
from tog_mjx.mjcf.scene import load_scene
from tog_mjx.running.errors import InputError


def pair_kind(name: str) -> str:
    """`corner_floor` of `corner1_floor`."""
    return "".join(c for c in name if not c.isdigit())


@pytest.mark.parametrize("name", ["flip", "grasp"])
def test_every_pair_follows_from_the_scenes_penalty_constants(name):
    scene = load_scene(name)
    model = scene.model
    assert model.npair == {"flip": 6, "grasp": 8}[name]
    for i in range(model.npair):
        law = PenaltyLaw(
            scene.numeric("contact_stiffness"),
            scene.numeric("contact_damping"),
            0.7,
            scene.numeric(f"viscous_friction_{pair_kind(model.pair(i).name)}"),
            scene.numeric("friction_slope"),
        )
        expected = to_mjcf(law, inverse_weight(model, i))
        np.testing.assert_allclose(model.pair_solref[i], expected.solref, rtol=1e-9)
        np.testing.assert_allclose(model.pair_solreffriction[i], expected.solreffriction, rtol=1e-9)
        np.testing.assert_allclose(model.pair_solimp[i], expected.solimp, rtol=1e-9)
        np.testing.assert_allclose(model.pair_friction[i], expected.friction, rtol=1e-9)
        found = PairParameters(
            model.pair_solref[i], model.pair_solimp[i], model.pair_solreffriction[i], model.pair_friction[i]
        )
        back = from_mjcf(found, inverse_weight(model, i))
        np.testing.assert_allclose(back[:4], law[:4], rtol=1e-9)


@pytest.mark.parametrize("name", ["flip", "grasp"])
def test_viscous_friction_is_the_slope_times_the_static_load(name):
    scene = load_scene(name)
    p = scene.physics
    surface = scene.start[1][0, 0] + p.finger_radius
    load = {
        "corner_floor": p.box_mass * p.gravity / 2,
        "finger_floor": p.finger_mass * p.gravity,
        "finger_box": p.finger_stiffness * (scene.initial_guess[0] - surface),
    }
    for kind, newtons in load.items():
        np.testing.assert_allclose(getattr(p, kind).viscosity, p.corner_floor.slope * newtons, rtol=1e-12)


positive = st.floats(1e-3, 1e6)


@given(positive, positive, st.floats(0.01, 2), positive, st.floats(1e-3, 1e3))
def test_there_and_back(stiffness, damping, friction, viscosity, weight):
    law = PenaltyLaw(stiffness, damping, friction, viscosity, 2.0)
    back = from_mjcf(to_mjcf(law, weight), weight)
    np.testing.assert_allclose(back[:4], law[:4], rtol=1e-12)
    assert math.isnan(back.slope)


@given(st.floats(0.01, 1), st.floats(0.1, 3))
def test_standard_and_direct_solref_are_the_same_law(time_constant, ratio):
    direct = (-1 / (time_constant * ratio) ** 2, -2 / time_constant)
    laws = [
        from_mjcf(PairParameters(np.array(s), np.array([0.5, 0.5, 1, 0.5, 2]), np.zeros(2), np.full(5, 0.3)), 2.0)
        for s in (direct, (time_constant, ratio))
    ]
    np.testing.assert_allclose(laws[0][:4], laws[1][:4], rtol=1e-12)


def drop(impedance: float, stiffness: float, damping: float) -> tuple[mujoco.MjModel, mujoco.MjData]:
    """A 2 kg ball at rest on a plane, on one contact with the given penalty law."""
    law = PenaltyLaw(stiffness, damping, 0.5, 3.0, 2.0)
    xml = """<mujoco><option cone="elliptic" timestep="0.0005"/>
      <worldbody><geom name="floor" type="plane" size="1 1 1"/>
        <body pos="0 0 0.1"><joint type="slide" axis="0 0 1"/><joint type="slide" axis="1 0 0"/>
          <geom name="ball" size="0.1" mass="2"/></body></worldbody>
      <contact><pair geom1="ball" geom2="floor" condim="3"/></contact></mujoco>"""
    model = mujoco.MjModel.from_xml_string(xml)
    pair = to_mjcf(law, inverse_weight(model, 0), impedance)
    model.pair_solref[0], model.pair_solimp[0] = pair.solref, pair.solimp
    model.pair_solreffriction[0], model.pair_friction[0] = pair.solreffriction, pair.friction
    return model, mujoco.MjData(model)


@pytest.mark.parametrize("impedance", [1e-2, 1e-3, 1e-4])
def test_a_resting_body_sinks_by_its_weight_over_the_stiffness(impedance):
    model, data = drop(impedance, 1000.0, 80.0)
    for _ in range(20000):
        mujoco.mj_step(model, data)
    # At rest f = k r / (A (1 - d)), exactly, with no acceleration in it.
    np.testing.assert_allclose(0.1 - (data.qpos[0] + 0.1), 2 * 9.81 / 1000 * (1 - impedance), rtol=1e-6)


def test_a_slow_body_feels_viscous_friction_and_a_fast_one_the_cone():
    model, data = drop(1e-4, 1000.0, 80.0)
    for speed in (0.01, 5.0):
        mujoco.mj_resetData(model, data)
        data.qpos[0], data.qvel[1] = -2 * 9.81 / 1000, speed
        mujoco.mj_forward(model, data)
        # Outside the cone, the projection of (f_n, b_f v): f_n = (f_n* + mu |f_t*|) / (1 + mu^2).
        normal, viscous, mu = 2 * 9.81, 3.0 * speed, 0.5
        friction = viscous if viscous < mu * normal else mu * (normal + mu * viscous) / (1 + mu**2)
        np.testing.assert_allclose(-data.qacc[1] * 2, friction, rtol=1e-3)


@pytest.mark.parametrize(
    ("weight", "impedance", "message"), [(0.0, 1e-4, "inverse_weight is 0"), (1.0, 1e-5, "impedance is 1e-05")]
)
def test_parameters_without_a_meaning_are_refused(weight, impedance, message):
    with pytest.raises(InputError, match=message):
        to_mjcf(PenaltyLaw(1.0, 1.0, 1.0, 1.0, 1.0), weight, impedance)


@pytest.mark.parametrize(
    ("solimp", "solreffriction", "message"),
    [((0.1, 0.9, 0.01, 0.5, 2), (0, 0), "varies"), ((0.1, 0.1, 0.01, 0.5, 2), (-5, -1), "no spring")],
)
def test_pairs_without_a_penalty_limit_are_refused(solimp, solreffriction, message):
    pair = PairParameters(np.array([-1.0, -1.0]), np.array(solimp), np.array(solreffriction, float), np.ones(5))
    with pytest.raises(InputError, match=message):
        from_mjcf(pair, 1.0)
