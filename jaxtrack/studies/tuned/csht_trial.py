"""What the study `tune_csht` simulates: the loss that is tuned by, and the score that counts.

The loss weighs every cluster of the soft estimator by the share by which it withstands ISODATA's
thresholds. The score takes those that are decided to be there as they are.
"""

import jax
import jax.numpy as jnp

from jaxtrack.clustering import IsodataParams
from jaxtrack.hough import clustering_statistic, pack_beams
from jaxtrack.metrics import ospa
from jaxtrack.models import propagate
from jaxtrack.sensors import motion_elements_scene, observe_beams
from jaxtrack.studies.csht.trial import BEAM_COUNT, CUTOFF, ORDER, POSITIONS
from jaxtrack.studies.tuned.ways import Score, Settings, smooth_ospa
from jaxtrack.types import Array, Key, Scan, Tracks

MOVED_M, MOVED_M_S = 10.0, 0.5  # deviations of the targets from table 2
TEMPERATURE = 0.05  # of the thresholds
_ISODATA = ("merge_exponent", "membership_floor", "aggregation_gate", "delete_share")


def hand() -> dict[str, float]:
    """Return the library's defaults, and a tolerance of two thirds of the sonar's noise."""
    params = clustering_statistic.ClusteringParams()
    isodata = {name: float(getattr(params.isodata, name)) for name in _ISODATA}
    return {"tolerance_m": 2.0, "cell_share": float(params.cell_share), **isodata}


def loss(settings: Settings, key: Key) -> Array:
    """Return the smooth OSPA of one window's positions, in units of the cut-off."""
    scans, truth = _simulate(key)
    tracks, info = _estimate(settings, scans)
    assert info.clusters is not None  # as of every estimate that clusters
    there = jnp.ones(truth.shape[0], bool)
    stays = info.clusters.survival
    return smooth_ospa(tracks, stays, truth, there, cutoff=CUTOFF, order=ORDER) / CUTOFF


def score(settings: Settings, key: Key) -> Score:
    """Return OSPA of one window's positions, metres: of the soft estimate, and of the hard one."""
    scans, truth = _simulate(key)
    soft, info = _estimate(settings, scans)
    hard, _ = clustering_statistic.estimate(scans, _params(settings))
    there = jnp.ones(truth.shape[0], bool)
    far = lambda tracks: ospa(
        tracks.mean[:, :2], tracks.mask, truth[:, :2], there, cutoff=CUTOFF, order=ORDER
    )
    return Score(jnp.stack([far(soft).distance, far(hard).distance]), info.overflow)


def _params(settings: Settings) -> clustering_statistic.ClusteringParams:
    default = clustering_statistic.ClusteringParams()
    isodata: IsodataParams = default.isodata._replace(**{n: settings[n] for n in _ISODATA})
    return default._replace(cell_share=settings["cell_share"], isodata=isodata)


def _estimate(
    settings: Settings, scans: Scan
) -> tuple[Tracks, clustering_statistic.ClusteringInfo]:
    return clustering_statistic.soft_estimate(
        scans, _params(settings), settings["tolerance_m"], TEMPERATURE
    )


def _simulate(key: Key) -> tuple[Scan, Array]:
    """Return a window, and where its targets are at its end, [3, 4]."""
    draw, look = jax.random.split(key)
    scene = motion_elements_scene()
    start = scene.truth.state[0]
    apart = jnp.asarray([MOVED_M, MOVED_M, MOVED_M_S, MOVED_M_S], start.dtype)
    start = start + apart[None] * jax.random.normal(draw, start.shape, start.dtype)
    state = jax.vmap(propagate, (None, 0))(start, scene.truth.time_s)
    scene = scene._replace(truth=scene.truth._replace(state=state))
    scans = observe_beams(look, *scene, beams=BEAM_COUNT, false_alarms="per_scan")
    return pack_beams(scans, scene.sonar, POSITIONS["per_scan"])[0], state[-1]
