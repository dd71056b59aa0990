"""Study of tuning by gradient: tolerance and thresholds of the clustering-statistic transform.

The soft estimator's tolerance, its primary threshold and the thresholds by which ISODATA combines
and deletes patterns are tuned by the gradient of a smooth OSPA, from a fifth and from five times of
the defaults; beside it Optuna's TPE, as `tuned` has it.
"""

import xarray as xr

from jaxtrack.numerics import bounded, positive
from jaxtrack.studies import tuned, tuned_report
from jaxtrack.studies.registry import Context, Study
from jaxtrack.studies.tables import Row
from jaxtrack.studies.tune_csht_trial import hand, loss, score
from jaxtrack.studies.tuned_ways import STARTS, Case, Effort

CASE = "csht"
MOST = 0.95  # of the shares, which are below 1
FULL = Effort(steps=80, batch=32, holdout=128, every=10, grid=13, scenes=64)
WORDS = tuned_report.Words(
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
    default = hand()
    most = lambda name, value: min(value, MOST) if name in _SHARES else value
    times = lambda factor: {n: most(n, factor * value) for n, value in default.items()}
    return {
        CASE: Case(
            loss=loss,
            score=score,
            hand={"defaults": default},
            starts={start: times(factor) for start, factor in STARTS.items()},
            bounds={name: (0.1 * x, most(name, 10.0 * x)) for name, x in default.items()},
            bijectors={
                name: bounded(0.0, 1.0) if name in _SHARES else positive() for name in default
            },
            clip=0.2,
            axes=("tolerance_m", "cell_share"),
        )
    }


def run(context: Context) -> None:
    """Run everything, print the table, save results and figures."""
    tuned.run_study(context, STUDY, FULL, cases(), WORDS, marks)


def marks(scores: xr.Dataset) -> list[Row]:
    """Return every figure that has a mark, and what was gained."""
    return tuned_report.near_best(scores, CASE, WORDS) + tuned_report.costs(scores)


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
