"""Three simulators behind one interface."""

from tog_mjx.engines.mjx import MjxSimulator as MjxSimulator
from tog_mjx.engines.penalty import PenaltySimulator as PenaltySimulator
from tog_mjx.engines.simulator import SIMULATORS as SIMULATORS
from tog_mjx.engines.simulator import Simulator as Simulator
from tog_mjx.engines.simulator import check_names as check_names
from tog_mjx.engines.simulator import gradient_charge as gradient_charge
from tog_mjx.engines.simulator import make_simulator as make_simulator
from tog_mjx.engines.simulator import precision as precision
from tog_mjx.paper.released import ReleasedSimulator as ReleasedSimulator
from tog_mjx.paper.terms import TERMS as TERMS
