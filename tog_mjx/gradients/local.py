"""What J looks like from samples about a point, and how reliable the estimates of its gradient are there.

Arrays in, numbers out: N samples in n dimensions. `normals` are standard normal; the points are u + sigma * normals.
"""

import numpy as np
from jaxtyping import Float

Samples = Float[np.ndarray, "N n"]
Costs = Float[np.ndarray, " N"]
Direction = Float[np.ndarray, " n"]


def zeroth_terms(rises: Costs, normals: Samples, sigma: float) -> Samples:
    """The terms rise * w / sigma^2 whose mean is the zeroth-order estimate, of rises J(u + w) - J(u)."""
    return rises[:, None] * normals / sigma


def signal_to_noise(terms: Samples) -> float:
    """|mean| / sqrt(trace of the covariance) of one term, the mean's own noise subtracted: 0 where it is no longer.

    For zeroth order and a linear J it is 1 / sqrt(n + 1), whatever the slope. Equal terms have an infinite one, and
    zeros have 0.
    """
    signal, noise = np.sum(terms.mean(0) ** 2), terms.var(0, ddof=1).sum()
    if noise == 0:
        return np.inf if signal > 0 else 0.0
    return float(np.sqrt(max(0.0, signal - noise / len(terms)) / noise))


def noise_of_mean(terms: Samples) -> float:
    """Standard error of the mean, relative to its norm; infinite where only the norm is zero."""
    noise, size = np.sqrt(terms.var(0, ddof=1).sum() / len(terms)), np.linalg.norm(terms.mean(0))
    return float(noise / size) if size > 0 else (np.inf if noise > 0 else 0.0)


def cosine(a: Direction, b: Direction) -> float:
    """0 where one of them is zero."""
    size = np.linalg.norm(a) * np.linalg.norm(b)
    return float(a @ b / size) if size > 0 else 0.0


def relative_error(estimate: Direction, truth: Direction) -> float:
    """|estimate - truth| / |truth|; infinite where only the truth is zero."""
    apart, size = float(np.linalg.norm(estimate - truth)), float(np.linalg.norm(truth))
    return apart / size if size > 0 else (np.inf if apart > 0 else 0.0)


def flatness(costs: Costs, cost: float, level: float) -> float:
    """The share of samples that differ from the middle by less than `level`."""
    return float(np.mean(np.abs(costs - cost) < level))


def roughness(costs: Costs, normals: Samples) -> float:
    """Standard deviation about the linear fit over that about the mean: 0 for a linear J, 1 where no slope helps."""
    spread = costs.std()
    design = np.column_stack([np.ones(len(costs)), normals])
    rest = costs - design @ np.linalg.lstsq(design, costs, rcond=None)[0]
    return float(np.sqrt(np.mean(rest**2)) / spread) if spread > 0 else 0.0


def steepness(gradients: Samples) -> float:
    """Largest norm over the median one."""
    norms = np.linalg.norm(gradients, axis=1)
    median = np.median(norms)
    return float(norms.max() / median) if median > 0 else (np.inf if norms.max() > 0 else 1.0)


def stepped(u: Direction, directions: Float[np.ndarray, "*batch n"], length: float) -> Float[np.ndarray, "*batch n"]:
    """u after a step of that length against each direction; u itself where that is zero or not finite."""
    size = np.linalg.norm(directions, axis=-1, keepdims=True)
    is_good = np.isfinite(size) & (size > 0)
    return u - length * np.where(is_good, directions / np.where(is_good, size, 1.0), 0.0)


def beaten(gain: float, rivals: Costs) -> float:
    """The share of rivals that gain less; equal ones count half."""
    return float(np.mean(gain > rivals) + np.mean(gain == rivals) / 2)
