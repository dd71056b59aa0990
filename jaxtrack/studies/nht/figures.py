"""The figures of the study `nht`, in the manner of the paper's, saved under their numbers there."""

import functools
import pathlib
from collections.abc import Callable, Mapping
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import xarray as xr

from jaxtrack.hough.standard import accumulator
from jaxtrack.hough.votes import accumulate
from jaxtrack.metrics import least_squares_line
from jaxtrack.montecarlo import proportion_interval
from jaxtrack.studies.nht.report import COMPARED
from jaxtrack.studies.nht.scores import Cell
from jaxtrack.studies.nht.trial import SHAPES, Inputs, Shape, detect, sizes_of
from jaxtrack.tracking import InitiateParams, initiate
from jaxtrack.types import Array, Scan

# The words that figures use everywhere; the paper's MHT is no multiple hypothesis tracker.
LONG = {
    "HT": "standard",
    "MHT": "modified",
    "IHT": "improved",
    "NHT": "neutrosophic",
    "NHT cov": "neutrosophic, covariance",
    "joint": "joint",
}


def draw(
    out: pathlib.Path,
    cells: Mapping[str, Cell],
    tables: Mapping[str, xr.Dataset],
    progress: Callable[[int, int], None],
) -> None:
    """Draw all figures into `out`; scenes, lines and votes are those of the first trial.

    Args:
        out: folder.
        cells: the paper's situations I–IV and "real".
        tables: `simulated` and `times` as they are saved.
        progress: (done, total).
    """
    from jaxtrack import plots

    jobs: dict[str, Callable[[], Any]] = {
        "figure_02_sinusoids": lambda: plots.sinusoids(
            np.asarray(cells["IV"].inputs.truth.state)[:, 0, :2],
            title="Seven points of a straight line",
        ),
        "figure_11_run_times": lambda: _run_times(tables["times"]),
        "scores_top_3": lambda: _scores(tables["simulated"], "top_k"),
        "scores_perfect": lambda: _scores(tables["simulated"], "perfect"),
    }
    # The real tracks bend by some 60 m, so more belongs to a line than the noise explains.
    bent = InitiateParams(member_m=200.0, along_m=300.0, sigma_m=60.0)
    for name, ideal, noisy, initiated, params in (
        ("IV", 4, 5, 6, InitiateParams()),
        ("real", 12, 13, 14, bent),
    ):
        cell = cells[name]
        scans, truth = _first(cell), cell.inputs.truth
        show = functools.partial(plots.scene, truth=truth)
        jobs[f"figure_{ideal:02}_ideal"] = functools.partial(show, None, title="Ideal tracks")
        jobs[f"figure_{noisy:02}_noisy"] = functools.partial(show, scans, title="Noise and clutter")
        for method in ("NHT", "joint"):
            jobs[f"figure_{initiated:02}_initiated_{method.lower()}"] = functools.partial(
                _initiated, scans, cell, method, params
            )
    for number, name in zip((7, 8, 9, 10, 15), cells, strict=True):
        title = f"Votes on the {name} data" if name == "real" else f"Votes in situation {name}"
        jobs[f"figure_{number:02}_votes"] = functools.partial(
            _accumulations, cells[name], title=title
        )
    for done, (name, job) in enumerate(sorted(jobs.items()), start=1):
        plots.save(job(), out / f"{name}.png")
        progress(done, len(jobs))


def _first(cell: Cell) -> Scan:
    """Return the scans of a cell's first trial, in arrays of one size for all simulated ones."""
    scans = jax.tree.map(lambda x: x[0], cell.outcome.scans)
    free = SHAPES["56"].detections - scans.mask.shape[1]
    return scans._replace(
        position_m=np.pad(scans.position_m, ((0, 0), (0, free), (0, 0))),
        mask=np.pad(scans.mask, ((0, 0), (0, free))),
    )


def _initiated(scans: Scan, cell: Cell, method: str, params: InitiateParams) -> Any:
    """Draw the tracks that the lines above the gate start, smoothed by recursive least squares."""
    from jaxtrack import plots

    lines = jax.tree.map(lambda x: x[0], cell.outcome.lines[method, "raw"])
    above = lines._replace(mask=lines.mask & (lines.votes >= cell.gates[method, "raw"]))
    tracks, info = _initiate(scans, above, params)
    return plots.scene(
        scans,
        cell.inputs.truth,
        tracks,
        smoothed_m=info.smoothed_m,
        title=f"Initiated tracks, {LONG[method]}" + ("" if tracks.mask.any() else ": none"),
    )


_initiate = jax.jit(initiate)


def _accumulations(cell: Cell, *, title: str) -> Any:
    from jaxtrack import plots

    shape = SHAPES["56"]._replace(rho=cell.shape.rho)
    panels, (rho, theta) = _votes(_first(cell), cell.inputs, shape)
    marks = [(float(r), float(t)) for r, t in zip(rho, theta, strict=True)]
    rho_max_m = float(np.asarray(cell.inputs.grid.rho_max_m))
    return plots.accumulations(panels, rho_max_m, title=title, marks=marks)


@functools.partial(jax.jit, static_argnames="shape")
def _votes(scans: Scan, inputs: Inputs, shape: Shape) -> tuple[dict[str, Array], Any]:
    """Return the accumulators [n_θ, n_ρ] by method, and the true lines from the grid's origin."""
    panels = {}
    for method in COMPARED:
        sizes = sizes_of(shape, method, "raw")
        if method == "HT":
            panels[LONG[method]] = accumulator(scans, inputs.grid, sizes=sizes)
        else:
            _, info = detect(method, inputs, shape, "raw")(scans)
            panels[LONG[method]] = accumulate(info.votes, inputs.grid, sizes=sizes)
    path = jnp.swapaxes(inputs.truth.state[..., :2], 0, 1)
    origin = jnp.asarray(inputs.grid.origin_m, path.dtype)
    return panels, jax.vmap(least_squares_line)(path - origin[None, None])


def _run_times(times: xr.Dataset) -> Any:
    from jaxtrack import plots

    by_method = {LONG[str(m)]: times.sel(estimator=m) for m in times.estimator.values}
    seconds = {name: here.seconds.values for name, here in by_method.items()}
    paper = {name: float(here.paper_seconds) for name, here in by_method.items()}
    known = {name: value for name, value in paper.items() if np.isfinite(value)}
    return plots.run_times(times.clutter.values, seconds, known)


def _scores(simulated: xr.Dataset, count: str) -> Any:
    from jaxtrack import plots

    def share(method: str, situation: str) -> tuple[float, float, float]:
        cell = simulated.sel(match=100.0, estimator=method, situation=situation, peaks="raw")
        k, n = float(cell[count]), int(cell.trials)
        lower, upper = proportion_interval(k, n)
        return k / n, float(lower), float(upper)

    situations = [str(name) for name in simulated.situation.values]
    shown = {LONG[m]: {name: share(m, name) for name in situations} for m in LONG}
    what = {
        "top_k": "The three strongest lines are the three targets",
        "perfect": "All targets found, nothing false",
    }[count]
    return plots.scores(shown, title=f"{what} (within 100 m, raw peaks)")
