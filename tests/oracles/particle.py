"""Particle filter and resampling, one particle at a time.

What is random comes in: uniform numbers for the resampling, moved particles for the motion.
"""

import itertools
import math

import numpy as np


def first_above(weights, point):
    """Return the first index whose running sum of normalized weights exceeds a point."""
    total, running = sum(weights), 0.0
    last = max(i for i, w in enumerate(weights) if w > 0)
    for i, w in enumerate(weights):
        running += w / total
        if running > point:
            return i
    return last


def systematic(weights, u):
    n = len(weights)
    return [first_above(weights, (j + u) / n) for j in range(n)]


def stratified(weights, u):
    n = len(weights)
    return [first_above(weights, (j + u[j]) / n) for j in range(n)]


def multinomial(weights, u):
    return [first_above(weights, u[j]) for j in range(len(weights))]


def residual(weights, u):
    """Copy whole parts first; a later place is drawn with its own uniform number."""
    n, total = len(weights), sum(weights)
    expected = [n * w / total for w in weights]
    ancestors = [i for i, e in enumerate(expected) for _ in range(math.floor(e))]
    left = [e - math.floor(e) for e in expected]
    while len(ancestors) < n:
        ancestors.append(first_above(left, u[len(ancestors)]))
    return ancestors


def soft_weights(weights, ancestors, mix):
    """Return weights after a draw by mixed weights, which `mixed` gives."""
    q = mixed(weights, mix)
    return [weights[a] / sum(weights) / (len(weights) * q[a]) for a in ancestors]


def mixed(weights, mix):
    return [mix * w / sum(weights) + (1 - mix) / len(weights) for w in weights]


def transport(particles, weights, epsilon, rounds):
    """Return blended particles and their weights: Sinkhorn on the kernel itself."""
    n, s = particles.shape
    variance = [np.mean((particles[:, k] - np.mean(particles[:, k])) ** 2) for k in range(s)]
    kernel = np.zeros((n, n))
    for i, j in itertools.product(range(n), range(n)):
        cost = [
            (particles[i, k] - particles[j, k]) ** 2 / variance[k] if variance[k] > 0 else 0.0
            for k in range(s)
        ]
        kernel[i, j] = math.exp(-sum(cost) / s / epsilon)
    across = np.ones(n)
    for _ in range(rounds):
        down = np.array([1 / n / sum(kernel[i] * across) for i in range(n)])
        across = np.array([weights[j] / sum(kernel[:, j] * down) for j in range(n)])
    plan = down[:, None] * kernel * across[None, :]
    moved = np.array([sum(plan[i, j] * particles[j] for j in range(n)) for i in range(n)])
    mass = plan.sum(1)
    return moved / mass[:, None], mass


def monotone(particles, weights):
    """Return what exact transport on a line makes of particles, from left to right."""
    order = np.argsort(particles)
    n, edges = len(particles), np.concatenate([[0.0], np.cumsum(np.array(weights)[order])])
    moved = np.zeros(n)
    for i, j in itertools.product(range(n), range(n)):
        shared = min((i + 1) / n, edges[j + 1]) - max(i / n, edges[j])
        moved[i] += n * max(shared, 0.0) * particles[order[j]]
    return moved


def effective_size(weights):
    total = sum(weights)
    return 1 / sum((w / total) ** 2 for w in weights)


def run(particles, looks, move, likelihood, resample, share):
    """Filter looks; return a list of what each did.

    looks: dicts with `valid` and what else move and likelihood read. move(particle i, i, look) →
    particle; likelihood(particle, look) → g and, for `score`, the gradients of log g and log f
    given the particle before. resample(weights) → ancestors.

    The score is the gradient of log Σ w g with w's own gradient carried along each lineage.
    """
    particles, n = [np.array(p, float) for p in particles], len(particles)
    weights, lineage = [1 / n] * n, [0.0] * n
    done = []
    for look in looks:
        one = {"resampled": False, "vanished": False, "log_likelihood": 0.0, "score": 0.0}
        if look["valid"]:
            before = particles
            particles = [move(before[i], i, look) for i in range(n)]
            told = [likelihood(particles[i], look) for i in range(n)]
            joint = [w * g for w, g in zip(weights, told, strict=True)]
            total = sum(joint)
            if total > 0:
                weights = [w / total for w in joint]
            one["vanished"] = not total > 0
            one["log_likelihood"] = math.log(total) if total > 0 else -math.inf
            if total > 0 and "slopes" in look:
                slopes = [lineage[i] + look["slopes"](before[i], particles[i]) for i in range(n)]
                one["score"] = sum(w * s for w, s in zip(weights, slopes, strict=True))
                lineage = [s - one["score"] for s in slopes]
        one |= {"particles": np.array(particles), "weights": np.array(weights)}
        one["effective_size"] = effective_size(weights)
        one["mean"] = sum(w * p for w, p in zip(weights, particles, strict=True)) / sum(weights)
        if look["valid"] and one["effective_size"] < share * n:
            one["resampled"] = True
            ancestors = resample(weights)
            particles = [particles[a] for a in ancestors]
            lineage = [lineage[a] for a in ancestors]
            weights = [1 / n] * n
        done.append(one)
    return done
