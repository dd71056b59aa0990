"""Stone Soup set up with this library's numbers: its filter, gate and associators, its own loop.

Positions are the first two entries of [x, y, vx, vy], times are seconds, gates are squared
Mahalanobis distances γ.
"""

import datetime

import numpy as np
from stonesoup.dataassociator.neighbour import GNNWith2DAssignment, NearestNeighbour
from stonesoup.dataassociator.probability import JPDA, PDA, JPDAwithEHM2
from stonesoup.functions import gm_reduce_single
from stonesoup.hypothesiser.distance import DistanceHypothesiser
from stonesoup.hypothesiser.probability import PDAHypothesiser
from stonesoup.measures import SquaredMahalanobis
from stonesoup.models.base import TimeVariantModel
from stonesoup.models.measurement.linear import LinearGaussian
from stonesoup.models.transition.linear import LinearGaussianTransitionModel
from stonesoup.predictor.kalman import KalmanPredictor
from stonesoup.types.array import StateVectors
from stonesoup.types.detection import Detection
from stonesoup.types.state import GaussianState
from stonesoup.types.track import Track
from stonesoup.types.update import GaussianStateUpdate
from stonesoup.updater.kalman import KalmanUpdater

NEIGHBOURS = {"nn": NearestNeighbour, "gnn": GNNWith2DAssignment}
MIXTURES = {"pda": PDA, "jpda": JPDA, "jpda_ehm2": JPDAwithEHM2}
EPOCH = datetime.datetime(2000, 1, 1)


class WhiteNoiseAcceleration(LinearGaussianTransitionModel, TimeVariantModel):
    """Constant velocity; the acceleration of each coordinate is drawn once a step."""

    sigma_a: float = 0.0

    @property
    def ndim_state(self):
        return 4

    def matrix(self, time_interval, **kwargs):
        f = np.eye(4)
        f[0, 2] = f[1, 3] = time_interval.total_seconds()
        return f

    def covar(self, time_interval, **kwargs):
        dt = time_interval.total_seconds()
        gain = np.array([[dt**2 / 2, 0.0], [0.0, dt**2 / 2], [dt, 0.0], [0.0, dt]])
        return self.sigma_a**2 * gain @ gain.T


class Setup:
    """The parts of a tracker by one name of `NEIGHBOURS` or `MIXTURES`."""

    def __init__(self, name, *, sigma, sigma_a, p_detect, clutter, gate):
        self.mixture = name in MIXTURES
        self.measurement = LinearGaussian(4, (0, 1), sigma**2 * np.eye(2))
        motion = WhiteNoiseAcceleration()
        motion.sigma_a = sigma_a
        self.predictor, self.updater = KalmanPredictor(motion), KalmanUpdater(self.measurement)
        if self.mixture:
            gated = 1 - np.exp(-gate / 2)
            hypothesiser = PDAHypothesiser(self.predictor, self.updater, clutter, p_detect, gated)
            self.associator = MIXTURES[name](hypothesiser)
        else:
            measure = SquaredMahalanobis()
            hypothesiser = DistanceHypothesiser(self.predictor, self.updater, measure, gate)
            self.associator = NEIGHBOURS[name](hypothesiser)

    def detections(self, places, time_s):
        """Return detections at places [(x, y), ...]."""
        now = instant(time_s)
        return {
            Detection(np.array(z)[:, None], timestamp=now, measurement_model=self.measurement)
            for z in places
        }

    def look(self, tracks, detections, time_s):
        """Predict tracks, associate them with a look and append what they are then."""
        found = self.associator.associate(tracks, detections, instant(time_s))
        for track, hypothesis in found.items():
            if self.mixture:
                track.append(self._mixed(hypothesis))
            elif hypothesis:
                track.append(self.updater.update(hypothesis))
            else:
                track.append(hypothesis.prediction)

    def _mixed(self, hypotheses):
        states = [self.updater.update(one) if one else one.prediction for one in hypotheses]
        mean, covariance = gm_reduce_single(
            StateVectors([state.state_vector for state in states]),
            np.stack([state.covar for state in states], axis=2),
            np.asarray([one.probability for one in hypotheses]),
        )
        return GaussianStateUpdate(mean, covariance, hypotheses, states[0].timestamp)


def instant(time_s):
    return EPOCH + datetime.timedelta(seconds=float(time_s))


def track(mean, covariance, time_s):
    """Return a track of one state."""
    return Track([GaussianState(np.array(mean)[:, None], np.array(covariance), instant(time_s))])
