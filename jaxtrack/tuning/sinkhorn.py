"""OSPA and GOSPA with a soft assignment: smooth where the exact ones have a kink, and never far."""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

from jaxtrack.metrics.cutoff import CutoffCosts, cutoff_costs, safe_power
from jaxtrack.numerics.checks import check_array, check_known, check_positive, check_size
from jaxtrack.numerics.masked import masked_logsumexp, masked_sum
from jaxtrack.numerics.safe import safe_log
from jaxtrack.types import Array


class SinkhornDistance(NamedTuple):
    """A smooth distance, and how far the exact one may be from it."""

    distance: Array  # [] in the unit of the cut-off
    bound: Array  # [] |distance − exact one| is at most this; carries no gradient


class _Transport(NamedTuple):
    """What the masses cost, in units of c^p: of everybody together."""

    costs: CutoffCosts
    total: Array  # [] N
    extra: Array  # [] |m − n|
    powered: Array  # [] the smooth optimum
    error: Array  # [] how far the exact one may be


def sinkhorn_ospa(
    estimates: Array,
    estimates_mask: Array,
    truths: Array,
    truths_mask: Array,
    *,
    cutoff: Any,
    order: Any,
    temperature: Any,
    iterations: int = 100,
    existence: Any = None,
) -> SinkhornDistance:
    """Measure OSPA with the assignment smoothed by entropy, of estimates that may exist in part.

    With m estimates (m = Σ r where they exist by shares r), n truths, N = max(m, n, 1),
    C = (min(c, d) / c)^p in [0, 1], a stand-in of cost 1 for each member that one set has less, and
    P over the matrices with row sums a, column sums b:

        distance^p = c^p / N · min_P (Σ P C + T Σ P log(P N / (a bᵀ)))

    At T = 0 that is OSPA, whose optimal P are assignments. The entropy of one is at most N log N,
    and roots of order p ≥ 1 are concave, so

        0 ≤ distance − OSPA ≤ c (T log ⌈N⌉)^(1/p)

    at the minimum. Sinkhorn's iterations come to it from below and miss its p-th power by at most
    c^p e / N, with e the sum of |row sums of P − a|; so after any number of them

        |distance − OSPA| ≤ bound = c max(T log ⌈N⌉, e / N)^(1/p)

    Args:
        estimates: [M, D] points, in the unit of `cutoff`.
        estimates_mask: [M] which of them exist.
        truths: [N, D] points, in the unit of `cutoff`.
        truths_mask: [N] which of them exist.
        cutoff: c > 0.
        order: p ≥ 1.
        temperature: T > 0, of the powered costs in units of c^p. Where it is small, more
            iterations are needed, about 1 / T at the worst.
        iterations: static.
        existence: [M] r in [0, 1], the mass of each estimate; None: 1. OSPA at T = 0 is then the
            optimal transport of the masses, and grows smoothly with the number of estimates.

    Raises:
        ValueError: shapes do not fit, or a known value that cannot be.
        TypeError: not real numbers.

    Example:
        >>> both, points = jnp.ones(2, bool), jnp.asarray([[0.0, 0.0], [3.0, 4.0]])
        >>> moved = points + jnp.asarray([[1.0, 0.0]])
        >>> score = sinkhorn_ospa(points, both, moved, both, cutoff=9.0, order=1.0, temperature=0.01)
        >>> print(f"{score.distance:.3f} within {score.bound:.3f}")  # OSPA is 1
        1.062 within 0.062

    Source:
        M. Cuturi, "Sinkhorn Distances: Lightspeed Computation of Optimal Transport", 2013. The
        error of iterations that are stopped early follows from the dual being concave: it is at
        most half of e times the span of the potentials' error, and potentials span at most 1 each.
    """  # noqa: E501
    found = _transport(
        cutoff_costs(estimates, estimates_mask, truths, truths_mask, cutoff=cutoff, order=order),
        estimates_mask,
        temperature,
        iterations,
        existence,
    )
    return _distance(found, found.powered / found.total, found.error / found.total)


def sinkhorn_gospa(
    estimates: Array,
    estimates_mask: Array,
    truths: Array,
    truths_mask: Array,
    *,
    cutoff: Any,
    order: Any,
    temperature: Any,
    iterations: int = 100,
    existence: Any = None,
) -> SinkhornDistance:
    """Measure GOSPA (α = 2) with the assignment smoothed by entropy, in `sinkhorn_ospa`'s terms.

        distance^p = c^p (min_P (Σ P C + T Σ P log(P N / (a bᵀ))) − |m − n| / 2)

    as a member that the other set has less costs c^p / 2 here and no share of N. At T = 0 that is
    GOSPA, as everybody is assigned at a cost of at most c^p, and else

        |distance − GOSPA| ≤ bound = c max(T N log ⌈N⌉, e)^(1/p)

    Args:
        estimates: [M, D] points, in the unit of `cutoff`.
        estimates_mask: [M] which of them exist.
        truths: [N, D] points, in the unit of `cutoff`.
        truths_mask: [N] which of them exist.
        cutoff: c > 0.
        order: p ≥ 1.
        temperature: T > 0, of the powered costs in units of c^p.
        iterations: static.
        existence: [M] r in [0, 1], the mass of each estimate; None: 1.

    Raises:
        ValueError: shapes do not fit, or a known value that cannot be.
        TypeError: not real numbers.

    Example:
        >>> both, points = jnp.ones(2, bool), jnp.asarray([[0.0, 0.0], [3.0, 4.0]])
        >>> moved = points + jnp.asarray([[1.0, 0.0]])
        >>> score = sinkhorn_gospa(points, both, moved, both, cutoff=9.0, order=1.0, temperature=0.01)
        >>> print(f"{score.distance:.3f} within {score.bound:.3f}")  # GOSPA is 2
        2.125 within 0.125

    Source:
        Cuturi, 2013, as there, for the metric of A. S. Rahmathullah, Á. F. García-Fernández and
        L. Svensson, "Generalized Optimal Sub-Pattern Assignment Metric", 2017.
    """  # noqa: E501
    found = _transport(
        cutoff_costs(estimates, estimates_mask, truths, truths_mask, cutoff=cutoff, order=order),
        estimates_mask,
        temperature,
        iterations,
        existence,
    )
    return _distance(found, found.powered - found.extra / 2, found.error)


def _distance(found: _Transport, powered: Array, error: Array) -> SinkhornDistance:
    root = lambda x: found.costs.cutoff * safe_power(x, 1.0 / found.costs.order)
    return SinkhornDistance(root(powered), jax.lax.stop_gradient(root(error)))


def _transport(
    costs: CutoffCosts, estimates_mask: Array, temperature: Any, iterations: int, existence: Any
) -> _Transport:
    """Return the optimal transport between the sets, smoothed by entropy."""
    check_array("temperature", temperature, shape=())
    iterations = check_size("iterations", iterations)
    dtype = costs.cost.dtype
    temperature = check_positive("temperature", temperature, dtype)

    masses = [mask.astype(dtype) for mask in (costs.estimates_mask, costs.truths_mask)]
    if existence is not None:
        check_array("existence", existence, shape=jnp.shape(estimates_mask))
        check_known("existence", existence, lambda r: (r >= 0) & (r <= 1), "shares from 0 to 1")
        shares = jnp.where(jnp.asarray(estimates_mask, bool), jnp.asarray(existence, dtype), 0.0)
        masses[0] = jnp.pad(shares, (0, masses[0].shape[0] - shares.shape[0]))
    larger = jnp.where(masses[0].sum() > masses[1].sum(), masses[0].sum(), masses[1].sum())
    # Where less than one member is there both sets have stand-ins, for which the corner has cost 0.
    total = jnp.where(larger > 1, larger, 1.0)
    rows, columns = (jnp.append(mass, total - mass.sum()) for mass in masses)
    cost = jnp.pad(costs.cost, ((0, 1), (0, 1)), constant_values=1.0).at[-1, -1].set(0.0)

    def potential(cost: Array, mass: Array, other: Array) -> Array:
        """Return the potentials of one side, of which `cost` has the rows, for the other's."""
        logarithm = safe_log(mass / total) + other / temperature
        exponent = logarithm[None, :] - cost / temperature
        return -temperature * masked_logsumexp(exponent, (mass > 0)[None, :])

    def improve(potentials: tuple[Array, Array], _: None) -> tuple[tuple[Array, Array], None]:
        left = potential(cost, columns, potentials[1])
        return (left, potential(cost.T, rows, left)), None

    start = jnp.zeros_like(rows), jnp.zeros_like(columns)
    (left, right), _ = jax.lax.scan(improve, start, length=iterations)
    powered = masked_sum(rows * left, rows > 0) + masked_sum(columns * right, columns > 0)

    # One more half step moves a row's potential by T log(row sum / mass).
    off = jnp.expm1((left - potential(cost, columns, right)) / temperature)
    missed = masked_sum(rows * jnp.abs(off), rows > 0)
    entropic = temperature * total * jnp.log(jnp.ceil(total))
    return _Transport(
        costs,
        total,
        extra=jnp.abs(masses[0].sum() - masses[1].sum()),
        powered=powered,
        error=jnp.where(missed > entropic, missed, entropic),
    )
