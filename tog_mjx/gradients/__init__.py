"""Gradient estimators: function transformers with one signature.

Each takes an objective J: u [n] -> scalar and returns `estimate(key, u) -> (J(u), gradient [n])`, which knows nothing
else of the problem. A deterministic estimator ignores the key.
"""

from tog_mjx.gradients.alpha_order import alpha_order as alpha_order
from tog_mjx.gradients.alpha_order import alpha_order_mix as alpha_order_mix
from tog_mjx.gradients.alpha_order import bernstein_radius as bernstein_radius
from tog_mjx.gradients.both_orders import Mix as Mix
from tog_mjx.gradients.common_starts import common_starts as common_starts
from tog_mjx.gradients.differences import central_differences as central_differences
from tog_mjx.gradients.estimator import Estimator as Estimator
from tog_mjx.gradients.estimator import Objective as Objective
from tog_mjx.gradients.exact import exact as exact
from tog_mjx.gradients.exact import exact_batch as exact_batch
from tog_mjx.gradients.first_order import first_order as first_order
from tog_mjx.gradients.mixed import mix as mix
from tog_mjx.gradients.mixed import mixed as mixed
from tog_mjx.gradients.stochastic import stochastic as stochastic
from tog_mjx.gradients.zeroth_order import zeroth_order as zeroth_order
