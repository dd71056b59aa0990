"""The posterior's moments by samples: what they say of their own error."""

import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxtrack.hough import SpeedGate
from jaxtrack.hough.evidence import evidence
from jaxtrack.models import PositionSensor
from jaxtrack.types import Scan

LOOKS, SIGMA, RUNS = 5, 10.0, 100
TIME_S = 2.0 * np.arange(LOOKS)
TRUTH = np.array([1600.0, 80.0, 200.0, 0.0])
SENSOR = PositionSensor(0.99, 1e-9, SIGMA)


@functools.partial(jax.jit, static_argnames="samples")
def moments(position, start, samples):
    def one(position, start):
        yes = jnp.ones(LOOKS, bool)
        scans = Scan(jnp.asarray(TIME_S), yes, position[:, None], yes[:, None])
        return evidence(start, scans, SENSOR, SpeedGate(), samples=samples)[:2]

    return jax.vmap(one)(position, start)


@pytest.mark.parametrize(("samples", "off"), [(16, 0.0), (512, 2.0)])
def test_few_samples_with_all_the_weight_are_not_sure_of_themselves(samples, off):
    # A lone target without clutter: the posterior is Gaussian, and the error squared four a run.
    # Sixteen points, or a search that ended two deviations off, leave a few of them the weight;
    # about their own mean alone these gave 8.6 and 21.
    rng = np.random.default_rng(0)
    path = TRUTH[:2] + (TIME_S - TIME_S[-1])[:, None] * TRUTH[2:]
    position = path + SIGMA * rng.normal(size=(RUNS, LOOKS, 2))
    away = rng.normal(size=(RUNS, 4))
    away = away / np.linalg.norm(away, axis=1, keepdims=True) * [8.0, 8.0, 2.0, 2.0]
    mean, covariance = moments(position, TRUTH + off * away, samples)
    error = np.asarray(mean) - TRUTH
    squared = (error * np.linalg.solve(covariance, error[..., None])[..., 0]).sum(1)
    assert 3.0 < squared.mean() < 7.0


def test_of_coincident_weight_the_covariance_is_finite():
    # One detection a thousand deviations off: no sample is like any other.
    position = np.broadcast_to(TRUTH[:2], (1, LOOKS, 2)) + 1e4 * np.eye(LOOKS)[None, :, :2]
    for leaf in moments(position, TRUTH[None], 16):
        assert np.isfinite(leaf).all()
