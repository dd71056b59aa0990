"""The likelihood ratio of an echo in clutter whose texture is a squared Gaussian, by quadrature.

Three beams in a row: g_b are standard normal with correlation φ^|b−b'|, the texture is τ_b = g_b².
"""

import math

import numpy as np


def log_ratio(amplitude, b, snr_db, correlation_beams, share, points=160):
    """log p(a_b | target in b, others) − log p(a_b | clutter in b, others), of up to three beams."""
    beams = len(amplitude)
    signal = 10 ** (snr_db / 20)
    phi = math.exp(-0.5 / correlation_beams)
    covariance = np.array([[phi ** abs(i - j) for j in range(beams)] for i in range(beams)])
    inverse = np.linalg.inv(covariance)
    # Densities are even in all g at once, and steep near 0: points are dense there.
    half = np.geomspace(1e-5, 7.0, points)
    g = np.concatenate([-half[::-1], half])
    width = np.gradient(g)

    def clutter(a, tau):
        return 2 * a / tau * math.exp(-(a**2) / tau)

    def target(a, tau):
        z = 2 * a * signal / tau
        if z < 500:
            bessel = math.log(np.i0(z))
        else:
            bessel = z - 0.5 * math.log(2 * math.pi * z)
        return 2 * a / tau * math.exp(-(a**2 + signal**2) / tau + bessel)

    tables = []
    for place in range(beams):
        here = []
        for x in g:
            tau = max(x**2, 1e-12)
            c, t = clutter(amplitude[place], tau), target(amplitude[place], tau)
            here.append((c, t, (1 - share) * c + share * t))
        tables.append(np.array(here))
    sums = []
    for kind in (1, 0):  # target, clutter in beam b
        factors = [tables[p][:, kind if p == b else 2] * width for p in range(beams)]
        total = 0.0
        for index in np.ndindex(*(len(g),) * (beams - 1)):
            fixed = [g[i] for i in index]
            rows = np.column_stack([np.full(len(g), x) for x in fixed] + [g])
            density = np.exp(-0.5 * np.einsum("ni,ij,nj->n", rows, inverse, rows))
            product = 1.0
            for place, i in enumerate(index):
                product *= factors[place][i]
            total += product * (density * factors[-1]).sum()
        sums.append(total)
    return math.log(sums[0]) - math.log(sums[1])
