"""The interacting multiple model filter, from Bar-Shalom, Li and Kirubarajan (2001), 11.6.6."""

import numpy as np


def together(means, covariances, weights):
    """Return mean and covariance of a mixture."""
    mean = sum(w * m for w, m in zip(weights, means, strict=True))
    covariance = np.zeros((len(mean), len(mean)))
    for w, m, p in zip(weights, means, covariances, strict=True):
        covariance += w * (p + np.outer(m - mean, m - mean))
    return mean, covariance


def run(prior, probability, switching, looks, moves, observe):
    """Filter looks; `moves` and `observe` as in `kalman.run`. Returns what each look did."""
    models = len(moves)
    means = [np.array(prior[0], float)] * models
    covariances = [np.array(prior[1], float)] * models
    mu, time, done = list(probability), prior[2], []
    for look in looks:
        if look["valid"]:
            predicted = [sum(switching[i][j] * mu[i] for i in range(models)) for j in range(models)]
            moved = []
            for j in range(models):
                weights = [switching[i][j] * mu[i] / predicted[j] for i in range(models)]
                mixed = together(means, covariances, weights)
                moved.append(moves[j](*mixed, look["time"] - time))
            means, covariances = [m[0] for m in moved], [m[1] for m in moved]
            mu, time = predicted, look["time"]
        one = {"predicted": together(means, covariances, mu), "log_likelihood": 0.0}
        if look["valid"] and look["seen"]:
            after = [observe(m, p, look) for m, p in zip(means, covariances, strict=True)]
            means, covariances = [a[0] for a in after], [a[1] for a in after]
            joint = [mu[j] * np.exp(after[j][2]) for j in range(models)]
            mu = [x / sum(joint) for x in joint]
            one["log_likelihood"] = np.log(sum(joint))
        filtered = together(means, covariances, mu)
        done.append(one | {"filtered": filtered, "probability": np.array(mu), "means": means})
    return done
