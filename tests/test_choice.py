"""The cheaper engine by itself: which one, why, and that the answer is the same."""

import jax.numpy as jnp
import mujoco
import numpy as np
import pytest

import tog_mjx as tog
from tog_mjx.engines import choice, choose_engine, objective

CART = """
<mujoco model="cart">
  <option timestep="0.01"/>
  <worldbody>
    <body><joint name="x" type="slide" axis="1 0 0" damping="0.5"/><geom size="0.1" mass="1"/></body></worldbody>
  <actuator><motor joint="x" ctrlrange="-1 1" ctrllimited="true"/></actuator>{rest}
</mujoco>"""
# A body that spins about a point which an equality holds: MJX leaves out what grows with the square of the spin.
HELD = """<body name="spun" pos="0.5 0 0"><freejoint/><geom size="0.1" mass="1"/></body>"""
CAN = """<geom type="box" size="1 1 0.1" pos="0 0 -1"/>
<body pos="0 0 1"><freejoint/><geom type="cylinder" size="0.1 0.1"/></body>"""
EQUALITY = """<equality><connect body1="spun" anchor="0.3 0 0"/></equality>"""


def problem(more: str = "", rest: str = "", cost=lambda last: (last.qpos[0] - 0.3) ** 2, **of) -> tog.Problem:
    text = CART.format(rest=rest).replace("</worldbody>", f"{more}</worldbody>")
    return tog.Problem(mujoco.MjModel.from_xml_string(text), 20, tog.Controls(2), cost=cost, **of)


@pytest.fixture(scope="module")
def cart() -> tog.Problem:
    return problem()


def test_the_trial_finds_that_steps_are_the_same_and_the_answer_is(cart):
    found = choose_engine(cart)
    assert found.engine in ("mjx", "mujoco")
    assert "a gradient takes" in found.reason
    step = choice._one_step(cart)
    assert step.apart < 1e-10
    assert min(step.seconds, step.seconds_compile) > 0
    J, x = objective(cart, "auto"), cart.x0 + 0.1
    assert J.engine == found.engine
    np.testing.assert_allclose(J(x), objective(cart, "mujoco")(x), rtol=1e-9)


@pytest.mark.parametrize(
    ("gradients", "ours", "step", "compiling", "expected"),
    [
        # 20 time steps, and a gradient through MJX takes 4 evaluations: 0.08 s for steps of 1 ms.
        (100, 0.02, 1e-3, 5.0, "mujoco"),
        (100, 0.10, 1e-3, 5.0, "mujoco"),  # 10 s against 5 + 8.
        (1000, 0.10, 1e-3, 5.0, "mjx"),  # 100 s against 5 + 80.
    ],
)
def test_the_one_that_is_done_sooner_is_taken(cart, monkeypatch, gradients, ours, step, compiling, expected):
    choice._chosen.cache_clear()
    monkeypatch.setattr(choice, "_seconds_of_c", lambda *_: ours)
    monkeypatch.setattr(choice, "_one_step", lambda _: choice._Step(1e-9, step, compiling))
    found = choose_engine(cart, gradients)
    choice._chosen.cache_clear()
    assert found.engine == expected
    assert f"a gradient takes {1e3 * ours:.3g} ms on C MuJoCo, on MJX about 80 ms" in found.reason


def test_where_a_step_differs_it_is_mjx_and_the_reason_says_by_how_much():
    held = problem(HELD, EQUALITY)
    held.origin.qvel[-1] = 20.0
    found = choose_engine(held)
    assert found.engine == "mjx"
    assert "a step of C MuJoCo differs by" in found.reason


def test_what_only_one_of_them_can_move_is_moved_by_that():
    refused = problem(CAN)
    found = choose_engine(refused)
    assert found.engine == "mujoco"
    assert "cylinder" in found.reason.lower()
    forces = problem(cost=lambda last: jnp.sum(last.data.qacc**2))
    assert choose_engine(forces).engine == "mjx"
    assert objective(forces, "auto").engine == "mjx"
    native = choose_engine(problem(), differentiation="native")
    assert native.engine == "mjx"


def test_a_descent_has_as_many_updates_whichever_is_chosen(cart, monkeypatch):
    for name in ("mjx", "mujoco"):
        monkeypatch.setattr("tog_mjx.solving.solve.choose_engine", lambda *_, name=name, **__: choice.Choice(name, ""))
        found = tog.solve(cart, budget=20, engine="auto")
        assert found.iterations == 4
    alone = tog.solve(cart, budget=100, engine="mujoco")  # Five gradients of 20 of its own evaluations.
    np.testing.assert_allclose(found.best, alone.best, rtol=1e-12)


def test_an_unknown_engine_is_told_with_all_names(cart):
    with pytest.raises(tog.InputError, match=r"engine 'brax' is unknown; choose from .*mujoco, auto"):
        objective(cart, "brax")
