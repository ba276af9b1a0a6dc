"""What moves a problem: MJX and C MuJoCo any scene, planar simulators those of one box and its fingers."""

from tog_mjx.engines.choice import Choice as Choice
from tog_mjx.engines.choice import choose_engine as choose_engine
from tog_mjx.engines.mjx import MjxSimulator as MjxSimulator
from tog_mjx.engines.objective import Objective as Objective
from tog_mjx.engines.objective import objective as objective
from tog_mjx.engines.objective import rollout as rollout
from tog_mjx.engines.penalty import PenaltySimulator as PenaltySimulator
from tog_mjx.engines.program import Motion as Motion
from tog_mjx.engines.simulator import ENGINES as ENGINES
from tog_mjx.engines.simulator import SIMULATORS as SIMULATORS
from tog_mjx.engines.simulator import Simulator as Simulator
from tog_mjx.engines.simulator import check_names as check_names
from tog_mjx.engines.simulator import gradient_charge as gradient_charge
from tog_mjx.engines.simulator import make_simulator as make_simulator
from tog_mjx.engines.simulator import precision as precision
