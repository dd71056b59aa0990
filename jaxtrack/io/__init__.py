"""Host side: files and arrays to padded scans, tracks to files, estimators to files.

    range, bearing ─ position_from_polar ─┐
    arrays of positions ──────────────────┴─ scans_from_arrays ─┐
    a CSV file ── read_detections ──────────────────────────────┤
    a beam sonar's ranges ── beam_scans_from_arrays ────────────┤
    a CSV file ── read_beams ───────────────────────────────────┤
    a CSV file ── read_pings ───────────────────────────────────┴─► Recording
                                                                      │  │
    a CSV file ◄── write_tracks ◄── Tracks ◄── estimators ◄── scans ──┘  │
                         └───────────── epoch, origin, axes ─────────────┘

    an estimator ── export_estimator ──► bytes that JAX runs where this library is not installed

Everything else here is NumPy in float64. A `Recording` holds scans relative to an epoch and an
origin, so that they survive float32 on the device, and what `write_tracks` needs to put both back.
Wrong values end here, as a `DataError` that names file, row and column.
"""

from jaxtrack.io.arrays import scans_from_arrays
from jaxtrack.io.beam_arrays import beam_scans_from_arrays
from jaxtrack.io.beams_csv import read_beams
from jaxtrack.io.detections_csv import read_detections
from jaxtrack.io.errors import DataError
from jaxtrack.io.exported import export_estimator, named_arrays
from jaxtrack.io.pings_csv import read_pings
from jaxtrack.io.polar import covariance_from_polar, position_from_polar
from jaxtrack.io.recording import Recording
from jaxtrack.io.tracks_csv import write_tracks

__all__ = [
    "DataError",
    "Recording",
    "beam_scans_from_arrays",
    "covariance_from_polar",
    "export_estimator",
    "named_arrays",
    "position_from_polar",
    "read_beams",
    "read_detections",
    "read_pings",
    "scans_from_arrays",
    "write_tracks",
]
