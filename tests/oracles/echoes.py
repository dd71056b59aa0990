"""The likelihood ratio of an echo in clutter whose texture is a squared Gaussian, by quadrature.

Two beams: g and h are standard normal with correlation φ, the textures are g² and h².
"""

import math

import numpy as np

_POINTS = 200  # of each sign; densities are steep near 0, so they are dense there


def _clutter(a, tau):
    return 2 * a / tau * math.exp(-(a**2) / tau)


def _target(a, tau, signal):
    z = 2 * a * signal / tau
    bessel = math.log(np.i0(z)) if z < 500 else z - 0.5 * math.log(2 * math.pi * z)
    return 2 * a / tau * math.exp(-(a**2 + signal**2) / tau + bessel)


def log_ratio(a, other, snr_db, correlation_beams, share):
    """log p(a | target, other) − log p(a | clutter, other), `other` being the next beam's."""
    signal = 10 ** (snr_db / 20)
    phi = math.exp(-0.5 / correlation_beams)
    half = np.geomspace(1e-4, 6.0, _POINTS)
    g = np.concatenate([-half[::-1], half])
    width = np.gradient(g)
    beside = []
    for x, dx in zip(g, width, strict=True):
        tau = x**2
        mixed = (1 - share) * _clutter(other, tau) + share * _target(other, tau, signal)
        beside.append(mixed * dx)
    target = clutter = 0.0
    for x, dx in zip(g, width, strict=True):
        told = 0.0
        for y, weight in zip(g, beside, strict=True):
            square = (x**2 - 2 * phi * x * y + y**2) / (1 - phi**2)
            told += math.exp(-square / 2) * weight
        target += _target(a, x**2, signal) * told * dx
        clutter += _clutter(a, x**2) * told * dx
    return math.log(target) - math.log(clutter)
