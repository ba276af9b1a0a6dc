"""Three simulators behind one interface."""

from tog_mjx.simulators.mjx import MjxSimulator as MjxSimulator
from tog_mjx.simulators.penalty import PenaltySimulator as PenaltySimulator
from tog_mjx.simulators.released import ReleasedSimulator as ReleasedSimulator
from tog_mjx.simulators.simulator import SIMULATORS as SIMULATORS
from tog_mjx.simulators.simulator import Simulator as Simulator
from tog_mjx.simulators.simulator import check_names as check_names
from tog_mjx.simulators.simulator import gradient_charge as gradient_charge
from tog_mjx.simulators.simulator import make_simulator as make_simulator
from tog_mjx.simulators.simulator import precision as precision
from tog_mjx.simulators.terms import TERMS as TERMS
