"""Figures printed in the clustering-statistic Hough transform paper (2018): tables 3 to 6.

Mean OSPA distances over 100 runs, order 2, cut-off 20, of estimates from one window of 20 looks.
"""

import numpy as np

RATES = (0.1, 0.3, 0.5, 0.7)  # P_M down, P_F across
SIGMAS_M = (1.0, 2.0, 3.0, 4.0, 5.0)  # at P_M = P_F = 0.3

# [P_M, P_F], σ = 3 m
VELOCITY_BY_RATES = {
    "CSHT": np.array(
        [
            [0.13, 0.15, 0.18, 0.26],
            [0.16, 0.18, 0.21, 0.33],
            [0.19, 0.21, 0.26, 0.35],
            [0.22, 0.26, 0.32, 0.42],
        ]
    ),
    "SHT": np.array(
        [
            [2.89, 3.28, 3.76, 4.72],
            [3.78, 4.79, 5.42, 5.59],
            [5.22, 5.21, 6.37, 6.72],
            [5.19, 5.36, 6.83, 7.85],
        ]
    ),
}
"""Table 3, m/s."""

POSITION_BY_RATES = {
    "CSHT": np.array(
        [
            [1.33, 1.98, 2.22, 2.51],
            [1.82, 2.14, 2.79, 2.96],
            [1.95, 2.95, 3.11, 3.45],
            [2.36, 3.52, 3.78, 4.33],
        ]
    ),
    "SHT": np.array(
        [
            [12.42, 15.32, 16.63, 18.62],
            [17.37, 22.43, 21.39, 24.33],
            [18.22, 23.37, 26.53, 25.44],
            [15.79, 26.45, 30.53, 32.51],
        ]
    ),
}
"""Table 4, metres. (A distance above the cut-off of 20 is impossible by equations 42 to 44.)"""

VELOCITY_BY_SIGMA = {
    "CSHT": np.array([0.13, 0.17, 0.18, 0.22, 0.25]),
    "SHT": np.array([3.26, 4.03, 4.79, 5.12, 5.58]),
}
"""Table 5, m/s."""

POSITION_BY_SIGMA = {
    "CSHT": np.array([1.29, 1.75, 2.14, 2.34, 2.85]),
    "SHT": np.array([18.93, 20.19, 22.43, 25.18, 27.26]),
}
"""Table 6, metres."""
