"""Figures printed in the clustering-statistic Hough transform paper (2018): tables 8 to 13.

Errors in metres, order 2, cut-off 20, averaged over 1 to 100 s and 100 runs. The distances of
tables 10 and 13 are not averages of distances: each is √(e_card² + e_loc²) of the averages that
tables 8, 9, 11 and 12 print, to the last digit but one. That is no more than the mean distance, and
less wherever errors of number come and go.
"""

import numpy as np

CARDINALITY_BY_RATES = {
    "CSHT": np.array(
        [
            [1.39, 1.36, 1.46, 1.47],
            [1.50, 1.53, 1.65, 2.34],
            [2.19, 2.56, 2.57, 2.78],
            [2.75, 3.03, 3.77, 3.33],
        ]
    ),
    "Kalman": np.array(
        [
            [3.14, 3.50, 2.68, 5.15],
            [4.36, 3.45, 5.73, 6.32],
            [4.05, 7.15, 6.37, 5.75],
            [5.42, 5.33, 4.85, 9.18],
        ]
    ),
}
"""Table 8, [P_M, P_F], σ = 3 m."""

LOCALIZATION_BY_RATES = {
    "CSHT": np.array(
        [
            [1.14, 1.05, 1.18, 1.22],
            [1.22, 1.31, 1.28, 1.46],
            [1.32, 1.33, 1.42, 1.55],
            [1.37, 1.49, 1.91, 1.93],
        ]
    ),
    "Kalman": np.array(
        [
            [1.01, 1.16, 1.08, 1.17],
            [1.34, 1.48, 1.74, 1.97],
            [1.80, 2.67, 2.77, 2.82],
            [1.91, 2.31, 2.75, 3.02],
        ]
    ),
}
"""Table 9."""

DISTANCE_BY_RATES = {
    "CSHT": np.array(
        [
            [1.80, 1.72, 1.88, 1.91],
            [1.93, 2.01, 2.09, 2.76],
            [2.56, 2.88, 2.94, 3.18],
            [3.07, 3.38, 4.23, 3.85],
        ]
    ),
    "Kalman": np.array(
        [
            [3.30, 3.69, 2.89, 5.28],
            [4.56, 3.75, 5.99, 6.62],
            [4.43, 7.63, 6.95, 6.40],
            [5.75, 5.81, 5.58, 9.66],
        ]
    ),
}
"""Table 10."""

CARDINALITY_BY_SIGMA = {
    "CSHT": np.array([0.98, 1.12, 1.53, 1.79, 2.02]),
    "Kalman": np.array([1.68, 2.17, 3.45, 3.92, 5.23]),
}
"""Table 11, P_M = P_F = 0.3."""

LOCALIZATION_BY_SIGMA = {
    "CSHT": np.array([0.82, 1.07, 1.31, 1.33, 1.86]),
    "Kalman": np.array([0.93, 1.22, 1.48, 1.93, 2.29]),
}
"""Table 12."""

DISTANCE_BY_SIGMA = {
    "CSHT": np.array([1.27, 1.55, 2.01, 2.23, 2.75]),
    "Kalman": np.array([1.92, 2.49, 3.75, 4.37, 5.71]),
}
"""Table 13."""

BY_RATES = {
    "cardinality": CARDINALITY_BY_RATES,
    "localization": LOCALIZATION_BY_RATES,
    "distance": DISTANCE_BY_RATES,
}
BY_SIGMA = {
    "cardinality": CARDINALITY_BY_SIGMA,
    "localization": LOCALIZATION_BY_SIGMA,
    "distance": DISTANCE_BY_SIGMA,
}

SECONDS_A_LOOK = {"CSHT": 0.1537, "Kalman": 0.0110}
