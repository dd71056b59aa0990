"""Random tables of tracks and looks, as arrays and as the oracles have them."""

from typing import NamedTuple

import numpy as np
from hypothesis import strategies as st

from jaxtrack.association import AssociationParams, predict_measurement
from jaxtrack.types import Scan

SIZES = ((3, 5, True), (2, 3, False))  # tracks, detections, with weights and covariances of its own
KINDS = ("plain", "coincident", "far", "no detections", "no tracks")


class Case(NamedTuple):
    """One problem."""

    mean: np.ndarray
    covariance: np.ndarray
    noise_m2: np.ndarray
    mask: np.ndarray
    scan: Scan
    params: AssociationParams


def definite(rng, *shape, size, scale):
    """Return random positive definite matrices."""
    root = rng.normal(size=(*shape, size, size)) * 0.4 + np.eye(size)
    return scale * root @ root.swapaxes(-1, -2)


def case(seed, size=SIZES[0], kind="plain", whole=False):
    """Return a problem; what is masked is NaN."""
    tracks, detections, full = size
    rng = np.random.default_rng(seed)
    mean = rng.normal(size=(tracks, 4)) * [2.0, 2.0, 1.0, 1.0]
    covariance = definite(rng, tracks, size=4, scale=0.8)
    noise = definite(rng, size=2, scale=0.5)
    position = mean[rng.integers(tracks, size=detections), :2] + rng.normal(size=(detections, 2))
    mask = np.ones(tracks, bool) if whole else rng.random(tracks) < 0.8
    there = np.ones(detections, bool) if whole else rng.random(detections) < 0.85
    if kind == "coincident":
        mean[:], covariance[:] = mean[0], covariance[0]
        position[:2] = position[0]
    elif kind == "far":
        position += 1000.0
    elif kind == "no detections":
        there[:] = False
    elif kind == "no tracks":
        mask[:] = False
    weight = rng.uniform(0.2, 1.0, detections)
    if not whole:
        weight[rng.random(detections) < 0.1] = 0.0
    own = definite(rng, detections, size=2, scale=0.5)
    scan = Scan(
        np.array(0.0),
        np.array(True),
        np.where(there[:, None], position, np.nan),
        there,
        np.where(there[:, None, None], own, np.nan) if full else None,
        np.where(there, weight, np.nan) if full else None,
    )
    numbers = np.full(tracks, rng.uniform(0.5, 1.0)), rng.uniform(0.01, 0.1), 9.21, 2.5
    params = AssociationParams(*map(np.array, numbers))
    return Case(
        np.where(mask[:, None], mean, np.nan),
        np.where(mask[:, None, None], covariance, np.nan),
        noise,
        mask,
        scan,
        params,
    )


@st.composite
def cases(draw):
    """Draw a problem of any kind and its kind."""
    kind = draw(st.sampled_from(KINDS))
    size = draw(st.sampled_from(SIZES))
    return case(draw(st.integers(0, 2**32 - 1)), size, kind), kind


def predicted_of(one):
    """Return the predicted measurements of a problem."""
    return predict_measurement(one.mean, one.covariance, one.noise_m2, one.mask)


def as_lists(one):
    """Return tracks and detections as the oracles have them."""
    tracks = [
        (x[:2], p[:2, :2]) if there else None
        for x, p, there in zip(one.mean, one.covariance, one.mask, strict=True)
    ]
    detections = []
    for i, there in enumerate(one.scan.mask):
        noise = one.noise_m2 if one.scan.covariance_m2 is None else one.scan.covariance_m2[i]
        weight = 1.0 if one.scan.weight is None else one.scan.weight[i]
        detections.append((one.scan.position_m[i], noise, weight) if there else None)
    return tracks, detections


def as_table(taken, detections):
    """Return the weights [T, M] of dicts."""
    table = np.zeros((len(taken), detections))
    for j, mine in enumerate(taken):
        for i, weight in mine.items():
            table[j, i] = weight
    return table
