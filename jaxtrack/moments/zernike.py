"""Zernike moments of weighted points in a disc about the origin.

With ρ and θ the polar coordinates of a point in units of the disc's radius,

    V_nm = R_nm(ρ) exp(j m θ),   Z_nm = (n + 1)/π Σ w V*_nm / Σ w   over ρ ≤ 1.

The paper's equation 14 is Z_nm Σ w. Equation 10 is the same integral divided by ∬ f dx dy, where w
is f times the area that a point stands for, if that area is the same for all; so no ΔA is needed.
"""

import math

import jax
import jax.numpy as jnp
import numpy as np

from jaxtrack.moments.totals import totals
from jaxtrack.moments.window import inside, soft_inside
from jaxtrack.numerics.checks import check_positive, check_size
from jaxtrack.types import Array

Orders = tuple[tuple[int, int], ...]
"""(n, m) of some moments: |m| ≤ n, n − |m| even."""

PAPER_ORDERS: Orders = ((3, 1), (5, 3), (7, 3), (7, 5), (9, 3), (9, 5), (9, 7))
"""The paper's Table 1. All m are odd: of what looks the same turned by π every moment is zero."""

LOW_ORDERS: Orders = ((2, 0), (2, 2), (3, 1), (3, 3), (4, 0), (4, 2), (4, 4))

HIGHEST = 40
"""n up to which the recurrence has been checked."""

_EXPLICIT = 9  # n up to which the polynomials are written out, which costs less than to recur


def zernike(xy: Array, weight: Array, *, orders: Orders, radius: Array | float) -> Array:
    """Return Zernike moments of points in a disc about the origin, complex [len(orders)].

        Z_nm = (n + 1)/π Σ_p w_p R_nm(ρ_p) exp(−j m θ_p) / Σ_p w_p   over ρ_p = |x_p|/r ≤ 1

        R_nm(ρ) = Σ_s (−1)^s (n − s)! / (s! ((n + |m|)/2 − s)! ((n − |m|)/2 − s)!) ρ^(n − 2s)

    Turned by φ about the origin, points have Z_nm exp(−j m φ): |Z_nm| stays. Mirrored in the x
    axis, they have the conjugate. Points and radius times a factor, or weights times one, change
    nothing. Points moved change everything: subtract the centre first, a particle or the centroid.
    Without weight in the disc, the moments are zero.

    `mahotas.features.zernike_moments(image, radius, degree, cm)` returns |Z_nm| for all n ≤ degree
    and m ≥ 0, with the same prefactor and the same division by the mass in the disc; its points are
    the pixels of positive value, see `zernike_image`.

    Args:
        xy: [P, 2] from the centre, in the unit of `radius`.
        weight: [P]; a point with a weight that is not positive and finite, or not at a finite
            place, is none.
        orders: (n, m), |m| ≤ n ≤ 40, n − |m| even. Static.
        radius: r > 0 of the disc; points on the edge count, R(1) = 1.

    Raises:
        ValueError: shapes do not fit, no such order, or a radius that cannot be.
        TypeError: not real numbers, or orders that are not ints.

    Example:
        >>> xy = jnp.array([[1.0, 0.0], [0.0, 1.0], [-1.0, 0.0], [0.0, -1.0]])
        >>> moments = zernike(xy, jnp.ones(4), orders=((2, 0), (2, 2), (4, 4)), radius=1.0)
        >>> print(*(f"{abs(z):.3f}" for z in moments))
        0.955 0.000 1.592

    Source: Zernike moment feature matching (2023), equations 7 to 14.

    Note:
        |m| ≤ n: the paper prints m < n. Its origin is the centre of the target's region.
        The gradient is that of the points in the disc: one that crosses the edge is a step.
    """
    xy, weight = inside(xy, weight, radius=radius)
    return _moments(xy, weight, orders, radius)


def soft_zernike(
    xy: Array,
    weight: Array,
    *,
    orders: Orders,
    radius: Array | float,
    taper: Array | float,
) -> Array:
    """Return Zernike moments of points that fade towards the edge, complex [len(orders)].

    The weights, in the sum of the moment and in the mass, are those of `soft_inside`. Tends to
    `zernike` as the taper vanishes. A point that crosses the edge is no step, unless it was the
    only one: a mean over no points is set to zero.

    Args:
        xy: [P, 2] from the centre, in the unit of `radius`.
        weight: [P]; what `zernike` says.
        orders: (n, m), |m| ≤ n ≤ 40, n − |m| even. Static.
        radius: r > 0 of the disc.
        taper: share of the radius over which points fade, in (0, 1].

    Raises:
        ValueError: shapes do not fit, no such order, or a radius or taper that cannot be.
        TypeError: not real numbers, or orders that are not ints.

    Example:
        >>> xy = jnp.array([[0.2, 0.0], [0.95, 0.0]])
        >>> one = {"orders": ((2, 0),), "radius": 1.0}
        >>> for taper in (0.5, 1e-3):
        ...     print(f"{soft_zernike(xy, jnp.ones(2), **one, taper=taper)[0].real:.3f}")
        -0.806
        -0.055
        >>> print(f"{zernike(xy, jnp.ones(2), **one)[0].real:.3f}")
        -0.055
    """
    xy, weight = soft_inside(xy, weight, radius=radius, taper=taper)
    return _moments(xy, weight, orders, radius)


def _moments(xy: Array, weight: Array, orders: Orders, radius: Array | float) -> Array:
    orders = check_orders(orders)
    dtype = xy.dtype
    radius = check_positive("radius", radius, dtype)
    z = xy * (1 / radius)
    highest = max(n for n, _ in orders)
    sums = _explicit if highest <= _EXPLICIT else _recurrent
    mass, real, imaginary = sums(z[:, 0], z[:, 1], weight, orders)
    # Dividing by the mass as a number first keeps its square, which may overflow, out of the
    # gradient; the quotient by what is then one brings the derivative in.
    some = mass > jnp.finfo(dtype).tiny
    scale = jax.lax.stop_gradient(jnp.where(some, 1 / jnp.where(some, mass, 1.0), 0.0))
    share = jnp.where(some, mass * scale, 1.0)
    factor = jnp.asarray([(n + 1) / math.pi for n, _ in orders], dtype)
    # V* of a negative m is V of the positive one.
    sign = jnp.asarray([-1.0 if m >= 0 else 1.0 for _, m in orders], dtype)
    factor = factor * scale / share
    return jax.lax.complex(factor * real, sign * factor * imaginary)


def _explicit(x: Array, y: Array, w: Array, orders: Orders) -> tuple[Array, Array, Array]:
    """Return Σ w and the parts of Σ w V, with z^m times a polynomial in u = 2ρ² − 1.

    In ρ² the coefficients of R_91 add up to 681, and their rounding with them; in u to 9.
    """
    u = 2 * (x * x + y * y) - 1
    # The parts of z^m, m by m from z^(m−2): most sets of orders have few m, of one parity.
    even, odd = x * x - y * y, 2 * x * y
    powers = [(jnp.ones_like(x), jnp.zeros_like(x)), (x, y)]
    for _ in range(2, max(abs(m) for _, m in orders) + 1):
        a, b = powers[-2]
        powers.append((a * even - b * odd, a * odd + b * even))
    terms = [w]
    for n, m in orders:
        coefficients = radial_coefficients(n, abs(m))
        value = jnp.full_like(u, coefficients[-1])
        for coefficient in coefficients[-2::-1]:
            value = value * u + coefficient
        terms += [w * value * part for part in powers[abs(m)]]
    mass, *parts = totals(*terms)
    return mass, jnp.stack(parts[::2]), jnp.stack(parts[1::2])


def _recurrent(x: Array, y: Array, w: Array, orders: Orders) -> tuple[Array, Array, Array]:
    """Return Σ w and the parts of Σ w V, for n = 0, 1, … from the two before.

        R_n^m = ρ (R_{n−1}^{|m−1|} + R_{n−1}^{m+1}) − R_{n−2}^m,
        V_n^m = z V_{n−1}^{m−1} + z* V_{n−1}^{m+1} − V_{n−2}^m,   V^{−1} = (V^1)*,  z = ρ exp(jθ)

    An even n has the rows m = 0, 2, …, an odd one m = 1, 3, …; those above n stay zero.
    """
    z = jax.lax.complex(x, y)
    weight = jax.lax.complex(w, jnp.zeros_like(w))
    half = max(n for n, _ in orders) // 2 + 1
    none = jnp.zeros((1, *z.shape), z.dtype)

    def two_orders(before: tuple[Array, Array], _: None) -> tuple[tuple[Array, Array], Array]:
        odd, even = before
        found = even @ weight
        above = jnp.concatenate([even[1:], none])
        odd = z[None] * even + z.conj()[None] * above - odd
        below = jnp.concatenate([odd[:1].conj(), odd[:-1]])
        even = z[None] * below + z.conj()[None] * odd - even
        return (odd, even), jnp.stack([found, odd @ weight])

    nothing = jnp.zeros((half, *z.shape), z.dtype)
    _, table = jax.lax.scan(two_orders, (nothing, nothing.at[0].set(1.0)), length=half)
    n, m = np.abs(orders).T
    moments = table[n // 2, n % 2, m // 2]
    return w.sum(), moments.real, moments.imag


def radial_coefficients(n: int, m: int) -> list[float]:
    """Return the coefficients c of R_nm(ρ) = ρ^m Σ_k c_k u^k, u = 2ρ² − 1.

    Args:
        n: order.
        m: from 0 to n, n − m even.

    Example:
        >>> radial_coefficients(3, 1)  # 3ρ³ − 2ρ
        [-0.5, 1.5]
    """
    half = (n - m) // 2
    factorial = math.factorial
    in_square = [
        (-1) ** (half - k)
        * factorial((n + m) // 2 + k)
        // (factorial(half - k) * factorial(m + k) * factorial(k))
        for k in range(half + 1)
    ]
    # ρ² = (1 + u)/2.
    return [
        sum(in_square[k] * math.comb(k, j) / 2**k for k in range(j, half + 1))
        for j in range(half + 1)
    ]


def check_orders(orders: Orders) -> Orders:
    """Return the orders of Zernike moments.

    Raises:
        ValueError: none, or an n and m that there is no polynomial of, or above 40.
        TypeError: not pairs of ints.

    Example:
        >>> check_orders(((3, 1), (4, -2)))
        ((3, 1), (4, -2))
    """
    check_size("number of orders", len(orders))
    for place, pair in enumerate(orders):
        if not isinstance(pair, (tuple, list)) or len(pair) != 2:
            raise TypeError(f"orders[{place}]: got {pair!r}, want a pair (n, m)")
        n, m = pair
        check_size(f"orders[{place}], n", n, at_least=0)
        check_size(f"orders[{place}], m", m, at_least=-HIGHEST)
        if n > HIGHEST or abs(m) > n or (n - m) % 2:
            raise ValueError(
                f"orders[{place}]: got {(n, m)}, want |m| ≤ n ≤ {HIGHEST} and n − |m| even"
            )
    return orders
