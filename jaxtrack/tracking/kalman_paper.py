"""The Kalman tracker that the clustering-statistic paper compares itself with: a weak baseline.

`kalman_tracker` with the paper's settings. Its process noise is so large that the filter hardly
smooths: at σ = 3 m and T_s = 0.5 s the acceleration's deviation is 24 m/s². A comparison that wants
to be fair puts a `kalman_tracker` with sensible settings beside it.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp

from jaxtrack.association import Associator
from jaxtrack.filtering.gaussian import Moments, correct, predict
from jaxtrack.models.motion import transition_matrix
from jaxtrack.models.process import white_noise_acceleration
from jaxtrack.numerics.checks import check_array, check_choice, check_positive
from jaxtrack.numerics.safe import as_float
from jaxtrack.tracking.filters import straight_filter
from jaxtrack.tracking.kalman_tracker import (
    KalmanTrackerInfo,
    KalmanTrackerParams,
    KalmanTrackerState,
    kalman_tracker,
)
from jaxtrack.tracking.lifecycle import LifecycleParams
from jaxtrack.types import Array, Estimator, Scan

STARTS = ("detection", "origin")


class KalmanPaperParams(NamedTuple):
    """The settings of section V-B; what it does not give is marked. Traced."""

    sigma_m: Array | float = 3.0  # [] σ = σ_V of each coordinate
    dt_s: Array | float = 0.5  # [] T_s, from which the process noise follows
    birth_sigma_m: Array | float = 5.0  # [] of P₀
    birth_sigma_m_s: Array | float = 2.0  # [] of P₀
    p_detect: Array | float = 0.5  # [] 1 − P_M
    clutter_per_m2: Array | float = 2.5e-3  # [] 90 beams at P_F = 0.5 over the sonar's sector
    gate: Array | float = 9.21  # [] squared Mahalanobis distance; ours
    lifecycle: LifecycleParams = LifecycleParams()  # ours


def kalman_paper(
    params: KalmanPaperParams,
    *,
    max_tracks: int,
    start: str = "detection",
    associator: str | Associator = "greedy",
    confirm_looks: int = 5,
) -> Estimator[Scan, KalmanTrackerState, KalmanTrackerInfo]:
    """Return the paper's Kalman tracker, as an estimator over `Scan`.

        X(i) = φ X(i−1) + Γ W(i),   Y(i) = [I₂ 0] X(i) + V(i),   Γ = [T_s²/2 I₂; T_s I₂],
        σ_W = 2 σ / T_s²,   σ_V = σ,   P₀ = diag(5², 5², 2², 2²)

    Args:
        params: of sensor, births and lifecycle. T_s sets the process noise alone: states move by
            the time that passed.
        max_tracks: T, slots of the table, static. Clutter fills many.
        start: where a track starts, static. `"detection"`: X₀ is the first detection at rest, and
            P₀ its covariance. `"origin"`: X₀ = 0 to the letter, T_s before the first detection,
            which then corrects it: at the default settings to a velocity of 0.86 of its place a
            second, so that a target farther from the origin than some 85 m is lost at once.
        associator: a name in `ASSOCIATORS`, or an associator with its update. The paper does not
            say which it has; the nearest neighbour that no closer track takes is ours.
        confirm_looks: N of the M-of-N rule, static.

    Returns:
        An estimator with the state and the info of `kalman_tracker`.

    Raises:
        TypeError: a size is not a Python int.
        ValueError: a size is too small, an unknown start or associator, or a known number that
            cannot be.

    Example:
        >>> t = 0.5 * jnp.arange(8.0)
        >>> at = jnp.stack([20 + 2 * t, 50 - t], axis=-1)[:, None]
        >>> scans = Scan(t, jnp.ones(8, bool), at, jnp.ones((8, 1), bool))
        >>> tracker = kalman_paper(KalmanPaperParams(), max_tracks=2)
        >>> _, info = jax.lax.scan(tracker.step, tracker.init(jax.random.key(0)), scans)
        >>> print(info.tracks.mean[-1, 0].round(1), info.tracks.stage[:, 0])
        [27.  46.5  2.  -1. ] [1 1 2 2 2 2 2 2]

    Source: clustering-statistic Hough transform (2018), equation 5 and section V-B.

    Note:
        The Ψ of equation 5 picks the first and the third entry of [n, e, ṅ, ė]; positions are meant.
        A detection's own covariance is not looked at: the paper's σ_V holds for both coordinates.
    """  # noqa: E501
    check_choice("start", start, STARTS)
    for name in ("sigma_m", "dt_s"):
        check_array(f"params.{name}", getattr(params, name), shape=())
    dtype = as_float(params.sigma_m).dtype
    sigma_m = check_positive("params.sigma_m", params.sigma_m, dtype)
    dt_s = check_positive("params.dt_s", params.dt_s, dtype)
    sigma_w = 2 * sigma_m / dt_s**2
    straight = straight_filter(sigma_m, sigma_w, params.birth_sigma_m_s, params.birth_sigma_m)

    def from_origin(look: Scan) -> Moments:
        """Return X₀ = 0 and P₀ moved by T_s and corrected with each detection."""
        at = straight.start(look)
        noise = white_noise_acceleration(dt_s, sigma_w)
        unit = jnp.eye(2, dtype=dtype)

        def one(position_m: Array, p0: Array) -> Moments:
            moved = predict(jnp.zeros(4, dtype), p0, transition_matrix(dt_s), noise)
            known = jnp.eye(2, 4, dtype=dtype), sigma_m**2 * unit
            return Moments(*correct(*moved, position_m, *known)[:2])

        return jax.vmap(one)(at.mean[:, :2], at.covariance)

    return kalman_tracker(
        KalmanTrackerParams(
            sigma_m,
            sigma_w,
            params.p_detect,
            params.clutter_per_m2,
            params.birth_sigma_m_s,
            params.birth_sigma_m,
            params.gate,
            lifecycle=params.lifecycle,
        ),
        max_tracks=max_tracks,
        associator=associator,
        confirm_looks=confirm_looks,
        filter=straight._replace(
            look=lambda scan: scan._replace(covariance_m2=None),
            start=straight.start if start == "detection" else from_origin,
        ),
    )
