"""Fuzzy ISODATA: c-means that finds the number of patterns, by merging, deleting and dividing them.

Patterns live in a fixed number of slots with an active mask; the operations on them (`patterns`)
follow each other in a loop of bounded length. They are decisions, locally constant; the gradient is
that of the c-means at the end. How near each pattern came to falling is told by its `survival`.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp

from jaxtrack.clustering.fuzzy_cmeans import check_samples, fuzzy_cmeans, memberships, update
from jaxtrack.clustering.patterns import (
    IsodataParams,
    delete,
    divide,
    merge,
    partition,
)
from jaxtrack.clustering.survival import survival
from jaxtrack.numerics.checks import check_size
from jaxtrack.types import Array


class IsodataSizes(NamedTuple):
    """Lengths of the loops. Static."""

    rounds: int = 8  # of merging, deleting and dividing, at most; the last does not divide
    updates: int = 3  # iterations of c-means before each
    iterations: int = 300  # of the c-means at the end, at most


class Isodata(NamedTuple):
    """What fuzzy ISODATA found."""

    centres: Array  # [K, D] zero in free slots
    active: Array  # [K] which slots hold a pattern
    membership: Array  # [K, N]
    mass: Array  # [K] Σ_j w_j μ_ij
    aggregation: Array  # [K] C_i: the mean membership of a pattern's own samples
    residual: Array  # [] how far the last update moved any centre
    settled: Array  # [] False: patterns were still changing when the rounds ended
    survival: Array  # [K] share by which a pattern stays; 1 where no width was given


def farthest_first(samples: Array, weights: Array, *, mask: Array, clusters: int) -> Array:
    """Return indices of samples to start from, [clusters]: heavy ones, far apart.

    The heaviest is taken first, then always the one of largest w d², d its distance to the nearest
    that is taken; −1 where all places are taken already.

    Args:
        samples: [N, D], N ≥ 1.
        weights: [N] ≥ 0.
        mask: [N] which samples exist.
        clusters: how many to take.

    Raises:
        ValueError: there is no sample.

    Example:
        >>> samples, weights = jnp.array([[0.0], [1.0], [5.0]]), jnp.array([1.0, 3.0, 1.0])
        >>> print(farthest_first(samples, weights, mask=jnp.ones(3, bool), clusters=4))
        [ 1  2  0 -1]
    """
    check_size("number of samples", samples.shape[0])
    clean = jnp.where(mask[:, None], samples, 0.0)
    weights = jnp.where(mask, weights, 0.0)
    far = jnp.full(weights.shape, jnp.inf, weights.dtype)
    taken = []
    for _ in range(clusters):
        score = weights if not taken else weights * far
        best = jnp.argmax(score)
        taken.append(jnp.where(score[best] > 0, best, -1))
        square = ((clean - clean[best][None, :]) ** 2).sum(-1)
        far = jnp.minimum(far, square)
    return jnp.stack(taken)


def isodata(
    samples: Array,
    weights: Array,
    centres: Array,
    *,
    mask: Array | None = None,
    active: Array | None = None,
    params: IsodataParams | None = None,
    tolerance: Array | float = 1e-6,
    sizes: IsodataSizes | None = None,
    width: Array | None = None,
) -> Isodata:
    """Return the patterns of weighted samples by fuzzy ISODATA.

    A round is some iterations of c-means, then combination, then deletion and division by the
    partition that is left. Rounds end when one of them changes no pattern; then c-means is iterated
    to its fixed point, which carries the gradient.

    Args:
        samples: [N, D] in units in which the features compare.
        weights: [N] ≥ 0; a sample of weight w counts as w samples.
        centres: [K, D] where to start; K is also the largest number of patterns.
        mask: [N] which samples exist; all by default.
        active: [K] which of the centres exist; all by default.
        params: parameters; the defaults if None.
        tolerance: the c-means at the end ends when no centre moves farther.
        sizes: lengths of the loops; the defaults if None.
        width: None, or that of the sigmoids in `survival`: there the thresholds have a gradient.

    Raises:
        ValueError: shapes do not fit, a size is too small, a weight is negative, or m ≤ 1.
        TypeError: not real numbers, or a size is not an int.

    Example:
        >>> samples = jnp.array([[0.0], [1.0], [10.0], [11.0]])
        >>> found = isodata(samples, jnp.ones(4), jnp.array([[0.0], [1.0], [10.0]]))
        >>> print(found.active.sum(), found.centres.round(1).ravel())
        2 [ 0.5  0.  10.5]

    Source: clustering-statistic Hough transform (2018), equations 20–37.
    """
    params = IsodataParams() if params is None else params
    sizes = IsodataSizes() if sizes is None else sizes
    for name, value in zip(sizes._fields, sizes, strict=True):
        check_size(f"sizes.{name}", value, at_least=1)
    samples, weights, mask, active = check_samples(samples, weights, centres, mask, active)
    centres = jnp.where(active[:, None], jnp.asarray(centres, samples.dtype), 0.0)

    frozen = jax.lax.stop_gradient((samples, weights, centres, params))
    start, active, settled = _decide(*frozen[:3], active, frozen[3], sizes)
    found = fuzzy_cmeans(
        samples,
        weights,
        jnp.where(active[:, None], start, 0.0),
        mask=mask,
        active=active,
        fuzzifier=params.fuzzifier,
        tolerance=tolerance,
        iterations=sizes.iterations,
    )
    last = partition(samples, weights, found.centres, active, found.membership, params=params)
    mass = (weights[None, :] * found.membership).sum(-1)
    stays = active.astype(mass.dtype)
    if width is not None:
        stays = survival(
            samples, weights, found.centres, active, found.membership, width, params=params
        )
    return Isodata(
        found.centres,
        active,
        found.membership,
        mass,
        last.aggregation,
        found.residual,
        settled,
        stays,
    )


def _decide(
    samples: Array,
    weights: Array,
    centres: Array,
    active: Array,
    params: IsodataParams,
    sizes: IsodataSizes,
) -> tuple[Array, Array, Array]:
    """Return centres, active mask and whether the patterns came to rest."""
    total, fuzzifier = weights.sum(), params.fuzzifier

    def go_on(state: tuple[Array, Array, Array, Array]) -> Array:
        return (state[0] < sizes.rounds) & ~state[3]

    def go(state: tuple[Array, Array, Array, Array]) -> tuple[Array, Array, Array, Array]:
        turn, centres, active, _ = state
        settle = lambda _, z: update(samples, weights, z, active=active, fuzzifier=fuzzifier)
        before = jax.lax.fori_loop(0, sizes.updates, settle, centres)
        mu = memberships(samples, before, active=active, fuzzifier=fuzzifier)
        mass = (weights[None, :] * mu).sum(-1)
        centres, left = merge(before, active, mass, merge_exponent=params.merge_exponent)
        mu = memberships(samples, centres, active=left, fuzzifier=fuzzifier)
        found = partition(samples, weights, centres, left, mu, params=params)
        left = delete(left, total, found, params=params)
        divided, more = divide(centres, left, found, params=params)
        last = turn == sizes.rounds - 1
        centres = jnp.where(last, centres, divided)
        left = jnp.where(last, left, more)
        same = (left == active).all() & ((centres == before) | ~active[:, None]).all()
        return turn + 1, centres, left, same

    begin = jnp.asarray(0, jnp.int32), centres, active, jnp.asarray(False)
    _, centres, active, settled = jax.lax.while_loop(go_on, go, begin)
    return centres, active, settled
