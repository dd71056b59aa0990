"""Figures printed in the clustering-statistic Hough transform paper (2018): tables 8 to 13.

Errors in metres, order 2, cut-off 20, averaged over 1 to 100 s and 100 runs. The distances of
tables 10 and 13 are not averages of distances: each is √(e_card² + e_loc²) of the averages that
tables 8, 9, 11 and 12 print, to the last digit but one. That is no more than the mean distance, and
less wherever errors of number come and go.
"""

import numpy as np

from jaxtrack.studies.printed import printed

_METRICS = {"cardinality": "cardinality_m", "localization": "localization_m", "distance": "ospa_m"}


def _by(study: str) -> dict[str, dict[str, np.ndarray]]:
    tables = {measure: printed(study, metric) for measure, metric in _METRICS.items()}
    return {m: {"CSHT": x["CSHT"], "Kalman": x["kalman_paper"]} for m, x in tables.items()}


BY_RATES = _by("csht_tracking")
"""Tables 8 to 10, [P_M, P_F], σ = 3 m."""

BY_SIGMA = _by("csht_tracking_noise")
"""Tables 11 to 13, P_M = P_F = 0.3."""

SECONDS_A_LOOK = {"CSHT": 0.1537, "Kalman": 0.0110}
