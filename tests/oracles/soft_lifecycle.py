"""Soft lives, track by track, and the share by which a cluster survives, in plain numbers."""

import math


def sigmoid(x):
    return 1.0 / (1.0 + math.exp(-x)) if x > -700 else 0.0


class SoftTrack:
    """One track: a row of shares of hits, expected misses, shares alive and confirmed."""

    def __init__(self, last, alive=1.0):
        self.hits = [0.0] * (last - 1) + [1.0]
        self.misses = self.unseen = 0.0
        self.alive, self.confirmed = alive, 0.0

    def look(self, hit, counted, valid, score, lives, widths):
        """Grade by (M, level, D, D_t, U) with widths (looks, score); return whether it stays."""
        if not valid:
            return True
        wanted, level, delete, tentative, out = lives
        looks, nats = widths
        hit = hit if counted else 0.0
        if counted:
            self.hits = [*self.hits[1:], hit]
            self.misses = (1 - hit) * (self.misses + 1)
        self.unseen = (1 - hit) * (self.unseen + 1)
        enough = sigmoid((sum(self.hits) - wanted + 0.5) / looks) * sigmoid((score - level) / nats)
        self.confirmed += (1 - self.confirmed) * hit * enough
        miss = 1 - sigmoid((self.misses - delete + 0.5) / looks)
        miss *= 1 - sigmoid((self.unseen - out + 0.5) / looks)
        young = 1 - sigmoid((self.unseen - tentative + 0.5) / looks)
        self.alive *= self.confirmed * miss + (1 - self.confirmed) * young
        return self.alive >= 0.5


def survival(samples, weights, centres, membership, width, p):
    """Return the share of each of K ≥ 1 patterns; p has alpha_c, gamma, theta, a and delta."""
    k, total = len(centres), sum(weights)
    spread, count, held, mass = [], [], [], []
    for z, mu in zip(centres, membership, strict=True):
        own = [w * sigmoid((m - p["theta"]) / width) for w, m in zip(weights, mu, strict=True)]
        count.append(sum(own))
        held.append(sum(o * m for o, m in zip(own, mu, strict=True)) / count[-1])
        mass.append(sum(w * m for w, m in zip(weights, mu, strict=True)))
        square = [
            sum(w * m * (x[j] - z[j]) ** 2 for w, m, x in zip(weights, mu, samples, strict=True))
            for j in range(len(z))
        ]
        spread.append([math.sqrt(s / (total - 1)) for s in square])
    gate = [sum(s[j] for s in spread) / k * (1 + k ** -p["gamma"]) for j in range(len(centres[0]))]
    pairs = [(i, n) for i in range(k) for n in range(i)]
    mean = sum(math.dist(centres[i], centres[n]) for i, n in pairs) / max(len(pairs), 1)
    least = mean * (1 - k ** -p["alpha_c"])
    shares = []
    for i in range(k):
        few = sigmoid((1 - count[i] * k / (p["delta"] * total)) / width)
        loose = sigmoid((p["a"] - held[i]) / width)
        for j in range(len(gate)):
            loose *= sigmoid((1 - spread[i][j] / gate[j]) / width)
        share = (1 - few) * (1 - loose)
        for n in range(k):
            if n != i and (mass[n], -n) > (mass[i], -i):
                share *= sigmoid((math.dist(centres[i], centres[n]) - least) / (width * mean))
        shares.append(share)
    return shares
