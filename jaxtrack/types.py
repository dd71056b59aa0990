"""Core types: what flows between the stages, and the protocols of swappable parts. No maths.

Every shape is that of *one* realization; batches are made by `jax.vmap` or
`jaxtrack.monte_carlo`. Leading axes are added by stacking: scans of a window carry `[T]`
in front of every field. Masked entries may hold anything, NaN included.
"""

from collections.abc import Callable
from typing import Any, Generic, NamedTuple, Protocol, TypeVar

import jax

Array = jax.Array
Key = jax.Array
"""A typed random key, as `jax.random.key` makes it."""

ScanT = TypeVar("ScanT")
StateT = TypeVar("StateT")
InfoT = TypeVar("InfoT")


class Pose(NamedTuple):
    """Where a sensor's carrier is, in the earth frame (x north, y east, or the user's own axes)."""

    position_m: Array  # [2]
    heading_rad: Array  # []  clockwise from the x axis (north)


class Scan(NamedTuple):
    """One look of a position sensor in the earth frame; also a point cloud."""

    time_s: Array  # []  seconds since the recording's float64 epoch
    valid: Array  # []  False: no look at all. True with an empty mask: a look without detections
    position_m: Array  # [N, 2]
    mask: Array  # [N]
    covariance_m2: Array | None = None  # [N, 2, 2]; None: the estimator's own sigma
    weight: Array | None = None  # [N] in [0, 1]: how much a detection counts
    delay_s: Array | None = None  # [N] detection time minus time_s
    intensity: Array | None = None  # [N] raw echo


class BeamScan(NamedTuple):
    """One look of a multi-beam sonar: at most one range a beam. The geometry is the sensor's."""

    time_s: Array  # []
    valid: Array  # []
    range_m: Array  # [B]
    mask: Array  # [B]
    pose: Pose
    weight: Array | None = None  # [B]
    intensity: Array | None = None  # [B]


class Pings(NamedTuple):
    """Pings of a mechanically scanned sonar, each with its own time and pose."""

    time_s: Array  # [Q]
    bearing_rad: Array  # [Q]
    intensity: Array  # [Q, R]
    mask: Array  # [Q]
    pose: Pose  # position_m [Q, 2], heading_rad [Q]


class Lines(NamedTuple):
    """Lines ρ = x cos θ + y sin θ, θ in [0, π), ρ signed: what a vote without time yields."""

    rho_m: Array  # [M]
    theta_rad: Array  # [M]
    votes: Array  # [M]
    mask: Array  # [M]


class Tracks(NamedTuple):
    """A table of tracks at the time of the look, or at a window's end."""

    time_s: Array  # []
    mean: Array  # [M, S]  position and velocity first: x, y, vx, vy, …
    covariance: Array  # [M, S, S]
    mask: Array  # [M]
    identity: Array  # [M] int; −1: empty slot; never reused within a run
    stage: Array  # [M] int, a `Stage`
    existence: Array  # [M] probability, or what the method takes for one
    log_score: Array  # [M] log-likelihood ratio against clutter; of votes, what they count


class Stage:
    """Values of `Tracks.stage`."""

    EMPTY = 0
    TENTATIVE = 1
    CONFIRMED = 2
    COASTING = 3


class Truth(NamedTuple):
    """What the targets really did."""

    time_s: Array  # [T]
    state: Array  # [T, K, 4]  x, y, vx, vy
    mask: Array  # [T, K]


class Estimator(NamedTuple, Generic[ScanT, StateT, InfoT]):
    """A recursive estimator: `jax.lax.scan(est.step, est.init(key), scans)` is the whole loop."""

    init: Callable[[Key], StateT]
    step: Callable[[StateT, ScanT], tuple[StateT, InfoT]]


class WindowEstimator(Protocol):
    """An estimator that looks at a whole window at once."""

    def __call__(
        self, scans: Any, params: Any, key: Key | None = None
    ) -> tuple[Tracks | Lines, Any]:
        """Estimate from scans stacked along a leading `[T]`."""
        ...


class LogLikelihoodRatio(Protocol):
    """How much one look speaks for a target in a given state, in nats, against clutter alone."""

    def __call__(self, state: Array, scan: Any, params: Any) -> Array:
        """Return `log p(scan | target at state [S]) / p(scan | no target)`, a scalar."""
        ...
