"""The methods as a careful NumPy user writes them: vectorized, one realization at a time."""

import itertools

import numpy as np

HALF_PI = np.pi / 2


def lines_through(first, second):
    along = second - first
    length = np.hypot(along[:, 0], along[:, 1])
    normal = np.stack([-along[:, 1], along[:, 0]], axis=1) / length[:, None]
    flip = (normal[:, 1] < 0) | ((normal[:, 1] == 0) & (normal[:, 0] < 0))
    normal[flip] *= -1
    return (normal * first).sum(1), np.arctan2(normal[:, 1], normal[:, 0])


def difference(rho, theta, other_rho, other_theta):
    d_theta = theta - other_theta
    twin = np.abs(d_theta) > HALF_PI
    d_theta = np.where(twin, d_theta - np.pi * np.sign(d_theta), d_theta)
    return np.where(twin, rho + other_rho, rho - other_rho), d_theta


def greedy(rho, theta, votes, lines, separation):
    left, picked = votes.copy(), []
    for _ in range(lines):
        if left.size == 0 or left[top := int(np.argmax(left))] <= 0:
            break
        picked.append(top)
        d_rho, d_theta = difference(rho[top], theta[top], rho, theta)
        left[(np.abs(d_rho) <= separation[0]) & (np.abs(d_theta) <= separation[1])] = 0
    return np.array(picked, int)


def standard(scans, rho_max, n_rho, n_theta, lines, separation, rows=64):
    z = np.concatenate(scans) * (n_rho / (2 * rho_max))
    theta = (np.arange(n_theta) + 0.5) * np.pi / n_theta
    votes = np.empty((n_theta, n_rho), np.int64)
    for begin in range(0, n_theta, rows):  # a block stays in the cache
        t = theta[begin : begin + rows]
        rho = np.outer(np.cos(t), z[:, 0]) + np.outer(np.sin(t), z[:, 1])
        cell = np.floor(rho + n_rho / 2).astype(np.int32)
        keep = (cell >= 0) & (cell < n_rho)
        cell += (np.arange(len(t), dtype=np.int32) * n_rho)[:, None]
        count = np.bincount(cell[keep], minlength=len(t) * n_rho)
        votes[begin : begin + rows] = count.reshape(len(t), n_rho)
    row_max = votes.max(1)
    d_j = int(separation[1] / (np.pi / n_theta))
    d_i = int(separation[0] * n_rho / (2 * rho_max))
    picked = []
    for _ in range(lines):
        j = int(np.argmax(row_max))
        i = int(np.argmax(votes[j]))
        picked.append((i, j, votes[j, i]))
        for row in range(j - d_j, j + d_j + 1):
            wrapped, centre = row % n_theta, i if 0 <= row < n_theta else n_rho - 1 - i
            votes[wrapped, max(centre - d_i, 0) : centre + d_i + 1] = 0
        window = np.arange(j - d_j, j + d_j + 1) % n_theta
        row_max[window] = votes[window].max(1)
    return picked


def gated_pairs(before, now, dt, v_min, v_max):
    displacement = now[:, None, :] - before[None, :, :]
    squared = displacement[..., 0] ** 2 + displacement[..., 1] ** 2
    second, first = np.nonzero((squared >= (v_min * dt) ** 2) & (squared <= (v_max * dt) ** 2))
    return first, second


def own_cell_votes(rho, theta, weight, rho_max, n_rho, n_theta):
    i = np.floor((rho + rho_max) * (n_rho / (2 * rho_max))).astype(np.int64)
    j = np.floor(theta * (n_theta / np.pi)).astype(np.int64)
    inside = (i >= 0) & (i < n_rho)
    _, inverse = np.unique(j * n_rho + i, return_inverse=True)
    return np.bincount(inverse, np.where(inside, weight, 0.0))[inverse]


def improved(scans, dt, v_min, v_max, rho_max, n_rho, n_theta, lines, separation):
    ends = []
    for before, now in itertools.pairwise(scans):
        first, second = gated_pairs(before, now, dt, v_min, v_max)
        ends.append((before[first], now[second]))
    rho, theta = lines_through(
        np.concatenate([a for a, _ in ends]), np.concatenate([b for _, b in ends])
    )
    votes = own_cell_votes(rho, theta, np.ones_like(rho), rho_max, n_rho, n_theta)
    top = greedy(rho, theta, votes, lines, separation)
    return rho[top], theta[top], votes[top]


def neutrosophic(
    scans, dt, v_min, v_max, eps, p_false, p_gate, sigma, rho_max, n_rho, n_theta, lines, separation
):
    """Kernels that share the detection, votes in the own cell: joined as ragged lists."""
    every, kernel = [], None
    for before, now in itertools.pairwise(scans):
        first, second = gated_pairs(before, now, dt, v_min, v_max)
        a, b = before[first], now[second]
        rho, theta = lines_through(a, b) if len(a) else (np.zeros(0), np.zeros(0))
        count = np.bincount(second, minlength=len(now))
        table = (a, b, rho, theta, np.cumsum(count) - count, count)
        if kernel is None:
            every.append((rho, theta, np.full(len(rho), 1 - p_false)))
        else:
            vote = _votes(table, first, kernel, eps, p_false, p_gate, sigma)
            every.append((rho, theta, vote))
        kernel = table
    rho, theta, weight = (np.concatenate(x) for x in zip(*every, strict=True))
    votes = own_cell_votes(rho, theta, weight, rho_max, n_rho, n_theta)
    top = greedy(rho, theta, votes, lines, separation)
    return rho[top], theta[top], votes[top]


def _votes(table, first, kernel, eps, p_false, p_gate, sigma):
    _, b, rho, theta, _, _ = table
    ka, kb, krho, ktheta, start, count = kernel
    n = count[first]
    owner = np.repeat(np.arange(len(first)), n)
    index = np.repeat(start[first], n) + np.arange(len(owner)) - np.repeat(np.cumsum(n) - n, n)
    d_rho, d_theta = difference(rho[owner], theta[owner], krho[index], ktheta[index])
    box = (np.abs(d_rho) <= 2 * eps[0]) & (np.abs(d_theta) <= 2 * eps[1])
    owner, index = owner[box], index[box]  # few remain
    value = np.exp(-((d_rho[box] / eps[0]) ** 2 + (d_theta[box] / eps[1]) ** 2) / 2)
    order = np.lexsort((-value, owner))
    owner, index, value = owner[order], index[order], value[order]
    true, uncertain = np.zeros(len(rho)), np.zeros(len(rho))
    lead = np.flatnonzero(np.r_[True, owner[1:] != owner[:-1]]) if len(owner) else np.zeros(0, int)
    true[owner[lead]] = (1 - p_false) * value[lead]
    two = lead[(lead + 1 < len(owner)) & (np.r_[owner, -1][lead + 1] == owner[lead])]
    if len(two):
        p, o1, o2 = owner[two], index[two], index[two + 1]
        middle = lines_through((ka[o1] + ka[o2]) / 2, (kb[o1] + kb[o2]) / 2)
        d_rho, d_theta = difference(rho[p], theta[p], *middle)
        near = np.exp(-((d_rho / eps[0]) ** 2 + (d_theta / eps[1]) ** 2) / 2)
        near *= (np.abs(d_rho) <= 2 * eps[0]) & (np.abs(d_theta) <= 2 * eps[1])
        for o in (o1, o2):
            miss = ((b[p] - (2 * kb[o] - ka[o])) ** 2).sum(1)
            near *= miss <= -2 * np.log1p(-p_gate) * sigma**2 * 6
        uncertain[p] = (1 - p_false) * near
    largest = np.maximum(true, uncertain)
    return np.where(largest > p_false, largest / (true + uncertain + p_false), 0.0)
