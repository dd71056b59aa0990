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

    def __init__(self, slots, last, confirm, delete, delete_tentative):
        self.slots = [None] * slots
        self.last, self.confirm = last, confirm
        self.delete, self.delete_tentative = delete, delete_tentative
        self.next_identity = 0

    def grade(self, hit, counted, sure=None):
        for slot, track in enumerate(self.slots):
            if track is None or not counted[slot]:
                continue
            track.history = ([*track.history, bool(hit[slot])])[-self.last :]
            if hit[slot]:
                track.misses = 0
                if sum(track.history) >= self.confirm and (sure is None or sure[slot]):
                    track.confirmed = True
            else:
                track.misses += 1
            limit = self.delete if track.confirmed else self.delete_tentative
            if track.misses >= limit:
                self.slots[slot] = None

    def admit(self, candidates):
        """Take (mean, score) or (mean, score, sure), the highest scores first; was it too many?"""
        crowded = False
        for mean, score, *sure in sorted(candidates, key=lambda c: -c[1]):
            free = [slot for slot, track in enumerate(self.slots) if track is None]
            if not free:
                crowded = True
                continue
            at_once = self.confirm <= 1 and all(sure)
            self.slots[free[0]] = Track(self.next_identity, list(mean), score, at_once)
            self.next_identity += 1
        return crowded
