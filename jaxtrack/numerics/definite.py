"""Inverse and roots of small positive definite matrices, written out entry by entry.

A batch of small matrices through LAPACK blocks the CPU's worker threads (with jaxlib 0.10.2 a few
hundred of them at once can hang the process); written out, the batch is plain vector arithmetic.
"""

import jax
import jax.numpy as jnp

from jaxtrack.types import Array


def definite_inverse(matrix: Array, *, floor: float = 1e-5) -> tuple[Array, Array]:
    """Return the inverse of a positive definite matrix by Cholesky, and whether it is one.

        A = L Lᵀ,   A⁻¹ = L⁻ᵀ L⁻¹

    Pivots below `floor` are raised to it, so that the result is finite and positive definite for
    every symmetric input; scale the matrix to a unit diagonal before.

    Args:
        matrix: [n, n] symmetric, n small: the program grows as n³.
        floor: least pivot.

    Returns:
        The inverse [n, n] and a flag, False where a pivot had to be raised.

    Example:
        >>> inverse, definite = definite_inverse(jnp.array([[2.0, 1.0], [1.0, 2.0]]))
        >>> print((3 * inverse).round(3).tolist(), bool(definite))
        [[2.0, -1.0], [-1.0, 2.0]] True
    """
    _, root, definite = _cholesky(matrix, floor)
    return root.T @ root, definite


def scaled_inverse(matrix: Array) -> tuple[Array, Array]:
    """Return the inverse of a positive definite matrix of mixed units, and whether it is one.

    Scaled to a unit diagonal first: positions and velocities differ by orders of magnitude.
    Directions without information get a large finite variance.

    Args:
        matrix: [n, n] symmetric, n small.

    Example:
        >>> inverse, definite = scaled_inverse(jnp.array([[4.0, 0.0], [0.0, 1e-8]]))
        >>> print(f"{inverse[0, 0]:.2f} {inverse[1, 1]:.0e} {definite}")
        0.25 1e+08 True
    """
    diagonal = jnp.diagonal(matrix)
    scale = jax.lax.rsqrt(jnp.where(diagonal > 0, diagonal, 1.0))
    inverse, definite = definite_inverse(matrix * scale[:, None] * scale[None, :])
    return inverse * scale[:, None] * scale[None, :], definite & (diagonal > 0).all()


def scaled_root(matrix: Array, *, floor: float = 1e-5) -> tuple[Array, Array]:
    """Return R with Rᵀ R the inverse of a positive definite matrix of mixed units, and whether.

    If z is standard normal, Rᵀ z has the matrix for its information.

    Args:
        matrix: [n, n] symmetric, n small.
        floor: least pivot of the matrix scaled to a unit diagonal.

    Example:
        >>> print(jnp.diagonal(scaled_root(jnp.array([[4.0, 0.0], [0.0, 0.01]]))[0]).round(1))
        [ 0.5 10. ]
    """
    _, root, definite = scaled_cholesky(matrix, floor=floor)
    return root, definite


def scaled_cholesky(matrix: Array, *, floor: float = 1e-5) -> tuple[Array, Array, Array]:
    """Return L and L⁻¹ of a positive definite matrix A = L Lᵀ of mixed units, and whether it is.

    Args:
        matrix: [n, n] symmetric, n small.
        floor: least pivot of the matrix scaled to a unit diagonal.

    Returns:
        L [n, n] and L⁻¹ [n, n], lower triangular, and a flag, False where a pivot had to be raised.

    Example:
        >>> lower, inverse, _ = scaled_cholesky(jnp.array([[4.0, 2.0], [2.0, 10.0]]))
        >>> print(lower.round(2).tolist(), jnp.allclose(lower @ inverse, jnp.eye(2), atol=1e-6))
        [[2.0, 0.0], [1.0, 3.0]] True
    """
    diagonal = jnp.diagonal(matrix)
    scale = jax.lax.rsqrt(jnp.where(diagonal > 0, diagonal, 1.0))
    lower, inverse, definite = _cholesky(matrix * scale[:, None] * scale[None, :], floor)
    return lower / scale[:, None], inverse * scale[None, :], definite & (diagonal > 0).all()


def rounding_floor(matrix: Array) -> float:
    """Return the least pivot of a matrix of unit diagonal that is more than rounding.

    Example:
        >>> 0 < rounding_floor(jnp.eye(2)) < 1e-5
        True
    """
    return 8 * float(jnp.finfo(matrix.dtype).eps)


def _cholesky(matrix: Array, floor: float) -> tuple[Array, Array, Array]:
    """Return L and L⁻¹ of A = L Lᵀ, and whether no pivot had to be raised."""
    n = matrix.shape[0]
    lower: list[list[Array]] = [[jnp.zeros((), matrix.dtype)] * n for _ in range(n)]
    inverse: list[list[Array]] = [[jnp.zeros((), matrix.dtype)] * n for _ in range(n)]
    definite = jnp.asarray(True)
    for j in range(n):
        pivot = matrix[j, j] - sum(lower[j][k] ** 2 for k in range(j))
        definite = definite & (pivot > floor)
        lower[j][j] = jnp.sqrt(jnp.where(pivot > floor, pivot, floor))
        for i in range(j + 1, n):
            rest = matrix[i, j] - sum(lower[i][k] * lower[j][k] for k in range(j))
            # Row i of L has the length √A_ii. Of a matrix that is not definite entries would grow
            # from column to column without end.
            entry = rest / lower[j][j]
            bound = 4 * jnp.where(matrix[i, i] > floor, matrix[i, i], floor)
            lower[i][j] = jnp.where(entry * entry <= bound, entry, 0.0)
    for j in range(n):
        inverse[j][j] = 1 / lower[j][j]
        for i in range(j + 1, n):
            rest = sum(lower[i][k] * inverse[k][j] for k in range(j, i))
            inverse[i][j] = -rest / lower[i][i]
    whole = lambda rows: jnp.stack([jnp.stack(row) for row in rows])
    return whole(lower), whole(inverse), definite
