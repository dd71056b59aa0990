"""Results on disk: labelled arrays as zarr groups, and a summary as JSON that says how they came.

results.zarr/<group>    one xarray Dataset a group
summary.json            seed, trials, versions, machine, verdicts and whatever the study adds
"""

import functools
import hashlib
import importlib.metadata
import json
import os
import pathlib
import platform
import shutil
from collections.abc import Mapping
from typing import Any

import jax
import numpy as np
import xarray as xr

RESULTS = "results.zarr"
SUMMARY = "summary.json"
_PACKAGES = ("jaxtrack", "jax", "jaxlib", "numpy", "xarray", "zarr")


def save(out: pathlib.Path, datasets: Mapping[str, xr.Dataset], summary: Mapping[str, Any]) -> None:
    """Write datasets and summary into a folder, replacing what an earlier run left there.

    Args:
        out: the folder; exists.
        datasets: group name → Dataset.
        summary: anything JSON can hold, NumPy numbers and arrays included; versions and machine
            are added. NaN and infinities, which JSON lacks, become null.

    Example:
        >>> import tempfile
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     here = pathlib.Path(folder)
        ...     save(here, {"a": xr.Dataset({"x": ("trial", np.arange(3))})}, {"seed": 0})
        ...     groups, summary = load(here)
        >>> int(groups["a"].x.sum()), summary["seed"]
        (3, 0)
    """
    shutil.rmtree(out / RESULTS, ignore_errors=True)
    for group, dataset in datasets.items():
        # Of the kinds of text, zarr's format specifies the one of variable length.
        text = {name: x.astype(object) for name, x in dataset.coords.items() if x.dtype.kind == "U"}
        dataset = dataset.assign_coords(text)
        dataset.to_zarr(out / RESULTS, group=group, consolidated=False)
    entries = {**summary, "groups": list(datasets), "made_with": made_with()}
    text = json.dumps(_plain(entries), indent=2, ensure_ascii=False, allow_nan=False)
    (out / SUMMARY).write_text(text + "\n", encoding="utf-8")


def load(out: pathlib.Path) -> tuple[dict[str, xr.Dataset], dict[str, Any]]:
    """Read what `save` wrote: datasets by group, in memory, and the summary."""
    summary = json.loads((out / SUMMARY).read_text(encoding="utf-8"))
    datasets = {}
    for group in summary["groups"]:
        with xr.open_zarr(out / RESULTS, group=group, consolidated=False, chunks=None) as dataset:
            datasets[group] = dataset.load()
    return datasets, summary


def made_with() -> dict[str, Any]:
    """Return the versions and the machine that results were made with."""
    versions = {name: importlib.metadata.version(name) for name in _PACKAGES}
    devices = jax.local_devices()
    return {
        "python": platform.python_version(),
        **versions,
        "processor": platform.machine(),
        "cores": os.cpu_count(),
        "devices": [device.platform for device in devices],
        "dtype": str(np.dtype(jax.dtypes.canonicalize_dtype(float))),
    }


@functools.cache
def source_digest() -> str:
    """Return a digest of the package's own source."""
    here = pathlib.Path(__file__).parents[1]
    source = b"".join(file.read_bytes() for file in sorted(here.rglob("*.py")))
    return hashlib.sha256(source).hexdigest()


def _plain(value: Any) -> Any:
    """Turn NumPy into Python, mappings' keys into strings, and what is not finite into None."""
    if isinstance(value, Mapping):
        return {str(key): _plain(item) for key, item in value.items()}
    if isinstance(value, (list, tuple)):
        return [_plain(item) for item in value]
    if isinstance(value, (np.ndarray, np.generic, jax.Array)):
        return _plain(np.asarray(value).tolist())
    if isinstance(value, float) and not np.isfinite(value):
        return None
    return value
