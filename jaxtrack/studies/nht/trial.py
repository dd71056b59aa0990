"""One trial of the study `nht`: a scene is simulated once, and every method sees the same scans.

All methods of one shape form one compiled program; noise, clutter, truth, grid and tolerances are
traced, so situations, scenes without targets and added noise need no other. Files of studies name
the parts: the scenes `crossing` and `recorded`, the method `initiate`, and the metrics.
"""

import functools
from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

from jaxtrack.hough import Sizes, improved, joint, modified, neutrosophic, standard
from jaxtrack.metrics import InitiationScores, initiation_scores
from jaxtrack.sensors import observe
from jaxtrack.studies.nht.scenes import Inputs, real_inputs, simulated_inputs
from jaxtrack.studies.nht.words import target_votes
from jaxtrack.studies.tables import SMOKE_BELOW
from jaxtrack.types import Array, Key, Lines, Scan, Truth

LINES = 8  # that every method may report
SMOOTH = 2  # cells, of the smoothed peaks
PEAKS = ("raw", "smoothed")

# Methods whose votes land in cells come with raw and with smoothed peaks, the others in one form.
FORMS = {
    "HT": PEAKS,
    "MHT": PEAKS,
    "IHT": PEAKS,
    "NHT": PEAKS,
    "NHT spread": PEAKS[:1],
    "NHT wide": PEAKS[:1],
    "NHT cov": PEAKS[:1],
    "joint": PEAKS[:1],
}
METHODS = tuple(FORMS)
TOLERANT = ("NHT spread", "NHT wide")  # the paper's ε and a wider one

_RULES = {
    "NHT": neutrosophic.Rules("own_cell"),
    "NHT spread": neutrosophic.Rules("spread"),
    "NHT wide": neutrosophic.Rules("spread"),
    "NHT cov": neutrosophic.Rules("spread", "covariance"),
}


class Shape(NamedTuple):
    """Static sizes of one table of programs."""

    detections: int  # a look
    pairs: int  # of an interval
    gated_pairs: int  # of them with an admissible speed
    predecessors: int
    hypotheses: int
    rho: int = 1600  # cells of 5 m
    forms: tuple[str, ...] = PEAKS  # of the peaks that are looked at
    candidates: int = 256  # parameter points at which votes are counted


# Each well above the largest number of 100 runs; what does not fit is counted and reported.
SHAPES = {
    "10": Shape(32, 1024, 192, 24, 4096),
    "56": Shape(96, 7168, 1536, 48, 32768),
    "real": Shape(32, 1024, 192, 24, 4096, rho=6800, forms=PEAKS[:1]),
}


def shapes_for(trials: int) -> dict[str, Shape]:
    """Return the shape of each table; a smoke run, mostly compiling, has one program for all.

    Example:
        >>> len(set(shapes_for(20).values())), len(set(shapes_for(2).values()))
        (3, 1)
    """
    if trials >= SMOKE_BELOW:
        return SHAPES
    return dict.fromkeys(SHAPES, SHAPES["56"]._replace(rho=SHAPES["real"].rho))


class Seen(NamedTuple):
    """What one trial simulates."""

    inputs: Inputs
    scans: Scan
    shape: Shape  # known to Python


class Found(NamedTuple):
    """What a method says in a study from a file."""

    lines: Lines  # [LINES]
    gate: Array | float  # fewest votes of a line that counts


class Outcome(NamedTuple):
    """What one trial gives, by method and form of the peaks."""

    scans: Scan
    lines: dict[tuple[str, str], Lines]  # [LINES]; the joint vote's are above its gate
    overflow: dict[tuple[str, str], Array]
    divergence: dict[str, Array]  # [K] cells
    decline: dict[str, Array]  # [K]


@functools.cache
def trial(shape: Shape) -> Callable[[Key, Inputs], Outcome]:
    """Return the function of one trial, the same object for the same shape."""

    def run(key: Key, inputs: Inputs) -> Outcome:
        scans = look(key, inputs, shape).scans
        lines, overflow = {}, {}
        for method, form in forms_of(shape):
            if method not in TOLERANT:
                found, info = detect(method, inputs, shape, form)(scans)
                lines[method, form], overflow[method, form] = found, info.overflow

        def tolerant(eps: tuple[Array, Array]) -> tuple[Lines, Array]:
            found, info = detect(TOLERANT[-1], _widened(inputs, *eps), shape, "raw")(scans)
            return found, info.overflow

        # These two differ in values only: a loop over them is compiled once.
        paper = neutrosophic.NeutrosophicParams()
        both = (paper.eps_rho_m, inputs.wide_m), (paper.eps_theta_rad, inputs.wide_rad)
        number = lambda x: jnp.asarray(x, scans.position_m.dtype)
        eps = tuple(jnp.stack([number(x) for x in pair]) for pair in both)
        found, full = jax.lax.map(tolerant, eps)
        for place, method in enumerate(TOLERANT):
            lines[method, "raw"] = jax.tree.map(lambda x, at=place: x[at], found)
            overflow[method, "raw"] = full[place]
        sizes = sizes_of(shape, "NHT", "raw")
        words = target_votes(scans, inputs.truth, _neutrosophic(inputs, "NHT"), sizes)
        return Outcome(scans, lines, overflow, *words)

    return run


def look(key: Key, inputs: Inputs, shape: Shape) -> Seen:
    """Return the looks of one trial."""
    scans = observe(key, inputs.truth, inputs.radar, detections=shape.detections)
    return Seen(inputs, scans, shape)


def crossing(key: Key, *, clutter_expected: int, sigma_m: Any, clutter_per_scan: Any) -> Seen:
    """Return looks at the paper's three crossing targets.

    Its situations: I has neither noise nor clutter, II noise, III clutter, IV both.

    Args:
        key: random key.
        clutter_expected: what methods and their tables are made for, 10 or 56 a look; static.
        sigma_m: noise.
        clutter_per_scan: what there is.

    Example:
        >>> ideal = {"clutter_expected": 10, "sigma_m": 0.0, "clutter_per_scan": 0.0}
        >>> jax.eval_shape(lambda key: crossing(key, **ideal).scans, jax.random.key(0)).mask.shape
        (7, 32)
    """
    inputs = simulated_inputs("IV", clutter_per_scan, clutter_expected)
    inputs = inputs._replace(radar=inputs.radar._replace(sigma_m=sigma_m))
    return look(key, inputs, SHAPES[str(clutter_expected)])


def recorded(key: Key, *, sigma_m: Any) -> Seen:
    """Return the paper's real radar data, with noise and 10 clutter a look added."""
    return look(key, real_inputs(sigma_m), SHAPES["real"])


def initiate(seen: Seen, *, transform: str, gate: Any, peaks: str = PEAKS[0]) -> Found:
    """Return the lines of one of `METHODS`.

    Args:
        seen: looks.
        transform: its name, static.
        gate: fewest votes of a line that counts; of the joint vote nats.
        peaks: raw or smoothed, static.
    """
    inputs = seen.inputs._replace(joint_gate=gate)
    return Found(detect(transform, inputs, seen.shape, peaks)(seen.scans)[0], gate)


def top_3(seen: Seen, found: Found, *, match_m: Any) -> Array:
    """Return whether the three strongest lines match the three targets, whatever the gate."""
    return _scores(seen, found, match_m).top_k


def perfect(seen: Seen, found: Found, *, match_m: Any) -> Array:
    """Return whether all targets are found, nothing false and nothing twice."""
    return _scores(seen, found, match_m).perfect


def targets_found(seen: Seen, found: Found, *, match_m: Any) -> Array:
    """Return how many targets have a line."""
    return _scores(seen, found, match_m).found


def false_lines(seen: Seen, found: Found, *, match_m: Any) -> Array:
    """Return how many lines match no target."""
    return _scores(seen, found, match_m).false


def scores(lines: Lines, truth: Truth, match_m: Any, gate: Any) -> InitiationScores:
    """Return the scores of one trial's lines."""
    path = jnp.swapaxes(truth.state[..., :2], 0, 1)
    return initiation_scores(lines, path, truth.mask.all(0), match_m=match_m, gate=gate)


def _scores(seen: Seen, found: Found, match_m: Any) -> InitiationScores:
    return scores(found.lines, seen.inputs.truth, match_m, found.gate)


def forms_of(shape: Shape) -> list[tuple[str, str]]:
    """Return the methods and forms of peaks that trials of a shape look at."""
    return [(method, form) for method in METHODS for form in FORMS[method] if form in shape.forms]


def detect(
    method: str, inputs: Inputs, shape: Shape, form: str
) -> Callable[[Scan], tuple[Lines, Any]]:
    """Return one method, ready for scans: `scans -> (lines [LINES], info)`."""
    sizes = sizes_of(shape, method, form)
    grid, peaks = inputs.grid, inputs.peaks
    estimate: Callable[..., tuple[Lines, Any]]
    params: Any
    if method == "joint":
        return lambda scans: _joint(scans, inputs, shape)
    if method == "HT":
        estimate, params = standard.estimate, standard.StandardParams(grid, peaks)
    elif method == "MHT":
        estimate, params = modified.estimate, modified.ModifiedParams(grid, peaks)
    elif method == "IHT":
        estimate, params = improved.estimate, improved.ImprovedParams(grid, peaks)
    else:
        estimate = functools.partial(neutrosophic.estimate, rules=_RULES[method])
        params = _neutrosophic(inputs, method)
    return lambda scans: estimate(scans, params, sizes=sizes)


def _joint(scans: Scan, inputs: Inputs, shape: Shape) -> tuple[Lines, joint.JointInfo]:
    params = joint.JointParams(inputs.sensor, gate=inputs.joint_gate)
    sizes = joint.JointSizes(hypotheses=shape.hypotheses)
    tracks, info = joint.estimate(scans, params, sizes=sizes)
    lines = joint.lines_of(tracks)
    free = LINES - sizes.tracks
    return jax.tree.map(lambda x: jnp.concatenate([x, jnp.zeros(free, x.dtype)]), lines), info


def _widened(inputs: Inputs, wide_m: Array, wide_rad: Array) -> Inputs:
    return inputs._replace(wide_m=wide_m, wide_rad=wide_rad)


def _neutrosophic(inputs: Inputs, method: str) -> neutrosophic.NeutrosophicParams:
    params = neutrosophic.NeutrosophicParams(inputs.grid, inputs.peaks)
    if method == "NHT wide":
        return params._replace(eps_rho_m=inputs.wide_m, eps_theta_rad=inputs.wide_rad)
    return params


def sizes_of(shape: Shape, method: str, form: str) -> Sizes:
    """Return a voting method's static sizes."""
    return Sizes(
        lines=LINES,
        pairs=shape.pairs if method == "MHT" else shape.gated_pairs,
        predecessors=shape.predecessors,
        candidates=shape.candidates,
        rho=shape.rho,
        smooth=SMOOTH if form == "smoothed" else 0,
    )
