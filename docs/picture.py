"""Draw docs/picture.png: real radar detections in clutter, and the tracks found among them.

python docs/picture.py
"""

import pathlib

import jax

from jaxtrack.plots import scene
from jaxtrack.sensors import observe, radar_measurements
from jaxtrack.tracking import initiate_window

SEED = 2018
SIGMA_M = 100.0  # these targets bend: what a straight line misses counts as noise


def main() -> None:
    """Simulate clutter around the recorded dots, start tracks, save the figure."""
    recorded = radar_measurements(clutter_per_scan=10.0)
    scans = observe(jax.random.key(SEED), recorded.truth, recorded.radar, detections=32)
    tracks, info = initiate_window(scans, method="joint", sigma_m=SIGMA_M)
    figure = scene(
        scans,
        recorded.truth,
        tracks,
        smoothed_m=info.smoothed_m,
    )
    figure.savefig(pathlib.Path(__file__).with_name("picture.png"), dpi=110)


if __name__ == "__main__":
    main()
