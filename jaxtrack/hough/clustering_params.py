"""Parameters and sizes of the clustering-statistic Hough transform, and where they come from."""

from typing import NamedTuple

from jaxtrack.clustering import IsodataParams, IsodataSizes
from jaxtrack.hough.slope_intercept import LineGrid, LineSizes
from jaxtrack.numerics.checks import check_known, check_positive, check_scans, check_size
from jaxtrack.types import Array, Scan


class ClusteringParams(NamedTuple):
    """Parameters of the clustering-statistic Hough transform. Traced.

    The defaults, with K0 = `ClusteringSizes.start` = 3, are what `benchmarks/search_csht.py` finds,
    in three digits: 30 generations of 24 settings on 256 scenes each, then 14 on 768 with factors
    half as wide. Its scenes are not the paper's: windows of 20 looks, P_M = P_F = 0.3, at most one
    false alarm a look, σ = 3 m; random straight targets, three in 70 % of the scenes, else one, two
    or four. Scored are the fair scenes, where every two targets are 2 m/s apart in v_n or 15 m
    apart in n at one end, and each is in sight in 75 % of the looks. Position OSPA of order 2 and
    cut-off 20 m:

        scenes                                       runs        exact number   median position OSPA
        of the finalists, three targets              about 769   0.991          2.9 m
        of the finalists, one | two | four targets   fewer       0.00 | 0.08 | 0.00
        table 2, the last cell of notebook 02        2000        1.000          2.8 m (mean 4.7 m)

    The finalists were compared on 2048 scenes, of which about 769 are fair and have three targets,
    and the winner was chosen on them: its shares there flatter it. The windows of table 2 have a
    seed of their own, which no choice has seen.

    The number is so often exact because K0 is the number of targets of the scenes: with these
    parameters patterns seldom divide, merge or vanish. A mean above the median says that three
    patterns need not be the three targets.

    Note:
        The exact number says little. Of those 2000 windows only 81 % have a track within 10 m of
        each of the three targets (84 % of 2000 others, of mean 4.4 m); without any target there
        are 2.7 tracks on average; and in generated scenes of one to five targets it is exact in
        .01, .08, .96, .00 and .00 of some 1400 windows each.
    """

    x: LineGrid = LineGrid(-9.8, 0.207, -49.7, 6.95)
    y: LineGrid = LineGrid(-6.0, 0.151, -40.0, 6.25)
    cell_share: Array | float = 0.544  # λ, of the strongest cell's votes
    line_share: Array | float = 0.796  # the same for the single line of the second coordinate
    velocity_scale_s: Array | float = 4.68  # clusters are found in (scale · v, n0 + τ v), metres
    cluster_time_s: Array | float = 2.59  # τ, after the window's first look
    isodata: IsodataParams = IsodataParams(2.47, 0.124, 3.43, 0.216, 0.439, 0.456, 0.0471)
    sigma_m: Array | float = 3.0  # noise of a position, for the covariance only


class ClusteringSizes(NamedTuple):
    """Everything that sets an array's shape. Static."""

    lines: LineSizes = LineSizes()
    cells: int = 192  # the strongest cells, which are clustered
    patterns: int = 9  # slots of clusters, and of tracks
    start: int = 3  # K0, clusters to start with
    isodata: IsodataSizes = IsodataSizes()


def check_clustering(
    scans: Scan, params: ClusteringParams, sizes: ClusteringSizes | None
) -> tuple[Scan, ClusteringSizes]:
    """Return sound looks and sizes, the defaults if None.

    Raises:
        ValueError: shapes do not fit, a size is too small, or a known parameter cannot be.
        TypeError: a size is not an int.
    """
    sizes = ClusteringSizes() if sizes is None else sizes
    scans = check_scans(scans)
    dtype = scans.position_m.dtype
    for axis in ("x", "y"):
        for name in ("velocity_step_m_s", "position_step_m"):
            step = getattr(getattr(params, axis), name)
            check_positive(f"params.{axis}.{name}", step, dtype)
    for name in ("velocity_scale_s", "sigma_m"):
        check_positive(f"params.{name}", getattr(params, name), dtype)
    for name in ("cell_share", "line_share"):
        share = getattr(params, name)
        check_known(f"params.{name}", share, lambda x: (x >= 0) & (x < 1), "a share below 1")
    for name in ("cells", "patterns", "start"):
        check_size(f"sizes.{name}", getattr(sizes, name))
    check_size("sizes.patterns", sizes.patterns, at_least=sizes.start)
    return scans, sizes
