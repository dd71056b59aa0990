"""Peaks of an accumulation, the same for every method.

Greedy non-maximum suppression: take the largest value, silence everything within the separation,
repeat. Then each peak moves to the weighted mean of the votes nearby; one that lands within the
separation of a stronger peak is that one, and falls away. What is left gets the detections that lie
close to its line. `extract` reads votes at parameter points; `extract_dense` is the same on an
accumulator with a value a cell.
"""

from collections.abc import Callable
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from jaxtrack.hough.grid import Grid, Sizes, centre_of, steps
from jaxtrack.hough.votes import VoteKernel, Votes, evaluate, upper_bound
from jaxtrack.models.line import line_difference, point_line_distance, wrap_line
from jaxtrack.numerics.checks import check_known, check_positive
from jaxtrack.numerics.safe import safe_divide
from jaxtrack.types import Array, Lines, Scan

RowReader = Callable[[Array], Array]
"""Rows [B, n_ρ] of an accumulator by their indices [B]."""

BLOCK = 64  # rows that are read at a time: a block stays in the cache


class Peaks(NamedTuple):
    """Settings of the extractor. Traced."""

    separation_rho_m: Array | float = 102.0  # two lines are one when nearer than this …
    separation_theta_rad: Array | float = 0.1003  # … and than this
    gate: Array | float = 0.0  # lines with fewer votes are masked out
    member_m: Array | float = 30.0  # how near a line a detection belongs to it


def check_extraction(grid: Grid, peaks: Peaks) -> None:
    """Check what is known of a grid and of an extractor's settings.

    Raises:
        ValueError: a length or an angle is not positive, or the gate is no number.

    Example:
        >>> check_extraction(Grid(), Peaks())
    """
    dtype = jnp.result_type(float)
    check_positive("grid.rho_max_m", grid.rho_max_m, dtype)
    for name in ("separation_rho_m", "separation_theta_rad", "member_m"):
        check_positive(f"peaks.{name}", getattr(peaks, name), dtype)
    check_known("peaks.gate", peaks.gate, lambda x: x == x, "a number")


class HoughInfo(NamedTuple):
    """What people look at."""

    relative_votes: Array  # [M] votes over the largest votes (equation 32)
    members: Array  # [M, K, N] detections that belong to a line
    overflow: Array  # [] a table was too small: the result may lack candidates
    votes: Votes | None  # every vote cast; None for the dense method


def extract(
    query: Votes, votes: Votes, kernel: VoteKernel, grid: Grid, peaks: Peaks, *, sizes: Sizes
) -> Lines:
    """Return the strongest lines among the query points, ρ measured from (0, 0).

    Args:
        query: where the accumulation is read, [Q] (weights are not used).
        votes: what is accumulated, [V].
        kernel: how votes count.
        grid: the point that ρ of queries and votes is measured from.
        peaks: separation and gate.
        sizes: `lines` to extract, `candidates` to evaluate exactly.

    Example:
        >>> votes = Votes(jnp.array([10.0, 10.0, -50.0]), jnp.array([0.5, 0.5, 2.0]),
        ...               jnp.ones(3), jnp.ones(3, bool))
        >>> from jaxtrack.hough.votes import gaussian
        >>> kernel = gaussian(jnp.array(5.0), jnp.array(0.1))
        >>> print(extract(votes, votes, kernel, Grid(), Peaks(), sizes=Sizes(lines=2)).votes)
        [2. 1.]
    """
    rho, theta, mask = query.rho_m, query.theta_rad, query.mask
    if sizes.candidates < rho.shape[0]:
        bound = jnp.where(mask, upper_bound(rho, theta, votes, kernel), -1.0)
        best = jnp.sort(jax.lax.top_k(jax.lax.stop_gradient(bound), sizes.candidates)[1])
        rho, theta, mask = rho[best], theta[best], mask[best]
    rho, theta = jnp.where(mask, rho, 0.0), jnp.where(mask, theta, 0.0)
    value = jnp.where(mask, evaluate(rho, theta, votes, kernel), 0.0)

    def pick(left: Array, _: None) -> tuple[Array, tuple[Array, Array]]:
        top = jnp.argmax(left)
        d_rho, d_theta = line_difference(rho[top], theta[top], rho, theta)
        return jnp.where(_separate(d_rho, d_theta, peaks), left, 0.0), (top, left[top] > 0)

    _, (picked, found) = jax.lax.scan(pick, jax.lax.stop_gradient(value), length=sizes.lines)

    prepared = kernel.prepare(votes)

    def refine(at: tuple[Array, Array]) -> tuple[Array, Array]:
        rho, theta = at
        near = jnp.where(votes.mask, votes.weight * kernel.nearby(rho, theta, prepared), 0.0)
        # Only shares count; of votes that all but vanish a quotient's slope would overflow.
        most, limits = jax.lax.stop_gradient(near).max(), jnp.finfo(near.dtype)
        some = most > limits.tiny / limits.eps
        near = jnp.where(some, near / jnp.where(some, most, 1.0), 0.0)
        d_rho, d_theta = line_difference(rho, theta, votes.rho_m, votes.theta_rad)
        shift = lambda d: safe_divide((near * jnp.where(votes.mask, d, 0.0)).sum(), near.sum())
        return wrap_line(rho - shift(d_rho), theta - shift(d_theta))

    rho, theta = jax.lax.map(refine, (rho[picked], theta[picked]))
    return _lines(rho, theta, jnp.where(found, value[picked], 0.0), grid, peaks)


def extract_dense(accumulator: Array, grid: Grid, peaks: Peaks, *, sizes: Sizes) -> Lines:
    """Return the strongest cells of a dense accumulator [n_θ, n_ρ] as lines.

    The same greedy rule as `extract`, on the accumulator smoothed by `sizes.smooth` cells.

    Example:
        >>> sizes = Sizes(lines=1, rho=80, theta=90)
        >>> accumulator = jnp.zeros((90, 80)).at[45, 60].set(7.0)
        >>> print(extract_dense(accumulator, Grid(), Peaks(), sizes=sizes).votes)
        [7.]
    """
    smoothed = smooth(accumulator, sizes=sizes) if sizes.smooth else accumulator
    return extract_rows(lambda j: smoothed[j], lambda j: accumulator[j], grid, peaks, sizes=sizes)


def extract_rows(
    values: RowReader, votes: RowReader, grid: Grid, peaks: Peaks, *, sizes: Sizes
) -> Lines:
    """Return the strongest cells of an accumulator that is read row by row.

    Only the rows' maxima are kept; a peak reads the rows within its separation again. So the
    accumulator need not stand in memory, and where it does it is never copied.

    Args:
        values: rows [B, n_ρ] of what peaks are found in, by their indices [B].
        votes: rows of the unsmoothed votes, for the place between the cells.
        grid: where the cells lie.
        peaks: separation (below π/2 in θ) and gate.
        sizes: how many cells and lines.
    """
    dtype = jax.eval_shape(votes, jnp.zeros(1, jnp.int32)).dtype
    rho_step, theta_step = steps(grid, sizes, dtype)
    rows_apart = jnp.floor(jnp.asarray(peaks.separation_theta_rad, dtype) / theta_step)
    cells_apart = jnp.floor(jnp.asarray(peaks.separation_rho_m, dtype) / rho_step)
    rows_apart = jnp.minimum(rows_apart, sizes.theta // 2 - 1).astype(jnp.int32)
    cells_apart = jnp.minimum(cells_apart, sizes.rho).astype(jnp.int32)
    cells = jnp.arange(sizes.rho, dtype=jnp.int32)
    block = min(BLOCK, sizes.theta)
    offset = jnp.arange(block, dtype=jnp.int32)

    def left(rows: Array, found: tuple[Array, Array]) -> Array:
        """Return rows of the accumulator without what the peaks silence."""

        def free(row: Array, i: Array, j: Array) -> Array:
            d_j = row - j
            turned = jnp.abs(d_j) > sizes.theta // 2
            d_j = jnp.where(turned, d_j - jnp.sign(d_j) * sizes.theta, d_j)
            centre = jnp.where(turned, sizes.rho - 1 - i, i)
            return (jnp.abs(d_j) > rows_apart) | (jnp.abs(cells - centre) > cells_apart)

        each_peak = jax.vmap(free, in_axes=(None, 0, 0))
        each_row = jax.vmap(lambda row: each_peak(row, *found).all(0))
        return jnp.where(each_row(rows), values(rows), 0.0)

    def pick(
        carry: tuple[Array, tuple[Array, Array]], n: Array
    ) -> tuple[tuple[Array, tuple[Array, Array]], Array]:
        row_max, found = carry
        j = jnp.argmax(row_max).astype(jnp.int32)
        i = jnp.argmax(left(j[None], found)[0]).astype(jnp.int32)
        found = found[0].at[n].set(i), found[1].at[n].set(j)

        def silence(b: Array, row_max: Array) -> Array:
            rows = (j - rows_apart + b * block + offset) % sizes.theta
            return row_max.at[rows].set(left(rows, found).max(1))

        blocks = (2 * rows_apart + block) // block
        return (jax.lax.fori_loop(0, blocks, silence, row_max), found), row_max[j]

    every = jnp.minimum(
        jnp.arange(-(-sizes.theta // block), dtype=jnp.int32)[:, None] * block + offset[None],
        sizes.theta - 1,
    )
    row_max = jax.lax.map(lambda rows: values(rows).max(1), every).ravel()[: sizes.theta]
    # Rows far outside stand for peaks that are not there yet.
    nowhere = jnp.zeros(sizes.lines, jnp.int32), jnp.full(sizes.lines, -4 * sizes.theta, jnp.int32)
    (_, (i, j)), value = jax.lax.scan(pick, (row_max, nowhere), jnp.arange(sizes.lines))
    reach = max(3 * sizes.smooth, 1)

    def refine(i: Array, j: Array) -> tuple[Array, Array]:
        rho, theta = centre_of(i, j, grid, sizes, dtype)
        near = jnp.arange(-reach, reach + 1, dtype=jnp.int32)
        row, column = j + near, i + near[None, :]
        turned = ((row < 0) | (row >= sizes.theta))[:, None]
        column = jnp.where(turned, sizes.rho - 1 - column, column)
        inside = (column >= 0) & (column < sizes.rho)
        column = jnp.clip(column, 0, sizes.rho - 1)
        counts = jnp.take_along_axis(votes(row % sizes.theta), column, axis=1)
        counts = jnp.where(inside, counts, 0.0).astype(dtype)
        shift = lambda d: safe_divide((counts * d).sum(), counts.sum())
        d = near.astype(dtype)
        return wrap_line(rho + shift(d[None, :] * rho_step), theta + shift(d[:, None] * theta_step))

    rho, theta = jax.lax.map(lambda cell: refine(*cell), (i, j))
    return _lines(rho, theta, value, grid, peaks)


def smooth(accumulator: Array, *, sizes: Sizes) -> Array:
    """Smooth an accumulator by the separable Gaussian of `sizes.smooth` cells, over the seam."""
    reach = 3 * sizes.smooth
    profile = np.exp(-(np.arange(-reach, reach + 1) ** 2) / (2 * sizes.smooth**2))
    profile /= profile.sum()
    seam = jnp.concatenate(
        [accumulator[-reach:, ::-1], accumulator, accumulator[:reach, ::-1]], axis=0
    )
    rows = sum(float(g) * seam[k : k + sizes.theta] for k, g in enumerate(profile))
    wide = jnp.pad(rows, ((0, 0), (reach, reach)))
    return sum(float(g) * wide[:, k : k + sizes.rho] for k, g in enumerate(profile))  # type: ignore[return-value]


def members(lines: Lines, scans: Scan, member_m: Array) -> Array:
    """Return which detections lie within `member_m` of each line, [M, K, N].

    Example:
        >>> lines = Lines(jnp.array([5.0]), jnp.array([0.0]), jnp.ones(1), jnp.ones(1, bool))
        >>> scans = Scan(jnp.zeros(1), jnp.ones(1, bool), jnp.array([[[4.0, 9.0], [9.0, 9.0]]]),
        ...              jnp.ones((1, 2), bool))
        >>> print(members(lines, scans, 2.0))
        [[[ True False]]]
    """
    counts = scans.mask & scans.valid[:, None]
    position = jnp.where(counts[..., None], scans.position_m, 0.0)
    distance = jax.vmap(lambda rho, theta: point_line_distance(rho, theta, position))(
        lines.rho_m, lines.theta_rad
    )
    return (jnp.abs(distance) <= member_m) & counts[None] & lines.mask[:, None, None]


def inform(
    lines: Lines, scans: Scan, peaks: Peaks, overflow: Array, votes: Votes | None
) -> HoughInfo:
    """Assemble what every method reports beside its lines."""
    belong = members(lines, scans, jnp.asarray(peaks.member_m, lines.rho_m.dtype))
    return HoughInfo(safe_divide(lines.votes, lines.votes[:1]), belong, overflow, votes)


def _separate(d_rho: Array, d_theta: Array, peaks: Peaks) -> Array:
    near = jnp.abs(d_rho) <= jnp.asarray(peaks.separation_rho_m, d_rho.dtype)
    return ~(near & (jnp.abs(d_theta) <= jnp.asarray(peaks.separation_theta_rad, d_rho.dtype)))


def _lines(rho: Array, theta: Array, value: Array, grid: Grid, peaks: Peaks) -> Lines:
    """Return refined peaks that are peaks still, strongest first, ρ measured from (0, 0) again.

    A peak holds more than rounding would leave of the strongest, stands apart from every stronger
    one, and passes the gate.
    """
    strength = jax.lax.stop_gradient(value)
    found = strength > jnp.finfo(value.dtype).eps * strength[0]

    def apart(kept: Array, n: Array) -> tuple[Array, None]:
        away = _separate(*line_difference(rho[n], theta[n], rho, theta), peaks)
        return kept.at[n].set(found[n] & (away | ~kept).all()), None

    places = jnp.arange(rho.shape[0], dtype=jnp.int32)
    keep, _ = jax.lax.scan(apart, jnp.zeros_like(found), places)
    origin = jnp.asarray(grid.origin_m, rho.dtype)
    rho = rho + origin[0] * jnp.cos(theta) + origin[1] * jnp.sin(theta)
    keep = keep & (strength >= jnp.asarray(peaks.gate, value.dtype))
    order = jnp.argsort(~keep, stable=True)
    clear = lambda x: jnp.where(keep[order], x[order], 0.0)
    return Lines(clear(rho), clear(theta), clear(value), keep[order])
