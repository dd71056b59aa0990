"""Zernike's and Hu's moments point by point, the polynomials with whole numbers and fractions."""

import cmath
import math
from fractions import Fraction


def radial(n, m, rho):
    """Return R_nm(ρ) of the very number that ρ is, by the sum over factorials (equation 9)."""
    rho, m, total = Fraction(float(rho)), abs(m), Fraction(0)
    for s in range((n - m) // 2 + 1):
        denominator = (
            math.factorial(s) * math.factorial((n + m) // 2 - s) * math.factorial((n - m) // 2 - s)
        )
        total += Fraction((-1) ** s * math.factorial(n - s), denominator) * rho ** (n - 2 * s)
    return float(total)


def fade(rho, taper):
    """Return the share of a point's weight that counts; a taper of 0 is the hard edge."""
    if rho > 1.0:
        return 0.0
    if rho <= 1.0 - taper:
        return 1.0
    s = (1.0 - rho**2) / (1.0 - (1.0 - taper) ** 2)
    return s**2 * (3.0 - 2.0 * s)


def zernike(points, weights, n, m, radius, taper=0.0):
    """Return Z_nm (equation 14) over the mass in the disc; 0 of none."""
    total, mass = 0.0, 0.0
    for (x, y), w in zip(points, weights, strict=True):
        if not (math.isfinite(x) and math.isfinite(y) and math.isfinite(w) and w > 0):
            continue
        rho, theta = math.hypot(x, y) / radius, math.atan2(y, x)
        w = w * fade(rho, taper)
        if w > 0:
            total += w * radial(n, m, rho) * cmath.exp(-1j * m * theta)
            mass += w
    return (n + 1) / math.pi * total / mass if mass > 0 else 0.0


def hu(points, weights):
    """Return the seven invariants as they stand in textbooks."""
    kept = [
        (x, y, w)
        for (x, y), w in zip(points, weights, strict=True)
        if math.isfinite(x) and math.isfinite(y) and math.isfinite(w) and w > 0
    ]
    mass = sum(w for _, _, w in kept)
    if mass == 0:
        return [0.0] * 7
    mean_x = sum(w * x for x, _, w in kept) / mass
    mean_y = sum(w * y for _, y, w in kept) / mass

    def eta(p, q):
        mu = sum(w * (x - mean_x) ** p * (y - mean_y) ** q for x, y, w in kept)
        return mu / mass ** (1 + (p + q) / 2)

    n20, n02, n11 = eta(2, 0), eta(0, 2), eta(1, 1)
    n30, n03, n21, n12 = eta(3, 0), eta(0, 3), eta(2, 1), eta(1, 2)
    return [
        n20 + n02,
        (n20 - n02) ** 2 + 4 * n11**2,
        (n30 - 3 * n12) ** 2 + (3 * n21 - n03) ** 2,
        (n30 + n12) ** 2 + (n21 + n03) ** 2,
        (n30 - 3 * n12) * (n30 + n12) * ((n30 + n12) ** 2 - 3 * (n21 + n03) ** 2)
        + (3 * n21 - n03) * (n21 + n03) * (3 * (n30 + n12) ** 2 - (n21 + n03) ** 2),
        (n20 - n02) * ((n30 + n12) ** 2 - (n21 + n03) ** 2) + 4 * n11 * (n30 + n12) * (n21 + n03),
        (3 * n21 - n03) * (n30 + n12) * ((n30 + n12) ** 2 - 3 * (n21 + n03) ** 2)
        - (n30 - 3 * n12) * (n21 + n03) * (3 * (n30 + n12) ** 2 - (n21 + n03) ** 2),
    ]
