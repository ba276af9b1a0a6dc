"""What to say where a scene passes the preflight, and its motion cannot be computed all the same."""

import jax
import mujoco

from tog_mjx.checks.told.finding import Finding, Level
from tog_mjx.mjcf.supported import step_failure


def failure(model: mujoco.MjModel, error: Exception) -> Finding | None:
    """The finding where memory does not suffice or MJX fails; None for any other error, which is one of this program.

    Args:
      error: what the computation of the motion, with its derivatives, has raised.
    """
    if isinstance(error, jax.errors.JaxRuntimeError) and "RESOURCE_EXHAUSTED" in str(error):
        told = str(error).partition("RESOURCE_EXHAUSTED:")[2].strip().splitlines()
        sentence = f"the motion with its derivatives does not fit into memory: {told[0] if told else 'it gives out'}"
        remedy = "give meshes that collide a small maxhullvert, or collide fewer geoms, or primitives"
    elif why := step_failure(model):
        sentence, remedy = f"MJX cannot step this scene: {why}", "remove what the message speaks of"
    else:
        return None
    return Finding("motion", Level.FAULT, sentence, None, remedy)
