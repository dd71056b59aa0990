"""Looks at one target, for the filters and, as a list of dicts, for their oracles."""

import jax
import numpy as np

from jaxtrack.filtering.gaussian import Prior
from jaxtrack.models import PolarScan
from jaxtrack.types import Pose, Scan
from tests.oracles import kalman

SIZE = 8
PRIOR_TIME = 0.5


def prior(size=4):
    """Return a correlated prior."""
    rng = np.random.default_rng(size)
    root = rng.normal(size=(size, size)) + 2 * np.eye(size)
    scale = np.array([20.0, 20.0, 3.0, 3.0, 0.05])[:size]
    covariance = scale[:, None] * (root @ root.T) * scale[None, :] / size
    return Prior(np.array([-60.0, 20.0, 3.0, -8.0, 0.1])[:size], covariance, PRIOR_TIME)  # pyright: ignore


def truth(rng, size=SIZE, rate=0.1):
    """Return times and states of a turning target that passes behind the sensor."""
    time_s = PRIOR_TIME + np.cumsum(rng.uniform(0.3, 1.7, size))
    start = np.array([-60.0, 20.0, 3.0, -8.0, rate])
    return time_s, np.stack([kalman.turned(start, t - PRIOR_TIME) for t in time_s])


def covariances(rng, size, scale):
    root = rng.normal(size=(size, 2, 2)) + 1.5 * np.eye(2)
    return np.asarray(scale)[:, None] * (root @ np.swapaxes(root, 1, 2)) * np.asarray(scale)


def position_looks(seed, seen=None, valid=None, own=True, size=SIZE):
    """Return a `Scan` of one detection and the oracle's looks; NaN behind every mask.

    With `own` the scans carry covariances, weights and delays; without, the noise is 3 m.
    """
    rng = np.random.default_rng(seed)
    seen = np.ones(size, bool) if seen is None else np.array(seen)
    valid = np.ones(size, bool) if valid is None else np.array(valid)
    time_s, states = truth(rng, size)
    r = covariances(rng, size, [3.0, 3.0]) if own else np.tile(9.0 * np.eye(2), (size, 1, 1))
    weight = rng.uniform(0.3, 1.0, size) if own else np.ones(size)
    delay = rng.uniform(-0.2, 0.2, size) if own else np.zeros(size)
    z = states[:, :2] + delay[:, None] * states[:, 2:4] + rng.normal(scale=3.0, size=(size, 2))
    looks = [
        {
            "time": time_s[k],
            "valid": valid[k],
            "seen": seen[k],
            "z": z[k],
            "R": r[k] / weight[k],
            "delay": delay[k],
        }
        for k in range(size)
    ]
    there = seen & valid
    hide = lambda x: np.where(there.reshape(-1, *[1] * (x.ndim - 1)), x, np.nan)[:, None]
    extra = (hide(r), hide(weight), hide(delay)) if own else (None, None, None)
    scan = Scan(np.where(valid, time_s, np.nan), valid, hide(z), seen[:, None], *extra)  # pyright: ignore
    return scan, looks


def polar_looks(seed, seen=None, valid=None, own=True, size=SIZE):
    """Return a `PolarScan` of one detection from a moving ship and the oracle's looks."""
    rng = np.random.default_rng(seed)
    seen = np.ones(size, bool) if seen is None else np.array(seen)
    valid = np.ones(size, bool) if valid is None else np.array(valid)
    time_s, states = truth(rng, size)
    ship = np.stack([2.0 * time_s, -0.5 * time_s], axis=-1)
    heading = 0.05 * time_s
    scale = np.array([2.0, 0.03])
    r = covariances(rng, size, scale) if own else np.tile(np.diag(scale**2), (size, 1, 1))
    z = np.stack([kalman.range_bearing(states[k], ship[k], heading[k]) for k in range(size)])
    z = z + rng.normal(size=(size, 2)) * scale
    looks = [
        {
            "time": time_s[k],
            "valid": valid[k],
            "seen": seen[k],
            "z": z[k],
            "R": r[k],
            "position": ship[k],
            "heading": heading[k],
        }
        for k in range(size)
    ]
    there = seen & valid
    hide = lambda x: np.where(there.reshape(-1, *[1] * (x.ndim - 1)), x, np.nan)
    pose = Pose(hide(ship), hide(heading))  # pyright: ignore
    scan = PolarScan(
        np.where(valid, time_s, np.nan),  # pyright: ignore
        valid,  # pyright: ignore
        hide(z[:, 0])[:, None],
        hide(z[:, 1])[:, None],
        seen[:, None],  # pyright: ignore
        pose,
        hide(r)[:, None] if own else None,
    )
    return scan, looks


def assert_moments(got, expected, rtol=1e-9):
    """Check means [T, S] and covariances [T, S, S] against the oracle's pairs, in deviations."""
    means, spreads = (np.stack(x) for x in zip(*expected, strict=True))
    deviation = np.sqrt(np.diagonal(spreads, axis1=1, axis2=2))
    np.testing.assert_allclose(got.mean, means, rtol=rtol, atol=rtol)
    error = (got.covariance - spreads) / deviation[:, :, None] / deviation[:, None, :]
    np.testing.assert_allclose(error, 0.0, atol=rtol)


def assert_near(got, expected, share=0.05, rtol=0.01):
    """Check means to a share of the oracle's deviation, and variances; single precision does."""
    means, spreads = (np.stack(x) for x in zip(*expected, strict=True))
    deviation = np.sqrt(np.diagonal(spreads, axis1=1, axis2=2))
    mean, spread = (np.asarray(x, np.float64) for x in got)
    np.testing.assert_allclose((mean - means) / deviation, 0.0, atol=share)
    variance = np.diagonal(spread, axis1=1, axis2=2)
    np.testing.assert_allclose(variance, deviation**2, rtol=rtol)


def assert_sound(covariance, rtol=3e-7):
    """Check that covariances [T, S, S] are finite, symmetric and positive definite."""
    covariance = np.asarray(covariance, np.float64)
    assert np.isfinite(covariance).all()
    np.testing.assert_allclose(covariance, np.swapaxes(covariance, 1, 2), rtol=rtol)
    deviation = np.sqrt(np.diagonal(covariance, axis1=1, axis2=2))
    correlation = covariance / deviation[:, :, None] / deviation[:, None, :]
    assert np.linalg.eigvalsh(correlation).min() > 1e-6


def batched(run, params, scans, *rest):
    """Run what is compiled for a batch of three on one realization.

    One program serves all tests of a module, and what it returns is compared with loops.
    """
    three = jax.tree.map(lambda x: np.stack([x] * 3), scans)
    return jax.tree.map(lambda x: x[0], run(params, three, *rest))


def assert_rows_are_alone(run, several, params, *rest):
    """Check that a batch of three realizations is each of them alone."""
    three = jax.tree.map(lambda *x: np.stack(x), *several)
    got = run(params, three, *rest)
    for n, scans in enumerate(several):
        alone = batched(run, params, scans, *rest)
        for a, b in zip(jax.tree.leaves(got), jax.tree.leaves(alone), strict=True):
            np.testing.assert_allclose(a[n], b, rtol=1e-9, atol=1e-9)


LONG = 10_000


def long_looks():
    """Return params' prior and `LONG` position looks of a target on an arc, 1 in 5 without it."""
    rng = np.random.default_rng(7)
    time_s = np.arange(1.0, LONG + 1)
    at = 2000 * np.sin(2e-3 * time_s)[:, None] + rng.normal(scale=3.0, size=(LONG, 2))
    seen = rng.random(LONG) < 0.8
    seen[5000:5100] = False
    scans = Scan(time_s, np.ones(LONG, bool), at[:, None], seen[:, None])  # pyright: ignore
    return Prior(np.zeros(4), np.diag([1e8, 1e8, 1e4, 1e4])), scans  # pyright: ignore


def single(tree):
    """Return a tree with its floating numbers in single precision."""
    return jax.tree.map(
        lambda x: np.asarray(x, np.float32) if np.asarray(x).dtype == float else x, tree
    )


def long_polar_looks():
    """Return a prior, `LONG` polar looks of a target that circles the sensor, and its states."""
    rng = np.random.default_rng(9)
    time_s = np.arange(1.0, LONG + 1)
    rate = 0.01
    states = np.stack(
        [
            800 * np.cos(rate * time_s) + 100,
            800 * np.sin(rate * time_s),
            -8 * np.sin(rate * time_s),
            8 * np.cos(rate * time_s),
            np.full(LONG, rate),
        ],
        axis=-1,
    )
    z = np.stack([np.hypot(*states[:, :2].T), np.arctan2(states[:, 1], states[:, 0])], axis=-1)
    z = z + rng.normal(size=(LONG, 2)) * [5.0, 0.01]
    seen = (rng.random(LONG) < 0.8)[:, None]
    seen[5000:5020] = False
    zero = np.zeros(LONG)
    pose = Pose(np.zeros((LONG, 2)), zero)  # pyright: ignore
    z = np.where(seen, z, np.nan)
    scans = PolarScan(time_s, np.ones(LONG, bool), z[:, :1], z[:, 1:], seen, pose)  # pyright: ignore
    start = Prior(states[0], np.diag([1e4, 1e4, 1e2, 1e2, 1e-2]), time_s[0])  # pyright: ignore
    return start, scans, states


def bare_looks(scans):
    """Return the oracle's looks of position scans without covariances, noise 3 m."""
    fields = (scans.time_s, scans.valid, scans.mask[:, 0], scans.position_m[:, 0])
    return [
        {"time": time, "valid": valid, "seen": seen, "z": z, "R": 9.0 * np.eye(2)}
        for time, valid, seen, z in zip(*fields, strict=True)
    ]
