"""The problems that have a name: whoever makes them puts them here."""

import dataclasses
import functools
from collections.abc import Callable

from tog_mjx.problems.problem import Problem
from tog_mjx.problems.variables import Controls
from tog_mjx.running.errors import InputError, near, require_whole
from tog_mjx.running.names import load_givers

LIBRARY: dict[str, Callable[[], Problem]] = {}
"""By name: functions of nothing, which always return the same problem."""


def get_problem(problem: str | Problem, knots: int | None = None) -> Problem:
    """The problem of that name; a Problem is returned as it is. With `knots`, its constant controls change over time.

    Equal calls return the same problem.

    Raises:
      InputError: for an unknown name, or a number of knots that is not positive or more than the time steps.
    """
    if not isinstance(problem, Problem):
        if problem not in list(LIBRARY):
            load_givers()
        if problem not in list(LIBRARY):
            choices = f"choose from {', '.join(LIBRARY)}"
            raise InputError(f"problem {problem!r} is unknown; {choices}{near(problem, LIBRARY)}")
        problem = LIBRARY[problem]()
    if knots is None or require_whole("knots", knots, 1, problem.steps) == problem.knots:
        return problem
    return _with_knots(problem, int(knots))


@functools.cache
def _with_knots(problem: Problem, knots: int) -> Problem:
    if problem.variables != Controls():
        raise InputError(f"{problem.scene.name} has {problem.variables} already; start from constant controls")
    return dataclasses.replace(problem, variables=Controls(knots))
