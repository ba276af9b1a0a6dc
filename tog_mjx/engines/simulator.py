"""The interface that all simulators share, and the one place that knows their names.

A simulator is an immutable set of parameters with three pure functions; everything above them is written once:

    state = simulator.init(box, fingers)      box [6] (x, z, theta, vx, vz, omega), fingers [F, 4] (x, z, vx, vz)
    state = simulator.step(state, setpoints)  setpoints [2F], finger-major; advances by one time step
    box, fingers = simulator.observe(state)

A simulator knows no task. Its parameters are leaves of a pytree, so that a compiled function can take them as an
argument and differentiate with respect to them; its choices of law and differentiation are static. `CHUNK` is the
number of motions that it simulates quickest at a time on one device, and `GRADIENT_CHARGE` the number of evaluations of
J that one gradient with J counts as: what `tog benchmark --section single` measures, rounded up to a half;
`SALTATION_CHARGE` is that of one with the jumps, where there is one.
"""

from collections import ChainMap
from collections.abc import Mapping
from typing import Any, ClassVar, Protocol, runtime_checkable

import jax

from tog_mjx.engines.mjx import MjxSimulator
from tog_mjx.engines.penalty import PenaltySimulator
from tog_mjx.mjcf.scene import Scene
from tog_mjx.running.errors import InputError, require_kind
from tog_mjx.running.names import load_givers
from tog_mjx.running.types import Box, Fingers, Setpoints


@runtime_checkable
class Simulator(Protocol):
    """See the module's header."""

    def init(self, box: Box, fingers: Fingers) -> Any: ...

    def step(self, state: Any, setpoints: Setpoints) -> Any: ...

    def observe(self, state: Any) -> tuple[Box, Fingers]: ...


SIMULATORS: dict[str, Any] = {"mjx": MjxSimulator, "penalty": PenaltySimulator}
"""By name. The paper's room adds its own."""


class CMujoco:
    """C MuJoCo, which moves any scene and is no planar simulator."""

    OPTIONS: ClassVar[dict[str, tuple[str, ...]]] = {"differentiation": ("implicit", "saltation")}
    CHUNK: ClassVar[int] = 64
    GRADIENT_CHARGE: ClassVar[float] = 20.0
    SALTATION_CHARGE: ClassVar[float] = 66.0


AUTO = "auto"
"""In place of an engine's name: the cheaper one of "mjx" and "mujoco"."""
ENGINES: Mapping[str, Any] = ChainMap({"mujoco": CMujoco}, SIMULATORS)
"""What moves a problem, by name: the simulators, and what moves any scene."""


def make_simulator(name: str, scene: Scene, **options: str) -> Simulator:
    """The simulator called `name` of a planar scene.

    It has `init(box, fingers)`, `step(state, setpoints)` and `observe(state)`, of box [6] (x, z, theta, vx, vz, omega),
    fingers [F, 4] (x, z, vx, vz) and setpoints [2F].

    Args:
      name: "mjx", "penalty" or "released".
      options: see `tog.objective`.

    Raises:
      InputError: for an unknown engine, option or value, or a scene that is not planar.

    Units: m, rad, s.
    Gradient: of a step, as `tog.objective` says of its engine.
    Source: as `tog.objective`.
    """
    check_names(name, options, SIMULATORS)
    require_kind("the scene", scene, Scene, "give what tog.load_scene returns")
    # Also inside a transformation the parameters are numbers, not tracers.
    with jax.ensure_compile_time_eval():
        return SIMULATORS[name].from_scene(scene, **options)


def gradient_charge(name: str, differentiation: str | None = None) -> float:
    """Evaluations of J that one gradient of this engine counts as. One that is still to be chosen counts as MJX: no
    choice changes the number of updates.

    Raises:
      InputError: for an unknown engine, or a differentiation that it does not have.
    """
    name = "mjx" if name == AUTO else name
    check_names(name, {"differentiation": differentiation} if differentiation else {})
    simulator = ENGINES[name]
    charge: float = simulator.SALTATION_CHARGE if differentiation == "saltation" else simulator.GRADIENT_CHARGE
    return charge


def precision(simulator: str, **options: str):
    """A context: the precision in which a simulator's numbers are told, float64 unless it says otherwise.

    Raises:
      InputError: for an unknown engine, option or value.
    """
    check_names(simulator, options)
    in_float32 = getattr(ENGINES[simulator], "in_float32", None)
    return jax.enable_x64(in_float32 is None or not in_float32(**options))


def check_names(name: str, options: Mapping[str, str], among: Mapping[str, Any] = ENGINES) -> None:
    """Raises InputError for an unknown engine, option or value."""
    if name not in list(among):
        load_givers()
    if name not in list(among):
        raise InputError(f"engine {name!r} is unknown; choose from {', '.join([*among, *[AUTO] * (among is ENGINES)])}")
    choices = among[name].OPTIONS
    for option, value in options.items():
        if option not in choices:
            raise InputError(
                f"engine {name!r} has no option {option!r}; it takes {' and '.join(choices) or 'no options'}"
            )
        if value not in choices[option]:
            raise InputError(f"{option}={value!r} is unknown; choose from {', '.join(choices[option])}")
