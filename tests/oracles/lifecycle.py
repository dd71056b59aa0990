"""The life of tracks, track by track, as objects in a list of slots."""

import dataclasses


@dataclasses.dataclass
class Track:
    identity: int
    mean: list
    log_score: float
    confirmed: bool = False
    history: list = dataclasses.field(default_factory=lambda: [True])
    misses: int = 0

    @property
    def stage(self):
        if not self.confirmed:
            return 1
        return 3 if self.misses else 2


class Book:
    """Slots for tracks; None where one is free."""

    def __init__(self, slots, last, confirm, delete, delete_tentative, score=float("-inf")):
        self.slots = [None] * slots
        self.last, self.confirm = last, confirm
        self.delete, self.delete_tentative = delete, delete_tentative
        self.score, self.next_identity = score, 0

    def grade(self, hit, counted):
        for slot, track in enumerate(self.slots):
            if track is None or not counted[slot]:
                continue
            track.history = ([*track.history, bool(hit[slot])])[-self.last :]
            if hit[slot]:
                track.misses = 0
                if sum(track.history) >= self.confirm and track.log_score >= self.score:
                    track.confirmed = True
            else:
                track.misses += 1
            limit = self.delete if track.confirmed else self.delete_tentative
            if track.misses >= limit:
                self.slots[slot] = None

    def admit(self, candidates):
        """Take (mean, score) pairs, the highest scores first; return whether some found no slot."""
        crowded = False
        for mean, score in sorted(candidates, key=lambda c: -c[1]):
            free = [slot for slot, track in enumerate(self.slots) if track is None]
            if not free:
                crowded = True
                continue
            at_once = self.confirm <= 1 and score >= self.score
            self.slots[free[0]] = Track(self.next_identity, list(mean), score, at_once)
            self.next_identity += 1
        return crowded
