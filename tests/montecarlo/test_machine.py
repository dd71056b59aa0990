"""Promises about the machine, each in a fresh process: number of devices, bounded memory."""

import os
import subprocess
import sys

import jax
import pytest

BITS = """
import hashlib
import jax, jax.numpy as jnp, numpy as np
from jaxtrack.montecarlo import monte_carlo

def trial(key, params):
    a, b = jax.random.split(key)
    dtype = params.dtype
    noise = jax.random.normal(a, (24, 6), dtype) * params
    gram = noise.T @ noise + 0.1 * jnp.eye(6, dtype=dtype)
    root = jnp.linalg.cholesky(gram)
    angles = jax.random.uniform(b, (33,), dtype, -3.0, 3.0)
    waves = jnp.exp(jnp.sin(angles)) / (1.1 + jnp.cos(angles)) + jnp.log1p(angles**2)

    def halve(state):
        return state[0] * 0.7 + 0.01, state[1] + 1

    steps = jax.lax.while_loop(lambda s: s[0] > 0.1, halve, (jnp.abs(waves[0]), 0))
    cells = jnp.clip((angles * 2 + 6).astype(jnp.int32), 0, 11)
    votes = jnp.zeros(12, dtype).at[cells].add(waves)
    return {
        "root": root, "solved": jax.scipy.linalg.cho_solve((root, True), noise[0]),
        "sorted": jnp.sort(waves), "sum": jnp.sum(waves), "softmax": jax.nn.softmax(waves),
        "steps": steps, "votes": votes, "peak": jnp.argmax(votes),
    }

def digest(values):
    hashed = hashlib.sha256()
    for leaf in jax.tree.leaves(values):
        hashed.update(np.ascontiguousarray(leaf).tobytes())
    return hashed.hexdigest()

key = jax.random.key(3)
print(jax.local_device_count())
for dtype, size in ((np.float64, 32), (np.float32, 4)):
    params = jnp.asarray(0.8, dtype)
    run = monte_carlo(trial, key, 137, params, micro_batch=size)
    assert run.values["root"].dtype == dtype and run.values["root"].shape == (137, 6, 6)
    head = monte_carlo(trial, key, 60, params, micro_batch=size).values
    tail = monte_carlo(trial, key, 77, params, first_trial=60, micro_batch=size).values
    parts = jax.tree.map(lambda a, b: np.concatenate([a, b]), head, tail)
    print(digest(run.values), digest(parts), digest((run.mean, run.standard_error)))
batch = monte_carlo(trial, key, 37, jnp.array([0.8, 1.2]), batch_params=True, micro_batch=8)
print(digest(batch))
"""

MEMORY = """
import pathlib
import jax, jax.numpy as jnp
from jaxtrack.montecarlo import monte_carlo

def trial(key, params):
    path = jnp.cumsum(jax.random.normal(key) + jnp.linspace(0.0, params, 8192))
    return path[::1024]

monte_carlo(trial, jax.random.key(0), 1, 1.0)
run = monte_carlo(trial, jax.random.key(0), 100_000, 1.0)
assert run.values.shape == (100_000, 8)
# Not ru_maxrss, which starts at what the process that called exec held: pytest's gigabytes.
status = pathlib.Path("/proc/self/status").read_text().splitlines()
print(next(row.split()[1] for row in status if row.startswith("VmHWM")))
"""


def run_fresh(code, devices, **more):
    environment = os.environ | {
        "JAX_NUM_CPU_DEVICES": str(devices),
        "JAX_PLATFORMS": "cpu",
        "JAX_ENABLE_X64": "1",
        "JAX_NUMPY_DTYPE_PROMOTION": "strict",
        "JAX_COMPILATION_CACHE_DIR": str(jax.config.jax_compilation_cache_dir),
        "JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS": "0",
    }
    environment |= more
    done = subprocess.run(
        [sys.executable, "-W", "error", "-c", code],
        env=environment,
        capture_output=True,
        text=True,
        timeout=300,
    )
    assert done.returncode == 0, done.stderr
    return done.stdout.split()


def test_bits_do_not_depend_on_devices_nor_on_resume_points():
    """137 trials are no multiple of a micro-batch, of 2 or of 4 devices; 5 or 35 micro-batches."""
    prints = {devices: run_fresh(BITS, devices) for devices in (1, 2, 4)}
    for devices, (count, *digests) in prints.items():
        assert count == str(devices)
        assert digests == prints[1][1:]
        for whole, parts in (digests[0:2], digests[3:5]):
            assert whole == parts


LINEAR_ALGEBRA = """
import jax, jax.numpy as jnp
from jaxtrack.montecarlo import monte_carlo

def trial(key, params):
    def one(key):
        points = jax.random.normal(key, (32, 32))
        return jnp.sum(jnp.linalg.cholesky(points @ points.T + params * jnp.eye(32)))

    return sum(one(part) for part in jax.random.split(key, 6))

print(monte_carlo(trial, jax.random.key(0), 2000, 64.0).values.shape)
"""


def test_the_advised_number_of_threads_prevents_stalls():
    """Without it this program comes to a standstill on a machine of few cores."""
    assert run_fresh(LINEAR_ALGEBRA, 2, NPROC="13") == ["(2000,)"]


@pytest.mark.slow
@pytest.mark.skipif(sys.platform != "linux", reason="the peak is read from /proc")
def test_memory_of_100_000_trials_is_bounded():
    """All trials at once would need 6.5 GB: each holds a path of 64 kB."""
    (peak_kilobytes,) = run_fresh(MEMORY, 2)
    assert int(peak_kilobytes) < 700_000
