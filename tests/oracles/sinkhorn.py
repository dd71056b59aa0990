"""The soft assignment as the optimum that it is, by a solver that knows no scaling."""

import numpy as np
from scipy.optimize import minimize


def shares(weight, miss, temperature):
    """Return argmax Σ p log w + Σ p_0 log w_0 − τ Σ p log p; columns add up to one at most.

    By its dual: minimize over v ≥ 0, a price of each detection,
    Σ_j τ log(w_0j^(1/τ) + Σ_i (w_ij exp(−v_i))^(1/τ)) + Σ_i v_i.
    """
    weight, miss = np.asarray(weight, float), np.asarray(miss, float)
    tracks, detections = weight.shape

    def table(price):
        found = np.zeros((tracks, detections + 1))
        for j in range(tracks):
            values = [
                (weight[j, i] * np.exp(-price[i])) ** (1 / temperature) for i in range(detections)
            ]
            values.append(miss[j] ** (1 / temperature))
            found[j] = np.array(values) / sum(values)
        return found

    def dual(price):
        total = price.sum()
        for j in range(tracks):
            values = [
                (weight[j, i] * np.exp(-price[i])) ** (1 / temperature) for i in range(detections)
            ]
            total += temperature * np.log(sum(values) + miss[j] ** (1 / temperature))
        return total

    slope = lambda price: 1 - table(price)[:, :-1].sum(0)
    bounds = [(0, None)] * detections
    options = {"ftol": 1e-16, "gtol": 1e-12, "maxiter": 10000}
    found = minimize(
        dual, np.zeros(detections), jac=slope, bounds=bounds, method="L-BFGS-B", options=options
    )
    return table(found.x)
