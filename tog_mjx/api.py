"""The public names, as `import tog_mjx as tog` gives them."""

from tog_mjx.checks.function_verdict import check as check
from tog_mjx.checks.scene_verdict import check_scene as check_scene
from tog_mjx.drawing.viewing.film import film as film
from tog_mjx.engines import Motion as Motion
from tog_mjx.engines import make_simulator as make_simulator
from tog_mjx.engines import objective as objective
from tog_mjx.engines import rollout as rollout
from tog_mjx.mjcf.parameter import Parameter as Parameter
from tog_mjx.mjcf.scene import Scene as Scene
from tog_mjx.mjcf.scene import load_scene as load_scene
from tog_mjx.paper.tasks import Task as Task
from tog_mjx.paper.tasks import get_task as get_task
from tog_mjx.problems import Controls as Controls
from tog_mjx.problems import Parameters as Parameters
from tog_mjx.problems import Plane as Plane
from tog_mjx.problems import Policy as Policy
from tog_mjx.problems import Problem as Problem
from tog_mjx.problems import Start as Start
from tog_mjx.problems import Starts as Starts
from tog_mjx.problems import State as State
from tog_mjx.running.errors import InputError as InputError
from tog_mjx.running.older_names import older_names as _older_names
from tog_mjx.solving.solve import solve as solve
from tog_mjx.stepping.converged import converged as converged
from tog_mjx.stepping.converged import solver_error as solver_error
from tog_mjx.stepping.implicit import step as step
from tog_mjx.stepping.simulate import simulate as simulate
from tog_mjx.studies.landscape import landscape as landscape

__getattr__ = _older_names("tog_mjx", {"Trajectory": Motion})
