"""Recursive least squares: fits a linear regression one measurement at a time.

    z_k = Bᵀ φ_k + noise;     minimises Σ_k f^{n−k} |z_k − Bᵀ φ_k|² + f^n ‖B − B₀‖² / δ

with f the forgetting factor. It smooths initialised tracks: φ = (1, t − t_ref), z a position.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp

from jaxtrack.numerics.checks import check_known, check_positive, check_size
from jaxtrack.types import Array, Estimator


class RlsParams(NamedTuple):
    """Parameters of recursive least squares. Traced."""

    forgetting: Array | float = 1.0  # f in (0, 1]; 1 forgets nothing
    initial_variance: Array | float = 1e6  # δ; P starts as δ I and B as zero


class RlsState(NamedTuple):
    """What the next measurement needs."""

    coefficients: Array  # [R, D] B
    inverse: Array  # [R, R] P, the inverse of the regressors' weighted scatter


class RlsInput(NamedTuple):
    """One measurement."""

    regressors: Array  # [R] φ
    measurement: Array  # [D] z; may hold anything where masked
    mask: Array  # []


def update(
    state: RlsState, regressors: Array, measurement: Array, forgetting: Array | float = 1.0
) -> RlsState:
    """Take one measurement in.

        g = P φ / (f + φᵀ P φ),   B ← B + g (z − Bᵀ φ)ᵀ,   P ← (P − g φᵀ P) / f

    Args:
        state: coefficients [R, D] and inverse scatter [R, R].
        regressors: [R] φ.
        measurement: [D] z.
        forgetting: [] f in (0, 1]; 1 forgets nothing.

    Raises:
        ValueError: a known forgetting factor outside (0, 1].

    Example:
        >>> state = RlsState(jnp.zeros((1, 1)), 1e6 * jnp.eye(1))
        >>> for z in (4.0, 6.0):
        ...     state = update(state, jnp.ones(1), jnp.array([z]))
        >>> print(state.coefficients.round(2))
        [[5.]]
    """
    want = "a factor above 0 and at most 1"
    check_known("forgetting", forgetting, lambda f: (f > 0) & (f <= 1), want)
    f = jnp.asarray(forgetting, regressors.dtype)
    reach = state.inverse @ regressors
    gain = reach / (f + regressors @ reach)
    innovation = measurement - state.coefficients.T @ regressors
    inverse = (state.inverse - gain[:, None] * reach[None, :]) / f
    # The update keeps P symmetric only up to rounding, which would add up over many steps.
    return RlsState(
        state.coefficients + gain[:, None] * innovation[None, :], (inverse + inverse.T) / 2
    )


def rls(
    params: RlsParams = RlsParams(),  # noqa: B008 - an immutable tuple
    *,
    regressors: int,
    dimensions: int,
) -> Estimator[RlsInput, RlsState, Array]:
    """Return the recursive least squares filter as an estimator.

    Args:
        params: forgetting factor and initial variance.
        regressors: R, static.
        dimensions: D, static.

    Raises:
        TypeError: a size is not a Python int.
        ValueError: a size is too small, or a known number cannot be.

    Returns:
        An estimator over `RlsInput`, whose info is the fitted measurement Bᵀ φ, [D]. A masked
        measurement changes nothing.

    Example:
        >>> filter = rls(regressors=2, dimensions=1)
        >>> t = jnp.arange(3.0)
        >>> inputs = RlsInput(jnp.stack([jnp.ones(3), t], -1), 5 + 2 * t[:, None], jnp.ones(3, bool))
        >>> state, fitted = jax.lax.scan(filter.step, filter.init(jax.random.key(0)), inputs)
        >>> print(state.coefficients.round(2).ravel())
        [5. 2.]
    """  # noqa: E501
    for name, size in (("regressors", regressors), ("dimensions", dimensions)):
        check_size(name, size)
    dtype = jnp.result_type(float)
    variance = check_positive("params.initial_variance", params.initial_variance, dtype)

    def init(key: Array) -> RlsState:
        zero = jnp.zeros((regressors, dimensions), variance.dtype)
        return RlsState(zero, variance * jnp.eye(regressors, dtype=variance.dtype))

    def step(state: RlsState, scan: RlsInput) -> tuple[RlsState, Array]:
        clean = jnp.where(scan.mask, scan.measurement, 0.0)
        after = update(state, scan.regressors, clean, params.forgetting)
        state = jax.tree.map(lambda new, old: jnp.where(scan.mask, new, old), after, state)
        return state, state.coefficients.T @ scan.regressors

    return Estimator(init, step)
