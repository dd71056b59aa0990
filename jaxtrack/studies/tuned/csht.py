"""Study of tuning by gradient: tolerance and thresholds of the clustering-statistic transform.

The soft estimator's tolerance, its primary threshold and the thresholds by which ISODATA combines
and deletes patterns are tuned by the gradient of a smooth OSPA, from a fifth and from five times of
the defaults; beside it Optuna's TPE, as `tuned.study` has it.

The share δ below which a pattern is deleted has a slope in few windows, where a pattern holds about
as little as that, and from both starts it becomes small: false patterns hold as many votes as true
ones, so what it deletes are targets. The mark is judged by the soft estimator, which is what the
loss is of and what has a tolerance; hard votes with the same thresholds stand beside it.
"""

import functools

from jaxtrack.studies.registry import Context, Study
from jaxtrack.studies.tuned import report
from jaxtrack.studies.tuned import study as tuned
from jaxtrack.studies.tuned.csht_trial import hand, loss, score
from jaxtrack.studies.tuned.ways import Case, Effort, case_around

CASE = "csht"
FULL = Effort(steps=80, batch=32, holdout=128, every=10, grid=13, scenes=64)
WORDS = report.Words(
    titles={CASE: "Clustering-statistic transform"},
    symbols={
        "tolerance_m": ("ε", "m"),
        "cell_share": ("λ", ""),
        "merge_exponent": ("α_c", ""),
        "membership_floor": ("θ", ""),
        "aggregation_gate": ("A", ""),
        "delete_share": ("δ", ""),
    },
    hand={"defaults": "the defaults, ε by hand"},
    measures=("OSPA, m", "OSPA of hard\nvotes, m"),
    unit="m",
)
_SHARES = ("cell_share", "membership_floor", "aggregation_gate")


def cases() -> dict[str, Case]:
    """Return what is tuned."""
    axes = "tolerance_m", "cell_share"
    return {CASE: case_around("defaults", hand(), loss, score, axes, shares=_SHARES, clip=0.2)}


def run(context: Context) -> None:
    """Run everything, print the table, save results and figures."""
    marks = functools.partial(report.marks, words=WORDS)
    tuned.run_study(context, STUDY, FULL, cases(), WORDS, marks)


STUDY = Study(
    name="tune_csht",
    title="Tuning by gradient: tolerance and thresholds of the clustering-statistic transform",
    source="this library; the transform is that of Yan et al., Clustering Statistic Hough "
    "Transform Based Estimation Method for Motion Elements of Multiple Underwater Targets, IEEE "
    "Access, 2018",
    trials_short=2,
    trials_full=500,
    seconds_short=30.0,
    seconds_full=400.0,
    run=run,
)
