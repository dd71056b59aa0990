"""How long one run of each method takes, against the clutter and on the real data."""

import concurrent.futures
import functools
import math
import time
from collections.abc import Callable, Sequence
from typing import NamedTuple

import jax
import numpy as np
import xarray as xr

from jaxtrack.sensors import observe
from jaxtrack.studies.nht.trial import SHAPES, Inputs, Shape, detect
from jaxtrack.types import Array, Key, Lines, Scan

TIMED = ("HT", "NHT", "MHT", "IHT", "joint")
PAPER_S = {"HT": 4.0209, "NHT": 0.1330, "MHT": 0.0637, "IHT": 0.0518}
"""The paper's times on the real data: MATLAB 2014b, two cores at 2.93 GHz."""

RUNS = 8  # one after another in one compiled program
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


class Setting(NamedTuple):
    """Scans to time the methods on, and what the methods are run with."""

    clutter: float  # a look
    shape: Shape
    inputs: Inputs
    scans: Scan  # [runs, T]


def simulated(key: Key, clutter: float, inputs: Inputs) -> Setting:
    """Return a setting of new scans, in arrays made for this clutter."""
    shape = shape_for(clutter)
    keys = jax.random.split(key, RUNS)
    look = lambda key: observe(key, inputs.truth, inputs.radar, detections=shape.detections)
    return Setting(clutter, shape, inputs, jax.jit(jax.vmap(look))(keys))


def measure(
    settings: Sequence[Setting], real: Setting, progress: Callable[[int, int], None]
) -> xr.Dataset:
    """Return seconds a run, on one device, compilation apart; the median of three.

    Args:
        settings: of simulated scenes.
        real: of the real data.
        progress: (done, total).
    """
    jobs: list[tuple[str, Shape, Inputs, Scan]] = []
    for setting in (*settings, real):
        for method in TIMED:
            # The joint vote has no cells: its programs differ by the other sizes only.
            shape = setting.shape._replace(rho=1) if method == "joint" else setting.shape
            jobs.append((method, shape, setting.inputs, setting.scans))
    # Two programs are compiled at a time; they run one after another.
    distinct = {job[:2]: job for job in jobs}
    with concurrent.futures.ThreadPoolExecutor(2) as pool:
        compiled = pool.map(lambda job: _runs.lower(*job).compile(), distinct.values())
        programs = dict(zip(distinct, compiled, strict=True))
    seconds, overflow = [], []
    for done, (name, shape, inputs, scans) in enumerate(jobs):
        lap = []
        for _ in range(_REPEATS):
            start = time.perf_counter()
            _, full = jax.block_until_ready(programs[name, shape](inputs, scans))
            lap.append((time.perf_counter() - start) / len(scans.mask))
        seconds.append(np.median(lap))
        overflow.append(np.mean(full))
        progress(done + 1, len(jobs))
    table = np.reshape(seconds, (len(settings) + 1, len(TIMED)))
    full = np.reshape(overflow, table.shape)
    return xr.Dataset(
        {
            "seconds": (("clutter", "estimator"), table[:-1], {"units": "s"}),
            "overflow": (("clutter", "estimator"), full[:-1]),
            "real_seconds": ("estimator", table[-1], {"units": "s"}),
            "paper_seconds": ("estimator", [PAPER_S.get(name, np.nan) for name in TIMED]),
        },
        coords={
            "clutter": (
                "clutter",
                [setting.clutter for setting in settings],
                {"long_name": "false detections a look"},
            ),
            "estimator": list(TIMED),
        },
        attrs={"runs": _REPEATS * min(len(setting.scans.mask) for setting in (*settings, real))},
    )


@functools.partial(jax.jit, static_argnums=(0, 1))
def _runs(method: str, shape: Shape, inputs: Inputs, scans: Scan) -> tuple[Lines, Array]:
    def one(scans: Scan) -> tuple[Lines, Array]:
        lines, info = detect(method, inputs, shape, "raw")(scans)
        return lines, info.overflow

    return jax.lax.map(one, scans)
