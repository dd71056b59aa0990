"""Data association: which detections of a look are which track's.

    predict_measurement ──► associate ──► update
       mean, covariance      Association    mean, covariance

Every `associate(predicted, scan, params, key)` is one look of one realization, with tables of
fixed size. One detection a track at most: `nearest`, `pda`, `jpda` (exact, at most 10 tracks),
`belief_propagation` (any number), updated by `update_mixture`, or, if it is a choice of one,
`update_single`. Several echoes a track: `cloud` (the cloud model) and `pmht`, updated by
`update_centroid`. `ASSOCIATORS` has them by name. `sinkhorn`, for gradients, is a smooth optimal
assignment; it is no posterior.
"""

from jaxtrack.association import belief_propagation, cloud, jpda, nearest, pda, pmht, sinkhorn
from jaxtrack.association.associators import ASSOCIATORS, Associator, Update
from jaxtrack.association.gating import (
    Associate,
    Association,
    AssociationParams,
    Gated,
    OwnView,
    Predicted,
    gate,
    gated_once,
    predict_measurement,
)
from jaxtrack.association.moments import update_centroid, update_mixture, update_single
from jaxtrack.association.precedence import in_turn
from jaxtrack.association.ratios import likelihood_ratios

__all__ = [
    "ASSOCIATORS",
    "Associate",
    "Association",
    "AssociationParams",
    "Associator",
    "Gated",
    "OwnView",
    "Predicted",
    "Update",
    "belief_propagation",
    "cloud",
    "gate",
    "gated_once",
    "in_turn",
    "jpda",
    "likelihood_ratios",
    "nearest",
    "pda",
    "pmht",
    "predict_measurement",
    "sinkhorn",
    "update_centroid",
    "update_mixture",
    "update_single",
]
