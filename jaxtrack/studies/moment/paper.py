"""Figures printed in the Zernike moment paper (2023): tables 4, 6 and 8, from its sea trials.

Means and variances of the deviation, truth less estimate, in X and Y, and the mean distance S. They
stand beside a simulation, for comparison and not for equality: path, water and bucket were others.
The text to table 8 says that all variances fall with the optimised transition; that of Zernike
moments in X is printed as .2180 before and .3365 after.
"""

from typing import NamedTuple


class Printed(NamedTuple):
    """One column of a table."""

    mean_x_m: float
    variance_x_m2: float
    mean_y_m: float
    variance_y_m2: float
    s_m: float


TABLES = {
    "static": {  # table 4, which does not say whether the transition was optimised: L < 0.3 m
        "hu, optimised": Printed(0.0492, 0.0754, -0.1559, 0.0711, 0.3791),
        "zernike, optimised": Printed(-0.0291, 0.0187, 0.0292, 0.0238, 0.1883),
    },
    "hovering": {  # table 6
        "hu": Printed(9.0516, 39.5647, 3.0310, 26.3450, 9.6144),
        "hu, optimised": Printed(1.0108, 0.4556, 0.6296, 0.1157, 1.2914),
        "zernike": Printed(1.8659, 1.9981, 0.6589, 0.7506, 2.0941),
        "zernike, optimised": Printed(0.0221, 0.0798, 0.2486, 0.0807, 0.4059),
    },
    "following": {  # table 8
        "hu": Printed(6.3420, 22.7151, -1.7531, 21.7965, 6.7260),
        "hu, optimised": Printed(0.6765, 0.4830, -0.4954, 0.3502, 1.1086),
        "zernike": Printed(0.7829, 0.2180, -0.3845, 0.2768, 1.0502),
        "zernike, optimised": Printed(0.5286, 0.3365, -0.3170, 0.2386, 0.8761),
    },
}
"""By experiment and method, as the study names them."""
