"""Which gradient to follow from a point: the exact one, or an average over perturbations? The estimators, compared.

At each scale sigma the variables, in units of their own scales, are perturbed by w ~ N(0, sigma^2 I). The mean of
antithetic zeroth-order terms over many w is the gradient of the smoothed J_sigma(u) = E J(u + w), unbiased also where J
jumps; the exact gradient and the mean of exact gradients at perturbed points are held against it. Then a step as long
as a typical w is tried against each: which lowers J most, for what 8 exact gradients cost?
"""

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import jax
import numpy as np
from jaxtyping import Array, Float

from tog_mjx.checks.measured.cost import seconds_of
from tog_mjx.checks.measured.jumps import Jumps, lacks
from tog_mjx.checks.step_check import compile_quickly
from tog_mjx.checks.told.finding import Finding, Level
from tog_mjx.gradients import Objective, exact_batch, local
from tog_mjx.gradients.exact import FORWARD_LIMIT
from tog_mjx.gradients.reversible import is_reversible
from tog_mjx.running.batches import call_in_chunks

SIGMAS = (1e-3, 1e-2, 1e-1)
"""Of a large displacement: what a descent of a thousand steps, of a hundred and of ten takes at a time."""
SAMPLES, PAIRS, AVERAGED = 64, 256, 8
"""Gradients and pairs of values at each sigma; gradients in one first-order estimate."""
REVERSE_CHARGE = 4
"""Values that a gradient in reverse mode counts for, whatever the number of variables: 3.4 to 4 were measured on all
simulators. In forward mode it is one value, and one more for each variable. What a machine takes at the moment decides
nothing."""
_CHUNK = 8
"""Gradients at a time: reverse mode keeps the whole motion of each."""
_NEARLY = 0.95
"""An average that gains less than a twentieth more than the exact gradient is not worth its eightfold cost."""
_SURE = 4
"""Standard errors from which on a difference is one: in one dimension chance makes it once in 16,000 times."""
_BIASED = 0.1
"""An error of the mean of first order that is told, if it is not noise: a smaller one costs a descent nothing, as a
step along it is off by 6 degrees at most."""
NAMES = ("exact", "first order", "zeroth order")
_MEANT = {"exact": "the exact gradient", "first order": "the mean of exact gradients nearby (first order)"}
_MEANT |= {"zeroth order": "zeroth order", "none": "none (no step lowers it)"}
_MEANT |= {"unknown": "what cannot be told (the smoothed gradient is not resolved from zero)"}

_CURVES = {
    "snr_zeroth": "signal-to-noise, zeroth order",
    "snr_first": "signal-to-noise, first order",
    "bias_exact": "error, exact",
    "bias_first": "error, first order",
    "noise": "error not resolved",
    "variance_zeroth": "variance, zeroth order",
    "variance_first": "variance, first order",
    "exact_wins": "share of zeroth-order draws that gain less than exact",
}

Batch = Callable[[Float[np.ndarray, "N n"]], np.ndarray]


class Comparison(NamedTuple):
    """At one sigma: signal-to-noise and variance of one sample; errors of the exact gradient and of the mean of first
    order, and the standard errors of the smoothed gradient and of that mean, all relative to the smoothed gradient;
    gains of a step by NAMES (of averages the mean over draws); and the share of zeroth-order draws that gain less than
    the exact gradient."""

    snr_zeroth: float
    snr_first: float
    variance_zeroth: float
    variance_first: float
    bias_exact: float
    bias_first: float
    noise: float
    noise_first: float
    gains: dict[str, float]
    exact_wins: float

    @property
    def is_resolved(self) -> bool:
        """Whether the smoothed gradient is told from zero; if not, nothing can be said against any other."""
        return self.noise <= 1 / _SURE

    @property
    def follow(self) -> str:
        """One of NAMES, none or unknown."""
        return self.best_of(NAMES)

    def best_of(self, names: Sequence[str]) -> str:
        """Which of these to follow, or none, or unknown."""
        if not self.is_resolved:
            return "unknown"
        best = max(names, key=lambda name: self.gains[name])
        if not self.gains[best] > 0:
            return "none"
        return "exact" if "exact" in names and self.gains["exact"] >= _NEARLY * self.gains[best] else best

    @property
    def is_blind(self) -> bool:
        """Whether first order misses some of the smoothed gradient: where J jumps, or rises so steeply that none of the
        gradients has met the rise."""
        noise = float(np.hypot(self.noise, self.noise_first))
        return self.is_resolved and self.bias_first > max(_BIASED, _SURE * noise)


def batch_of_gradients(J: Objective, n: int) -> tuple[Batch, int]:
    """The gradients [N, n] of J at points [N, n], and the values of J that one of them counts for; in forward mode
    where variables are few, or reverse mode refuses."""
    batch, charge = exact_batch(J), 1 + n
    if n > FORWARD_LIMIT and is_reversible(J, n):
        batch, charge = jax.vmap(jax.value_and_grad(J)), REVERSE_CHARGE
    run = compile_quickly(batch)
    return lambda points: call_in_chunks(run, points, _CHUNK)[1], charge


def compare_at(values: Batch, gradients: Batch, n: int, sigma: float, charge: int) -> Comparison:
    """The estimators of the gradient at 0, with `values` [N] and `gradients` [N, n] of points [N, n].

    Args:
      charge: evaluations of J that an exact gradient counts for.
    """
    normals = np.random.default_rng(0).normal(size=(PAIRS, n))
    costs = values(np.concatenate([np.zeros((1, n)), sigma * normals, -sigma * normals]))
    slopes = gradients(np.concatenate([np.zeros((1, n)), sigma * normals[:SAMPLES]]))
    (cost, ahead, behind), exact = np.split(costs, [1, 1 + PAIRS]), slopes[0]
    terms = local.zeroth_terms(np.concatenate([ahead, behind]) - cost, np.concatenate([normals, -normals]), sigma)
    symmetric = _least_noisy(ahead, behind, normals, sigma, exact)
    smooth, first = symmetric.mean(0), slopes[1:]
    # Both halves of a pair never serve in the same estimate, nor in signal-to-noise: they are not independent.
    number = min(AVERAGED * charge, PAIRS)
    draws = terms.reshape(2, PAIRS, n)[:, : PAIRS // number * number].reshape(-1, number, n).mean(1)
    ways = np.concatenate([exact[None], first.reshape(-1, AVERAGED, n).mean(1), draws])
    gains = cost - values(local.stepped(np.zeros(n), ways, sigma * n**0.5))
    of_first, of_zeroth = np.split(gains[1:], [SAMPLES // AVERAGED])
    return Comparison(
        snr_zeroth=local.signal_to_noise(terms[:PAIRS]),
        snr_first=local.signal_to_noise(first),
        variance_zeroth=float(terms[:PAIRS].var(0, ddof=1).sum()),
        variance_first=float(first.var(0, ddof=1).sum()),
        bias_exact=local.relative_error(exact, smooth),
        bias_first=local.relative_error(first.mean(0), smooth),
        noise=local.noise_of_mean(symmetric),
        noise_first=float((first.var(0, ddof=1).sum() / SAMPLES) ** 0.5 / (np.linalg.norm(smooth) or np.inf)),
        gains=dict(zip(NAMES, (float(gains[0]), float(of_first.mean()), float(of_zeroth.mean())), strict=True)),
        exact_wins=local.beaten(float(gains[0]), of_zeroth),
    )


def _least_noisy(ahead: np.ndarray, behind: np.ndarray, normals: np.ndarray, sigma: float, exact: np.ndarray):
    """Antithetic terms [N, n] whose mean is the smoothed gradient: plain, or with the linear part, whose smoothed
    gradient is known, taken out of J beforehand."""
    rises = (ahead - behind) / 2
    plain = local.zeroth_terms(rises, normals, sigma)
    controlled = exact + local.zeroth_terms(rises - sigma * normals @ exact, normals, sigma)
    return controlled if local.noise_of_mean(controlled) < local.noise_of_mean(plain) else plain


def compare_estimators(values: Batch, J: Objective, n: int, name: str, lacks_jumps: bool = False) -> Finding:
    """Which gradient to follow at each of SIGMAS, of J [n] with `values` [N]; `name` is that of the number to lower.

    Args:
      lacks_jumps: the gradient of J is known not to be the slope of J, see `checks.measured.jumps`: neither it nor a
        mean of others like it is advised, however much a step along it may gain here.
    """
    gradients, charge = batch_of_gradients(J, n)
    found = [compare_at(values, gradients, n, sigma, charge) for sigma in SIGMAS]
    curves: dict[str, Any] = {"sigma": list(SIGMAS)}
    for name_of, curve in _CURVES.items():
        curves[curve] = [getattr(some, name_of) for some in found]
    for way in NAMES:
        curves[f"gain, {way}"] = [some.gains[way] for some in found]
    follow = [some.best_of(NAMES[2:] if lacks_jumps else NAMES) for some in found]
    sentence = (
        f"to lower {name} follow {_told(follow)} (at a cost of {AVERAGED} gradients, each counted as {charge} values; "
        f"{_measured_charge(values, gradients, n):.2g} were measured); "
        f"at perturbations of {_listed(SIGMAS)} of a large one a sample's signal-to-noise is "
        f"{_listed(some.snr_zeroth for some in found)} in zeroth order and {_listed(some.snr_first for some in found)} "
        f"in first, and the exact gradient is off the smoothed one by {_listed(some.bias_exact for some in found)} of "
        f"it (known to {_listed(some.noise for some in found)})"
    )
    remedy = "average values over perturbations: tog_mjx.gradients.zeroth_order"
    if lacks_jumps:
        remedy = f"differentiate with differentiation='saltation', or {remedy}"
    if blind := [some for some in zip(SIGMAS, found, strict=True) if some[1].is_blind]:
        sigma, first = blind[0]
        told = (
            f"within perturbations of {sigma:.2g} the value jumps, or rises more steeply than {SAMPLES} gradients can "
            f"see: their mean is off the smoothed gradient by {first.bias_first:.2g} of it"
        )
        return Finding("estimators", Level.CARE, f"{told}; {sentence}", first.bias_first, remedy, curves)
    if not lacks_jumps and ("exact" in follow or set(follow) <= {"none", "unknown"}):
        return Finding("estimators", Level.FINE, sentence, found[0].exact_wins, "", curves)
    told = "lacks the jumps, see 'agreement'" if lacks_jumps else "is a poor guide here"
    sentence = f"the exact gradient {told}: {sentence}"
    return Finding("estimators", Level.CARE, sentence, found[0].exact_wins, remedy, curves)


def which_to_follow(
    values: Callable[[Float[np.ndarray, "N n"]], Float[np.ndarray, "N m"]],
    function: Callable[[Float[Array, " n"]], Float[Array, " m"]],
    x: Float[np.ndarray, " n"],
    scale: Float[np.ndarray, " n"],
    slopes: Float[np.ndarray, "m k"],
    jumps: Jumps | None,
    names: Sequence[str],
) -> Finding:
    """`compare_estimators` at x, with perturbations of that scale, of that of m outputs whose derivative is largest, or
    lacks jumps; `values` are those of the function at many points."""
    missed = lacks(slopes, jumps)
    i = jumps.entry[0] if jumps and missed else int(np.linalg.norm(slopes, axis=1).argmax())
    return compare_estimators(
        lambda points: np.asarray(values(x + scale * points), float)[:, i],
        lambda z: function(x + scale * z)[i],
        len(x),
        names[i],
        missed,
    )


def _told(follow: list[str]) -> str:
    """What to follow, by the scale of the step."""
    if len(set(follow)) == 1:
        return f"{_MEANT[follow[0]]} at every scale tried"
    scales = {way: [sigma for sigma, some in zip(SIGMAS, follow, strict=True) if some == way] for way in follow}
    return "; ".join(f"{_MEANT[way]} over steps of {_listed(some)}" for way, some in scales.items())


def _listed(numbers: Any) -> str:
    return ", ".join(f"{number:.2g}" for number in numbers)


def _measured_charge(values: Batch, gradients: Batch, n: int) -> float:
    """Values that take as long as a gradient, on this machine; earlier calls have compiled."""
    points = np.zeros((SAMPLES, n))
    of_values, of_gradients = (seconds_of(batch, points) for batch in (values, gradients))
    return of_gradients / of_values
