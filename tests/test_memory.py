"""Memory of a hundred thousand realizations in one call: a process of its own.

Run as a script with a number of realizations, this file is that process.
"""

import json
import os
import pathlib
import resource
import subprocess
import sys
import time

import jax
import jax.numpy as jnp
import pytest

from jaxtrack.hough import Grid, Sizes, improved
from jaxtrack.metrics import initiation_scores
from jaxtrack.montecarlo import monte_carlo
from jaxtrack.sensors import crossing_targets, observe

GIB = 2**30
SCENE = crossing_targets("IV", clutter_per_scan=10.0)
SIZES = Sizes(lines=5, pairs=192, candidates=64, rho=64, theta=100)
PARAMS = improved.ImprovedParams(Grid((1750.0, 800.0), 2000.0))


def trial(key, params):
    scans = observe(key, SCENE.truth, SCENE.radar, detections=24)
    lines, info = improved.estimate(scans, params, sizes=SIZES)
    position = jnp.moveaxis(SCENE.truth.state[..., :2], 0, 1)
    there = SCENE.truth.mask.all(0)
    return initiation_scores(lines, position, there, match_m=50.0, gate=4.0), info.overflow


def peak_bytes():
    """Return the largest resident set of this process so far."""
    status = pathlib.Path("/proc/self/status")
    if status.exists():
        # On Linux ru_maxrss starts at what the process that called exec held: pytest's gigabyte.
        lines = status.read_text().splitlines()
        return 1024 * next(int(row.split()[1]) for row in lines if row.startswith("VmHWM"))
    unit = 1 if sys.platform == "darwin" else 1024
    return unit * resource.getrusage(resource.RUSAGE_SELF).ru_maxrss


def report(trials):
    begin = time.monotonic()
    scores, overflow = monte_carlo(trial, jax.random.key(0), trials, PARAMS).values
    return {
        "peak_gib": peak_bytes() / GIB,
        "seconds": time.monotonic() - begin,
        "trials": len(scores.found),
        "found": float(scores.found.mean()),
        "overflow": float(overflow.mean()),
    }


def run(trials):
    root = pathlib.Path(__file__).resolve().parent.parent
    options = {
        "JAX_NUM_CPU_DEVICES": "2",
        "JAX_COMPILATION_CACHE_DIR": str(root / ".jax_cache"),
        "JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS": "0",
        "JAX_PLATFORMS": "cpu",
    }
    process = subprocess.run(
        [sys.executable, "-W", "error", __file__, str(trials)],
        cwd=root,
        env=os.environ | options,
        capture_output=True,
        text=True,
        check=False,
    )
    assert process.returncode == 0, process.stderr
    seen = json.loads(process.stdout)
    assert seen["trials"] == trials
    assert seen["overflow"] < 0.01
    assert seen["found"] > 0.5  # of three targets: the trials did their work
    return seen


@pytest.mark.slow
def test_two_thousand_realizations_stay_below_a_gibibyte():
    assert run(2_000)["peak_gib"] < 1.0


@pytest.mark.slow
def test_a_hundred_thousand_realizations_stay_below_two_gibibytes():
    # Their tables of pairs, all at once, would be five.
    assert run(100_000)["peak_gib"] < 2.0


if __name__ == "__main__":
    sys.stdout.write(json.dumps(report(int(sys.argv[1]))))
