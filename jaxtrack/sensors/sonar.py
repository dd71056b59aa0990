"""A multi-beam forward-looking sonar that reports at most one range a beam.

Each beam of each look is one of four events: a target in it is detected (E_D) or missed (E_M), or
there is none and the beam stays silent (E_N) or gives a false alarm (E_F),

    P(E_M | target) = P_M,  P(E_F | no target) = P_F,
    E_D: r = ρ + v,  v ~ N(0, σ²);    E_F: r ~ U(0, ρ_D).

Source: clustering-statistic Hough transform (2018), equation 47 and section V.
"""

import jax
import jax.numpy as jnp

from jaxtrack.models.frames import earth_to_polar, polar_to_earth
from jaxtrack.models.sonar import BeamSonar, beam_bearings, check_sonar
from jaxtrack.numerics.checks import check_array, check_choice, check_size
from jaxtrack.numerics.safe import safe_min
from jaxtrack.sensors.echoes import Echo, echo_amplitudes
from jaxtrack.types import Array, BeamScan, Key, Pose, Scan, Truth

FALSE_ALARMS = ("per_beam", "per_scan")


def observe_beams(
    key: Key,
    truth: Truth,
    pose: Pose,
    sonar: BeamSonar,
    *,
    beams: int = 90,
    false_alarms: str = "per_beam",
    echo: Echo | None = None,
    clutter_degrees: int = 4,
) -> BeamScan:
    """Return the looks of a multi-beam sonar at a scene, stacked [T].

    A target is in sight if its range is within the scope and its bearing within the sector; it then
    lies in the beam that its true bearing falls into. Each target in sight is missed with P_M on
    its own, and its echo is lost as well if noise carries the range out of (0, ρ_D]. Of several
    echoes in one beam the nearest is reported, for it comes first. Beams without a target may give
    a false alarm; of the beams whose targets are all missed or lost the share
    `clutter_in_missed_beam` may too, the others stay silent.

    Args:
        key: random key.
        truth: T looks at K targets; those masked out are not there.
        pose: the carrier's, at each look: position_m [T, 2], heading_rad [T].
        sonar: what it does.
        beams: how many divide the sector, static.
        false_alarms: `"per_beam"`: each beam that may give one does so with P_F; `"per_scan"`: at
            most one a look, with P_F, in one of these beams, all alike.
        echo: how loud targets are in the clutter; None: no intensity.
        clutter_degrees: of the clutter's texture, for `echo_amplitudes`, static.

    Returns:
        Scans whose every look is valid; silent beams hold zero, their mask is False.

    Raises:
        ValueError: shapes that do not fit each other, an unknown word, or a known value of the
            sonar that cannot be.

    Example:
        >>> state = jnp.array([[[80.0, 1.0, 0.0, 0.0]]])
        >>> truth = Truth(jnp.zeros(1), state, jnp.ones((1, 1), bool))
        >>> pose = Pose(jnp.zeros((1, 2)), jnp.zeros(1))
        >>> sonar = BeamSonar(p_miss=0.0, p_false=0.0, sigma_m=0.0)
        >>> scans = observe_beams(jax.random.key(0), truth, pose, sonar)
        >>> print(scans.mask[0].nonzero()[0], f"{scans.range_m[0, 45]:.3f}")
        [45] 80.006

    Source: clustering-statistic Hough transform (2018), equation 47 and section V.

    Note:
        Equation 47 lets the four probabilities sum to one, which P_M = P_F = 0.7 of table 3 cannot;
        P_M and P_F are read as conditional on a target being there or not.
        `"per_scan"` and `clutter_in_missed_beam` are not the paper's.
    """
    options = {"beams": beams, "false_alarms": false_alarms, "echo": echo}
    return observe_known_beams(key, truth, pose, sonar, **options, clutter_degrees=clutter_degrees)[
        0
    ]


def observe_known_beams(
    key: Key,
    truth: Truth,
    pose: Pose,
    sonar: BeamSonar,
    *,
    beams: int = 90,
    false_alarms: str = "per_beam",
    echo: Echo | None = None,
    clutter_degrees: int = 4,
) -> tuple[BeamScan, Array]:
    """Return what `observe_beams` does, and which target each detection comes from, [T, B].

    −1 stands for none. Floors may know this, estimators may not.

    Example:
        >>> truth = Truth(jnp.zeros(1), jnp.array([[[80.0, 1.0, 0.0, 0.0]]]), jnp.ones((1, 1), bool))
        >>> pose = Pose(jnp.zeros((1, 2)), jnp.zeros(1))
        >>> sonar = BeamSonar(p_miss=0.0, p_false=0.0)
        >>> _, origin = observe_known_beams(jax.random.key(0), truth, pose, sonar)
        >>> print(origin[0, 44:47])
        [-1  0 -1]
    """  # noqa: E501
    check_array("truth.mask", truth.mask, shape=("T", "K"))
    looks, targets = truth.mask.shape
    check_array("truth.state", truth.state, shape=(looks, targets, 4))
    check_array("pose.position_m", pose.position_m, shape=(looks, 2))
    check_array("pose.heading_rad", pose.heading_rad, shape=(looks,))
    check_size("beams", beams)
    check_choice("false_alarms", false_alarms, FALSE_ALARMS)
    check_sonar(sonar)
    dtype = truth.state.dtype
    keys = jax.random.split(key, 7)
    p_false = jnp.asarray(sonar.p_false, dtype)
    scope_m = jnp.asarray(sonar.range_max_m, dtype)

    present, range_m, bearing_rad = _sight(truth, pose, sonar)
    sector = jnp.asarray(sonar.sector_rad, dtype)
    beam = jnp.floor((bearing_rad / sector + 0.5) * beams).astype(jnp.int32)
    here = beam.clip(0, beams - 1)[..., None] == jnp.arange(beams, dtype=jnp.int32)[None, None]
    noise = jax.random.normal(keys[0], present.shape, dtype)
    measured_m = range_m + jnp.asarray(sonar.sigma_m, dtype) * noise
    heard = jax.random.uniform(keys[1], present.shape, dtype) >= jnp.asarray(sonar.p_miss, dtype)
    heard &= present & (measured_m > 0) & (measured_m <= scope_m)
    echo_m = jnp.where(here & heard[..., None], measured_m[..., None], jnp.inf)
    # The row of infinity stands for no echo, and lets a scene be empty.
    echoes_m = jnp.pad(echo_m, ((0, 0), (0, 1), (0, 0)), constant_values=jnp.inf)
    nearest_m = safe_min(echoes_m, 1)
    detected = jnp.isfinite(nearest_m)

    shape = (looks, beams)
    occupied = (here & present[..., None]).any(axis=1)
    cluttered = jax.random.uniform(keys[2], shape, dtype)
    cluttered = cluttered < jnp.asarray(sonar.clutter_in_missed_beam, dtype)
    open_to_clutter = ~occupied | (~detected & cluttered)
    draw = jax.random.uniform(keys[3], shape, dtype)
    if false_alarms == "per_beam":
        alarm = open_to_clutter & (draw < p_false)
    else:
        one = jnp.argmax(jnp.where(open_to_clutter, draw, -1.0), axis=1)
        alarm = open_to_clutter & (jnp.arange(beams)[None] == one[:, None])
        alarm &= jax.random.uniform(keys[4], (looks, 1), dtype) < p_false
    false_m = scope_m * (1 - jax.random.uniform(keys[5], shape, dtype))  # never 0

    reported_m = jnp.where(detected, nearest_m, jnp.where(alarm, false_m, 0.0))
    mask = detected | alarm
    intensity = None
    if echo is not None:
        loud = echo_amplitudes(keys[6], detected, echo, degrees=clutter_degrees, dtype=dtype)
        intensity = jnp.where(mask, loud, 0.0)
    valid = jnp.ones(looks, bool)
    origin = jnp.where(detected, jnp.argmin(echoes_m, axis=1).astype(jnp.int32), -1)
    return BeamScan(truth.time_s, valid, reported_m, mask, pose, intensity=intensity), origin


def in_sight(truth: Truth, pose: Pose, sonar: BeamSonar) -> Truth:
    """Return the truth with targets masked out while they are beyond the scope or the sector.

    Args:
        truth: T looks at K targets.
        pose: the carrier's, at each look: position_m [T, 2], heading_rad [T].
        sonar: whose scope and sector count.

    Example:
        >>> state = jnp.array([[[80.0, 1.0, 0.0, 0.0], [80.0, 90.0, 0.0, 0.0]]])
        >>> truth = Truth(jnp.zeros(1), state, jnp.ones((1, 2), bool))
        >>> pose = Pose(jnp.zeros((1, 2)), jnp.zeros(1))
        >>> print(in_sight(truth, pose, BeamSonar()).mask)
        [[ True False]]

    Source: clustering-statistic Hough transform (2018), table 1.
    """
    return truth._replace(mask=_sight(truth, pose, sonar)[0])


def in_view(position_m: Array, pose: Pose, sonar: BeamSonar) -> Array:
    """Return which places are within the scope and the sector of a sonar, [...].

    Args:
        position_m: [..., 2] in the earth frame.
        pose: the carrier's, at one look.
        sonar: whose scope and sector count.

    Example:
        >>> pose = Pose(jnp.zeros(2), jnp.array(0.0))
        >>> print(in_view(jnp.array([[80.0, 1.0], [80.0, 90.0]]), pose, BeamSonar()))
        [ True False]
    """
    dtype = position_m.dtype
    mount_m = jnp.asarray(sonar.mount_m, dtype)
    return _inside(*earth_to_polar(position_m, pose, mount_m), sonar)


def scan_of_beams(scan: BeamScan, sonar: BeamSonar) -> Scan:
    """Return one look's detections as positions in the earth frame, with covariances.

        R = σ² u uᵀ + (r² Δ² / 12) n nᵀ

    u points along the beam's centre, n across it; Δ is a beam's width, within which the bearing is
    uniform. Stacked looks: `jax.vmap(scan_of_beams, (0, None))(scans, sonar)`.

    Args:
        scan: one look, of B beams.
        sonar: its range noise, sector and mounting.

    Returns:
        A look of B detections, time, validity, mask, weight and intensity carried on. Silent beams
        hold zero and the unit covariance.

    Example:
        >>> pose = Pose(jnp.array([10.0, 0.0]), jnp.array(jnp.pi / 2))
        >>> look = BeamScan(jnp.array(0.0), jnp.array(True), jnp.array([100.0]), jnp.array([True]),
        ...                 pose)
        >>> scan = scan_of_beams(look, BeamSonar(sigma_m=3.0, sector_rad=0.03))
        >>> print(scan.position_m.round(1), jnp.diagonal(scan.covariance_m2[0]).round(2))
        [[ 10. 100.]] [0.75 9.  ]

    Source: clustering-statistic Hough transform (2018), equations 1–4.
    """
    check_array("scan.range_m", scan.range_m, shape=("B",))
    beams = scan.range_m.shape[0]
    dtype = scan.range_m.dtype
    range_m = jnp.where(scan.mask, scan.range_m, 0.0)
    bearing_rad = beam_bearings(sonar, beams=beams, dtype=dtype)
    position_m = polar_to_earth(range_m, bearing_rad, scan.pose, sonar.mount_m)
    angle_rad = bearing_rad + scan.pose.heading_rad
    cos, sin = jnp.cos(angle_rad), jnp.sin(angle_rad)
    along = jnp.asarray(sonar.sigma_m, dtype) ** 2
    across = (range_m * jnp.asarray(sonar.sector_rad, dtype) / beams) ** 2 / 12
    xx, yy = along * cos**2 + across * sin**2, along * sin**2 + across * cos**2
    xy = (along - across) * sin * cos
    covariance_m2 = jnp.stack([xx, xy, xy, yy], axis=-1).reshape(beams, 2, 2)
    unit = jnp.broadcast_to(jnp.eye(2, dtype=dtype), covariance_m2.shape)
    return Scan(
        scan.time_s,
        scan.valid,
        jnp.where(scan.mask[:, None], position_m, 0.0),
        scan.mask,
        jnp.where(scan.mask[:, None, None], covariance_m2, unit),
        weight=scan.weight,
        intensity=scan.intensity,
    )


def _sight(truth: Truth, pose: Pose, sonar: BeamSonar) -> tuple[Array, Array, Array]:
    """Return what is in sight, and its true range and bearing from the sonar, each [T, K]."""
    dtype = truth.state.dtype
    position_m = jnp.where(truth.mask[..., None], truth.state[..., :2], 0.0)
    polar = jax.vmap(earth_to_polar, (0, 0, None))
    range_m, bearing_rad = polar(position_m, pose, jnp.asarray(sonar.mount_m, dtype))
    return truth.mask & _inside(range_m, bearing_rad, sonar), range_m, bearing_rad


def _inside(range_m: Array, bearing_rad: Array, sonar: BeamSonar) -> Array:
    half = jnp.asarray(sonar.sector_rad, range_m.dtype) / 2
    inside = (bearing_rad >= -half) & (bearing_rad < half)
    return inside & (range_m <= jnp.asarray(sonar.range_max_m, range_m.dtype))
