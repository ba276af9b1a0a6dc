"""Names of version 0.1.0 work and warn, where whoever wrote them sees it; nothing here simulates."""

import re
from typing import Any

import numpy as np
import pytest

import tog_mjx
from tog_mjx.solving.descent import Descent, Status
from tog_mjx.studies.landscape import gradient_field, landscape

tog: Any = tog_mjx  # No type knows the older names.
FLIP = tog.get_task("flip")
DESCENT = Descent(np.array([3.0, 1.0, 2.0]), np.eye(3), np.zeros((3, 3)), Status.EXHAUSTED, 0.0, 0.0)


def no_such_engine(function, *args, **named) -> str:
    """What a function says of the engine it is asked for, which it must have been told."""
    with pytest.raises(tog.InputError) as caught:
        function(*args, **named)
    return str(caught.value)


@pytest.mark.parametrize(
    ("older", "newer", "ask", "expected"),
    [
        ("simulator=", "engine=", lambda: tog.objective("flip", simulator="penalty"), tog.objective("flip", "penalty")),
        ("task=", "problem=", lambda: tog.objective(task="flip"), tog.objective("flip")),
        ("setpoints_best", "best", lambda: DESCENT.setpoints_best.tolist(), [0, 1, 0]),
        ("setpoints_last", "last", lambda: DESCENT.setpoints_last.tolist(), [0, 0, 1]),
        ("horizon", "steps + 1", lambda: FLIP.horizon, 600),
        ("tog_mjx.Trajectory", "tog_mjx.Motion", lambda: tog.Trajectory, tog.Motion),
    ],
)
def test_it_has_the_new_ones_value_and_names_it_to_its_user(older, newer, ask, expected):
    told = re.escape(f"{older} is the older name of {newer}, and goes with tog_mjx 0.3.0")
    with pytest.warns(DeprecationWarning, match=f"^{told}$") as caught:
        assert ask() == expected
    assert [warning.filename for warning in caught] == [__file__]


@pytest.mark.parametrize(
    "ask",
    [
        lambda **named: tog.rollout("flip", [0.0, 0.25], **named),
        lambda **named: tog.rollout("flip", u=[0.0, 0.25], **named),
        lambda **named: tog.solve("flip", **named),
        lambda **named: tog.solve(task="flip", **named),
        lambda **named: landscape(FLIP, **named),
        lambda **named: gradient_field(FLIP, **named),
    ],
)
def test_keywords_reach_every_function_that_had_them(ask):
    with pytest.warns(DeprecationWarning, match="older name") as caught:
        assert no_such_engine(ask, simulator="bullet").startswith("engine 'bullet' is unknown")
    assert "simulator= is the older name of engine=" in str(caught[-1].message)


def test_both_names_at_once_are_one_line():
    told = "simulator= is the older name of engine=; give the latter alone"
    assert no_such_engine(tog.objective, "flip", engine="mjx", simulator="penalty") == told


def test_what_is_no_name_is_none():
    with pytest.raises(AttributeError, match="module 'tog_mjx' has no attribute 'Trajectories'"):
        _ = tog.Trajectories
    assert "Trajectory" not in dir(tog)
