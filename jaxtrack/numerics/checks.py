"""Entry checks: one place that words what is wrong with an argument's shape, dtype or static value.

They look at shapes, dtypes and known values, so they cost nothing in compiled code. A traced value
cannot be refused; `check_positive` and `check_probability` return what it then acts as.
"""

import operator
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer

from jaxtrack.types import Array, BeamScan, Scan, ScanT


def check_array(name: str, value: Any, *, shape: tuple[int | str, ...] | None = None) -> None:
    """Check that `value` is a real numeric array of the wanted shape.

    Args:
        name: the argument's name, for the message.
        value: the argument; an array, or anything `jnp.shape` understands.
        shape: ints must match exactly, strings (axis names) match any length.

    Raises:
        TypeError: the dtype is not a real number or a boolean.
        ValueError: the shape differs.

    Example:
        >>> check_array("points_m", jnp.zeros((4, 2)), shape=("N", 2))
    """
    try:
        if value is None or isinstance(value, str):  # which name dtypes
            raise TypeError
        dtype, got = jnp.result_type(value), jnp.shape(value)
    except TypeError as error:
        raise TypeError(f"{name}: got {type(value).__name__}, want an array of numbers") from error
    numeric = jnp.issubdtype(dtype, jnp.number) or jnp.issubdtype(dtype, jnp.bool_)
    if not numeric or jnp.issubdtype(dtype, jnp.complexfloating):
        raise TypeError(f"{name}: got dtype {dtype}, want real numbers")
    if shape is None:
        return
    fits = len(got) == len(shape) and all(
        isinstance(want, str) or want == have for want, have in zip(shape, got, strict=True)
    )
    if not fits:
        wanted = ", ".join(str(want) for want in shape)
        raise ValueError(f"{name}: got shape {list(got)}, want [{wanted}]")


def check_size(name: str, value: Any, *, at_least: int = 1) -> int:
    """Check a static size: a Python int (or NumPy integer), at least `at_least`.

    Raises:
        TypeError: not an integer.
        ValueError: too small.

    Example:
        >>> check_size("max_lines", 8)
        8
    """
    try:
        size = operator.index(value)
    except TypeError as error:
        raise TypeError(f"{name}: got {type(value).__name__}, want a Python int") from error
    if isinstance(value, bool):
        raise TypeError(f"{name}: got a bool, want a Python int")
    if size < at_least:
        raise ValueError(f"{name}: got {size}, want an int ≥ {at_least}")
    return size


def check_choice(name: str, value: Any, choices: tuple[str, ...]) -> str:
    """Check a static choice among words.

    Raises:
        ValueError: not one of `choices`.

    Example:
        >>> check_choice("landing", "spread", ("own_cell", "spread"))
        'spread'
    """
    if value not in choices:
        raise ValueError(f"{name}: got {value!r}, want one of {', '.join(choices)}")
    return value


def check_known(name: str, value: Any, fits: Callable[[Any], Any], want: str) -> None:
    """Check what a number is, if it is known.

    Args:
        name: the argument's name.
        value: a number or an array of them; of traced ones nothing is known.
        fits: which values are right; NaN should not be.
        want: them, in words.

    Raises:
        ValueError: some value is not right.

    Example:
        >>> check_known("p_detect", 0.9, lambda p: (p >= 0) & (p <= 1), "a probability")
    """
    if not isinstance(value, Tracer) and not np.all(fits(np.asarray(value))):
        raise ValueError(f"{name}: got {value}, want {want}")


def check_positive(name: str, value: Any, dtype: Any) -> Array:
    """Return a positive, finite number as an array.

    A traced one outside acts as the nearest that can be squared and divided by, and gets no
    gradient.

    Raises:
        ValueError: a known value that is not positive, or not finite.

    Example:
        >>> print(check_positive("eps_rho_m", 20.0, jnp.float32))
        20.0
    """
    fits = lambda x: (x > 0) & np.isfinite(x)
    check_known(name, value, fits, "a positive, finite number")
    if not isinstance(value, Tracer):
        return jnp.asarray(value, dtype)
    value = jnp.asarray(value, dtype)
    dtype, info = value.dtype, jnp.finfo(value.dtype)
    least, most = jnp.asarray(info.eps, dtype), jnp.asarray(float(info.max) ** 0.25, dtype)
    return jnp.where(value > least, jnp.where(value < most, value, most), least)


def check_probability(name: str, value: Any, dtype: Any) -> Array:
    """Return a probability as an array; a traced one outside [0, 1] acts as the nearest.

    Raises:
        ValueError: a known value outside [0, 1].

    Example:
        >>> print(check_probability("p_detect", 0.9, jnp.float32))
        0.9
    """
    check_known(name, value, lambda x: (x >= 0) & (x <= 1), "a probability from 0 to 1")
    value = jnp.asarray(value, dtype)
    one = jnp.ones_like(value)
    return jnp.where(value > 0, jnp.where(value < 1, value, one), 0 * one)


def check_key(name: str, value: Any) -> None:
    """Check that `value` is a single typed random key.

    Raises:
        TypeError: not a typed key.
        ValueError: several keys.

    Example:
        >>> check_key("key", jax.random.key(0))
    """
    if not (isinstance(value, jax.Array) and jnp.issubdtype(value.dtype, jax.dtypes.prng_key)):
        known = hasattr(value, "dtype")
        got = f"{value.dtype}{list(value.shape)}" if known else type(value).__name__
        raise TypeError(f"{name}: got {got}, want a key from jax.random.key(seed)")
    if value.shape:
        raise ValueError(f"{name}: got keys of shape {list(value.shape)}, want a single one")


def check_mask(name: str, value: Any, *, shape: tuple[int | str, ...]) -> None:
    """Check that `value` is a boolean array of the wanted shape.

    Numbers are refused: a mask of 0.0 and 1.0 would be added and compared, not believed.

    Raises:
        TypeError: not booleans.
        ValueError: the shape differs.

    Example:
        >>> check_mask("scans.mask", jnp.ones((4, 2), bool), shape=("K", "N"))
    """
    check_array(name, value, shape=shape)
    dtype = jnp.result_type(value)
    if dtype != jnp.bool_:
        raise TypeError(f"{name}: got dtype {dtype}, want booleans")


def check_scans(scans: Scan) -> Scan:
    """Return stacked looks that are sound: floating positions [K, N, 2], and fields that fit them.

    Known looks are refused where a live position is no finite number, or times run back. In
    traced ones such a detection counts as none, and so does a look whose time is no finite number.

    Raises:
        TypeError: looks at beams, positions that are not floating numbers, or `mask` or `valid` not
            booleans.
        ValueError: a shape differs, a look has no place for a detection, a value is not sound.

    Example:
        >>> scans = Scan(jnp.zeros(3), jnp.ones(3, bool), jnp.zeros((3, 4, 2)), jnp.ones((3, 4), bool))
        >>> print(check_scans(scans).mask.sum())
        12
    """  # noqa: E501
    if isinstance(scans, BeamScan):
        want = "a Scan: positions, which sensors.scan_of_beams makes of beams"
        raise TypeError(f"scans: got a BeamScan, want {want}; the joint vote reads beams by BEAMS")
    _check_looks(scans, "position_m", ("K", "N", 2), "places for detections")
    looks, places = jnp.shape(scans.mask)
    for name, shape in (("covariance_m2", (2, 2)), ("delay_s", ())):
        if getattr(scans, name) is not None:
            check_array(f"scans.{name}", getattr(scans, name), shape=(looks, places, *shape))
    return sound(scans)


def sound(scan: ScanT) -> ScanT:
    """Return looks, one or stacked, in which only detections count that are numbers throughout.

    A look without a finite time, or pose, is none; a detection without a finite place or range,
    covariance, weight or delay is none. Looks of other kinds are returned as they are.

    Example:
        >>> position = jnp.array([[0.0, jnp.nan], [1.0, 1.0]])
        >>> scan = Scan(jnp.array(0.0), jnp.array(True), position, jnp.ones(2, bool))
        >>> print(sound(scan).mask)
        [False  True]
    """
    if isinstance(scan, BeamScan):
        return _sound_beams(scan)
    if not isinstance(scan, Scan):
        return scan
    mask = scan.mask & jnp.isfinite(scan.position_m).all(-1)
    if scan.covariance_m2 is not None:
        mask = mask & jnp.isfinite(scan.covariance_m2).all((-1, -2))
    for field in (scan.weight, scan.delay_s):
        if field is not None:
            mask = mask & jnp.isfinite(field)
    return scan._replace(valid=scan.valid & jnp.isfinite(scan.time_s), mask=mask)


def _sound_beams(scan: BeamScan) -> BeamScan:
    pose = scan.pose
    at = jnp.isfinite(pose.position_m).all(-1) & jnp.isfinite(pose.heading_rad)
    mask = scan.mask & jnp.isfinite(scan.range_m)
    if scan.weight is not None:
        mask = mask & jnp.isfinite(scan.weight)
    return scan._replace(valid=scan.valid & jnp.isfinite(scan.time_s) & at, mask=mask)


def check_beam_scans(scans: BeamScan) -> BeamScan:
    """Return stacked looks that are sound: floating ranges [K, B], and fields that fit them.

    What `check_scans` says of positions is said here of ranges; a look without a finite pose is
    none.

    Raises:
        TypeError: looks at positions, ranges that are not floating numbers, or `mask` or `valid`
            not booleans.
        ValueError: a shape differs, a look has no beam, a value is not sound.

    Example:
        >>> from jaxtrack.types import Pose
        >>> scans = BeamScan(jnp.zeros(3), jnp.ones(3, bool), jnp.ones((3, 4)), jnp.ones((3, 4), bool),
        ...                  Pose(jnp.zeros((3, 2)), jnp.zeros(3)))
        >>> print(check_beam_scans(scans).mask.sum())
        12
    """  # noqa: E501
    if isinstance(scans, Scan):
        raise TypeError("scans: got a Scan, which is of positions, want a BeamScan")
    _check_looks(scans, "range_m", ("K", "B"), "beams")
    pose, looks = scans.pose, jnp.shape(scans.mask)[0]
    check_array("scans.pose.position_m", pose.position_m, shape=(looks, 2))
    check_array("scans.pose.heading_rad", pose.heading_rad, shape=(looks,))
    return sound(scans)


def _check_looks(
    scans: Scan | BeamScan, measured: str, shape: tuple[int | str, ...], places: str
) -> None:
    """Check what looks of every sensor have: times, masks, weights, and what is measured."""
    name, values = f"scans.{measured}", getattr(scans, measured)
    check_array(name, values, shape=shape)
    dtype = jnp.result_type(values)
    if not jnp.issubdtype(dtype, jnp.floating):
        raise TypeError(f"{name}: got dtype {dtype}, want floating numbers")
    table = jnp.shape(values)[:2]
    check_size(f"{name}, {places}", table[1])
    check_array("scans.time_s", scans.time_s, shape=table[:1])
    check_mask("scans.valid", scans.valid, shape=table[:1])
    check_mask("scans.mask", scans.mask, shape=table)
    if scans.weight is not None:
        check_array("scans.weight", scans.weight, shape=table)
    if any(isinstance(leaf, Tracer) for leaf in jax.tree.leaves(scans)):
        return
    valid, values = np.asarray(scans.valid), np.asarray(values)
    finite = np.isfinite(values).reshape(*table, -1).all(-1)
    broken = np.argwhere(np.asarray(scans.mask) & valid[:, None] & ~finite)
    if len(broken):
        look, place = broken[0]
        raise ValueError(
            f"{name}: got {values[look, place]} at [{look}, {place}], want finite numbers"
        )
    time_s = np.asarray(scans.time_s)[valid]
    if not np.isfinite(time_s).all() or (np.diff(time_s) < 0).any():
        raise ValueError(f"scans.time_s: got {time_s}, want finite times that do not run back")
