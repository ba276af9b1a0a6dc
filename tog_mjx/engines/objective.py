"""The one road through the package: a problem, an engine and variables give a cost to differentiate, or a motion."""

from dataclasses import dataclass
from typing import Any

from jaxtyping import Array, Float, Key

from tog_mjx.engines.choice import resolved
from tog_mjx.engines.engine import Engine, check_engine, on_plane
from tog_mjx.engines.program import Motion, Program, program
from tog_mjx.engines.simulator import Simulator
from tog_mjx.problems.library import get_problem
from tog_mjx.problems.problem import Problem
from tog_mjx.running.errors import InputError, require_whole
from tog_mjx.running.older_names import older_keywords
from tog_mjx.running.types import Numbers, Scalar


@dataclass(frozen=True)
class Objective:
    """J(x) of a problem on an engine: a JAX function, to jit, vmap and differentiate in both modes; see `objective`.

    Of a problem with `Starts` J is the mean over starts, drawn by `key`; without one always the same. x is [n].

    Units: of x those of the problem's variables, of J those of its cost.
    Gradient: as `tog.objective` says; by `each` and `with_motion` too.
    """

    problem: Problem
    engine: str
    options: tuple[tuple[str, str], ...] = ()
    checkpoint: int | None = None

    @property
    def __name__(self) -> str:
        return f"J of {self.problem.scene.name}"

    def __call__(self, x: Numbers, key: Key[Array, ""] | None = None) -> Scalar:
        """J at x [n]; raises InputError for an x of another shape or not finite, and a cost that fails."""
        return self._program.mean(self.problem.check(x), key)

    def each(self, x: Numbers, key: Key[Array, ""], count: int | None = None) -> Float[Array, " count"]:
        """The cost of each start that the key draws, so many of them or the problem's own number; of a problem with one
        start that one [1]. InputError: as when J is called."""
        return self._program.costs(self.problem.check(x), key, count)

    def with_motion(self, x: Numbers) -> tuple[Motion, Scalar]:
        """The motion under x from the problem's own start, and its cost. InputError: as when J is called."""
        given = self._program
        return given.whole(self.problem.check(x), given.engine.model, given.origin)

    def motion(self, x: Numbers, key: Key[Array, ""] | None = None) -> Motion:
        """The motion under x; with a key those of the starts that it draws, with a leading axis. InputError: as when J
        is called."""
        return self._program.motion(self.problem.check(x), key)

    @property
    def _program(self) -> Program:
        return program(self.problem, self.engine, self.options, self.checkpoint)


@older_keywords(task="problem", simulator="engine")
def objective(problem: str | Problem, engine: str = "mjx", *, checkpoint: Any = None, **options: Any) -> Objective:
    """J(x) of a problem, a JAX function of its variables x [n]. Equal calls share one compiled function.

    Args:
      problem: a Problem, or the name of one: "flip" or "grasp".
      engine: "mjx" for any scene (option `differentiation="implicit" | "saltation" | "native"`, see `tog.step`);
        "mujoco", C MuJoCo, for any scene, also one that MJX refuses (its costs see what a State holds, and no forces);
        "penalty" (options `friction="mujoco" | "paper"` and `differentiation="native" | "saltation"`) or "released"
        (option `mended`, one quirk out of `tog_mjx.paper.released.MENDED`) for those of one box and its fingers;
        "auto" for the cheaper one of "mjx" and "mujoco", see `choose_engine`: the objective's `engine` is its name.
      checkpoint: keep the state only every so many steps for reverse mode and compute the rest again; a divisor of the
        steps, and a multiple of those for which a policy's controls are held.

    Its precision is that of JAX's x64 flag where it is called.

    Raises:
      InputError: for an unknown name or option, and a scene or variables that the engine cannot move.

    Units: of x those of the problem's variables, of J those of its cost.
    Gradient: through all steps, forward and reverse. On "mjx" it is as that of `tog.step`. On "mujoco", of first order
      alone, each step is linearised by short differences: at a touch-down it is the slope of the side that does not
      cross the jump, at a kink (stick to slip, a contact or a limit exactly at its surface and at rest) the mean of
      both sides, and of a control at the end of its range that within. On "penalty" and "released" it is JAX's of
      their program: at a touch-down that of the side on which the step is, at rest that of sticking, at a kink one
      side's; neither knows limits. "saltation" adds the jumps of touch-downs on average, on any but
      "released".
    Source: for "mjx" as `tog.step`; "mujoco": own, by MuJoCo's `mjd_transitionFD` and `mjd_inverseFD`; "penalty": the
      limit of soft contact of MuJoCo's documentation, Computation, "Constraint model"; "released": the paper's program.
    """
    problem = get_problem(problem)
    engine = resolved(problem, engine, options)
    check_engine(problem, engine, options)
    steps, every = problem.steps, problem.bound.every
    if checkpoint is not None and (steps % require_whole("checkpoint", checkpoint, 1, steps) or checkpoint % every):
        raise InputError(f"checkpoint is {checkpoint}: give a divisor of {steps} steps, and a multiple of {every}")
    return Objective(problem, engine, tuple(sorted(options.items())), checkpoint)


@older_keywords(task="problem", u="x", simulator="engine")
def rollout(problem: str | Problem, x: Numbers, engine: str = "mjx", **options: Any) -> Motion:
    """The motion of a problem under its variables x [n].

    Raises:
      InputError: as `tog.objective`, whose arguments it takes, and for an x of another shape or not finite.

    Units: of x those of the problem's variables, of the motion those of `tog.Motion`.
    Gradient: of every number of the motion as that of `tog.objective`.
    Source: as `tog.objective`.
    """
    return objective(problem, engine, **options).motion(x)


def final_cost(problem: Problem, engine: Engine | Simulator, x: Float[Array, " n"]) -> Scalar:
    """J on an engine of one's own, or on a planar simulator, which may be a traced pytree: J is differentiable in its
    parameters too."""
    given = Program(problem, engine if isinstance(engine, Engine) else on_plane(problem, engine))
    return given.cost(x, given.engine.model, given.origin)


def trajectory(problem: Problem, simulator: Simulator, x: Float[Array, " n"]) -> Motion:
    """The whole motion on a planar simulator of one's own, the initial state first."""
    given = Program(problem, on_plane(problem, simulator))
    return given.whole(x, given.engine.model, given.origin)[0]
