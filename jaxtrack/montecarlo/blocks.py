"""The inside of the engine: micro-batches of trials, and blocks of micro-batches on all devices."""

import functools
import time
from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.core
import jax.numpy as jnp
import numpy as np
from jax.sharding import Mesh, NamedSharding, PartitionSpec

from jaxtrack.montecarlo.advice import warn_of_stalls
from jaxtrack.numerics import checks
from jaxtrack.types import Key

# A block is what the devices compute between two visits of the host. On each of them its results
# may fill this many bytes and come from this many micro-batches; it stays shorter where
# micro-batches are slow, so that progress is seen and an interrupt is heard.
_BLOCK_BYTES = 32 * 2**20
_BLOCK_STEPS = 256
_BLOCK_SECONDS = 0.1


class Plan(NamedTuple):
    """What makes one compiled program; hashable."""

    fn: Callable[[Key, Any], Any]
    micro_batch: int
    batch_params: bool


def run_micro_batch(plan: Plan, key: Key, params: Any, index: jax.Array) -> Any:
    """Run the trials of one micro-batch: leaves `[(P,) micro_batch, ...]`."""
    lanes = jnp.arange(plan.micro_batch, dtype=jnp.uint32)
    trial = index * jnp.uint32(plan.micro_batch) + lanes
    keys = jax.vmap(jax.random.fold_in, in_axes=(None, 0))(key, trial)

    def one_set(one_params: Any) -> Any:
        if plan.micro_batch == 1:
            # Without vmap: it would turn loops of traced length into selects of whole arrays.
            return jax.tree.map(lambda x: jnp.asarray(x)[None], plan.fn(keys[0], one_params))
        return jax.vmap(plan.fn, in_axes=(0, None))(keys, one_params)

    return jax.lax.map(one_set, params) if plan.batch_params else one_set(params)


def check_outputs(shapes: Any) -> None:
    """Check that there is something to average in what `fn` returns."""
    leaves = jax.tree.leaves_with_path(shapes)
    if not leaves:
        raise TypeError("fn: got a function that returns no array, want a pytree of arrays")
    for path, leaf in leaves:
        checks.check_array(f"fn's result{jax.tree_util.keystr(path)}", leaf)


def run_in_blocks(
    plan: Plan, key: Key, params: Any, batches: range, report: Callable[[int], None]
) -> Any:
    """Run micro-batches on all local devices.

    Args:
        plan: the program.
        key: of the run.
        params: shared by all trials.
        batches: the numbers of the micro-batches.
        report: called after each block with the number of micro-batches done so far.

    Returns:
        Leaves `[(P,) len(batches), micro_batch, ...]` in host memory.
    """
    devices = tuple(jax.local_devices())
    program, replicated = _block_program(plan, devices)
    key, params = jax.device_put((key, params), replicated)

    def start(begin: int, steps: int) -> tuple[int, int, Any]:
        end = min(begin + steps * len(devices), len(batches))
        span = np.array([batches[begin], batches[end - 1]], np.uint32)
        return begin, end, program(key, params, span)

    steps = 1
    block = start(0, steps)
    leaves, structure = jax.tree.flatten(block[2])
    if any(isinstance(leaf, jax.core.Tracer) for leaf in leaves):
        raise TypeError("fn: got a function that closes over traced values, want them in params")
    most_steps = leaves[0].shape[1]
    axis = int(plan.batch_params)
    buffers = [
        np.empty((*leaf.shape[2 : 2 + axis], len(batches), *leaf.shape[2 + axis :]), leaf.dtype)
        for leaf in leaves
    ]
    clock = time.perf_counter()
    while block is not None:
        begin, end, outputs = block
        # The devices get their next block before the host copies this one.
        block = start(end, steps) if end < len(batches) else None
        for buffer, leaf in zip(buffers, jax.tree.leaves(outputs), strict=True):
            _gather(np.moveaxis(buffer, axis, 0)[begin:end], leaf)
        report(end)
        elapsed, clock = time.perf_counter() - clock, time.perf_counter()
        if elapsed < _BLOCK_SECONDS:
            steps = min(2 * steps, most_steps)
    return structure.unflatten(buffers)


def _gather(target: np.ndarray, leaf: jax.Array) -> None:
    """Copy one leaf of a block, `[devices, steps, ...]`, to the rows of its micro-batches."""
    for shard in leaf.addressable_shards:
        device = shard.index[0].start or 0
        rows = target[device :: leaf.shape[0]]
        rows[...] = np.asarray(shard.data)[0, : len(rows)]


@functools.lru_cache(maxsize=64)
def _block_program(
    plan: Plan, devices: tuple[Any, ...]
) -> tuple[Callable[..., Any], NamedSharding]:
    """Build the program of one block, `(key, params, [first, last] micro-batch) -> rows`.

    Rows have leaves `[devices, steps, (P,) micro_batch, ...]`. Device d takes micro-batches
    first + d, first + d + devices, … up to the last, so that short blocks are shared out evenly.
    How many those are is a value, not a shape: nothing is computed to be thrown away, and one
    program serves blocks of all lengths.
    """
    mesh = Mesh(np.array(devices), ("trial",))
    everywhere, by_device = PartitionSpec(), PartitionSpec("trial")

    def local(key: Key, params: Any, span: jax.Array) -> Any:
        # The inner jit is inlined; it is there so that looking at the program and filling the loop
        # trace fn once, not twice.
        run = jax.jit(functools.partial(run_micro_batch, plan), inline=True)
        jaxpr, shapes = jax.make_jaxpr(run, return_shape=True)(key, params, span[0])
        check_outputs(shapes)
        warn_of_stalls(jaxpr.jaxpr, devices)
        step_bytes = sum(leaf.size * leaf.dtype.itemsize for leaf in jax.tree.leaves(shapes))
        most_steps = min(max(_BLOCK_BYTES // max(step_bytes, 1), 1), _BLOCK_STEPS)

        stride = jnp.uint32(len(devices))
        first = span[0] + jax.lax.axis_index("trial").astype(jnp.uint32)
        last = span[1]
        steps = jnp.where(first > last, jnp.uint32(0), (last - first) // stride + jnp.uint32(1))

        def step(position: jax.Array, rows: Any) -> Any:
            row = run(key, params, first + position.astype(jnp.uint32) * stride)
            return jax.tree.map(
                lambda whole, part: jax.lax.dynamic_update_index_in_dim(whole, part, position, 0),
                rows,
                row,
            )

        rows = jax.tree.map(lambda leaf: jnp.zeros((most_steps, *leaf.shape), leaf.dtype), shapes)
        rows = jax.lax.fori_loop(jnp.int32(0), steps.astype(jnp.int32), step, rows)
        return jax.tree.map(lambda leaf: leaf[None], rows)

    # No check of varying axes: trials never talk to each other, and the check would forbid fn
    # its own loops with constant initial values.
    program = jax.shard_map(
        local, mesh=mesh, in_specs=everywhere, out_specs=by_device, check_vma=False
    )
    return jax.jit(program), NamedSharding(mesh, everywhere)
