"""Differentiable, batched estimators for tracking many targets in sonar and radar data.

    file, simulator ──► Scan ──► votes ──► Lines ──► Tracks ──► scores
       io, sensors     types          hough         tracking   metrics

    models        how targets move and how they are seen
    clustering    fuzzy clustering of weighted samples
    moments       features of point clouds and images that turning leaves alone
    filtering     recursive estimators
    association   which detections are which track's
    montecarlo    any of it, for thousands of trials in one compiled program
    studies       scenes × methods × tables
    tuning        gradients through all of it: losses, and the loop that fits parameters
    plots         figures of all of it

Every estimator is a pure function of *one* realization. A batch is `jax.vmap` or `monte_carlo`, a
gradient is `jax.grad`; both go through the whole pipeline. `docs/design.md` tells the rules.

`studies`, `plots` and `tuning` are loaded at first use: the first two bring the command line's
packages and matplotlib along, which an estimator does without.

Example:
    >>> import jax
    >>> from jaxtrack import hough, monte_carlo, sensors
    >>> scene = sensors.crossing_targets("I")
    >>> def lines_found(key, gate):
    ...     scans = sensors.observe(key, scene.truth, scene.radar, detections=4)
    ...     params = hough.improved.ImprovedParams(peaks=hough.Peaks(gate=gate))
    ...     lines, info = hough.improved.estimate(scans, params, sizes=hough.Sizes(pairs=16))
    ...     return lines.mask.sum()
    >>> run = monte_carlo(lines_found, jax.random.key(0), trials=100, params=4.0)
    >>> print(f"{run.mean:.1f} lines of 3 targets")
    3.0 lines of 3 targets
"""

import importlib
from typing import TYPE_CHECKING, Any

from jaxtrack import (
    association,
    clustering,
    filtering,
    hough,
    io,
    metrics,
    models,
    moments,
    montecarlo,
    numerics,
    sensors,
    tracking,
    types,
)
from jaxtrack.montecarlo import MonteCarlo, monte_carlo
from jaxtrack.types import (
    BeamScan,
    Estimator,
    Lines,
    LogLikelihoodRatio,
    Pings,
    Pose,
    Scan,
    Stage,
    Tracks,
    Truth,
    WindowEstimator,
)

if TYPE_CHECKING:
    from jaxtrack import plots, studies, tuning

__version__ = "0.1.0"

__all__ = [
    "BeamScan",
    "Estimator",
    "Lines",
    "LogLikelihoodRatio",
    "MonteCarlo",
    "Pings",
    "Pose",
    "Scan",
    "Stage",
    "Tracks",
    "Truth",
    "WindowEstimator",
    "association",
    "clustering",
    "filtering",
    "hough",
    "io",
    "metrics",
    "models",
    "moments",
    "monte_carlo",
    "montecarlo",
    "numerics",
    "plots",
    "sensors",
    "studies",
    "tracking",
    "tuning",
    "types",
]

_LAZY = ("plots", "studies", "tuning")


def __getattr__(name: str) -> Any:
    if name in _LAZY:
        return importlib.import_module(f"jaxtrack.{name}")
    raise AttributeError(f"module 'jaxtrack' has no attribute {name!r}")


def __dir__() -> list[str]:
    return sorted({*__all__, "__version__"})
