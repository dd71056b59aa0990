"""Figures printed in the clustering-statistic Hough transform paper (2018): tables 3 to 6.

Mean OSPA distances over 100 runs, order 2, cut-off 20, of estimates from one window of 20 looks.
"""

from jaxtrack.studies.printed import printed

RATES = (0.1, 0.3, 0.5, 0.7)  # P_M down, P_F across
SIGMAS_M = (1.0, 2.0, 3.0, 4.0, 5.0)  # at P_M = P_F = 0.3

VELOCITY_BY_RATES = printed("csht_estimation", "velocity_ospa_m_s")
"""Table 3, [P_M, P_F], σ = 3 m; m/s."""

POSITION_BY_RATES = printed("csht_estimation", "position_ospa_m")
"""Table 4, metres. (A distance above the cut-off of 20 is impossible by equations 42 to 44.)"""

VELOCITY_BY_SIGMA = printed("csht_estimation_noise", "velocity_ospa_m_s")
"""Table 5, m/s."""

POSITION_BY_SIGMA = printed("csht_estimation_noise", "position_ospa_m")
"""Table 6, metres."""
