"""What the checks read of a motion, and what they ask of whoever runs one.

motion = recorder.run()              that of the scene function
finer = recorder.run(recorder.changed({"opt.timestep": 0.001}), steps=200)
values = recorder.values(points)     y at displacements x
"""

import abc
from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Array, Float

from tog_mjx.checks.measured.agreement import REMEDY
from tog_mjx.problems.scene_function import SceneFunction

SAMPLES = 100
"""Times at which a motion is recorded."""
QUANTITIES = ("collision", "smooth dynamics", "constraints", "solver", "integrator")
"""Stages of a step, in their order."""
NEVER = np.iinfo(np.int32).max
"""The step of what does not happen."""


class Motion(NamedTuple):
    """Of S samples, k directions of the variables and s of the initial state.

    value [m], slopes [m, k]; `bad_value` and `bad_slope` [Q] are the first steps at which a quantity or its derivative
    is not finite, by QUANTITIES, or NEVER; of a step as a whole [1]. `times` [S] are steps, and `states` [S, ...] the
    states there, by `tog_mjx.stepping.mjx_state.STATE`; `moved` [S, k] the norms of the state's derivative along the
    directions; `jacobians` [S, 2 nv + na, s] that of the state in the initial one, both in velocity space.
    Over the motion: the least distance [C] of each candidate contact, of the surfaces and less the margin (below zero
    there is a force); the step of it, and the geoms [C, 2]; and how far the solver's answers are from the exact ones,
    at most, relative to the acceleration.
    """

    value: np.ndarray
    slopes: np.ndarray
    bad_value: np.ndarray
    bad_slope: np.ndarray
    times: np.ndarray
    moved: np.ndarray
    jacobians: np.ndarray
    states: dict[str, np.ndarray]
    distance: np.ndarray
    distance_step: np.ndarray
    geoms: np.ndarray
    correction: np.ndarray

    def at(self, sample: int | np.integer) -> dict[str, Any]:
        """One of the states."""
        return {name: values[sample] for name, values in self.states.items()}


class Recorder(abc.ABC):
    """A scene function, and `directions` [n, k] of its variables, on an engine with models of its own kind."""

    scene: SceneFunction
    directions: Float[np.ndarray, "n k"]
    model: Any
    engine: str
    remedy: str = REMEDY
    """Of a gradient that differences contradict."""

    @abc.abstractmethod
    def run(self, model: Any = None, steps: int | None = None, start: dict[str, Any] | None = None) -> Motion:
        """The motion of another model (its numbers may differ), of so many steps, from another state."""

    @abc.abstractmethod
    def values(self, points: Float[np.ndarray, "N n"]) -> Float[np.ndarray, "N m"]:
        """y at displacements x."""

    @abc.abstractmethod
    def value(self, x: Float[Array, " n"]) -> Float[Array, " m"]:
        """y at a displacement: a JAX function, differentiable in both modes."""

    @abc.abstractmethod
    def changed(self, numbers: Mapping[str, Any]) -> Any:
        """The model with other numbers in some of its fields, as "opt.timestep"."""

    @abc.abstractmethod
    def displaced(self, x: Float[np.ndarray, " n"]) -> tuple[Any, dict[str, Any]]:
        """The model, and the start's state and inputs by name, at a displacement."""

    @abc.abstractmethod
    def differentiated(self, differentiation: str) -> Motion:
        """The same motion, differentiated otherwise."""
