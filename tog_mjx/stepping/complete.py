"""All that MJX computes of a state, and what it leaves out."""

from tog_mjx.stepping._mjx import constraint_rows, mjx
from tog_mjx.stepping.implicit import FORWARDS


def complete(model: mjx.Model, data: mjx.Data, differentiation: str) -> mjx.Data:
    """`data` with all that MJX computes of its state and inputs: poses, forces, accelerations, sensors, and the bodies'
    forces and momenta. Under jit what is not read of it costs nothing."""
    return completed(model, FORWARDS[differentiation](model, data))


def completed(model: mjx.Model, data: mjx.Data) -> mjx.Data:
    """As `complete`, of data on which `forward` has been called."""
    if constraint_rows(data).jacobian.size == 0:
        data = mjx.sensor_acc(model, data)  # Which MJX leaves out where nothing can touch.
    return mjx.subtree_vel(model, mjx.rne_postconstraint(model, data))
