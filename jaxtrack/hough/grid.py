"""The parameter space: its cells, its sizes, and the seam at θ = 0 ~ π.

    ρ_i = (i + ½) Δρ − ρ_max,  Δρ = 2 ρ_max / n_ρ;     θ_j = (j + ½) Δθ,  Δθ = π / n_θ

(equations 25 and 26 of the neutrosophic Hough transform, 2018, with the offset that a signed ρ
needs). Cell (i, j) and cell (n_ρ − 1 − i, j ± n_θ) are one: leaving at θ = π with ρ means
entering at θ = 0 with −ρ.
"""

from typing import NamedTuple

import jax.numpy as jnp

from jaxtrack.numerics.checks import check_size
from jaxtrack.types import Array


class Grid(NamedTuple):
    """Where the parameter space lies. Traced."""

    origin_m: Array | tuple[float, float] = (0.0, 0.0)  # [2] the point that ρ is measured from
    rho_max_m: Array | float = 4000.0  # [] |ρ| below this; votes outside are dropped


class Sizes(NamedTuple):
    """Everything that sets an array's shape. Python ints, static under `jit`.

    Votes are evaluated at the `candidates` parameter points that a cheap upper bound ranks first;
    `pairs` bounds the candidate pairs of one interval, `predecessors` those that end in one
    detection. What does not fit raises the `overflow` flag of the method's info. Where votes have
    covariances of their own the bound is a rule of thumb: it goes by the typical one.
    """

    lines: int = 8  # lines that are extracted
    pairs: int = 2048  # candidate pairs an interval
    predecessors: int = 48  # candidate pairs that end in one detection
    candidates: int = 256  # parameter points at which votes are counted exactly
    rho: int = 1600  # cells along ρ
    theta: int = 3142  # cells along θ
    smooth: int = 0  # sigma in cells of the Gaussian that smooths the votes; 0: raw


def check_sizes(sizes: Sizes) -> None:
    """Check every static size.

    Raises:
        TypeError: a size is not a Python int.
        ValueError: a size is too small.
    """
    for name, value in zip(Sizes._fields, sizes, strict=True):
        check_size(f"sizes.{name}", value, at_least=0 if name == "smooth" else 1)


def steps(grid: Grid, sizes: Sizes, dtype: jnp.dtype) -> tuple[Array, Array]:
    """Return the cells' widths (Δρ in metres, Δθ in radians)."""
    rho_step = 2 * jnp.asarray(grid.rho_max_m, dtype) / sizes.rho
    return rho_step, jnp.asarray(jnp.pi / sizes.theta, dtype)


def cell_of(rho_m: Array, theta_rad: Array, grid: Grid, sizes: Sizes) -> tuple[Array, Array, Array]:
    """Return the cell indices (i, j) of parameter points, and whether they lie in the grid."""
    rho_step, theta_step = steps(grid, sizes, rho_m.dtype)
    i = jnp.floor((rho_m + jnp.asarray(grid.rho_max_m, rho_m.dtype)) / rho_step)
    j = jnp.floor(theta_rad / theta_step)
    # The largest θ below π may be rounded up to the edge of the last cell, out of the grid.
    j = jnp.where(theta_rad < jnp.pi, jnp.minimum(j, float(sizes.theta - 1)), j)
    inside = (i >= 0) & (i < sizes.rho) & (j >= 0) & (j < sizes.theta)
    clean = jnp.where(inside, i, 0.0), jnp.where(inside, j, 0.0)
    return clean[0].astype(jnp.int32), clean[1].astype(jnp.int32), inside


def centre_of(
    i: Array, j: Array, grid: Grid, sizes: Sizes, dtype: jnp.dtype
) -> tuple[Array, Array]:
    """Return the centre (ρ, θ) of cells."""
    rho_step, theta_step = steps(grid, sizes, dtype)
    rho = (i.astype(dtype) + 0.5) * rho_step - jnp.asarray(grid.rho_max_m, dtype)
    return rho, (j.astype(dtype) + 0.5) * theta_step


def cell_difference(
    i: Array, j: Array, other_i: Array, other_j: Array, sizes: Sizes
) -> tuple[Array, Array]:
    """Return (Δi, Δj) from one cell to others, each taken as the nearer of its two names."""
    d_j = other_j - j
    twin = jnp.abs(d_j) > sizes.theta // 2
    d_j = jnp.where(twin, d_j - jnp.sign(d_j) * sizes.theta, d_j)
    return jnp.where(twin, sizes.rho - 1 - other_i, other_i) - i, d_j
