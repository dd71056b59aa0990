"""Study of tuning by gradient: the two tolerances of the neutrosophic Hough transform.

In situation IV with 10 clutter a scan the paper's ε finds nothing. ε is tuned by the gradient of a
soft vote's candidate softmax, from the paper's values, a tenth and ten times, with ρ measured from
the field's corner and from its centre; beside it Optuna's TPE, as `tuned.study` has it.
"""

import numpy as np
import xarray as xr

from jaxtrack.numerics import positive
from jaxtrack.studies.nht.scenes import WIDE
from jaxtrack.studies.registry import Context, Study
from jaxtrack.studies.tables import Figure, Mark, Row, mean_of
from jaxtrack.studies.tuned import report
from jaxtrack.studies.tuned import study as tuned
from jaxtrack.studies.tuned.nht_trial import ORIGINS, loss_from, paper, score_from
from jaxtrack.studies.tuned.ways import GRADIENT, Case, Effort, label

STARTS = {"the paper's": 1.0, "a tenth": 0.1, "ten times": 10.0}
FULL = Effort(steps=80, batch=24, holdout=64, every=10, grid=13, scenes=48)
ABOVE_PAPER = {"corner": Mark(0.50), "centre": Mark(0.65)}
WITHIN = Mark(1.15, at_least=False)  # the largest of the three starts' ends over the smallest
AS_GOOD = Mark(0.0)  # share of scenes that the gradient has over TPE
WORDS = report.Words(
    titles={origin: f"ρ from the {origin}, situation IV" for origin in ORIGINS},
    symbols={"eps_rho_m": ("ε_ρ", "m"), "eps_theta_rad": ("ε_θ", "rad")},
    hand={"paper": "the paper's ε, the default", "wide": "study nht's wide ε"},
    measures=("top 3\n50 m", "top 3\n100 m"),
    shares=True,
)


def cases() -> dict[str, Case]:
    """Return what is tuned: with ρ from the corner, and from the centre."""
    default = paper()
    names = tuple(default)
    return {
        origin: Case(
            loss=loss_from(origin),
            score=score_from(origin),
            hand={"paper": default, "wide": dict(zip(names, WIDE, strict=True))},
            starts={
                start: {name: factor * value for name, value in default.items()}
                for start, factor in STARTS.items()
            },
            bounds={name: (0.1 * value, 100.0 * value) for name, value in default.items()},
            bijectors=positive(),
            axes=("eps_rho_m", "eps_theta_rad"),
        )
        for origin in ORIGINS
    }


def run(context: Context) -> None:
    """Run everything, print the tables, save results and figures."""
    tuned.run_study(context, STUDY, FULL, cases(), WORDS, marks)


def marks(scores: xr.Dataset) -> list[Row]:
    """Return every figure that has a mark."""
    rows = []
    trials = scores.sizes["trial"]
    starts = [str(start) for start in scores.start.values]
    ends = scores.params_on_the_way.isel(evaluation=-1).sel(tuner=GRADIENT)
    for origin in map(str, scores.case.values):
        for name, (symbol, _) in WORDS.symbols.items():
            three = ends.sel(case=origin, parameter=name).values
            spread = report.exact(float(three.max() / three.min()), trials)
            rows.append(Row(f"{origin}: {symbol}, largest / smallest end", spread, mark=WITHIN))
        for start in starts:
            gain = _difference(scores, origin, [label(GRADIENT, start)], ["paper"])
            what = f"{origin}: top 3 above the paper's ε, from {start}"
            rows.append(Row(what, gain, mark=ABOVE_PAPER[origin]))
        for tuner in map(str, scores.tuner.values):
            if tuner != GRADIENT:
                ours, theirs = ([label(x, start) for start in starts] for x in (GRADIENT, tuner))
                what = f"{origin}: top 3 above {tuner}, mean of the starts"
                rows.append(Row(what, _difference(scores, origin, ours, theirs), mark=AS_GOOD))
    return rows + report.costs(scores)


def _difference(scores: xr.Dataset, origin: str, ours: list[str], theirs: list[str]) -> Figure:
    """Return the mean gain in top 3 at the closest match, over the same scenes."""
    here = scores.score.isel(measure=0).sel(case=origin)
    missed = lambda names: here.sel(setting=names).values.astype(np.float64).mean(-1)
    return mean_of(missed(theirs) - missed(ours))


STUDY = Study(
    name="tune_nht",
    title="Tuning by gradient: the tolerances of the neutrosophic Hough transform",
    source="this library; the transform is that of Fan et al., Neutrosophic Hough Transform-Based "
    "Track Initiation Method for Multiple Target Tracking, IEEE Access, 2018",
    trials_short=2,
    trials_full=500,
    seconds_short=28.0,
    seconds_full=600.0,
    run=run,
)
