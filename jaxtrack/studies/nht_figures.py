"""The figures of the study `nht`, in the manner of the paper's, saved under their numbers there."""

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
from jaxtrack.sensors import observe
from jaxtrack.studies.nht_report import COMPARED
from jaxtrack.studies.nht_scores import Gates
from jaxtrack.studies.nht_trial import Inputs, Shape, detect, sizes_of
from jaxtrack.tracking import InitiateParams, initiate
from jaxtrack.types import Key, Lines, Scan

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
    key: Key,
    simulated: Mapping[str, tuple[Inputs, Shape, Gates]],
    real: tuple[Inputs, Shape, Gates],
    tables: Mapping[str, xr.Dataset],
    progress: Callable[[int, int], None],
) -> None:
    """Draw all figures into `out`.

    Args:
        out: folder.
        key: of the one realization that is shown.
        simulated: the paper's situation → its inputs, shape and gates.
        real: the same of the real data.
        tables: `simulated` and `times` as they are saved.
        progress: (done, total).
    """
    from jaxtrack import plots

    inputs, shape, gates = simulated["IV"]
    recorded, real_shape, real_gates = real
    scans = _scans(key, inputs, shape)
    real_scans = _scans(key, recorded, real_shape)
    jobs: dict[str, Callable[[], Any]] = {
        "figure_02_sinusoids": lambda: plots.sinusoids(
            np.asarray(inputs.truth.state)[:, 0, :2], title="Seven points of a straight line"
        ),
        "figure_04_ideal_tracks": lambda: plots.scene(
            None, inputs.truth, None, title="Ideal tracks"
        ),
        "figure_05_noisy_tracks": lambda: plots.scene(
            scans, inputs.truth, None, title="Situation IV, 56 clutter a scan"
        ),
        "figure_12_real_tracks": lambda: plots.scene(
            None, recorded.truth, None, title="Real radar measurements"
        ),
        "figure_13_real_cluttered": lambda: plots.scene(
            real_scans, recorded.truth, None, title="Real measurements, noise and clutter added"
        ),
        "figure_11_run_times": lambda: _run_times(tables["times"]),
        "scores_top_3": lambda: _scores(tables["simulated"], "top_k"),
        "scores_perfect": lambda: _scores(tables["simulated"], "perfect"),
    }
    for method in ("NHT", "joint"):
        jobs[f"figure_06_tracks_{method.lower()}"] = lambda method=method: _initiated(
            scans, inputs, shape, gates, method, InitiateParams()
        )
        # The real tracks bend by some 60 m, so more belongs to a line than noise alone says.
        bent = InitiateParams(member_m=200.0, along_m=300.0, sigma_m=recorded.sensor.sigma_m)
        jobs[f"figure_14_real_tracks_{method.lower()}"] = lambda method=method, bent=bent: (
            _initiated(real_scans, recorded, real_shape, real_gates, method, bent)
        )
    for number, (name, setting) in enumerate(simulated.items(), start=7):
        jobs[f"figure_{number:02}_situation_{name.lower()}"] = lambda name=name, setting=setting: (
            _accumulations(key, *setting[:2], title=f"Votes in situation {name}")
        )
    jobs["figure_15_real"] = lambda: _accumulations(
        key, recorded, real_shape, title="Votes on the real data"
    )
    for done, (name, job) in enumerate(sorted(jobs.items())):
        job().savefig(out / f"{name}.png", dpi=150)
        progress(done + 1, len(jobs))


def _scans(key: Key, inputs: Inputs, shape: Shape) -> Scan:
    return observe(key, inputs.truth, inputs.radar, detections=shape.detections)


def _initiated(
    scans: Scan, inputs: Inputs, shape: Shape, gates: Gates, method: str, params: InitiateParams
) -> Any:
    """Draw the tracks that the lines above the gate start, smoothed by recursive least squares."""
    from jaxtrack import plots

    def tracks(scans: Scan) -> Any:
        lines: Lines = detect(method, inputs, shape, "raw")(scans)[0]
        above = lines._replace(mask=lines.mask & (lines.votes >= gates[method, "raw"]))
        return initiate(scans, above, params)

    found, info = jax.jit(tracks)(scans)
    return plots.scene(
        scans,
        inputs.truth,
        found,
        smoothed_m=info.smoothed_m,
        title=f"Initiated tracks, {LONG[method]}",
    )


def _accumulations(key: Key, inputs: Inputs, shape: Shape, *, title: str) -> Any:
    from jaxtrack import plots

    scans = _scans(key, inputs, shape)
    panels = {}
    for method in COMPARED:
        sizes = sizes_of(shape, method, "raw")
        if method == "HT":
            votes = accumulator(scans, inputs.grid, sizes=sizes)
        else:
            cast = jax.jit(lambda scans, m=method: detect(m, inputs, shape, "raw")(scans)[1].votes)
            votes = accumulate(cast(scans), inputs.grid, sizes=sizes)
        panels[LONG[method]] = np.asarray(votes)
    origin = jnp.asarray(inputs.grid.origin_m, inputs.truth.state.dtype)
    path = jnp.swapaxes(inputs.truth.state[..., :2], 0, 1) - origin[None, None]
    marks = np.stack(jax.vmap(least_squares_line)(path), axis=-1)
    return plots.accumulations(
        panels,
        float(inputs.grid.rho_max_m),
        title=title,
        marks=[(float(rho), float(theta)) for rho, theta in marks],
    )


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
        return k / n, *(float(end) for end in proportion_interval(k, n))

    situations = [str(name) for name in simulated.situation.values]
    shown = {LONG[m]: {name: share(m, name) for name in situations} for m in LONG}
    what = {
        "top_k": "The three strongest lines are the three targets",
        "perfect": "All targets found, nothing false",
    }[count]
    return plots.scores(shown, title=f"{what} (within 100 m, raw peaks)")
