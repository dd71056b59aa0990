"""Study of tuning by gradient: five numbers of the Kalman–JPDA tracker.

The gate, the process and the measurement noise, the speed that a new track may have and the
evidence that confirms one are tuned by the gradient of a smooth OSPA through forty looks of the
tracker with soft lives, from a fifth and from five times of what is set by hand; beside it Optuna's
TPE, as `tuned.study` has it. A few scenes have gradients many times as long as the others', so that
their mean points anywhere: each scene's is clipped.
"""

import functools

from jaxtrack.numerics import positive
from jaxtrack.studies.registry import Context, Study
from jaxtrack.studies.tuned import report
from jaxtrack.studies.tuned import study as tuned
from jaxtrack.studies.tuned.tracker_trial import hand, loss, score
from jaxtrack.studies.tuned.ways import Case, Effort, case_around
from jaxtrack.tuning import clip_each

CASE = "tracker"
CLIP = 0.05  # about the median norm, away from the least loss, of one scene's gradient
FULL = Effort(steps=60, batch=24, holdout=48, every=10, grid=11, scenes=16)
WORDS = report.Words(
    titles={CASE: "Kalman–JPDA tracker"},
    symbols={
        "gate": ("γ", ""),
        "sigma_m": ("σ", "m"),
        "sigma_a_m_s2": ("σ_a", "m/s²"),
        "birth_sigma_m_s": ("σ_v of births", "m/s"),
        "confirm_score": ("to confirm", "nats"),
    },
    hand={"by hand": "by hand, the default"},
    measures=("OSPA, m",),
    unit="m",
)


def cases() -> dict[str, Case]:
    """Return what is tuned."""
    axes = "sigma_m", "birth_sigma_m_s"
    return {CASE: case_around("by hand", hand(), clip_each(loss, CLIP, positive()), score, axes)}


def run(context: Context) -> None:
    """Run everything, print the table, save results and figures."""
    marks = functools.partial(report.marks, words=WORDS)
    tuned.run_study(context, STUDY, FULL, cases(), WORDS, marks)


STUDY = Study(
    name="tune_tracker",
    title="Tuning by gradient: gate, noise, birth and confirmation of the Kalman–JPDA tracker",
    source="this library; the tracker is that of Fortmann, Bar-Shalom and Scheffe, Sonar Tracking "
    "of Multiple Targets Using Joint Probabilistic Data Association, 1983, with M-of-N lives",
    trials_short=2,
    trials_full=200,
    seconds_short=40.0,
    seconds_full=90.0,
    run=run,
)
