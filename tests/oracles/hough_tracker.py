"""The tracker on window estimates, track by track, with lists of what each track was before."""

import math

import numpy as np
from scipy.optimize import linear_sum_assignment

from tests.oracles.lifecycle import Book
from tests.oracles.tracker import motion


def lines(looks, sigma):
    """Return for each slot a least-squares line through its detections in the looks, or None.

    Args:
        looks: (time, [(x, y) or None, ...]) oldest first; states are those at the last one.
        sigma: noise of each coordinate.

    Returns:
        A list of (mean [4], covariance [4, 4], number of detections).
    """
    end, found = looks[-1][0], []
    for slot in range(len(looks[-1][1])):
        seen = [(time - end, places[slot]) for time, places in looks if places[slot] is not None]
        if len(seen) < 3:
            found.append(None)
            continue
        design = np.array([[1.0, dt] for dt, _ in seen])
        spread = sigma**2 * np.linalg.inv(design.T @ design)
        solution = np.linalg.lstsq(design, np.array([z for _, z in seen]), rcond=None)[0]
        covariance = np.zeros((4, 4))
        for axis in (0, 1):
            for a in (0, 1):
                for b in (0, 1):
                    covariance[axis + 2 * a, axis + 2 * b] = spread[a, b]
        found.append((solution.ravel(), covariance, len(seen)))
    return found


def run(scans, *, window, slots, last, lives, gate, sigma, sigma_a, score):
    """Return after each look a list of slots: None, or (identity, mean, covariance, stage).

    Args:
        scans: looks (time, valid, [(x, y) or None, ...]).
        window: looks.
        slots: of the table.
        last: looks of the M-of-N rule.
        lives: M, misses that delete a confirmed track, and a tentative one.
        gate: squared distance.
        sigma: noise of a detection.
        sigma_a: acceleration.
        score: that confirms a track: the number of detections in its window.
    """
    book, past, history = (
        Book(slots, last, *lives, score),
        {},
        [],
    )  # past: identity → [(time, m, P), ...]
    looks = []
    for time, valid, places in scans:
        if valid:
            looks = [*looks, (time, places)][-window:]
            estimates = lines(looks, sigma)
            predicted = [None] * slots
            for slot, track in enumerate(book.slots):
                if track is not None:
                    before, mean, covariance = past[track.identity][-1]
                    f, q = motion(time - before, sigma_a)
                    predicted[slot] = f @ mean, f @ covariance @ f.T + q
            cost, near = np.zeros((slots, len(estimates))), set()
            for slot, track in enumerate(book.slots):
                for i, estimate in enumerate(estimates):
                    if track is None or estimate is None:
                        continue
                    mean, covariance = predicted[slot]
                    apart = estimate[0] - mean
                    square = apart @ np.linalg.inv(covariance + estimate[1]) @ apart
                    if square < gate:
                        near.add(i)
                        quality = (1 + sum(track.history)) / (1 + last)
                        cost[slot, i] = min(square - 2 * math.log(quality) - gate, 0.0)
            own = {
                slot: i
                for slot, i in zip(*linear_sum_assignment(cost), strict=True)
                if cost[slot, i] < 0
            }
            for slot, track in enumerate(book.slots):
                if track is None:
                    continue
                mean, covariance = predicted[slot]
                if slot in own:
                    mean, covariance, track.log_score = estimates[own[slot]]
                    known = past[track.identity]
                    if len(known) >= window:
                        before, old, spread = known[-window]
                        f, q = motion(time - before, sigma_a)
                        old, spread = f @ old, f @ spread @ f.T + q
                        weight = np.linalg.inv(spread) + np.linalg.inv(covariance)
                        joined = np.linalg.inv(spread) @ old + np.linalg.inv(covariance) @ mean
                        covariance = np.linalg.inv(weight)
                        mean = covariance @ joined
                past[track.identity].append((time, mean, covariance))
            hit = [slot in own for slot in range(slots)]
            book.grade(hit, [track is not None for track in book.slots])
            free = [slot for slot, track in enumerate(book.slots) if track is None]
            new = [e for i, e in enumerate(estimates) if e is not None and i not in near]
            book.admit([(e[0], float(e[2])) for e in new])
            for slot in free:
                track = book.slots[slot]
                if track is not None:
                    mine = next(e for e in new if np.array_equal(e[0], track.mean))
                    past[track.identity] = [(time, mine[0], mine[1])]
        history.append(
            [
                None
                if track is None
                else (track.identity, *past[track.identity][-1][1:], track.stage)
                for track in book.slots
            ]
        )
    return history
