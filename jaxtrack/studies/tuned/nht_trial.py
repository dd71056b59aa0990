"""What the study `tune_nht` simulates: the loss that is tuned by, and the score that counts.

The loss is smooth: soft memberships, votes as Gaussians, a softmax over the candidate pairs. The
score is the estimator as people use it, with hard memberships and peaks.
"""

import functools
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp

from jaxtrack.hough import Grid, Sizes, neutrosophic
from jaxtrack.hough.votes import evaluate, gaussian
from jaxtrack.metrics import initiation_scores, line_distance
from jaxtrack.sensors import Scene, crossing_targets, observe
from jaxtrack.studies.tuned.ways import Score, Settings
from jaxtrack.tuning import candidate_softmax
from jaxtrack.types import Array, Key, Lines, Scan

ORIGINS = {"corner": (0.0, 0.0), "centre": (1750.0, 800.0)}  # of ρ, metres
CLUTTER = 10.0  # a scan
NEAR_M = 100.0  # candidates so near a target's path are its own
MATCH_M = (50.0, 100.0)
TEMPERATURE = 0.1  # of the memberships
_DETECTIONS = 32
_SIZES = Sizes(lines=8, pairs=192, predecessors=24, candidates=256)
_RULES = neutrosophic.Rules("spread")


def paper() -> dict[str, Any]:
    """Return the paper's tolerances, which are the library's defaults as well."""
    params = neutrosophic.NeutrosophicParams()
    return {"eps_rho_m": params.eps_rho_m, "eps_theta_rad": params.eps_theta_rad}


@functools.cache
def loss_from(origin: str) -> Callable[[Settings, Key], Array]:
    """Return the loss of one scene with ρ measured from a place, the same object every time."""

    def loss(eps: Settings, key: Key) -> Array:
        scene, scans = _simulate(key)
        grid = Grid(ORIGINS[origin])
        params = neutrosophic.NeutrosophicParams(grid)._replace(**eps)
        _, info = neutrosophic.soft_estimate(
            scans, params, jnp.asarray(TEMPERATURE), sizes=_SIZES, rules=_RULES
        )
        # Every candidate pair is read, not only the peaks: which those are is no smooth choice.
        assert info.votes is not None  # as of every method that votes at points
        votes = info.votes
        kernel = gaussian(eps["eps_rho_m"], eps["eps_theta_rad"])
        # Computed again on the way back: what every candidate says of every other is a table that
        # leaves the cache, and keeping it takes 1.6 times as long.
        at = jax.checkpoint(
            lambda line: evaluate(line[0][None], line[1][None], votes, kernel)[0],
            prevent_cse=False,
        )
        scores = jax.lax.map(at, (votes.rho_m, votes.theta_rad))
        x, y = ORIGINS[origin]
        shift = x * jnp.cos(votes.theta_rad) + y * jnp.sin(votes.theta_rad)
        lines = Lines(votes.rho_m + shift, votes.theta_rad, scores, votes.mask)
        near = line_distance(lines, _paths(scene)) <= NEAR_M
        return candidate_softmax(scores, votes.mask, near)

    return loss


@functools.cache
def score_from(origin: str) -> Callable[[Settings, Key], Score]:
    """Return the score of one scene: whether the three strongest lines are not the three targets.

    Its measures are the two distances at which a line is a target's.
    """

    def score(eps: Settings, key: Key) -> Score:
        scene, scans = _simulate(key)
        there = jnp.asarray(scene.truth.mask).all(0)
        params = neutrosophic.NeutrosophicParams(Grid(ORIGINS[origin]))._replace(**eps)
        lines, info = neutrosophic.estimate(scans, params, sizes=_SIZES, rules=_RULES)
        right = [
            initiation_scores(lines, _paths(scene), there, match_m=m, gate=0.0).top_k
            for m in MATCH_M
        ]
        return Score(1.0 - jnp.stack(right).astype(jnp.result_type(float)), info.overflow)

    return score


def _simulate(key: Key) -> tuple[Scene, Scan]:
    scene = crossing_targets("IV", CLUTTER)
    return scene, observe(key, scene.truth, scene.radar, detections=_DETECTIONS)


def _paths(scene: Scene) -> Array:
    return jnp.swapaxes(scene.truth.state[..., :2], 0, 1)
