"""Warnings about the machine: cores that idle, and LAPACK calls that can stall it."""

import math
import os
import warnings
from collections.abc import Iterator, Sequence
from typing import Any

import jax

_MANY_TRIALS = 10_000  # from here on, idle cores are worth a warning

# Primitives that become LAPACK or BLAS calls which jaxlib splits over XLA's own threads, and how
# much work (elements × order of the matrix) it still does in one piece; seen with jaxlib 0.10.2.
_SPLIT_CALLS = ("cholesky", "eigh", "triangular_solve", "tridiagonal_solve")
_WORK_IN_ONE_PIECE = 150_000


def warn_of_idle_cores(trials: int) -> None:
    """Warn, in the name of the caller's caller, when a long run leaves cores without work."""
    devices = jax.local_devices()
    if trials < _MANY_TRIALS or len(devices) > 1 or devices[0].platform != "cpu":
        return
    cores = available_cores()
    if cores > 1:
        warnings.warn(
            f"monte_carlo runs on one CPU device although there are {cores} cores: call "
            f'jax.config.update("jax_num_cpu_devices", {cores}) before anything else uses JAX',
            stacklevel=3,
        )


def warn_of_stalls(jaxpr: Any, devices: Sequence[Any]) -> None:
    """Warn when linear algebra in `jaxpr`, one micro-batch, may bring XLA to a standstill.

    A split call keeps one of XLA's threads waiting for parts that other threads are to compute.
    When every thread waits, none computes, and the process sleeps for ever without an error. That
    takes as many simultaneous calls as there are threads: soon reached where every core is a
    device, and with a single device on a machine of few cores. More threads than calls prevent it.
    XLA starts as many as there are cores or devices, or as the environment's NPROC says.
    """
    if devices[0].platform != "cpu":
        return
    calls = sum(_work(eqn) > _WORK_IN_ONE_PIECE for eqn in _split_calls(jaxpr))
    configured = os.environ.get("NPROC", "")
    threads = int(configured) if configured.isdigit() else available_cores()
    if calls and len(devices) * calls >= threads:
        warnings.warn(
            "fn has linear algebra that jaxlib splits over XLA's threads; on the CPU such calls "
            f"can wait for each other for ever (calls: {calls}, devices: {len(devices)}, threads: "
            f"{threads}): start Python with NPROC={1 + len(devices) * calls} in the environment, "
            "or take a smaller micro_batch",
            RuntimeWarning,
            stacklevel=2,
        )


def _split_calls(jaxpr: Any) -> Iterator[Any]:
    """Walk through all equations of a jaxpr and of those inside it."""
    for eqn in jaxpr.eqns:
        if eqn.primitive.name in _SPLIT_CALLS:
            yield eqn
        for value in jax.tree.leaves(list(eqn.params.values()), is_leaf=_holds_jaxpr):
            if _holds_jaxpr(value):
                yield from _split_calls(getattr(value, "jaxpr", value))


def _holds_jaxpr(value: Any) -> bool:
    return hasattr(getattr(value, "jaxpr", value), "eqns")


def _work(eqn: Any) -> int:
    shapes = [operand.aval.shape for operand in eqn.invars]
    return max(math.prod(shape) for shape in shapes) * shapes[0][-1]


def available_cores() -> int:
    """Return how many cores this process may use."""
    affinity = getattr(os, "sched_getaffinity", None)  # not on every system
    return len(affinity(0)) if affinity else os.cpu_count() or 1
