"""How long one run of each method takes, against the clutter and on the real data."""

import concurrent.futures
import functools
import math
import time
from collections.abc import Callable

import jax
import numpy as np
import xarray as xr

from jaxtrack.sensors import clutter_per_scan
from jaxtrack.studies.nht_trial import SHAPES, SHOWN, Inputs, Shape, detect, simulate
from jaxtrack.types import Array, Key, Lines, Scan

TIMED = ("HT", "NHT", "MHT", "IHT", "joint")
PAPER_S = {"HT": 4.0209, "NHT": 0.1330, "MHT": 0.0637, "IHT": 0.0518}
"""The paper's times on the real data: MATLAB 2014b, two cores at 2.93 GHz."""

_REPEATS = 3


def shape_for(clutter: float) -> Shape:
    """Return static sizes for an expected clutter a look: arrays that grow as the method's work.

    Example:
        >>> shape_for(56.0).detections
        96
    """
    largest = lambda clutter: clutter + 3 + 4 * math.sqrt(clutter + 1)
    base = SHAPES["56"]
    share = (largest(clutter) / largest(56.0)) ** 2
    up = lambda size: 64 * math.ceil(size * share / 64)
    return Shape(
        detections=8 * math.ceil((largest(clutter) + 3) / 8),
        pairs=up(base.pairs),
        gated_pairs=up(base.gated_pairs),
        predecessors=8 * math.ceil(base.predecessors * math.sqrt(share) / 8),
        hypotheses=up(base.hypotheses),
    )


def measure(
    key: Key,
    densities: tuple[float, ...],
    simulated: Callable[[float], Inputs],
    real: Inputs,
    progress: Callable[[int, int], None],
) -> xr.Dataset:
    """Return seconds a run, on one device, compilation apart; the median of three.

    Args:
        key: random key.
        densities: clutter a square kilometre.
        simulated: clutter a look → inputs of a simulated scene.
        real: inputs of the real data.
        progress: (done, total).
    """
    clutter = [float(clutter_per_scan(density, simulated(0.0).radar)) for density in densities]
    settings = [(shape_for(c), simulated(c)) for c in clutter] + [(SHAPES["real"], real)]
    jobs = []
    for shape, inputs in settings:
        scans = simulate(key, inputs, detections=shape.detections)
        jobs += [(method, shape, scans, inputs) for method in TIMED]
    # Two programs are compiled at a time; they run one after another.
    with concurrent.futures.ThreadPoolExecutor(2) as pool:
        programs = list(pool.map(lambda job: _runs.lower(*job).compile(), jobs))
    seconds, overflow = [], []
    for done, (program, (_, _, *arguments)) in enumerate(zip(programs, jobs, strict=True)):
        lap = []
        for _ in range(_REPEATS):
            start = time.perf_counter()
            _, full = jax.block_until_ready(program(*arguments))
            lap.append((time.perf_counter() - start) / SHOWN)
        seconds.append(np.median(lap))
        overflow.append(np.mean(full))
        progress(done + 1, len(programs))
    table = np.reshape(seconds, (len(settings), len(TIMED)))
    full = np.reshape(overflow, table.shape)
    return xr.Dataset(
        {
            "seconds": (("clutter", "estimator"), table[:-1], {"units": "s"}),
            "overflow": (("clutter", "estimator"), full[:-1]),
            "real_seconds": ("estimator", table[-1], {"units": "s"}),
            "paper_seconds": ("estimator", [PAPER_S.get(name, np.nan) for name in TIMED]),
        },
        coords={
            "clutter": ("clutter", clutter, {"long_name": "false detections a look"}),
            "density_per_km2": ("clutter", list(densities)),
            "estimator": list(TIMED),
        },
    )


@functools.partial(jax.jit, static_argnums=(0, 1))
def _runs(method: str, shape: Shape, scans: Scan, inputs: Inputs) -> tuple[Lines, Array]:
    def one(scans: Scan) -> tuple[Lines, Array]:
        lines, info = detect(method, inputs, shape, "raw")(scans)
        return lines, info.overflow

    return jax.lax.map(one, scans)
