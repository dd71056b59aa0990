"""What is said of wrong values in user data: where the value stands, what it is, what is wanted.

Readers of files and of arrays share these checks. They differ in how they name a place, so every
check takes a `where(row, column)` that words it.
"""

from collections.abc import Callable

import numpy as np

Where = Callable[[int, str], str]
"""Words the place of a value: `where(row, column)`, the row as counted in the checked array."""

LARGEST = 1e12
"""Larger numbers are no seconds or metres: this also finds Unix time given in milliseconds."""

SMALLEST_SIGMA = 1e-9
"""The square of a smaller standard deviation nears the smallest numbers of float32."""


class DataError(ValueError):
    """User data hold a wrong value; the message names the place, what it got and what it wants."""


def number(value: float) -> str:
    """Word a number with all its digits, so that two different ones never look the same.

    Example:
        >>> number(1700000000.25)
        '1700000000.25'
    """
    return repr(float(value)).removesuffix(".0")


def check_numbers(
    values: np.ndarray,
    column: str,
    where: Where,
    *,
    low: float = -LARGEST,
    high: float = LARGEST,
    want: str = "a finite number, at most 1e12 in size",
) -> None:
    """Check low ≤ values ≤ high, which NaN and inf fail.

    Args:
        values: [R].
        column: the name of the column, for the message.
        where: words the place.
        low: the smallest value allowed.
        high: the largest value allowed.
        want: what is wanted, for the message.

    Raises:
        DataError: the first row that fails.

    Example:
        >>> check_numbers(np.array([0.0, np.nan]), "x_m", lambda row, column: f"{column}[{row}]")
        Traceback (most recent call last):
        jaxtrack.io.errors.DataError: x_m[1]: got nan, want a finite number, at most 1e12 in size
    """
    wrong = ~((values >= low) & (values <= high))
    if wrong.any():
        row = int(np.argmax(wrong))
        raise DataError(f"{where(row, column)}: got {number(values[row])}, want {want}")


def check_sigmas(values: np.ndarray, column: str, where: Where) -> None:
    """Check standard deviations [R]: positive, and large enough to be squared in float32.

    Raises:
        DataError: the first row that fails.
    """
    want = f"a standard deviation of at least {SMALLEST_SIGMA:g}"
    check_numbers(values, column, where, low=SMALLEST_SIGMA, want=want)


def check_degrees(values: np.ndarray, column: str, where: Where) -> None:
    """Check angles [R] in degrees: no more than a turn either way, which finds other units.

    Raises:
        DataError: the first row that fails.

    Example:
        >>> check_degrees(np.array([359.0]), "bearing_deg", lambda row, column: column)
    """
    want = "degrees from -360 to 360"
    check_numbers(values, column, where, low=-360.0, high=360.0, want=want)


def check_weights(values: np.ndarray, column: str, where: Where) -> None:
    """Check weights [R]: in [0, 1].

    Raises:
        DataError: the first row that fails.
    """
    check_numbers(values, column, where, low=0.0, high=1.0, want="a weight in [0, 1]")


def check_rising(values: np.ndarray, column: str, where: Where) -> None:
    """Check that values [R] never fall from one row to the next.

    Raises:
        DataError: the first row that fails.
    """
    falls = values[1:] < values[:-1]
    if falls.any():
        row = int(np.argmax(falls)) + 1
        raise DataError(
            f"{where(row, column)}: got {number(values[row])} after {number(values[row - 1])}, "
            "want values that do not run back"
        )


def check_covariances(
    covariance_m2: np.ndarray, columns: tuple[str, str, str], where: Where
) -> None:
    """Check that covariances [R, 2, 2] are positive definite.

    Args:
        covariance_m2: symmetric, [R, 2, 2].
        columns: the names of the xx, xy and yy entries, for the message.
        where: words the place.

    Raises:
        DataError: the first row that fails.
    """
    xx, xy, yy = covariance_m2[:, 0, 0], covariance_m2[:, 0, 1], covariance_m2[:, 1, 1]
    want = f"a variance of at least {SMALLEST_SIGMA**2:g}"
    for column, variances in ((columns[0], xx), (columns[2], yy)):
        check_numbers(variances, column, where, low=SMALLEST_SIGMA**2, want=want)
    # Entries up to 1e12 cannot overflow here; the bound is strict: full correlation is singular.
    bound = np.nextafter(np.sqrt(xx) * np.sqrt(yy), 0.0)
    want = "a finite number smaller in size than the root of the product of the variances"
    wrong = ~(np.abs(xy) < bound)
    if wrong.any():
        row = int(np.argmax(wrong))
        raise DataError(f"{where(row, columns[1])}: got {number(xy[row])}, want {want}")
