"""Random small models at random states: the derivative of a step is finite, and that of differences away from kinks."""

import functools

import jax
import jax.numpy as jnp
import mujoco
import mujoco.rollout
import numpy as np
from hypothesis import Phase, given, settings
from hypothesis import strategies as st

import tog_mjx as tog
from tog_mjx._mjx import mjx
from tog_mjx.differences import central_differences, halvings
from tog_mjx.step_check import compile_quickly

STATES = 16
SETTLED, TOLERANCE = 1e-6, 1e-5

JOINTS = {
    "free": "<freejoint/>",
    # Off the centre of mass: at it MuJoCo's inverse weight of the body is zero, and its contacts infinitely stiff.
    "ball": '<joint type="ball" pos="0 0 0.1"/>',
    "planar": '<joint type="slide" axis="1 0 0"/><joint type="slide" axis="0 0 1"/><joint axis="0 1 0"/>',
    "hinge": '<joint axis="0 1 0" limited="true" range="-20 20" frictionloss="{loss}" damping="{damping}"/>',
}
# The capsule lies: where one stands upright, MJX and C MuJoCo turn its contact's frame about the normal differently.
GEOMS = {"sphere": 'size="{r}"', "capsule": 'size="{r}" fromto="-0.1 0 0 0.1 0 0"'}


@st.composite
def models(draw) -> mujoco.MjModel:
    """A body near the floor, and one more on a hinge with a limit and dry friction; all its numbers random."""
    number = functools.partial(st.floats, allow_nan=False, width=16)
    joint, geom = draw(st.sampled_from(["free", "ball", "planar"])), draw(st.sampled_from(list(GEOMS)))
    values = {
        "loss": draw(number(0.125, 1)),
        "damping": draw(number(0, 0.5)),
        "r": draw(number(0.0625, 0.125)),
    }
    cone, integrator = (
        draw(st.sampled_from(["elliptic", "pyramidal"])),
        draw(st.sampled_from(["Euler", "implicitfast"])),
    )
    solref = f"{draw(number(0.015625, 0.0625))} {draw(number(0.5, 1.5))}"
    friction = f"{draw(number(0.25, 1.5))} {draw(number(0.0078125, 0.125))} {draw(number(0.0078125, 0.125))}"
    contact = f'condim="{draw(st.sampled_from([1, 3, 4, 6]))}" friction="{friction}" solref="{solref}"'
    mass = draw(number(0.25, 4))
    return mujoco.MjModel.from_xml_string(f"""<mujoco>
      <option timestep="0.002" cone="{cone}" integrator="{integrator}" tolerance="1e-14"
              iterations="200" ls_iterations="50"/>
      <worldbody><geom type="plane" size="5 5 0.1" friction="0.1 0.001 0.001"/>
        <body pos="0 0 {values["r"]}">{JOINTS[joint]}
          <geom type="{geom}" {GEOMS[geom].format(**values)} mass="{mass}" {contact}/>
          <body pos="0.3 0 0">{JOINTS["hinge"].format(**values)}
            <geom size="0.05" pos="0.1 0 0" mass="0.5" {contact}/></body>
        </body></worldbody></mujoco>""")


def random_states(model: mujoco.MjModel, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Positions [STATES, nq], moved from the model's own pose by centimetres, and velocities [STATES, nv]."""
    rng = np.random.default_rng(seed)
    positions = []
    for _ in range(STATES):
        qpos = model.qpos0.copy()
        mujoco.mj_integratePos(model, qpos, rng.normal(size=model.nv) * 0.02, 1)
        qpos[-1] = rng.uniform(-0.6, 0.6)  # The hinge: its limits are at 0.35.
        positions.append(qpos)
    return np.array(positions), rng.normal(size=(STATES, model.nv))


def step_in_c(model: mujoco.MjModel, states: np.ndarray) -> np.ndarray:
    """The next (qpos, qvel) of each row."""
    start = np.concatenate([np.zeros((len(states), 1)), states], axis=1)
    after, _ = mujoco.rollout.rollout(model, [mujoco.MjData(model)], start, nstep=1)
    return after[:, 0, 1:]


# Every example is compiled, so that a smaller failing one would cost minutes.
@given(models(), st.integers(0, 1000))
@settings(max_examples=4, phases=[Phase.generate])
def test_the_derivative_of_a_step(model, seed):
    x = np.concatenate(random_states(model, seed), axis=1)
    rng = np.random.default_rng(seed)
    direction, weight = rng.normal(size=(2, x.shape[1]))
    mjx_model = mjx.put_model(model)

    def both_modes(x):
        def at(t):
            moved = x + t * direction
            data = mjx.make_data(mjx_model).replace(qpos=moved[: model.nq], qvel=moved[model.nq :])
            after = tog.step(mjx_model, data)
            return weight @ jnp.concatenate([after.qpos, after.qvel])

        value, push = jax.linearize(at, 0.0)
        return value, push(1.0), jax.linear_transpose(push, 0.0)(1.0)[0]

    value, forward, reverse = map(np.asarray, compile_quickly(jax.vmap(both_modes))(x))
    np.testing.assert_allclose(value, step_in_c(model, x) @ weight, rtol=0, atol=1e-6)  # To what two solvers stop at.
    assert np.isfinite(forward).all()
    np.testing.assert_allclose(reverse, forward, rtol=1e-9, atol=1e-9 * np.abs(forward).max())

    # Two points a state are asked for at a time.
    repeated = np.repeat(x, 2, axis=0)
    expected = central_differences(
        lambda t: step_in_c(model, repeated + np.asarray(t) * direction) @ weight[:, None],
        np.zeros((STATES, 1)),
        halvings(1e-5, 6),
        order=4,
    )
    settled = expected.change <= SETTLED
    assert settled.mean() >= 0.75
    np.testing.assert_allclose(forward[settled], expected.jacobian[settled, 0, 0], rtol=TOLERANCE)
