"""What the three beams nearest to a target say about it in one look.

A target at range ρ and bearing α (u in beams from the port edge) stands in beam b with probability
P(b | u), the mass of N(u, s_b²) on the beam. A beam that holds it and reports range r, or nothing,
is by

    Λ_b = {(1 − o) [(1 − P_M) N(r; ρ, σ²) + P_M c P_F / ρ_D] + o / ρ_D} / (P_F / ρ_D),
    Λ_b = (1 − o) P_M (1 − c P_F) / (1 − P_F)

likelier than one that is empty, and the look's log-likelihood ratio is log Σ_b P(b | u) Λ_b over
the three nearest beams: three gathers, however many beams there are. o is the probability that
another target answers in the beam instead. P_F is kept a millionth away from
0 and 1, where there is no ratio.
Outside the sector and the scope nothing can be seen, Λ = 1.
"""

import math
from typing import NamedTuple

import jax
import jax.numpy as jnp

from jaxtrack.models.beam_place import Place
from jaxtrack.models.sonar import BeamSonar
from jaxtrack.types import Array, BeamScan

_LEAST = 1e-6  # share of everything that the model does not know: bounds a look's penalty
_SURE = 1e-6  # traced P_F keep so far away from 0 and 1
PAD = 3  # beams that do not exist, on each side


class BeamSensor(NamedTuple):
    """What a multi-beam sonar's likelihood needs. Traced."""

    sonar: BeamSonar = BeamSonar()
    spread_beams: Array | float = 0.1  # s_b, blur of the beams' edges
    p_other: Array | float = 0.02  # o, a beam with the target reports another target instead


Three = tuple[Array, Array, Array]
"""One array for each of the nearest beams: stacked, the compiler would not vectorize them."""


class Report(NamedTuple):
    """What the three nearest beams report to each state."""

    range_m: Three
    peak: Three  # of the target's own detection: w (1 − o) (1 − P_M) ρ_D / (P_F σ √2π)
    rest: Three  # ratio of everything else that the report can be; 1 where there is no beam


def _table(scan: BeamScan, params: BeamSensor) -> tuple[Array, Array, Array]:
    """Ranges, peaks and rests of one look's beams, with beams that do not exist at both ends."""
    sonar, dtype = params.sonar, scan.range_m.dtype
    cast = lambda x: jnp.asarray(x, dtype)
    miss, false, clutter, other = (
        cast(x) for x in (sonar.p_miss, sonar.p_false, sonar.clutter_in_missed_beam, params.p_other)
    )
    false = jnp.where(false > _SURE, jnp.where(false < 1 - _SURE, false, 1 - _SURE), _SURE)
    alone = 1 - other
    counts = scan.mask & scan.valid
    weight = jnp.ones_like(scan.range_m) if scan.weight is None else scan.weight
    weight = jnp.where(counts, weight, 0.0)
    normal = cast(sonar.range_max_m) / (cast(sonar.sigma_m) * math.sqrt(2 * math.pi))
    peak = weight * (alone * (1 - miss) * normal / false)
    something = alone * miss * clutter + other / false
    silence = alone * miss * (1 - clutter * false) / (1 - false)
    rest = jnp.where(counts, 1 + weight * (something - 1), silence)
    range_m = jnp.where(counts, scan.range_m, 0.0)
    return jnp.pad(range_m, PAD), jnp.pad(peak, PAD), jnp.pad(rest, PAD, constant_values=1.0)


def nearest_beams(beams: Array, count: int) -> Three:
    """Places in the table of the three beams nearest to a bearing."""
    middle = jnp.clip(jnp.floor(beams).astype(jnp.int32), -2, count + 1) + PAD
    return middle - 1, middle, middle + 1


def report_of(beams: Array, scan: BeamScan, params: BeamSensor) -> Report:
    """Return what the beams nearest to bearings […] report in one look."""
    table = _table(scan, params)
    port, middle, starboard = nearest_beams(beams, scan.mask.shape[0])
    return Report(*((column[port], column[middle], column[starboard]) for column in table))


def ratio_of(place: Place, report: Report, params: BeamSensor) -> tuple[Array, Three]:
    """Likelihood ratio, and the parts of it that the detections of the three beams give.

    What lies beyond the three beams is the outer ones'.
    """
    cast = lambda x: jnp.asarray(x, place.range_m.dtype)
    sigma, scope = cast(params.sonar.sigma_m), cast(params.sonar.range_max_m)
    within = place.beams - jnp.floor(place.beams)
    spread = cast(params.spread_beams)
    port, starboard = _phi(-within / spread), _phi((within - 1) / spread)
    inside = _phi((scope - place.range_m) / sigma)
    total, own = 1 - inside + _LEAST, []
    shares = port, 1 - port - starboard, starboard
    for share, range_m, peak, rest in zip(shares, *report, strict=True):
        density = jnp.exp(-(((range_m - place.range_m) / sigma) ** 2) / 2)
        seen = inside * share * peak * density
        total = total + (seen + inside * share * rest)
        own.append(seen)
    return total, tuple(own)


def _phi(z: Array) -> Array:
    return 0.5 * (1 + jax.lax.erf(z * math.sqrt(0.5)))
