import re

from jaxtrack.studies import STUDIES
from jaxtrack.studies.tables import SMOKE_BELOW


def test_every_study_is_registered_under_its_own_name():
    assert "nht" in STUDIES
    for name, study in STUDIES.items():
        assert name == study.name
        assert re.fullmatch(r"[a-z][a-z0-9_]*", name)


def test_every_study_says_what_it_is_and_what_it_costs():
    for study in STUDIES.values():
        assert study.title
        assert "\n" not in study.title
        assert study.source
        assert 1 <= study.trials_short < study.trials_full
        assert study.seconds_short > 0
        assert study.seconds_short < study.seconds_full
        assert callable(study.run)


def test_all_short_runs_together_take_nine_minutes_and_the_main_job_gives_verdicts():
    assert sum(study.seconds_short for study in STUDIES.values()) <= 540
    assert STUDIES["nht"].trials_short >= SMOKE_BELOW
