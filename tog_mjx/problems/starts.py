"""Many starts: a problem's cost is then their mean."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, fields

import jax
from jaxtyping import Array, Key

from tog_mjx.mjcf.moved import MovedModel
from tog_mjx.problems.wrt import Model
from tog_mjx.running.errors import InputError, near, require_kind, require_whole
from tog_mjx.stepping.mjx_state import START


@dataclass(frozen=True)
class Starts:
    """Starts drawn at random, `count` of them at a time.

    Args:
      sample: `key -> {name: array}`, of `qpos`, `qvel`, `act`, `mocap_pos` and `mocap_quat`, and of fields of
        `mjx.Model` (domain randomisation), such as
        `{"qpos": qpos0 + 0.05 * jax.random.normal(key, [nq]), "body_mass": ...}`. What it leaves out is the problem's.
      count: starts of one evaluation.

    Raises:
      InputError: for a sample that is no function, or a count that is no positive number.

    Units: the model's, SI where it is.
    Gradient: in the problem's variables, as that of `tog.objective`; what is drawn is constant.
    """

    sample: Callable[[Key[Array, ""]], Mapping[str, Array]]
    count: int

    def __post_init__(self):
        require_kind("sample", self.sample, Callable, "give a function of a key")
        require_whole("count", self.count, 1)

    def draw(self, key: Key[Array, ""], count: int, model: Model, start: dict[str, Array]) -> tuple[dict, dict]:
        """So many starts and changes of the model, as arrays with a leading axis.

        Raises:
          InputError: for a name that is neither the start's nor the model's, or a shape that is not its own.
        """
        drawn = dict(jax.vmap(self.sample)(jax.random.split(key, count)))
        shapes = {**_shapes(model), **{name: start[name].shape for name in START}}
        for name, value in drawn.items():
            if name not in shapes:
                choices = [*START, *sorted(shapes)]
                raise InputError(
                    f"a start has no {name}; give {', '.join(START)} or a field of mjx.Model{near(name, choices)}"
                )
            if value.shape[1:] != shapes[name]:
                raise InputError(f"the starts' {name} has the shape {list(value.shape[1:])}; give {list(shapes[name])}")
        return {name: drawn.pop(name) for name in START if name in drawn}, drawn


def _shapes(model: Model) -> dict[str, tuple[int, ...]]:
    """Of the fields that may be drawn."""
    if isinstance(model, MovedModel):
        return model.shapes
    found = {field.name: getattr(model, field.name) for field in fields(model)}
    return {name: value.shape for name, value in found.items() if isinstance(value, jax.Array)}
