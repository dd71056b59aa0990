"""Studies: a paper's experiments, run again; tables and figures beside what the paper says.

A study is one entry of `STUDIES`. It simulates with `jaxtrack.monte_carlo`, prints tables made by
`studies.tables` (ours, the paper's words, the mark, the verdict) and saves labelled results and a
summary through `studies.store`. The same seed and number of trials give the same results.

Studies from files are apart: `design` reads one, `functions` finds what it names, `trials`
computes, `chunks` stores, `summary` tells, `run` does it all; see docs/studies.md.
"""

from jaxtrack.studies.ccm import STUDY as _CCM
from jaxtrack.studies.csht import STUDY as _CSHT
from jaxtrack.studies.learn_weights import STUDY as _LEARN_WEIGHTS
from jaxtrack.studies.moment import STUDY as _MOMENT
from jaxtrack.studies.nht import STUDY as _NHT
from jaxtrack.studies.registry import Context, Study
from jaxtrack.studies.tracking import STUDY as _TRACKING
from jaxtrack.studies.tune_csht import STUDY as _TUNE_CSHT
from jaxtrack.studies.tune_nht import STUDY as _TUNE_NHT
from jaxtrack.studies.tune_tracker import STUDY as _TUNE_TRACKER

STUDIES: dict[str, Study] = {
    study.name: study
    for study in (
        *(_NHT, _CSHT, _CCM, _TRACKING, _MOMENT),
        *(_TUNE_NHT, _TUNE_CSHT, _TUNE_TRACKER, _LEARN_WEIGHTS),
    )
}

__all__ = ["STUDIES", "Context", "Study"]
