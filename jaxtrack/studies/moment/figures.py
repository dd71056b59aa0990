"""The figures of the study `moment_tracking`, in the manner of the paper's, under their numbers."""

import functools
import pathlib
from collections.abc import Callable, Mapping
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from jaxtrack.studies.moment.trial import FIRST, OPTIMISED, OURS, Seen, Track
from jaxtrack.tracking.moment_match import aligned

SHOWN = {  # by scene: the numbers of template, process, path and deviations
    "static, clean": ("09", "10", "10b", "11"),
    "hovering, clean": ("12", "13", "14", "15"),
    "following, clean": ("16", "17", "18", "19"),
    "hovering, two objects": ("20", "21", "22", "23"),  # not in the paper
}
_APART_M = (0.55, 0.15)
_BEST = f"zernike{OPTIMISED}"


def draw(
    out: pathlib.Path,
    runs: Mapping[str, tuple[Seen, Mapping[str, Track]]],
    progress: Callable[[int, int], None],
) -> None:
    """Draw all figures into `out`.

    Args:
        out: folder.
        runs: one of each scene that is shown.
        progress: (done, total).
    """
    from jaxtrack import plots

    jobs: dict[str, Callable[[], Any]] = {"figure_06_turned_steps": _turned}
    for scene, (seen, tracks) in runs.items():
        where = scene.replace(", ", "_").replace(" ", "_")
        template, process, path, off = SHOWN[scene]
        jobs[f"figure_{template}_template_{where}"] = functools.partial(_template, seen, scene)
        for name, word in ((_BEST, "zernike"), (OURS, OURS)):
            jobs[f"figure_{process}_process_{where}_{word}"] = functools.partial(
                _process, seen, tracks[name], f"{scene}: {name}"
            )
        jobs[f"figure_{path}_paths_{where}"] = functools.partial(_paths, seen, tracks, scene)
        jobs[f"figure_{off}_deviations_{where}"] = functools.partial(_off, seen, tracks, scene)
    for done, (name, job) in enumerate(sorted(jobs.items()), start=1):
        plots.save(job(), out / f"{name}.png")
        progress(done, len(jobs))


def _turned() -> Any:
    from jaxtrack import plots

    steps = jax.random.normal(jax.random.key(0), (400, 2))
    apart = jnp.asarray(_APART_M, steps.dtype)
    turned = jax.vmap(aligned, (0, None))(steps, apart)
    title = "Steps of particles when the target moved by the arrow"
    return plots.turned_steps(steps, turned, apart, title=title)


def _template(seen: Seen, scene: str) -> Any:
    from jaxtrack import plots

    clouds = jax.tree.map(lambda x: x[:FIRST], seen.clouds)
    return plots.template_frames(clouds, seen.picked_m, title=f"{scene}: the first three frames")


def _process(seen: Seen, track: Track, title: str) -> Any:
    from jaxtrack import plots

    later = jax.tree.map(lambda x: x[FIRST:], seen.clouds)
    count = len(track.position_m)
    return plots.pursuit(
        later,
        seen.truth.state[FIRST:, 0, :2],
        track.position_m,
        track.particles_m,
        until=(3, 10, count),
        vehicle_m=seen.stand_m[FIRST:],
        title=title,
    )


def _paths(seen: Seen, tracks: Mapping[str, Track], scene: str) -> Any:
    from jaxtrack import plots

    paths = {name: track.position_m for name, track in tracks.items()}
    return plots.target_paths(seen.truth.state[FIRST:, 0, :2], paths, title=f"{scene}, a run")


def _off(seen: Seen, tracks: Mapping[str, Track], scene: str) -> Any:
    from jaxtrack import plots

    truth_m = np.asarray(seen.truth.state)[FIRST:, 0, :2]
    off = {name: truth_m - np.asarray(track.position_m) for name, track in tracks.items()}
    return plots.deviations(seen.truth.time_s[FIRST:], off, title=f"{scene}, a run")
