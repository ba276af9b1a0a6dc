"""A problem is a scene, variables and a cost; what comes of it is held against the paper's tasks, closed forms and
differences."""

import functools

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest

import tog_mjx as tog
from tog_mjx.checks.step_check import compile_quickly
from tog_mjx.gradients.differences import halvings, settled_differences

# A mass on a rail, pushed; a hinge that turns freely beside it.
RAIL = """
<mujoco model="rail">
  <option timestep="0.01" gravity="0 0 -10"/>
  <worldbody>
    <body name="cart"><joint name="rail" type="slide" axis="1 0 0"/><geom size="0.1" mass="2"/>
      <site name="nose" pos="0.3 0 0"/></body>
    <body pos="0 1 0"><joint name="hinge" axis="0 1 0"/><geom size="0.1" mass="1"/></body>
  </worldbody>
  <actuator><motor name="push" joint="rail" ctrlrange="-3 3" ctrllimited="true"/></actuator>
  <sensor><actuatorfrc name="force" actuator="push"/><jointpos name="where" joint="rail"/></sensor>
</mujoco>
"""
MASS, DT, STEPS = 2.0, 0.01, 20


@pytest.fixture(scope="module")
def rail() -> mujoco.MjModel:
    return mujoco.MjModel.from_xml_string(RAIL)


def upright(state: tog.State) -> jax.Array:
    return state.qpos[0] ** 2 + state.joint("box_theta") ** 2


def where(state: tog.State) -> jax.Array:
    return state.site("nose")[0]


def in_both_modes(J, x) -> list[np.ndarray]:
    """J, and its gradient in reverse and in forward mode, in one compilation."""

    @compile_quickly
    def all_(x):
        value, push = jax.linearize(J, x)
        return value, jax.linear_transpose(push, x)(jnp.ones(()))[0], jax.vmap(push)(jnp.eye(x.size))

    return list(map(np.asarray, all_(jnp.asarray(x, float))))


def along_the_rail(forces: np.ndarray) -> np.ndarray:
    """Where the cart is after each step, by semi-implicit Euler."""
    return DT * np.cumsum(DT * np.cumsum(forces / MASS))


@pytest.mark.parametrize("knots", [1, 4])
@pytest.mark.parametrize("name", ["flip", "grasp"])
def test_the_papers_tasks_are_problems_and_their_cost_is_that_of_a_loop_by_hand(name, knots):
    """Steps of the planar simulator, one after the other, under setpoints between knots as numpy has them."""
    task, engine = tog.get_task(name, knots=knots), tog.make_simulator("penalty", tog.load_scene(name))

    def by_hand(u):
        rows = jnp.reshape(u, (knots, -1)).T
        at = np.linspace(0, knots - 1, task.steps)
        table = jnp.stack([jnp.interp(at, np.arange(knots), row) for row in rows], 1)
        start = engine.init(*task.scene.start)
        box, _ = engine.observe(jax.lax.scan(lambda now, row: (engine.step(now, row), None), start, table)[0])
        if name == "flip":
            return box[0] ** 2 + box[2] ** 2
        return (box[1] - 1) ** 2 + 0.1 * (box[0] ** 2 + (box[2:] ** 2).sum())

    u = task.initial_guess + np.random.default_rng(0).normal(size=task.initial_guess.shape) * 0.2
    (cost, *gradients), (value, *expected) = in_both_modes(tog.objective(task, "penalty"), u), in_both_modes(by_hand, u)
    np.testing.assert_allclose(cost, value, rtol=1e-11)
    np.testing.assert_allclose(gradients, expected, rtol=1e-8, atol=1e-9 * np.abs(expected).max())
    motion = tog.rollout(task, u, "penalty")
    np.testing.assert_array_equal(motion.qpos[:, task.scene.joints[:3]], motion.box[:, :3])
    np.testing.assert_allclose(motion.time, np.arange(task.steps + 1) * task.scene.model.opt.timestep, atol=1e-12)


def test_a_site_and_a_sensor_by_name_and_costs_of_the_last_and_of_every_state(rail):
    """The sensor's force is that of the step which it begins, and not the last one's."""
    problem = tog.Problem(
        rail,
        STEPS,
        tog.Controls(knots=STEPS),
        cost=where,
        running_cost=lambda state: state.sensor("force")[0] ** 2 + state.sensor("where")[0],
    )
    x = np.random.default_rng(1).uniform(-2, 2, STEPS)
    positions = along_the_rail(x)
    expected = 0.3 + positions[-1] + np.mean(x**2 + np.concatenate([[0], positions[:-1]]))
    value, *gradients = in_both_modes(tog.objective(problem), x)
    np.testing.assert_allclose(value, expected, rtol=1e-12)
    # d position_i / d force_j = DT^2 (i - j) / MASS: force j moves the cart from the end of step j on.
    later = np.maximum(np.arange(STEPS)[:, None] - np.arange(STEPS) + 1, 0) * DT**2 / MASS
    slope = later[-1] + (2 * x + later[:-1].sum(0)) / STEPS
    for gradient in gradients:
        np.testing.assert_allclose(gradient, slope, rtol=1e-10)
    motion = tog.rollout(problem, x)
    np.testing.assert_allclose(motion.qpos[1:, 0], positions, rtol=1e-12)
    np.testing.assert_array_equal(motion.ctrl[:, 0], [*x, x[-1]])


def test_controls_are_held_or_linear_between_knots(rail):
    held, linear = (
        tog.rollout(tog.Problem(rail, 8, tog.Controls(3, hold), cost=where), [1.0, 2.0, -1.0]).ctrl[:-1, 0]
        for hold in (True, False)
    )
    np.testing.assert_array_equal(held, [1, 1, 1, 2, 2, 2, -1, -1])
    np.testing.assert_allclose(linear, np.interp(np.linspace(0, 2, 8), [0, 1, 2], [1, 2, -1]))


def test_several_kinds_at_once_have_names_bounds_and_a_scale(rail):
    kinds = [tog.Controls(), tog.Start("qvel[0]"), tog.Parameters("opt.gravity[2]", "actuator_gear[0, 0]")]
    problem = tog.Problem(rail, STEPS, kinds, cost=where)
    assert problem.bound.names == ("push", "qvel[0]", "opt.gravity[2]", "actuator_gear[0, 0]")
    np.testing.assert_array_equal(problem.x0, [0, 0, -10, 1])
    np.testing.assert_array_equal(problem.limits, [[-3, -np.inf, -np.inf, -np.inf], [3, np.inf, np.inf, np.inf]])
    np.testing.assert_array_equal(problem.bound.scale, [3, 1, 10, 1])
    force, speed, gear = 1.5, 0.7, 2.0
    found, slope, _ = in_both_modes(tog.objective(problem), [force, speed, -9.0, gear])
    whole = DT**2 * STEPS * (STEPS + 1) / 2 / MASS
    np.testing.assert_allclose(found, 0.3 + STEPS * DT * speed + gear * force * whole, rtol=1e-12)
    np.testing.assert_allclose(slope, [gear * whole, STEPS * DT, 0, force * whole], rtol=1e-12)


@functools.cache
def _balance(steps: int, every: int) -> tog.Problem:
    """A pendulum upright on a cart, whose gains are the variables."""
    model = mujoco.MjModel.from_xml_string("""
    <mujoco><option timestep="0.01"/><worldbody><body>
      <joint name="rail" type="slide" axis="1 0 0" damping="0.2"/><geom size="0.1" mass="1"/>
      <body><joint name="hinge" axis="0 1 0"/><geom size="0.05" pos="0 0 0.5" mass="0.2"/></body></body></worldbody>
      <actuator><motor joint="rail"/></actuator></mujoco>""")
    data = mujoco.MjData(model)
    data.qpos[1] = 0.2
    gains = {"p": np.array([1.0, 30.0]), "d": np.array([2.0, 6.0])}

    def feedback(gains: dict, state: dict) -> jax.Array:
        return (gains["p"] @ state["q"] + gains["d"] @ state["v"])[None]

    return tog.Problem(
        model,
        steps,
        tog.Policy(feedback, gains, observe=lambda state: {"q": state.qpos, "v": state.qvel}, every=every),
        running_cost=lambda state: jnp.sum(state.qpos**2) + 1e-3 * state.ctrl @ state.ctrl,
        start=data,
    )


def test_the_gradient_of_a_policy_is_that_of_differences():
    """Ten steps that are no multiple of what a control is held for, in both modes."""
    every = 4
    problem = _balance(10, every)
    assert problem.bound.names == ("policy['d'][0]", "policy['d'][1]", "policy['p'][0]", "policy['p'][1]")
    J = tog.objective(problem)
    # A policy sees the state, and its control is held: C MuJoCo under the same law.
    model, data = problem.scene.model, mujoco.MjData(problem.scene.model)
    data.qpos[:] = problem.origin.qpos

    def by_hand(x: np.ndarray) -> float:
        mujoco.mj_resetData(model, data)
        data.qpos[:], total = problem.origin.qpos, 0.0
        for i in range(10):
            if i % every == 0:
                data.ctrl[:] = x[2:] @ data.qpos + x[:2] @ data.qvel
            total += data.qpos @ data.qpos + 1e-3 * data.ctrl @ data.ctrl
            mujoco.mj_step(model, data)
        return total / 10

    x = problem.x0
    value, *gradients = in_both_modes(J, x)
    np.testing.assert_allclose(value, by_hand(x), rtol=1e-10)
    values = lambda points: np.array([[by_hand(x)] for x in points])  # noqa: E731
    expected = settled_differences(values, x[None], halvings(1e-2, 8), order=4).jacobian[0, 0]
    for gradient in gradients:
        np.testing.assert_allclose(gradient, expected, rtol=1e-7)


def test_checkpoints_change_no_gradient():
    """Of a plan, and of a policy, which is asked anew in each segment."""
    policy = tog.Policy(lambda gain, seen: gain * seen[:2], -np.ones(2), every=10)
    for variables in (tog.Controls(3), policy):
        problem = tog.Problem("flip", 600, variables, cost=upright)
        (_, plain, _), (_, kept, _) = (
            in_both_modes(tog.objective(problem, "penalty", checkpoint=every), problem.x0) for every in (None, 60)
        )
        np.testing.assert_allclose(kept, plain, rtol=1e-10)


def test_a_checkpoint_that_does_not_fit_is_told():
    problem = _balance(12, 4)
    with pytest.raises(tog.InputError, match="checkpoint is 6: give a divisor of 12 steps, and a multiple of 4"):
        tog.objective(problem, checkpoint=6)


def test_many_starts_are_drawn_by_a_key_and_may_move_the_model(rail):
    """The cost is the mean over starts of what each costs; masses differ too."""

    def sample(key: jax.Array) -> dict[str, jax.Array]:
        keys = jax.random.split(key)
        mass = jnp.asarray(rail.body_mass).at[1].set(jax.random.uniform(keys[0], minval=1.0, maxval=4.0))
        return {"qpos": jax.random.normal(keys[1], (rail.nq,)), "body_mass": mass}

    problem = tog.Problem(rail, STEPS, cost=where, start=tog.Starts(sample, 5))
    J, key, force = tog.objective(problem), jax.random.key(7), 2.5
    drawn = jax.vmap(sample)(jax.random.split(key, 5))
    expected = 0.3 + drawn["qpos"][:, 0] + force * DT**2 * STEPS * (STEPS + 1) / 2 / drawn["body_mass"][:, 1]
    each, motion = compile_quickly(lambda x: (J.each(x, key), J.motion(x, key)))([force])
    np.testing.assert_allclose(each, expected, rtol=1e-12)
    np.testing.assert_allclose(motion.qpos[:, 0], drawn["qpos"])
    np.testing.assert_allclose(motion.qpos[:, -1, 0] + 0.3, expected, rtol=1e-12)
    np.testing.assert_allclose(J([force], key), expected.mean(), rtol=1e-12)
    assert J([force]) == J([force]) != J([force], key)


def test_solve_stays_within_the_bounds_and_finds_the_answer(rail):
    """A cart that is to stop far away presses against the control's limit; a near one is reached."""
    for target, answer in ((0.31, None), (9.0, 3.0)):

        def miss(last: tog.State, target: float = target) -> jax.Array:
            return (where(last) - target) ** 2

        problem = tog.Problem(rail, STEPS, cost=miss)
        found = tog.solve(problem, budget=400)
        expected = answer or (target - 0.3) * MASS / (DT**2 * STEPS * (STEPS + 1) / 2)
        np.testing.assert_allclose(found.best, [expected], rtol=1e-2)
        assert (np.abs(found.setpoints) <= 3).all()


def test_a_verdict_names_the_problems_variables(rail):
    kinds = [tog.Controls(), tog.Start("qvel[0]")]
    verdict = tog.check(tog.Problem(rail, STEPS, kinds, cost=where))
    assert verdict.word == "trust", verdict.line
    assert verdict.variables == ("push", "qvel[0]")
    assert verdict.scale == [3.0, 1.0]
    np.testing.assert_allclose(verdict.gradient, [[DT**2 * STEPS * (STEPS + 1) / 2 / MASS, STEPS * DT]], rtol=1e-10)


def no_cost(_):
    raise KeyError("reward")


BAD = {
    "the problem has no cost": {"cost": None},
    "steps is 0": {"steps": 0},
    "a variable is of type str": {"variables": ["ctrl"]},
    "no variables": {"variables": []},
    "the start's variable='ctrl' is unknown": {"variables": tog.Start("ctrl")},
    "did you mean body_mass": {"variables": tog.Parameters("body_mas")},
    "no keyframe named home": {"start": "home"},
    "is above the largest": {"bounds": (1.0, -1.0)},
    "x has the shape [3]; model takes [1]: push": {"guess": [1.0, 2.0, 3.0]},
    "knots is 99": {"variables": tog.Controls(99)},
}
BAD_WHEN_RUN = {
    "cost fails: KeyError: 'reward'": {"cost": no_cost},
    "cost returns an array of shape [2]; give one number": {"cost": lambda last: last.qpos},
    "no site named nos; choose from nose; did you mean nose?": {"cost": lambda last: last.site("nos")[0]},
    "the policy returns an array of shape [2]; give [1] controls": {
        "variables": tog.Policy(lambda p, o: p * o[:2], jnp.ones(2))
    },
    "do not add up": {"variables": [tog.Controls(3), tog.Policy(lambda p, _: p, jnp.ones(1))]},
    "a start has no qposs": {"start": tog.Starts(lambda _: {"qposs": jnp.zeros(2)}, 2)},
    "the starts' qpos has the shape [3]; give [2]": {"start": tog.Starts(lambda _: {"qpos": jnp.zeros(3)}, 2)},
}


@pytest.mark.parametrize(("message", "wrong"), list(BAD.items()) + list(BAD_WHEN_RUN.items()))
def test_bad_input_is_one_line(rail, message, wrong):
    given = {"model": rail, "steps": 5, "cost": where, **wrong}

    def run() -> None:
        problem = tog.Problem(**given)
        tog.objective(problem)(problem.x0)

    with pytest.raises(tog.InputError) as told:
        run()
    assert message in str(told.value)
    assert "\n" not in str(told.value)


def test_what_an_engine_cannot_move_is_told(rail):
    with pytest.raises(tog.InputError, match="engine 'bullet' is unknown"):
        tog.objective(tog.Problem(rail, 5, cost=where), "bullet")
    with pytest.raises(tog.InputError, match="it has no body named box"):
        tog.objective(tog.Problem(rail, 5, cost=where), "penalty")
    flip = functools.partial(tog.Problem, "flip", 5)
    with pytest.raises(tog.InputError, match="engine penalty reads its parameters from the scene"):
        tog.objective(flip(tog.Parameters("body_mass"), cost=lambda last: last.qpos[0]), "penalty")
    J = tog.objective(flip(cost=lambda last: last.data.qacc[0]), "penalty")
    with pytest.raises(tog.InputError, match=r"this engine has no mjx\.Data"):
        J([0.0, 0.25])
