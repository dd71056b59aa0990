"""The scaled unscented transform and its filter, from Wan and van der Merwe (2000), in loops."""

import numpy as np

from tests.oracles.kalman import log_normal, range_bearing, wrapped


def sigma_points(mean, covariance, alpha, beta, kappa):
    """Return points [2n + 1][n], and their weights for the mean and for the covariance."""
    n = len(mean)
    lam = alpha**2 * (n + kappa) - n
    root = np.linalg.cholesky((n + lam) * covariance)
    points = [mean]
    points += [mean + root[:, i] for i in range(n)]
    points += [mean - root[:, i] for i in range(n)]
    for_mean = [lam / (n + lam)] + [1 / (2 * (n + lam))] * (2 * n)
    for_covariance = [for_mean[0] + 1 - alpha**2 + beta, *for_mean[1:]]
    return points, for_mean, for_covariance


def subtract(a, b):
    return a - b


def polar_subtract(a, b):
    return np.array([a[0] - b[0], wrapped(a[1] - b[1])])


def transform(values, for_mean, for_covariance, residual):
    """Return mean and covariance of weighted values; differences are to the first one."""
    mean = values[0].copy()
    for w, v in zip(for_mean, values, strict=True):
        mean += w * residual(v, values[0])
    covariance = np.zeros((len(mean), len(mean)))
    for w, v in zip(for_covariance, values, strict=True):
        covariance += w * np.outer(residual(v, mean), residual(v, mean))
    return mean, covariance


def predict(mean, covariance, function, noise, spread):
    points, for_mean, for_covariance = sigma_points(mean, covariance, *spread)
    mean, covariance = transform([function(p) for p in points], for_mean, for_covariance, subtract)
    return mean, covariance + noise


def update(mean, covariance, z, function, noise, residual, spread):
    """Return mean, covariance and log-likelihood."""
    points, for_mean, for_covariance = sigma_points(mean, covariance, *spread)
    values = [function(p) for p in points]
    expected, s = transform(values, for_mean, for_covariance, residual)
    s = s + noise
    cross = np.zeros((len(mean), len(z)))
    for w, p, v in zip(for_covariance, points, values, strict=True):
        cross += w * np.outer(p - mean, residual(v, expected))
    gain = cross @ np.linalg.inv(s)
    y = residual(z, expected)
    return mean + gain @ y, covariance - gain @ s @ gain.T, log_normal(y, s)


def mover(function, noise, spread):
    """Return what `kalman.run` moves with; without matrices, for there are none."""

    def move(mean, covariance, dt):
        moved = predict(mean, covariance, lambda x: function(x, dt), noise(dt), spread)
        return *moved, None, None

    return move


def polar_observer(spread):
    def observe(mean, covariance, look):
        seen = lambda state: range_bearing(state, look["position"], look["heading"])
        return update(mean, covariance, look["z"], seen, look["R"], polar_subtract, spread)

    return observe


def smooth(done, function, dts, spread):
    """Särkkä's unscented smoother (2008) over the result of `kalman.run`; dts[k] leads to k."""
    mean, covariance = done[-1]["filtered"]
    smoothed = [(mean, covariance)]
    for k in range(len(done) - 2, -1, -1):
        m, p = done[k]["filtered"]
        m_next, p_next = done[k + 1]["predicted"]
        points, _, weights = sigma_points(m, p, *spread)
        cross = np.zeros_like(p)
        for w, x in zip(weights, points, strict=True):
            cross += w * np.outer(x - m, function(x, dts[k + 1]) - m_next)
        gain = cross @ np.linalg.inv(p_next)
        mean, covariance = m + gain @ (mean - m_next), p + gain @ (covariance - p_next) @ gain.T
        smoothed.append((mean, covariance))
    return smoothed[::-1]
