"""Numbers for two of the words of table 2: how far a target's votes scatter, how much is missing.

A target's own detection of a look is the one nearest to its true position, within 40 m (four
standard deviations of the noise); its own votes are those of its own detections, so both numbers
say what noise does to a peak. What clutter does to it is the third word's, discrimination.
"""

import jax
import jax.numpy as jnp
import numpy as np

from jaxtrack.hough import Sizes, neutrosophic
from jaxtrack.hough.grid import cell_of, steps
from jaxtrack.hough.pairs import candidate_pairs
from jaxtrack.metrics import decline, divergence, least_squares_line
from jaxtrack.models import line_through
from jaxtrack.types import Array, Scan, Truth

OWN_M = 40.0
_ROUND_RAD = 0.1  # how far from the true θ the standard transform's peak is looked for

Words = tuple[dict[str, Array], dict[str, Array]]


def target_votes(
    scans: Scan, truth: Truth, params: neutrosophic.NeutrosophicParams, sizes: Sizes
) -> Words:
    """Return each target's divergence in cells and decline, [K], by method.

    The improved transform's are the modified one's: the targets' own pairs pass the speed gate.

    Args:
        scans: T looks stacked.
        truth: T looks at K targets.
        params: of the neutrosophic transform; its grid is everybody's.
        sizes: static sizes of the neutrosophic transform.
    """
    dtype = scans.position_m.dtype
    grid = params.grid
    origin = jnp.asarray(grid.origin_m, dtype)
    rho_step, theta_step = steps(grid, sizes, dtype)
    index, seen = _own(scans, truth)
    pairs = candidate_pairs(scans, origin, params.speed, pairs=sizes.pairs)
    rules = neutrosophic.Rules("own_cell")
    vote = neutrosophic.memberships(pairs, params, sizes=sizes, rules=rules).vote

    def target(path: Array, index: Array, seen: Array) -> tuple[dict[str, Array], ...]:
        own = jnp.take_along_axis(scans.position_m, index[:, None, None], axis=1)[:, 0]
        own = jnp.where(seen[:, None], own, 0.0)
        rho, theta = least_squares_line(path - origin[None])

        def scatter(line: tuple[Array, Array], weight: Array) -> Array:
            return divergence(*line, weight, rho, theta, rho_step, theta_step)

        # The standard transform's curves, where they pass the true θ, and where they meet.
        seen_weight = seen.astype(dtype)
        at = (own - origin[None]) @ jnp.stack([jnp.cos(theta), jnp.sin(theta)])
        around = np.arange(-_ROUND_RAD, _ROUND_RAD, 0.001)
        angle = jnp.mod(theta + jnp.asarray(around, dtype), jnp.asarray(jnp.pi, dtype))
        normal = jnp.stack([jnp.cos(angle), jnp.sin(angle)])
        curve = jnp.floor(((own - origin[None]) @ normal) / rho_step)  # [T, angles]
        meet = (curve[:, None] == curve[None]) & seen[:, None, None]
        curves = jnp.where(seen[:, None], meet.sum(0), 0).max().astype(dtype)

        # Pairs of successive detections of the target, and what the neutrosophic rule gives them.
        both = seen[1:] & seen[:-1]
        safe = jnp.where(both[:, None], own[1:], own[:-1] + 1.0)
        line = line_through(own[:-1], safe, origin)
        cell = cell_of(*line, grid, sizes)
        same = (cell[0][:, None] == cell[0][None]) & (cell[1][:, None] == cell[1][None])
        mine = (pairs.first == index[:-1, None]) & (pairs.second == index[1:, None]) & pairs.mask
        earned = jnp.where(mine & both[:, None], vote, 0.0).sum(-1)
        fallen = lambda weight: jnp.where(same & both[:, None], weight[None, :], 0.0).sum(-1).max()
        once = both.astype(dtype)
        looks, intervals = float(seen.shape[0]), float(both.shape[0])
        sure = 1 - jnp.asarray(params.p_false, dtype)
        wide = {
            "HT": scatter((at, jnp.broadcast_to(theta, at.shape)), seen_weight),
            "MHT": scatter(line, once),
            "NHT": scatter(line, earned),
        }
        missing = {
            "HT": decline(curves, jnp.asarray(looks, dtype)),
            "MHT": decline(fallen(once), jnp.asarray(intervals, dtype)),
            "NHT": decline(fallen(earned), sure * intervals),
        }
        return wide, missing

    path = jnp.swapaxes(truth.state[..., :2], 0, 1)
    wide, missing = jax.vmap(target)(path, index.T, seen.T)
    for words in (wide, missing):
        words["IHT"] = words["MHT"]
    return wide, missing


def _own(scans: Scan, truth: Truth) -> tuple[Array, Array]:
    """Return the index of each target's own detection [T, K], and whether there is one."""
    counts = scans.mask & scans.valid[:, None]
    position = jnp.where(counts[..., None], scans.position_m, 0.0)
    away = position[:, :, None] - truth.state[:, None, :, :2]
    squared = jnp.where(counts[..., None], (away**2).sum(-1), jnp.inf)
    index = jnp.argmin(squared, axis=1).astype(jnp.int32)
    nearest = jnp.take_along_axis(squared, index[:, None], axis=1)[:, 0]
    return index, (nearest <= OWN_M**2) & truth.mask
