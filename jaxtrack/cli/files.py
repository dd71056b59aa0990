"""Commands on a user's own file: initiate, estimate, track."""

import pathlib
from typing import Literal

from jaxtrack.cli.inputs import as_positions, read_looks, wrong_outputs
from jaxtrack.cli.screen import (
    draw,
    fail,
    line,
    print_elements,
    print_files,
    print_lives,
    print_tracks,
    progress,
    seed_of,
    use_all_cores,
)


def initiate(
    file: pathlib.Path,
    /,
    *,
    method: Literal["joint", "neutrosophic", "improved", "modified", "standard"] = "joint",
    out: pathlib.Path = pathlib.Path("tracks.csv"),
    figure: pathlib.Path | None = None,
    speed_min_m_s: float = 100.0,
    speed_max_m_s: float = 400.0,
    sigma_m: float = 10.0,
    p_detect: float = 0.9,
    false_per_run: float = 0.01,
    bearing: Literal["clockwise_from_north", "math"] = "clockwise_from_north",
    max_tracks: int = 8,
    seed: int = 0,
) -> int:
    """Start tracks in a file of detections; all its looks form one window.

    Args:
        file: CSV, one detection a row: time_s and x_m, y_m or range_m, bearing_deg; where there
            are, scan, weight, sigma_m or cov_xx_m2, cov_xy_m2, cov_yy_m2 and, with bearings,
            sigma_range_m, sigma_bearing_deg, own_x_m, own_y_m, own_heading_deg.
        method: how detections vote for tracks; joint is the best, the others are the paper's.
        out: where the tracks go, CSV.
        figure: a map of detections and tracks goes here (PNG, PDF or SVG).
        speed_min_m_s: slowest target, m/s.
        speed_max_m_s: fastest target, m/s.
        sigma_m: standard deviation of each coordinate of a detection, m; more where targets bend.
        p_detect: probability that a target is detected in a look.
        false_per_run: wanted mean number of false tracks in such a file; the gate comes from
            simulated scenes with the file's clutter and no targets.
        bearing: how bearings in the file are counted, degrees.
        max_tracks: most tracks that are looked for.
        seed: of the simulated scenes.
    """
    from rich.console import Console

    use_all_cores()
    import jax

    from jaxtrack.hough import SpeedGate
    from jaxtrack.io import read_detections, write_tracks
    from jaxtrack.tracking import initiate_window

    wrong = wrong_outputs(file, out, figure)
    if wrong:
        return fail(wrong)
    try:
        recording = read_detections(file, bearing=bearing)
        with progress(Console(stderr=True)) as report:
            tracks, info = initiate_window(
                recording.scans,
                method=method,
                speed=SpeedGate(speed_min_m_s, speed_max_m_s),
                sigma_m=sigma_m,
                p_detect=p_detect,
                false_per_run=false_per_run,
                max_tracks=max_tracks,
                key=jax.random.key(seed_of(seed)),
                on_progress=lambda done, total: report("scenes without targets", done, total),
            )
        write_tracks(out, tracks, recording)
        if figure is not None:
            draw(figure, recording, tracks, info.smoothed_m, f"{file.name}, {method}")
    except (OSError, ValueError) as error:  # a DataError is a ValueError
        return fail(line(error))
    print_tracks(Console(), recording, tracks, info, seed)
    print_files(info.notes, out, figure)
    return 0


def estimate(
    file: pathlib.Path,
    /,
    *,
    speed_max_m_s: float,
    method: Literal["joint", "csht", "sht"] = "joint",
    out: pathlib.Path = pathlib.Path("motion_elements.csv"),
    figure: pathlib.Path | None = None,
    speed_min_m_s: float = 0.0,
    sigma_m: float = 3.0,
    p_detect: float = 0.7,
    false_per_window: float = 0.01,
    bearing: Literal["clockwise_from_north", "math"] = "clockwise_from_north",
    beams: int | None = None,
    sector_deg: float = 90.0,
    range_max_m: float = 150.0,
    max_tracks: int = 8,
) -> int:
    """Estimate motion elements of targets: where they were, where they are, how they move.

    Args:
        file: CSV; all its looks form one window. One detection a row: time_s and x_m, y_m or
            range_m, bearing_deg (see initiate); with --beams: time_s, beam, range_m, heading_deg,
            x_m, y_m.
        speed_max_m_s: fastest target, m/s.
        method: joint is the best; csht is the clustering-statistic Hough transform, sht the vote
            by threshold alone.
        out: where the targets go, CSV: states at the last look.
        figure: a map of detections and targets goes here (PNG, PDF or SVG).
        speed_min_m_s: slowest target, m/s.
        sigma_m: standard deviation of each coordinate of a detection (of the range, with --beams),
            m.
        p_detect: probability that a target is detected in a look.
        false_per_window: mean number of false targets, at most; for joint.
        bearing: how bearings in the file are counted, degrees.
        beams: the file is that of a multi-beam sonar of so many beams.
        sector_deg: of all its beams together, degrees.
        range_max_m: its scope, m.
        max_tracks: most targets that are looked for.
    """
    from rich.console import Console

    use_all_cores()
    from jaxtrack.hough import SpeedGate
    from jaxtrack.io import write_tracks
    from jaxtrack.tracking import motion_elements

    wrong = wrong_outputs(file, out, figure)
    if wrong:
        return fail(wrong)
    try:
        recording, sonar = read_looks(
            file, bearing, beams, sector_deg, range_max_m, sigma_m, p_detect
        )
        found = motion_elements(
            recording.scans,
            method=method,
            sonar=sonar,
            speed=SpeedGate(speed_min_m_s, speed_max_m_s),
            sigma_m=sigma_m,
            p_detect=p_detect,
            false_per_window=false_per_window,
            max_tracks=max_tracks,
        )
        write_tracks(out, found.tracks, recording)
        if figure is not None:
            shown = as_positions(recording, sonar)
            draw(figure, shown, found.tracks, None, f"{file.name}, {method}")
    except (OSError, ValueError) as error:
        return fail(line(error))
    print_elements(Console(), recording, found)
    print_files(found.notes, out, figure)
    return 0


def track(
    file: pathlib.Path,
    /,
    *,
    speed_max_m_s: float,
    tracker: Literal[
        "joint",
        "csht",
        "sht",
        "kalman_paper",
        "nearest",
        "greedy",
        "optimal",
        "pda",
        "jpda",
        "belief_propagation",
        "cloud",
        "cloud_nearest",
        "cloud_averaged",
        "cloud_soft",
        "pmht",
    ] = "joint",
    out: pathlib.Path = pathlib.Path("tracks.csv"),
    figure: pathlib.Path | None = None,
    speed_min_m_s: float = 0.0,
    sigma_m: float = 3.0,
    sigma_a_m_s2: float = 0.05,
    p_detect: float = 0.7,
    echoes: float = 1.0,
    false_per_window: float = 0.01,
    window: int = 20,
    bearing: Literal["clockwise_from_north", "math"] = "clockwise_from_north",
    beams: int | None = None,
    sector_deg: float = 90.0,
    range_max_m: float = 150.0,
    max_tracks: int | None = None,
    seed: int = 0,
) -> int:
    """Follow targets through a file of looks: tracks that start, go on and end.

    Args:
        file: CSV. One detection a row: time_s and x_m, y_m or range_m, bearing_deg (see initiate);
            with --beams: time_s, beam, range_m, heading_deg, x_m, y_m.
        speed_max_m_s: fastest target, m/s; to a Kalman filter twice the standard deviation of a new
            track's velocity, to kalman_paper nothing.
        tracker: joint votes over the last looks, and is the best; csht and sht are the votes in
            cells of the clustering-statistic paper, and kalman_paper the weak Kalman tracker that
            it compares them with: clutter's tracks and copies of one target are among theirs, and
            they read no standard deviations from the file. The others are Kalman filters with
            that association. Where a target gives several detections a look: pmht or a cloud.
        out: where the tracks go, CSV: a row for each track and look.
        figure: a map of detections and tracks goes here (PNG, PDF or SVG).
        speed_min_m_s: slowest target, m/s; for joint.
        sigma_m: standard deviation of each coordinate of a detection (of the range, with --beams),
            m.
        sigma_a_m_s2: acceleration of targets, each coordinate, m/s².
        p_detect: probability that a target is detected in a look.
        echoes: mean number of detections of a detected target, read by pmht; the clouds need none.
        false_per_window: mean number of false tracks in a window, at most; not for csht and sht.
        window: looks that the votes look at, and those that false-per-window counts.
        bearing: how bearings in the file are counted, degrees.
        beams: the file is that of a multi-beam sonar of so many beams.
        sector_deg: of all its beams together, degrees.
        range_max_m: its scope, m.
        max_tracks: most tracks at a time, tentative ones included. None: 10 for the votes and for
            jpda, which takes no more, and 32 for the others.
        seed: of the associations that draw.
    """
    from rich.console import Console

    use_all_cores()
    import jax

    from jaxtrack import tracking
    from jaxtrack.hough import SpeedGate
    from jaxtrack.io import write_tracks

    wrong = wrong_outputs(file, out, figure)
    if wrong:
        return fail(wrong)
    try:
        recording, sonar = read_looks(
            file, bearing, beams, sector_deg, range_max_m, sigma_m, p_detect
        )
        tracks, info = tracking.track(
            recording.scans,
            tracker=tracker,
            sonar=sonar,
            speed=SpeedGate(speed_min_m_s, speed_max_m_s),
            sigma_m=sigma_m,
            sigma_a_m_s2=sigma_a_m_s2,
            p_detect=p_detect,
            echoes=echoes,
            false_per_window=false_per_window,
            window=window,
            max_tracks=max_tracks,
            key=jax.random.key(seed_of(seed)),
        )
        write_tracks(out, tracks, recording)
        if figure is not None:
            draw(figure, as_positions(recording, sonar), tracks, None, f"{file.name}, {tracker}")
    except (OSError, ValueError) as error:
        return fail(line(error))
    print_lives(Console(), recording, tracks, info)
    print_files(info.notes, out, figure)
    return 0
