"""The Kalman tracker, look by look and track by track, with M-of-N lives.

Confirmed tracks choose first, tentative ones see what weight these leave of each detection.
"""

import math

import numpy as np

from tests.oracles import association as pairs
from tests.oracles.jpda import marginals
from tests.oracles.lifecycle import Book


def motion(dt, sigma_a):
    """Return F and Q of a constant velocity under white-noise acceleration."""
    f, q = np.eye(4), np.zeros((4, 4))
    for axis in (0, 1):
        f[axis, axis + 2] = dt
        g = np.zeros(4)
        g[axis], g[axis + 2] = dt**2 / 2, dt
        q += sigma_a**2 * np.outer(g, g)
    return f, q


def assign(name, tracks, detections, known):
    """Return for each track the weights {i: β_i} and the miss."""
    p_detect, clutter, gate = known
    if name in ("greedy", "optimal"):
        taken = getattr(pairs, name)(tracks, detections, gate)
        return [(mine, 0.0 if mine else 1.0) for mine in taken]
    w, missed = pairs.ratios(tracks, detections, p_detect, clutter, gate)
    rows = marginals(w, missed)
    return [({i: b for i, b in enumerate(row[:-1]) if b > 0}, row[-1]) for row in rows]


def run(scans, name, *, slots, last, lives, sigma, sigma_a, known, birth_speed=None, birth=None):
    """Return after each look a list of slots: None, or what there is of the track.

    That is (identity, mean, covariance, stage, score, existence).

    Args:
        scans: looks (time, valid, [(x, y) or None, ...]).
        name: greedy, optimal or jpda.
        slots: of the table.
        last: looks of the M-of-N rule.
        lives: M, misses that delete a confirmed track, and a tentative one.
        sigma: noise of a detection.
        sigma_a: acceleration.
        known: P_D, clutter and gate.
        birth_speed: deviation of a new track's velocity.
        birth: (state at rest at the detection) → mean and covariance of a new track; None: that
            state, with the detection's noise and birth_speed.
    """
    book, covariance, before, history = Book(slots, last, *lives), [None] * slots, None, []
    noise = sigma**2 * np.eye(2)
    p_detect, clutter, gate = known
    if birth is None:
        birth = lambda mean: (mean, np.diag([sigma**2] * 2 + [birth_speed**2] * 2))
    for time, valid, places in scans:
        if valid:
            detections = [None if z is None else (np.array(z), noise, 1.0) for z in places]
            if before is not None:
                f, q = motion(time - before, sigma_a)
                for slot, track in enumerate(book.slots):
                    if track is not None:
                        track.mean = f @ track.mean
                        covariance[slot] = f @ covariance[slot] @ f.T + q
            before = time
            tracks = [
                None if track is None else (track.mean[:2], covariance[slot][:2, :2])
                for slot, track in enumerate(book.slots)
            ]
            found, gain = [({}, 1.0)] * slots, [1.0] * slots
            left = [1.0] * len(detections)
            for confirmed in (True, False):
                turn = [
                    pair if pair is not None and book.slots[slot].confirmed == confirmed else None
                    for slot, pair in enumerate(tracks)
                ]
                seen = [
                    None if d is None else (d[0], d[1], rest)
                    for d, rest in zip(detections, left, strict=True)
                ]
                w, missed = pairs.ratios(turn, seen, p_detect, clutter, gate)
                taken = assign(name, turn, seen, known)
                for slot, pair in enumerate(turn):
                    if pair is not None:
                        found[slot], gain[slot] = taken[slot], missed[slot] + w[slot].sum()
                        for i, b in taken[slot][0].items():
                            left[i] = max(left[i] - b, 0.0)
            held = {
                i
                for j, i in pairs.gated(tracks, detections, gate)
                if book.slots[j] is not None and book.slots[j].confirmed
            }
            claimed = np.zeros(len(detections))
            hit = []
            for slot, track in enumerate(book.slots):
                weights, miss = found[slot]
                hit.append(sum(weights.values()) >= 0.5)
                if track is None:
                    continue
                for i, b in weights.items():
                    claimed[i] += b
                track.log_score += math.log(gain[slot])
                odds = 0.99 * track.existence / (1 - 0.99 * track.existence) * gain[slot]
                track.existence = odds / (1 + odds)
                state = track.mean, covariance[slot], detections, weights, miss
                track.mean, covariance[slot] = pairs.mixture(*state)
            book.grade(hit, [track is not None for track in book.slots])
            empty = [slot for slot, track in enumerate(book.slots) if track is None]
            born = [
                np.array([*d[0], 0.0, 0.0])
                for i, d in enumerate(detections)
                if d is not None and i not in held and claimed[i] < 0.5
            ]
            book.admit([(mean, 0.0) for mean in born])
            for slot in empty:
                track = book.slots[slot]
                if track is not None:
                    track.mean, covariance[slot] = birth(np.array(track.mean))
        history.append(
            [
                None
                if track is None
                else (
                    track.identity,
                    np.array(track.mean),
                    np.array(covariance[slot]),
                    track.stage,
                    track.log_score,
                    track.existence,
                )
                for slot, track in enumerate(book.slots)
            ]
        )
    return history
