"""Which pairs agree on one alignment: consensus without a threshold to choose.

The a-contrario criterion (Moisan and Stival 2004; Moulon, Monasse and Marlet 2012) asks of every
hypothesis and every radius r how many agreeing pairs chance alone would give: for k of n pairs within
r, with samples of s pairs and an image area a,

    NFA = (n - s) C(n, k) C(k, s) (pi r^2 / a)^(k - s)

The hypothesis and radius with the smallest NFA win, and an NFA that is not small is a refusal: pairs
that agree no better than random ones never become a calibration.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from itertools import combinations
from math import comb
from typing import TypeVar

import numpy as np
from scipy.special import gammaln

from ..model.arrays import BoolArray, Float64Array, IndexArray

Model = TypeVar("Model")

#: log10 of the largest number of false alarms that counts as agreement.
SIGNIFICANT = -3.0
#: Fewer than this share of the pairs agreeing is a refusal: the others might be the right ones.
SMALLEST_SHARE = 0.55
_HYPOTHESES = 700
_FAR_PX = 1e300
_EXHAUSTIVE = 700
_SCORED_POINTS = 400


@dataclass(frozen=True, eq=False)
class Consensus:
    """The pairs that agree, the radius in pixels within which they do, and how unlikely that is by chance."""

    inliers: BoolArray
    radius_px: float
    log10_nfa: float

    @property
    def significant(self) -> bool:
        """Whether chance is ruled out and at least `SMALLEST_SHARE` of the pairs agree."""
        return self.log10_nfa < SIGNIFICANT and self.inliers.mean() >= SMALLEST_SHARE


def samples(count: int, size: int, seed: int = 0) -> IndexArray:
    """Return index samples, shape (M, size): every one where there are few, random ones otherwise."""
    if comb(count, size) <= _EXHAUSTIVE:
        return np.array(list(combinations(range(count), size)), dtype=np.intp)
    rng = np.random.default_rng(seed)
    return np.array([rng.choice(count, size, replace=False) for _ in range(_HYPOTHESES)], dtype=np.intp)


def score(residuals_px: Float64Array, sample_size: int, area: float, largest_px: float = np.inf) -> Consensus:
    """Choose the best hypothesis' inliers by the number of false alarms.

    Parameters
    ----------
    residuals_px : float64, shape (N,)
        Distances of one hypothesis; not finite counts as far away.
    sample_size : int
    area : float
        Area in which wrong partners may lie, pixels squared.
    largest_px : float
        Pairs farther off never agree, however many they are.
    """
    count = len(residuals_px)
    order = np.argsort(residuals_px)
    k = np.arange(sample_size + 1, count + 1)
    if len(k) == 0:
        return Consensus(np.ones(count, bool), float(residuals_px.max()), -np.inf)
    radius = residuals_px[order[k - 1]]
    with np.errstate(divide="ignore", invalid="ignore"):
        chance = np.log(np.clip(np.pi * radius**2 / area, 1e-300, 1.0))
    log_nfa = (
        np.log(count - sample_size)
        + _log_binomial(count, k)
        + _log_binomial(k, sample_size)
        + (k - sample_size) * np.where(radius <= min(largest_px, _FAR_PX), chance, 0.0)
    )
    best = int(np.argmin(log_nfa))
    inliers = np.zeros(count, bool)
    inliers[order[: k[best]]] = True
    return Consensus(inliers, float(radius[best]), float(log_nfa[best] / np.log(10)))


def find_consensus(
    count: int,
    sample_size: int,
    area: float,
    hypotheses: Callable[[IndexArray], list[Model]],
    residuals_px: Callable[[Model], Float64Array],
    refit: Callable[[BoolArray], Model | None],
    first: list[Model],
    largest_px: float = np.inf,
) -> tuple[Consensus, Model] | None:
    """Search for the hypothesis with the fewest false alarms and polish it by refitting.

    Parameters
    ----------
    count : int
        Number of pairs.
    hypotheses : callable
        Index samples (M, sample_size) to models; degenerate samples give none.
    residuals_px : callable
        Distances (N,) of every pair from a model.
    refit : callable
        Inliers to a model, or None where they determine none.
    first : list
        Models to try beside the sampled ones.
    largest_px : float
        See `score`.

    Returns
    -------
    Consensus and model, or None where no sample determines a model.
    """
    some = np.arange(count)
    if count > _SCORED_POINTS:
        some = np.random.default_rng(1).choice(count, _SCORED_POINTS, replace=False)
    models = [*first, *hypotheses(some[samples(len(some), sample_size)])]
    ranked = [(score(residuals_px(model)[some], sample_size, area, largest_px).log10_nfa, model) for model in models]
    if not ranked:
        return None
    ranked.sort(key=lambda entry: entry[0])
    best: tuple[Consensus, Model] | None = None
    for _, model in ranked[:5]:
        found = _polish(model, sample_size, area, residuals_px, refit, largest_px)
        if best is None or found[0].log10_nfa < best[0].log10_nfa:
            best = found
    return best


def _polish(
    model: Model,
    sample_size: int,
    area: float,
    residuals_px: Callable[[Model], Float64Array],
    refit: Callable[[BoolArray], Model | None],
    largest_px: float,
) -> tuple[Consensus, Model]:
    best = score(residuals_px(model), sample_size, area, largest_px)
    for _ in range(5):
        candidate = refit(best.inliers)
        if candidate is None:
            break
        found = score(residuals_px(candidate), sample_size, area, largest_px)
        if not found.log10_nfa < best.log10_nfa:
            break
        best, model = found, candidate
    return best, model


def _log_binomial(n: float | IndexArray, k: float | IndexArray) -> Float64Array:
    n, k = np.asarray(n, dtype=np.float64), np.asarray(k, dtype=np.float64)
    return np.asarray(gammaln(n + 1) - gammaln(k + 1) - gammaln(n - k + 1))
