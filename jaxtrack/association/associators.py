"""An associator with the update that goes with it, and all of them by name."""

import functools
from typing import NamedTuple, Protocol

from jaxtrack.association import belief_propagation, cloud, jpda, nearest, pda, pmht
from jaxtrack.association.gating import Associate, Association, Predicted
from jaxtrack.association.moments import update_centroid, update_mixture, update_single
from jaxtrack.types import Array, Scan


class Update(Protocol):
    """A Kalman update from an association."""

    def __call__(
        self,
        mean: Array,
        covariance: Array,
        predicted: Predicted,
        scan: Scan,
        association: Association,
    ) -> tuple[Array, Array]:
        """Return means [T, S] and covariances [T, S, S]."""
        ...


class Associator(NamedTuple):
    """What a tracker asks of data association. Static: functions only."""

    associate: Associate
    update: Update
    several: bool = False  # a track may take several detections of a look


_single = functools.partial(update_centroid, noise="single")
_nearest_centre = functools.partial(cloud.sampled, pairing="nearest")

ASSOCIATORS: dict[str, Associator] = {
    "nearest": Associator(nearest.independent, update_single),
    "greedy": Associator(nearest.greedy, update_single),
    "optimal": Associator(nearest.optimal, update_single),
    "pda": Associator(pda.associate, update_mixture),
    "jpda": Associator(jpda.associate, update_mixture),
    "belief_propagation": Associator(belief_propagation.associate, update_mixture),
    "cloud": Associator(cloud.sampled, _single, several=True),
    "cloud_nearest": Associator(_nearest_centre, _single, several=True),
    "cloud_averaged": Associator(cloud.averaged, _single, several=True),
    "cloud_soft": Associator(cloud.soft, _single, several=True),
    "pmht": Associator(pmht.associate, update_centroid, several=True),
}
"""All associators with their updates; the clouds with the paper's noise of a single echo."""
