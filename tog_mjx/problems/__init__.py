"""A problem: a model, a start or many, variables and a cost; any engine moves it, see `tog_mjx.problems.problem`."""

from tog_mjx.problems.planes import Plane as Plane
from tog_mjx.problems.policy import Policy as Policy
from tog_mjx.problems.problem import Problem as Problem
from tog_mjx.problems.starts import Starts as Starts
from tog_mjx.problems.state import State as State
from tog_mjx.problems.variables import Controls as Controls
from tog_mjx.problems.variables import Parameters as Parameters
from tog_mjx.problems.variables import Start as Start
from tog_mjx.problems.variables import Variables as Variables
