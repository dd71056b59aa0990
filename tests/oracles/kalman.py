"""Kalman, extended Kalman filter and smoother from the textbook's equations, one matrix at a time.

States are [x, y, vx, vy] or [x, y, vx, vy, ω]. A look is a dict: time, valid, seen, z and R, and
what else the measurement needs.
"""

import math

import numpy as np


def transition(dt):
    return np.array([[1, 0, dt, 0], [0, 1, 0, dt], [0, 0, 1, 0], [0, 0, 0, 1]], float)


def acceleration_noise(dt, sigma):
    gain = np.array([[dt * dt / 2, 0], [0, dt * dt / 2], [dt, 0], [0, dt]])
    return sigma**2 * gain @ gain.T


def turned(state, dt):
    """Move along a circle; complex states too, for `jacobian`."""
    x, y, vx, vy, rate = state
    if rate == 0:
        return np.array([x + vx * dt, y + vy * dt, vx, vy, rate])
    sin, cos = np.sin(rate * dt), np.cos(rate * dt)
    return np.array(
        [
            x + (vx * sin - vy * (1 - cos)) / rate,
            y + (vx * (1 - cos) + vy * sin) / rate,
            vx * cos - vy * sin,
            vx * sin + vy * cos,
            rate,
        ]
    )


def turn_noise(dt, sigma_a, sigma_turn):
    noise = np.zeros((5, 5))
    noise[:4, :4] = acceleration_noise(dt, sigma_a)
    noise[4, 4] = (sigma_turn * dt) ** 2
    return noise


def jacobian(function, state):
    """Differentiate by a complex step, which has no rounding."""
    columns = []
    for k in range(len(state)):
        moved = np.array(state, complex)
        moved[k] += 1e-200j
        columns.append(function(moved).imag / 1e-200)
    return np.stack(columns, axis=1)


def wrapped(angle):
    return math.remainder(angle, 2 * math.pi)


def range_bearing(state, position, heading):
    north, east = state[0] - position[0], state[1] - position[1]
    return np.array([math.hypot(north, east), wrapped(math.atan2(east, north) - heading)])


def range_bearing_jacobian(state, position):
    north, east = state[0] - position[0], state[1] - position[1]
    r = math.hypot(north, east)
    rows = np.zeros((2, len(state)))
    rows[0, :2] = north / r, east / r
    rows[1, :2] = -east / r**2, north / r**2
    return rows


def log_normal(y, spread):
    sign, log_determinant = np.linalg.slogdet(2 * math.pi * spread)
    assert sign > 0
    return -0.5 * (y @ np.linalg.solve(spread, y) + log_determinant)


def update(mean, covariance, y, h, r):
    """Return mean, covariance and log-likelihood after an innovation."""
    spread = h @ covariance @ h.T + r
    gain = covariance @ h.T @ np.linalg.inv(spread)
    return mean + gain @ y, covariance - gain @ spread @ gain.T, log_normal(y, spread)


def run(prior, looks, move, observe):
    """Filter looks; return a list of what each did.

    prior: (mean, covariance, time). move(mean, covariance, dt) → mean, covariance, F, Q;
    observe(mean, covariance, look) → mean, covariance, log-likelihood.
    """
    mean, covariance, time = (np.array(x, float) for x in prior)
    done = []
    for look in looks:
        f, q, log_likelihood = np.eye(len(mean)), np.zeros((len(mean),) * 2), 0.0
        if look["valid"]:
            mean, covariance, f, q = move(mean, covariance, look["time"] - time)
            time = look["time"]
        one = {"predicted": (mean, covariance), "F": f, "Q": q}
        if look["valid"] and look["seen"]:
            mean, covariance, log_likelihood = observe(mean, covariance, look)
        done.append(one | {"filtered": (mean, covariance), "log_likelihood": log_likelihood})
    return done


def linear_move(sigma_a):
    def move(mean, covariance, dt):
        f, q = transition(dt), acceleration_noise(dt, sigma_a)
        return f @ mean, f @ covariance @ f.T + q, f, q

    return move


def turn_move(sigma_a, sigma_turn):
    def move(mean, covariance, dt):
        f = jacobian(lambda x: turned(x, dt), mean)
        q = turn_noise(dt, sigma_a, sigma_turn)
        return turned(mean, dt), f @ covariance @ f.T + q, f, q

    return move


def observe_position(mean, covariance, look):
    """See a position, `delay` after the look's time."""
    h = np.zeros((2, len(mean)))
    h[0, 0] = h[1, 1] = 1
    h[0, 2] = h[1, 3] = look.get("delay", 0.0)
    return update(mean, covariance, look["z"] - h @ mean, h, look["R"])


def observe_polar(mean, covariance, look):
    y = look["z"] - range_bearing(mean, look["position"], look["heading"])
    y[1] = wrapped(y[1])
    h = range_bearing_jacobian(mean, look["position"])
    return update(mean, covariance, y, h, look["R"])


def smooth(done):
    """Rauch, Tung and Striebel's backward pass over the result of `run`."""
    mean, covariance = done[-1]["filtered"]
    smoothed = [(mean, covariance)]
    for here, ahead in zip(done[-2::-1], done[:0:-1], strict=True):
        m, p = here["filtered"]
        m_next, p_next = ahead["predicted"]
        gain = p @ ahead["F"].T @ np.linalg.inv(p_next)
        mean, covariance = m + gain @ (mean - m_next), p + gain @ (covariance - p_next) @ gain.T
        smoothed.append((mean, covariance))
    return smoothed[::-1]


def batch(prior, looks, sigma_a):
    """Return means [T, 4] and covariances [T, 4, 4] given all looks, from one big Gaussian.

    All looks are valid. The states of all looks are jointly normal, and the positions seen are
    linear in them: one conditioning, without any recursion.
    """
    size = len(looks)
    mean, covariance = np.zeros(4 * size), np.zeros((4 * size, 4 * size))
    m, time = np.array(prior[0], float), prior[2]
    marginal = np.array(prior[1], float)
    for k, look in enumerate(looks):
        step, time = look["time"] - time, look["time"]
        f = transition(step)
        m, marginal = f @ m, f @ marginal @ f.T + acceleration_noise(step, sigma_a)
        here = slice(4 * k, 4 * k + 4)
        mean[here], covariance[here, here] = m, marginal
        for j in range(k):
            there, before = slice(4 * j, 4 * j + 4), slice(4 * k - 4, 4 * k)
            covariance[here, there] = f @ covariance[before, there]
            covariance[there, here] = covariance[here, there].T
    rows = [4 * k + axis for k, look in enumerate(looks) if look["seen"] for axis in (0, 1)]
    z = np.concatenate([look["z"] for look in looks if look["seen"]])
    spread = covariance[np.ix_(rows, rows)]
    blocks = [look["R"] for look in looks if look["seen"]]
    for k, block in enumerate(blocks):
        spread[2 * k : 2 * k + 2, 2 * k : 2 * k + 2] += block
    gain = covariance[:, rows] @ np.linalg.inv(spread)
    mean = mean + gain @ (z - mean[rows])
    covariance = covariance - gain @ spread @ gain.T
    cut = [slice(4 * k, 4 * k + 4) for k in range(size)]
    return mean.reshape(size, 4), np.stack([covariance[s, s] for s in cut])
