"""PMHT in one pass, detection by detection."""

import numpy as np

from tests.oracles.association import density, gated


def weights(tracks, detections, p_detect, clutter, gate, echoes):
    """Return w [T][M] = c P_D λ N / (β + Σ P_D λ N)."""
    inside = gated(tracks, detections, gate)
    found = np.zeros((len(tracks), len(detections)))
    for i, detection in enumerate(detections):
        near = [j for j in range(len(tracks)) if (j, i) in inside]
        expected = {j: p_detect * echoes * density(tracks[j], detection) for j in near}
        for j in near:
            found[j, i] = detection[2] * expected[j] / (clutter + sum(expected.values()))
    return found
