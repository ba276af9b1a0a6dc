"""tog_mjx: exact against stochastic gradients through contact, on MuJoCo MJX."""

from tog_mjx import _mujoco as _mujoco  # First of all: what follows imports MuJoCo.
from tog_mjx.checks.function import check as check
from tog_mjx.checks.scene import check_scene as check_scene
from tog_mjx.converged import converged as converged
from tog_mjx.converged import solver_error as solver_error
from tog_mjx.errors import InputError as InputError
from tog_mjx.implicit import step as step
from tog_mjx.parameter import Parameter as Parameter
from tog_mjx.problems import Controls as Controls
from tog_mjx.problems import Parameters as Parameters
from tog_mjx.problems import Policy as Policy
from tog_mjx.problems import Problem as Problem
from tog_mjx.problems import Start as Start
from tog_mjx.problems import Starts as Starts
from tog_mjx.problems import State as State
from tog_mjx.rollout import Trajectory as Trajectory
from tog_mjx.rollout import objective as objective
from tog_mjx.rollout import rollout as rollout
from tog_mjx.scene import Scene as Scene
from tog_mjx.scene import load_scene as load_scene
from tog_mjx.simulate import simulate as simulate
from tog_mjx.simulators import make_simulator as make_simulator
from tog_mjx.solve import solve as solve
from tog_mjx.tasks import Task as Task
from tog_mjx.tasks import get_task as get_task
