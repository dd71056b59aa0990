"""What the commands on files read and where they write: found wrong before anything is computed."""

import math
import pathlib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from jaxtrack.io import Recording


def wrong_outputs(file: pathlib.Path, out: pathlib.Path, figure: pathlib.Path | None) -> str:
    """Return what is wrong with the files to write, before anything is computed; "" if nothing."""
    if figure is not None:
        # So does a missing matplotlib.
        from jaxtrack import plots  # noqa: F401

        kinds = (".png", ".pdf", ".svg")
        if figure.suffix.lower() not in kinds:
            return f"--figure: got {figure}, want a name that ends in {', '.join(kinds)}"
    for path in (out, figure):
        if path is not None and not path.parent.is_dir():
            return f"{path}: there is no folder {path.parent}"
        if path is not None and path.is_dir():
            return f"{path}: got a folder, want the name of a file"
    if out.resolve() == file.resolve():
        return f"--out: got {out}, which is the file of detections itself"
    if figure is not None and figure.resolve() in (out.resolve(), file.resolve()):
        return f"--figure: got {figure}, which is another of the files"
    return ""


def read_looks(
    file: pathlib.Path,
    bearing: str,
    beams: int | None,
    sector_deg: float,
    range_max_m: float,
    sigma_m: float,
    p_detect: float,
) -> tuple[Any, Any]:
    """Return a recording and, of beams, the sonar: false alarms are what most beams report."""
    import numpy as np

    from jaxtrack.io import read_beams, read_detections
    from jaxtrack.models import BeamSonar

    if beams is None:
        return read_detections(file, bearing=bearing), None
    if not 0 < sector_deg <= 360:
        raise ValueError(f"--sector-deg: got {sector_deg:g}, want an angle from 0 to 360")
    if not 0 < p_detect < 1:
        raise ValueError(f"--p-detect: got {p_detect:g}, want a probability between 0 and 1")
    recording = read_beams(file, beams=beams)
    shown = np.asarray(recording.scans.mask)[np.asarray(recording.scans.valid)]
    range_m = np.asarray(recording.scans.range_m)[np.asarray(recording.scans.mask)]
    if (range_m > range_max_m).any():
        raise ValueError(
            f"--range-max-m: got {range_max_m:g}, want the sonar's scope; {file} has "
            f"{(range_m > range_max_m).sum()} of {range_m.size} ranges beyond it, up to "
            f"{range_m.max():g} m"
        )
    p_false = float(np.clip(shown.mean() if shown.size else 0.0, 1e-4, 0.95))
    return recording, BeamSonar(
        1 - p_detect, p_false, sigma_m, range_max_m, math.radians(sector_deg)
    )


def as_positions(recording: "Recording", sonar: Any) -> "Recording":
    """Return a recording of beams as one of positions."""
    if sonar is None:
        return recording
    import jax

    from jaxtrack.sensors import scan_of_beams

    return recording._replace(scans=jax.vmap(scan_of_beams, (0, None))(recording.scans, sonar))
