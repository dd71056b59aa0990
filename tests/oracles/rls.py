"""Recursive least squares as one batch problem: reference 28 of the paper."""

import numpy as np


def batch(time_s, z, mask, t_ref, forgetting, delta, initial=None):
    """Return (B [2, D], P [2, 2]) of the accepted measurements: regularised normal equations.

    B minimises Σ f^(n−k) |z_k − Bᵀ φ_k|² + f^n ‖B − B_0‖² / δ over the accepted measurements
    k = 1..n, φ_k = (1, t_k − t_ref): its rows are position and velocity at t_ref. P is the inverse
    of the matrix of the equations. A measurement that is not accepted forgets nothing.
    """
    z = np.asarray(z, dtype=np.float64)
    accepted = [k for k in range(len(time_s)) if bool(mask[k])]
    n = len(accepted)
    start = np.zeros((2, z.shape[1])) if initial is None else np.asarray(initial, dtype=np.float64)
    information = forgetting**n / delta * np.eye(2)
    moment = information @ start
    for count, k in enumerate(accepted, start=1):
        phi = np.array([1.0, float(time_s[k]) - t_ref])
        weight = forgetting ** (n - count)
        information += weight * np.outer(phi, phi)
        moment += weight * np.outer(phi, z[k])
    return np.linalg.solve(information, moment), np.linalg.inv(information)
