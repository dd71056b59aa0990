"""Candidate pairs: two detections of successive looks, and the line through them.

All pairs of an interval are n_{k−1} · n_k; the speed gate leaves a few of them. These are packed
to the front of a table of fixed size, in the order of the second detection, then the first, so that
the pairs that end in one detection stand together.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer

from jaxtrack.models.line import line_covariance, line_through
from jaxtrack.models.motion import look_times
from jaxtrack.numerics.checks import check_known, check_size
from jaxtrack.types import Array, Scan


class SpeedGate(NamedTuple):
    """Admissible speeds of a target."""

    v_min_m_s: Array | float = 100.0
    v_max_m_s: Array | float = 400.0


def check_speeds(speed: SpeedGate) -> None:
    """Check that known speeds are a range.

    Raises:
        ValueError: the least speed is negative, or the largest is not above it.

    Example:
        >>> check_speeds(SpeedGate(0.0, 6.0))
    """
    slowest, fastest = speed
    check_known("speed.v_min_m_s", slowest, lambda v: v >= 0, "a speed of at least 0 m/s")
    if not isinstance(slowest, Tracer):
        want = f"more than v_min_m_s, {slowest}"
        check_known("speed.v_max_m_s", fastest, lambda v: v > np.asarray(slowest), want)


class Pairs(NamedTuple):
    """Candidate pairs of the K − 1 intervals, with the lines through them."""

    first: Array  # [K-1, P] index of the earlier detection
    second: Array  # [K-1, P] index of the later detection
    start: Array  # [K-1, N] where the pairs that end in a detection begin
    count: Array  # [K-1, N] how many there are
    first_m: Array  # [K-1, P, 2]
    second_m: Array  # [K-1, P, 2]
    second_s: Array  # [K-1, P] time of the later detection
    dt_s: Array  # [K-1, P] what passed since the earlier one
    rho_m: Array  # [K-1, P] measured from the origin given
    theta_rad: Array  # [K-1, P]
    weight: Array  # [K-1, P] product of the detections' weights
    mask: Array  # [K-1, P]
    overflow: Array  # [K-1] some pair did not fit


def detection_times(scans: Scan) -> Array:
    """Return each detection's own time, [K, N]; in a look that was lost, the last look's."""
    before, end = look_times(scans)
    time = before + end
    time = jnp.broadcast_to(time[:, None], scans.mask.shape)
    if scans.delay_s is None:
        return time
    return time + jnp.where(scans.mask & scans.valid[:, None], scans.delay_s, 0.0)


def counting(scans: Scan) -> Array:
    """Return which detections count at all, [K, N]: there, in a valid look, of a weight above 0.

    Example:
        >>> scans = Scan(jnp.zeros(2), jnp.array([True, False]), jnp.zeros((2, 2, 2)),
        ...              jnp.ones((2, 2), bool), weight=jnp.array([[0.5, 0.0], [1.0, 1.0]]))
        >>> print(counting(scans)[0], counting(scans)[1])
        [ True False] [False False]
    """
    there = scans.mask & scans.valid[:, None]
    return there if scans.weight is None else there & (jnp.where(there, scans.weight, 0.0) > 0)


def candidate_pairs(scans: Scan, origin_m: Array, speed: SpeedGate | None, *, pairs: int) -> Pairs:
    """Return the pairs of detections of successive looks that one target could have caused.

        v_min ≤ |z_{k,j} − z_{k−1,i}| / (t_j − t_i) ≤ v_max

    Args:
        scans: K ≥ 2 sound looks stacked (`check_scans`); a detection of weight 0 counts as none.
        origin_m: [2] the point that ρ is measured from.
        speed: admissible speeds, or None for all pairs.
        pairs: size of the table, pairs an interval.

    Returns:
        The table; `overflow` says that an interval had more pairs than fit.

    Raises:
        ValueError: fewer than two looks, or a known value that cannot be.

    Example:
        >>> scans = Scan(jnp.array([0.0, 1.0]), jnp.ones(2, bool),
        ...              jnp.array([[[0.0, 0.0]], [[0.0, 200.0]]]), jnp.ones((2, 1), bool))
        >>> table = candidate_pairs(scans, jnp.zeros(2), SpeedGate(), pairs=4)
        >>> print(table.mask[0], abs(table.theta_rad[0, 0]))
        [ True False False False] 0.0

    Source: neutrosophic Hough transform (2018), equations 4 and 20–22.
    """
    check_size("number of looks", scans.mask.shape[0], at_least=2)
    counts = counting(scans)
    position = jnp.where(counts[..., None], scans.position_m, 0.0)
    time = detection_times(scans)
    weight = jnp.ones_like(time) if scans.weight is None else jnp.where(counts, scans.weight, 0.0)

    earlier = np.arange(scans.mask.shape[0] - 1)
    mask = _admissible(position, time, counts, earlier, earlier + 1, speed)
    flat, start, count, overflow = jax.vmap(lambda m: _pack(m, pairs))(mask)
    packed = jnp.arange(pairs)[None, :] < count.sum(-1)[:, None]
    second, first = flat // mask.shape[2], flat % mask.shape[2]
    take = jax.vmap(lambda table, index: table[index])
    first_m, second_m = take(position[:-1], first), take(position[1:], second)
    # Free slots get a harmless line, so that no gradient goes through a vanishing length.
    second_m = jnp.where(packed[..., None], second_m, first_m + 1.0)
    rho, theta = line_through(first_m, second_m, origin_m)
    second_s = jnp.where(packed, take(time[1:], second), 0.0)
    return Pairs(
        first=first,
        second=second,
        start=start,
        count=count,
        first_m=first_m,
        second_m=second_m,
        second_s=second_s,
        dt_s=jnp.where(packed, second_s - take(time[:-1], first), 1.0),
        rho_m=rho,
        theta_rad=theta,
        weight=jnp.where(packed, take(weight[:-1], first) * take(weight[1:], second), 0.0),
        mask=packed,
        overflow=overflow,
    )


def distant_pairs(
    scans: Scan, speed: SpeedGate, *, gap: int, hypotheses: int
) -> tuple[Array, Array, Array]:
    """Return the constant-velocity trajectories through two detections at least `gap` looks apart.

    Args:
        scans: K > gap sound looks stacked; a detection of weight 0 counts as none.
        speed: admissible speeds.
        gap: least distance in looks, static.
        hypotheses: size of the table, static.

    Returns:
        States [H, 4] at the time of the last look, a mask [H], and whether some did not fit.

    Raises:
        ValueError: too few looks, or a known value that cannot be.

    Example:
        >>> scans = Scan(jnp.array([0.0, 1.0]), jnp.ones(2, bool),
        ...              jnp.array([[[0.0, 0.0]], [[0.0, 200.0]]]), jnp.ones((2, 1), bool))
        >>> states, mask, overflow = distant_pairs(scans, SpeedGate(), gap=1, hypotheses=2)
        >>> print(states[0], mask)
        [  0. 200.   0. 200.] [ True False]
    """
    looks, n = scans.mask.shape
    check_size("number of looks", looks, at_least=gap + 1)
    couples = [(k, k + g) for g in range(gap, looks) for k in range(looks - g)]
    early = np.array([k for k, _ in couples], np.int32)
    late = np.array([k for _, k in couples], np.int32)
    counts = counting(scans)
    position = jnp.where(counts[..., None], scans.position_m, 0.0)
    time = detection_times(scans)
    admissible = _admissible(position, time, counts, early, late, speed)
    flat, _, count, overflow = _pack(admissible.reshape(-1, n), hypotheses)
    row, first = flat // n, flat % n
    couple, second = row // n, row % n
    k, m = jnp.asarray(early)[couple], jnp.asarray(late)[couple]
    mask = jnp.arange(hypotheses) < count.sum()
    dt = jnp.where(mask, time[m, second] - time[k, first], 1.0)[:, None]
    velocity = (position[m, second] - position[k, first]) / dt
    ahead = (look_times(scans)[1] - time[m, second])[:, None]
    states = jnp.concatenate([position[m, second] + velocity * ahead, velocity], axis=-1)
    return jnp.where(mask[:, None], states, 0.0), mask, overflow


def pair_covariances(pairs: Pairs, origin_m: Array, sigma_m: Array) -> tuple[Array, Array, Array]:
    """Return var ρ, cov(ρ, θ) and var θ of every pair's line, each [K-1, P]."""
    return line_covariance(pairs.first_m, pairs.second_m, origin_m, sigma_m)


def _admissible(
    position: Array,
    time: Array,
    counts: Array,
    early: np.ndarray,
    late: np.ndarray,
    speed: SpeedGate | None,
) -> Array:
    """Return which pairs of detections a target could have caused, [couples, second, first].

    Comparisons are made on squares, so nothing is divided or rooted for all pairs.
    """
    squared = sum(
        (position[late, :, None, axis] - position[early, None, :, axis]) ** 2 for axis in (0, 1)
    )
    dt = time[late, :, None] - time[early, None, :]
    mask = counts[late, :, None] & counts[early, None, :] & (dt > 0) & (squared > 0)
    if speed is None:
        return mask
    check_speeds(speed)
    slowest = jnp.asarray(speed.v_min_m_s, dt.dtype) * dt
    fastest = jnp.asarray(speed.v_max_m_s, dt.dtype) * dt
    return mask & (squared >= slowest**2) & (squared <= fastest**2)


def _pack(mask: Array, size: int) -> tuple[Array, Array, Array, Array]:
    """Return the flat indices of a mask's [N, N] true entries in order, padded to a size.

    A running count as a product with a triangle of ones: on a CPU three times as fast as a
    cumulative sum, and exact, as the counts stay far below 2²⁴.
    """
    n_second, n_first = mask.shape
    triangle = jnp.asarray(np.triu(np.ones((n_first, n_first), np.float32)))
    running = mask.astype(jnp.float32) @ triangle
    count = running[:, -1].astype(jnp.int32)
    start = jnp.cumsum(count) - count
    place = start[:, None] + running.astype(jnp.int32) - 1
    place = jnp.where(mask & (place < size), place, size)
    index = jnp.arange(n_second * n_first, dtype=jnp.int32)
    flat = jnp.zeros(size, jnp.int32).at[place.ravel()].set(index, mode="drop")
    total = start[-1] + count[-1]
    kept = jnp.clip(jnp.minimum(start + count, size) - start, 0)
    return flat, start, kept, total > size
