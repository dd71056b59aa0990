"""Entry checks: one place that words what is wrong with an argument's shape, dtype or static value.

They look at shapes, dtypes and known values only, so they cost nothing in compiled code.
"""

import operator
from typing import Any

import jax.numpy as jnp
import numpy as np
from jax.core import Tracer

from jaxtrack.types import Array, Scan


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
        dtype = jnp.result_type(value)
        got = jnp.shape(value)
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


def check_positive(name: str, value: Any, dtype: Any) -> Array:
    """Return a positive number as an array; where it is traced, one that is at least the rounding.

    Compiled code cannot refuse a value: a traced one at or below zero acts as the smallest that
    divides without overflow, and gets no gradient.

    Raises:
        ValueError: a known value that is not positive.

    Example:
        >>> print(check_positive("eps_rho_m", 20.0, jnp.float32))
        20.0
    """
    if not isinstance(value, Tracer) and not (np.asarray(value) > 0).all():
        raise ValueError(f"{name}: got {value}, want a positive number")
    value, least = jnp.asarray(value, dtype), jnp.asarray(jnp.finfo(dtype).eps, dtype)
    return jnp.where(value > least, value, least)


def check_scans(scans: Scan) -> None:
    """Check that stacked looks have floating positions [K, N, 2], and fields that fit them.

    Raises:
        TypeError: positions are not floating numbers.
        ValueError: a shape differs, or a look has no place for a detection.

    Example:
        >>> scans = Scan(jnp.zeros(3), jnp.ones(3, bool), jnp.zeros((3, 4, 2)), jnp.ones((3, 4), bool))
        >>> check_scans(scans)
    """  # noqa: E501
    check_array("scans.position_m", scans.position_m, shape=("K", "N", 2))
    dtype = jnp.result_type(scans.position_m)
    if not jnp.issubdtype(dtype, jnp.floating):
        raise TypeError(f"scans.position_m: got dtype {dtype}, want floating numbers")
    looks, places = jnp.shape(scans.position_m)[:2]
    check_size("scans.position_m, places for detections", places)
    wanted = {
        "time_s": (looks,),
        "valid": (looks,),
        "mask": (looks, places),
        "covariance_m2": (looks, places, 2, 2),
        "weight": (looks, places),
        "delay_s": (looks, places),
    }
    for name, shape in wanted.items():
        if getattr(scans, name) is not None:
            check_array(f"scans.{name}", getattr(scans, name), shape=shape)
