"""Cells of the clustering-statistic Hough transform paper's tables: rates, false alarms, gates."""

import functools
import importlib.resources
import json
from typing import NamedTuple

import jax.numpy as jnp

from jaxtrack.models import BeamSonar
from jaxtrack.sensors import motion_elements_scene
from jaxtrack.studies.csht.paper import RATES, SIGMAS_M
from jaxtrack.types import Array

# Nats. Where clutter alone gives next to nothing false, what targets leave behind does; chosen on
# windows of other seeds than the study's.
LEAST_GATE = 9.0


class Variant(NamedTuple):
    """A model of false alarms."""

    false_alarms: str  # a beam or a scan
    clutter_in_missed_beam: float


VARIANTS = {
    "literal": Variant("per_beam", 0.0),
    "clutter in missed beams": Variant("per_beam", 1.0),
    "one a scan": Variant("per_scan", 0.0),
}


class Rates(NamedTuple):
    """One cell of the paper's tables."""

    p_miss: float
    p_false: float
    sigma_m: float


CELLS = tuple(Rates(m, f, 3.0) for m in RATES for f in RATES) + tuple(
    Rates(0.3, 0.3, sigma_m) for sigma_m in SIGMAS_M if sigma_m != 3.0
)


def sonar_of(variant: str, cell: Rates) -> BeamSonar:
    """Return the paper's sonar with a cell's rates."""
    number = lambda x: jnp.asarray(x)
    clutter = number(VARIANTS[variant].clutter_in_missed_beam)
    sonar = motion_elements_scene().sonar._replace(clutter_in_missed_beam=clutter)
    return sonar._replace(**{name: number(x) for name, x in cell._asdict().items()})


@functools.cache
def shipped_gates() -> dict[str, list[float]]:
    """Return what the study's `derive_gates` gave with seed 1, from 200 windows a cell."""
    file = importlib.resources.files("jaxtrack.studies.csht") / "gates.json"
    return json.loads(file.read_text(encoding="utf-8"))


def shipped_gate(variant: str, cell: Rates) -> Array:
    """Return the joint vote's gate of the nearest of `CELLS`. Rates are traced.

    Example:
        >>> print(shipped_gate("literal", Rates(0.7, 0.7, 3.0)))
        11.362
    """
    dtype = jnp.result_type(float)
    rates = jnp.stack([jnp.asarray(x, dtype) for x in cell])
    nearest = ((rates[None] - jnp.asarray(CELLS, dtype)) ** 2).sum(1).argmin()
    return jnp.asarray(shipped_gates()[variant], dtype)[nearest]
