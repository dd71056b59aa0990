"""The multi-beam forward-looking sonar: what it is, for the simulator and for the likelihood."""

import math
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np

from jaxtrack.numerics.checks import check_known, check_positive, check_probability
from jaxtrack.types import Array


class BeamSonar(NamedTuple):
    """A sonar whose B beams divide its sector evenly; B is the length of its scans. Traced.

    A beam with a target misses it with probability P_M; a beam without one reports a range,
    uniform over the scope, with probability P_F. A missed beam stays silent, as in the paper, or
    reports clutter like an empty one with probability `clutter_in_missed_beam` · P_F.
    """

    p_miss: Array | float = 0.3  # P_M
    p_false: Array | float = 0.3  # P_F, of one beam in one look
    sigma_m: Array | float = 3.0  # noise of a target's range
    range_max_m: Array | float = 150.0  # ρ_D
    sector_rad: Array | float = math.pi / 2  # all beams together, symmetric about straight ahead
    mount_m: Array | tuple[float, float] = (0.0, 0.0)  # [2] in the body frame
    clutter_in_missed_beam: Array | float = 0.0  # 0: as in the paper; 1: as at sea


def check_sonar(sonar: BeamSonar) -> None:
    """Check what is known of a sonar.

    Raises:
        ValueError: a probability outside [0, 1], a negative noise, a scope or sector that is none.

    Example:
        >>> check_sonar(BeamSonar())
    """
    for name in ("p_miss", "p_false", "clutter_in_missed_beam"):
        check_probability(f"sonar.{name}", getattr(sonar, name), jnp.result_type(float))
    amount = lambda x: (x >= 0) & np.isfinite(x)
    check_known("sonar.sigma_m", sonar.sigma_m, amount, "a number of metres of at least 0")
    for name in ("range_max_m", "sector_rad"):
        check_positive(f"sonar.{name}", getattr(sonar, name), jnp.result_type(float))


def beam_bearings(sonar: BeamSonar, *, beams: int, dtype: jnp.dtype) -> Array:
    """Return the bearings of the beams' centres, port to starboard, [B].

    Example:
        >>> print(beam_bearings(BeamSonar(sector_rad=1.0), beams=4, dtype=jnp.float32))
        [-0.375 -0.125  0.125  0.375]

    Source: clustering-statistic Hough transform (2018), table 1.
    """
    width = jnp.asarray(sonar.sector_rad, dtype) / beams
    return (jnp.arange(beams).astype(dtype) - (beams - 1) / 2) * width
