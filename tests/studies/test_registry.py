import re

from jaxtrack.studies import STUDIES


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
        assert 20 <= study.trials_short < study.trials_full  # a short run gives verdicts
        assert 0 < study.seconds_short <= 180
        assert study.seconds_short < study.seconds_full
        assert callable(study.run)
