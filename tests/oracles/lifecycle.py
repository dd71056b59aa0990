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
    unseen: int = 0
    existence: float = 0.5

    @property
    def stage(self):
        if not self.confirmed:
            return 1
        return 3 if self.misses else 2


class Book:
    """Slots for tracks; None where one is free."""

    def __init__(
        self, slots, last, confirm, delete, delete_tentative, score=float("-inf"), unseen=100
    ):
        self.slots = [None] * slots
        self.last, self.confirm = last, confirm
        self.delete, self.delete_tentative = delete, delete_tentative
        self.score, self.unseen, self.next_identity = score, unseen, 0

    def grade(self, hit, counted, valid=True):
        if not valid:
            return
        for slot, track in enumerate(self.slots):
            if track is None:
                continue
            track.unseen = 0 if hit[slot] and counted[slot] else track.unseen + 1
            if counted[slot]:
                track.history = ([*track.history, bool(hit[slot])])[-self.last :]
                track.misses = 0 if hit[slot] else track.misses + 1
                enough = sum(track.history) >= self.confirm and track.log_score >= self.score
                track.confirmed |= bool(hit[slot]) and enough
            if track.confirmed:
                gone = track.misses >= self.delete or track.unseen >= self.unseen
            else:
                gone = track.unseen >= self.delete_tentative
            if gone:
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
