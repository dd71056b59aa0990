"""The posterior Cramér–Rao bound: what no filter's mean square error can fall below.

Motion is linear, with Gaussian noise that may be singular; measurements are any function of the
state with Gaussian noise. The bound is then the covariance of a Kalman filter whose measurement
carries the mean information over the targets' true states.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer

from jaxtrack.filtering.gaussian import predicted_covariance
from jaxtrack.numerics.checks import check_array, check_known, check_size
from jaxtrack.numerics.definite import rounding_floor, scaled_cholesky, scaled_root
from jaxtrack.numerics.masked import masked_mean
from jaxtrack.numerics.safe import as_float
from jaxtrack.types import Array


class CramerRao(NamedTuple):
    """The bound at T looks."""

    covariance: Array  # [T, S, S] after each look
    definite: Array  # [T] False: a covariance was singular beyond rounding


def measurement_information(
    states: Array,
    mask: Array,
    measure: Callable[[Array], Array],
    noise: Array,
    p_detect: Any = 1.0,
) -> Array:
    """Return the mean information of one look, over the states where a target may be.

        E[P_D(x) H(x)ᵀ R⁻¹ H(x)],   H = ∂h/∂x

    Args:
        states: [N, S] true states of N runs at this look; one is enough where h is linear.
        mask: [N] which of them exist.
        measure: h, state [S] → measurement [Z].
        noise: [Z, Z] R.
        p_detect: [] or [N] P_D.

    Returns:
        [S, S]; zero where there is no state.

    Raises:
        ValueError: shapes do not fit, or a known P_D is no probability.
        TypeError: not real numbers.

    Example:
        >>> position = lambda state: state[:2]
        >>> print(measurement_information(
        ...     jnp.zeros((1, 3)), jnp.ones(1, bool), position, 4.0 * jnp.eye(2), 0.5))
        [[0.125 0.    0.   ]
         [0.    0.125 0.   ]
         [0.    0.    0.   ]]

    Source:
        Tichavský, Muravchik and Nehorai, "Posterior Cramér–Rao Bounds for Discrete-Time Nonlinear
        Filtering" (1998), the part of D²² that the measurement gives. P_D as a factor: see
        `cramer_rao`.
    """
    check_array("states", states, shape=("N", "S"))
    check_size("number of states", jnp.shape(states)[0])
    check_array("noise", noise, shape=("Z", jnp.shape(noise)[-1] if jnp.ndim(noise) else "Z"))
    states = as_float(states)
    check_array("mask", mask, shape=states.shape[:1])
    if jnp.ndim(p_detect):
        check_array("p_detect", p_detect, shape=states.shape[:1])
    mask = jnp.asarray(mask, bool)
    if not isinstance(mask, Tracer) and not isinstance(p_detect, Tracer):
        known = np.where(mask, np.asarray(p_detect), 0.0)
        check_known("p_detect", known, lambda p: (p >= 0) & (p <= 1), "probabilities")
    # Where a state is missing, the first that exists stands for it: its slope is finite.
    states = jnp.where(mask[:, None], states, states[jnp.argmax(mask)][None])
    states = jnp.where(mask.any(), states, 0.0)
    noise = jnp.asarray(noise, states.dtype)
    root, _ = scaled_root(noise, floor=rounding_floor(noise))
    slopes = jax.vmap(lambda state: root @ jax.jacfwd(measure)(state))(states)  # [N, Z, S]
    detect = jnp.where(mask, jnp.asarray(p_detect, states.dtype), 0.0)
    each = detect[:, None, None] * jnp.einsum("nzs,nzr->nsr", slopes, slopes)
    return masked_mean(each, mask[:, None, None], axis=0)


def cramer_rao(covariance: Array, transition: Array, noise: Array, information: Array) -> CramerRao:
    """Return the posterior Cramér–Rao bound of the state after each look.

        J_k = (Q + F J_{k−1}⁻¹ Fᵀ)⁻¹ + G_k,   P_k = J_k⁻¹,   G_k = E[P_D Hᵀ R⁻¹ H]

    With a linear measurement and P_D = 1 that is the Kalman filter's covariance, which reaches it.
    With P_D < 1 it is the *information-reduction* form: a look carries the mean information. It is
    a bound, but a lower one than the mean over all sequences of detections of the bound given the
    sequence (the enumeration form, which a Kalman filter reaches), for the inverse is convex.

    Args:
        covariance: [S, S] before the first look, and before the motion to it.
        transition: [T, S, S] F, to each look from the one before.
        noise: [T, S, S] Q of that motion.
        information: [T, S, S] G, from `measurement_information`.

    Returns:
        The bound on E[(x̂ − x)(x̂ − x)ᵀ], without clutter and with known association.

    Raises:
        ValueError: shapes do not fit.
        TypeError: not real numbers.

    Example:
        >>> one = jnp.ones((3, 1, 1))
        >>> print(cramer_rao(jnp.eye(1), one, 0 * one, one).covariance[:, 0, 0].round(3))
        [0.5   0.333 0.25 ]

    Source:
        Tichavský, Muravchik and Nehorai (1998), proposition 1; on P_D Hernandez, Ristic,
        Farina and Timmoneri, "A Comparison of Two Cramér–Rao Bounds for Nonlinear Filtering
        with P_D < 1" (2004).

    Note:
        The proposition inverts Q, which is singular where one acceleration drives position and
        velocity. For linear motion it is the form above, by the matrix inversion lemma.
    """
    check_array("covariance", covariance, shape=("S", "S"))
    size = jnp.shape(covariance)[0]
    check_array("covariance", covariance, shape=(size, size))
    check_array("transition", transition, shape=("T", size, size))
    looks = jnp.shape(transition)[0]
    check_array("noise", noise, shape=(looks, size, size))
    check_array("information", information, shape=(looks, size, size))

    def step(before: Array, look: tuple[Array, Array, Array]) -> tuple[Array, tuple[Array, Array]]:
        motion, added, gained = look
        predicted = predicted_covariance(before, motion, added)
        # (P⁻¹ + G)⁻¹ = L (I + Lᵀ G L)⁻¹ Lᵀ with P = L Lᵀ: nothing nearly singular is inverted.
        lower, _, definite = scaled_cholesky(predicted, floor=rounding_floor(predicted))
        inner = jnp.eye(size, dtype=before.dtype) + lower.T @ gained @ lower
        root, _ = scaled_root((inner + inner.T) / 2, floor=rounding_floor(inner))
        half = root @ lower.T
        after = half.T @ half
        return after, (after, definite)

    start = jnp.asarray(covariance, jnp.result_type(covariance, transition, float))
    same = [jnp.asarray(x, start.dtype) for x in (transition, noise, information)]
    _, (after, definite) = jax.lax.scan(step, start, (same[0], same[1], same[2]))
    return CramerRao(after, definite)
