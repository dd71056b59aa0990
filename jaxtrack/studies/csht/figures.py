"""The figures of the study `csht_estimation`, in the manner of the paper's, under their numbers."""

import functools
import pathlib
from collections.abc import Callable, Mapping
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import xarray as xr

from jaxtrack.hough import clustering_statistic, pack_beams
from jaxtrack.hough.slope_intercept import cell_centres, hard_votes, points_of
from jaxtrack.sensors import motion_elements_scene, observe_beams
from jaxtrack.studies.csht import paper as csht_paper
from jaxtrack.studies.csht.trial import BEAM_COUNT, KNOWN, METHODS, POSITIONS
from jaxtrack.types import Array, Key, Scan, Tracks


def draw(
    out: pathlib.Path,
    table_2: Mapping[str, xr.Dataset],
    key: Key,
    progress: Callable[[int, int], None],
) -> None:
    """Draw all figures into `out`; the windows are the first of the key, one false alarm a look.

    Args:
        out: folder.
        table_2: by model of false alarms, [cell, trial, estimator].
        key: random key of the windows shown.
        progress: (done, total).
    """
    from jaxtrack import plots

    shown = {name: _window(key, name) for name in ("per_scan", "per_beam")}
    scans, found = shown["per_scan"]
    truth = motion_elements_scene().truth
    over_time = functools.partial(plots.coordinate_over_time, scans, truth)
    jobs: dict[str, Callable[[], Any]] = {
        "figure_03_frames": _frames,
        "figure_04_line": lambda: _one_target(None),
        "figure_05_clutter": lambda: _one_target(key),
        "figure_07_detections": lambda: plots.scene(
            shown["per_beam"][0], truth, axes="north_east", title="A window of 20 looks, P_F a beam"
        ),
        "figure_08_north": lambda: over_time({}, title="Northern positions"),
        "figure_13_east": lambda: over_time(
            {}, coordinate=1, name="east", title="Eastern positions"
        ),
    }
    for number, method, coordinate, name in (
        (10, "SHT", 0, "north"),
        (12, "CSHT", 0, "north"),
        (14, "SHT", 1, "east"),
        (15, "CSHT", 1, "east"),
    ):
        tracks, initial = found[method]
        lines = np.asarray(initial)[np.asarray(tracks.mask)][:, [coordinate, coordinate + 2]]
        jobs[f"figure_{number}_{method.lower()}_{name}"] = functools.partial(
            over_time,
            {method: lines},
            coordinate=coordinate,
            name=name,
            title=f"{method}: {len(lines)} targets where there are 3",
        )
    for number, what in ((9, "votes"), (11, "clusters")):
        for false_alarms, (window, _) in shown.items():
            jobs[f"figure_{number:02}_{what}_{false_alarms}"] = functools.partial(
                _plane, window, false_alarms, clusters=what == "clusters"
            )
    for variant, here in table_2.items():
        name = variant.replace(" ", "_")
        for numbers, (field, unit) in {
            (16, 18): ("velocity_ospa", "m/s"),
            (17, 19): ("position_ospa", "m"),
        }.items():
            rates, noise = (f"figure_{n}_{field}_{name}" for n in numbers)
            jobs[rates] = functools.partial(_by_rates, here, field, unit, variant)
            jobs[noise] = functools.partial(_by_sigma, here, field, unit, variant)
    for done, (name, job) in enumerate(sorted(jobs.items()), start=1):
        plots.save(job(), out / f"{name}.png")
        progress(done, len(jobs))


def _window(key: Key, false_alarms: str) -> tuple[Scan, dict[str, tuple[Tracks, Array]]]:
    """Return one window as positions, and what the votes make of it."""

    @jax.jit
    def run(key: Key) -> Any:
        scene = motion_elements_scene()
        scans = observe_beams(key, *scene, beams=BEAM_COUNT, false_alarms=false_alarms)
        positions, _ = pack_beams(scans, scene.sonar, BEAM_COUNT)
        params = clustering_statistic.ClusteringParams()
        found = {}
        for name, estimate in (
            ("SHT", clustering_statistic.threshold_estimate),
            ("CSHT", clustering_statistic.estimate),
        ):
            tracks, info = estimate(positions, params)
            found[name] = tracks, info.initial
        return positions, found

    return run(key)


def _frames() -> Any:
    from jaxtrack import plots

    scene = motion_elements_scene()
    first = jax.tree.map(lambda x: x[0], scene.pose)
    target = scene.truth.state[0, 0, :2]
    title = "The frames, and the sonar's sector"
    return plots.sonar_frames(first, scene.sonar, target, beams=BEAM_COUNT, title=title)


def _one_target(key: Key | None) -> Any:
    """Draw the first target's northern positions and their votes; with a key, as the sonar sees it.

    Its noise and misses are the sonar's, and a false alarm comes with every look.
    """
    from jaxtrack import plots

    scene = motion_elements_scene()
    truth = scene.truth._replace(
        mask=scene.truth.mask & (jnp.arange(scene.truth.mask.shape[1]) == 0)
    )
    scans = Scan(truth.time_s, truth.mask[:, 0], truth.state[..., :2], truth.mask)
    words = "One line"
    if key is not None:
        sonar = scene.sonar._replace(p_false=1.0)
        beams = observe_beams(
            key, truth, scene.pose, sonar, beams=BEAM_COUNT, false_alarms="per_scan"
        )
        scans, _ = pack_beams(beams, sonar, POSITIONS["per_scan"])
        words = "Noise, misses, and a false alarm a look"
    params, sizes = clustering_statistic.ClusteringParams(), clustering_statistic.ClusteringSizes()
    votes = hard_votes(points_of(scans, 0), params.x, sizes=sizes.lines)
    velocity, position = cell_centres(params.x, sizes=sizes.lines, dtype=votes.dtype)
    line = np.asarray(truth.state)[0, 0, [2, 0]]
    own = _votes_at(votes, velocity, position, line[None])
    title = f"{words}: strongest cell {float(votes.max()):.0f} votes, true cell {own}"
    return plots.points_and_votes(scans, line, votes, velocity, position, title=title)


def _plane(scans: Scan, false_alarms: str, *, clusters: bool) -> Any:
    from jaxtrack import plots

    params, sizes = clustering_statistic.ClusteringParams(), clustering_statistic.ClusteringSizes()
    votes = hard_votes(points_of(scans, 0), params.x, sizes=sizes.lines)
    velocity, position = cell_centres(params.x, sizes=sizes.lines, dtype=votes.dtype)
    truth = np.asarray(motion_elements_scene().truth.state)[0][:, [2, 0]]
    true = _votes_at(votes, velocity, position, truth)
    words = {"per_beam": "P_F a beam", "per_scan": "one false alarm a look"}[false_alarms]
    title = f"{words}: strongest cell {float(votes.max()):.0f} votes, true cells {true}"
    shown: dict[str, Any] = {}
    if clusters:
        tracks, info = clustering_statistic.estimate(scans, params)
        mask, cells = np.asarray(tracks.mask), np.asarray(info.cells.mask)
        shown["centres"] = np.asarray(info.initial)[mask][:, [2, 0]]
        pairs = np.stack([info.cells.velocity_m_s, info.cells.position_m], -1)
        shown["samples"] = pairs[cells]
    return plots.vote_plane(votes, velocity, position, truth=truth, title=title, **shown)


def _votes_at(votes: Array, velocity: Array, position: Array, truth: np.ndarray) -> str:
    """Return the votes of the cells that hold the true lines."""
    row = np.abs(np.asarray(velocity)[None] - truth[:, :1]).argmin(1)
    column = np.abs(np.asarray(position)[None] - truth[:, 1:]).argmin(1)
    return ", ".join(f"{v:.0f}" for v in np.asarray(votes)[row, column])


def _by_rates(table: xr.Dataset, field: str, unit: str, variant: str) -> Any:
    from jaxtrack import plots

    paper = csht_paper.VELOCITY_BY_RATES if unit == "m/s" else csht_paper.POSITION_BY_RATES
    panels, printed = {}, {}
    for row, p_miss in enumerate(csht_paper.RATES):
        cells = (table.p_miss == p_miss) & (table.sigma_m == 3.0)
        name = f"P_M = {p_miss:g}"
        panels[name] = _curves(table.isel(cell=np.flatnonzero(cells.values)), field, "p_false")
        printed[name] = {m: (csht_paper.RATES, paper[m][row]) for m in ("CSHT", "SHT")}
    return plots.error_curves(
        panels,
        x_label="P_F",
        y_label=f"{field.split('_')[0]} OSPA, {unit}",
        paper=printed,
        title=f"False alarms: {variant}; σ = 3 m",
    )


def _by_sigma(table: xr.Dataset, field: str, unit: str, variant: str) -> Any:
    from jaxtrack import plots

    paper = csht_paper.VELOCITY_BY_SIGMA if unit == "m/s" else csht_paper.POSITION_BY_SIGMA
    at = (table.p_miss == 0.3) & (table.p_false == 0.3)
    chosen = table.isel(cell=np.flatnonzero(at.values)).sortby("sigma_m")
    name = "P_M = P_F = 0.3"
    printed = {name: {m: (csht_paper.SIGMAS_M, paper[m]) for m in ("CSHT", "SHT")}}
    return plots.error_curves(
        {name: _curves(chosen, field, "sigma_m")},
        x_label="σ, m",
        y_label=f"{field.split('_')[0]} OSPA, {unit}",
        paper=printed,
        title=f"False alarms: {variant}",
    )


def _curves(cells: xr.Dataset, field: str, condition: str) -> Mapping[str, tuple[Any, Any, Any]]:
    trials = cells.sizes["trial"]
    mean = cells[field].mean("trial")
    error = cells[field].std("trial", ddof=1 if trials > 1 else 0) / np.sqrt(trials)
    return {
        name: (
            cells[condition].values,
            mean.sel(estimator=name).values,
            error.sel(estimator=name).values,
        )
        for name in (*METHODS, *KNOWN)
    }
