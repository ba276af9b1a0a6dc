"""Gradient estimators: function transformers with one signature.

Each takes an objective J: u [n] -> scalar and returns `estimate(key, u) -> (J(u), gradient [n])`, which knows nothing
else of the problem. A deterministic estimator ignores the key.
"""

from tog_mjx.gradients.estimator import Estimator as Estimator
from tog_mjx.gradients.estimator import Objective as Objective
from tog_mjx.gradients.exact import exact as exact
from tog_mjx.gradients.exact import exact_batch as exact_batch
from tog_mjx.gradients.stochastic import stochastic as stochastic
