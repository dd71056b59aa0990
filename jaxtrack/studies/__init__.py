"""Studies: a paper's experiments, run again; tables and figures beside what the paper says.

A study is one entry of `STUDIES`, with a folder of its own. It simulates with
`jaxtrack.monte_carlo`, prints tables made by `studies.tables` (ours, the paper's words, the mark,
the verdict) and saves labelled results and a summary through `studies.store`. The same seed and
number of trials give the same results.

Studies from files are apart: `design` reads one, `functions` finds what it names, `trials`
computes, `chunks` stores, `summary` tells, `run` does it all, `report` makes a page of it; see
docs/studies.md.
"""

from jaxtrack.studies.ccm.study import STUDY as _CCM
from jaxtrack.studies.csht.study import STUDY as _CSHT
from jaxtrack.studies.learn.weights import STUDY as _LEARN_WEIGHTS
from jaxtrack.studies.moment.study import STUDY as _MOMENT
from jaxtrack.studies.nht.study import STUDY as _NHT
from jaxtrack.studies.registry import Context, Study
from jaxtrack.studies.tracking.study import STUDY as _TRACKING
from jaxtrack.studies.tuned.csht import STUDY as _TUNE_CSHT
from jaxtrack.studies.tuned.nht import STUDY as _TUNE_NHT
from jaxtrack.studies.tuned.tracker import STUDY as _TUNE_TRACKER

STUDIES: dict[str, Study] = {
    study.name: study
    for study in (
        *(_NHT, _CSHT, _CCM, _TRACKING, _MOMENT),
        *(_TUNE_NHT, _TUNE_CSHT, _TUNE_TRACKER, _LEARN_WEIGHTS),
    )
}

__all__ = ["STUDIES", "Context", "Study"]
