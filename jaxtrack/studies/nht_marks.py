"""The marks of the study `nht`, fixed before its runs, beside what the paper says."""

import xarray as xr

from jaxtrack.studies.nht_trial import FORMS
from jaxtrack.studies.tables import Figure, Mark, Row, mean, rate

# "All methods 1.00" is read in its two decimals.
_EVERY = Mark(0.995)


def rows(simulated: xr.Dataset, real: xr.Dataset) -> list[Row]:
    """Return every figure that has a mark, and those the paper speaks of without one."""
    listed = [
        Row(f"I: {method} {form}, top 3 at 50 m", _share(simulated, "I", method, form), word, mark)
        for method, forms in FORMS.items()
        for form in forms
        for word, mark in [("good" if method in ("HT", "MHT", "IHT", "NHT") else "", _EVERY)]
    ]
    share = lambda *at, **more: _share(simulated, *at, **more)
    listed += [
        Row("II: NHT raw, top 3 at 100 m", share("II", "NHT", at_m=100.0), "good", Mark(0.80)),
        Row("II: HT smoothed, top 3 at 50 m", share("II", "HT", "smoothed"), "good", Mark(0.95)),
        Row("II: HT raw, top 3 at 100 m", share("II", "HT", at_m=100.0), "good"),
        Row("II: IHT raw, top 3 at 100 m", share("II", "IHT", at_m=100.0), "poor"),
    ]
    perfect = lambda *at: share(*at, count="perfect")
    listed += [
        Row("III-56: NHT raw, perfect", perfect("III-56", "NHT"), "good", Mark(0.93)),
        Row("III-56: IHT raw, perfect", perfect("III-56", "IHT"), "good", Mark(0.93)),
        Row("III-56: HT raw, top 3", share("III-56", "HT"), "poor", Mark(0.15, at_least=False)),
    ]
    for situation, bound in (("IV-10", 0.97), ("IV-56", 0.95)):
        listed += [
            Row(f"{situation}: joint, perfect", perfect(situation, "joint"), "", Mark(bound)),
            Row(
                f"{situation}: NHT raw, top 3 at 100 m", share(situation, "NHT", at_m=100.0), "good"
            ),
            Row(f"{situation}: NHT wide, top 3 at 100 m", share(situation, "NHT wide", at_m=100.0)),
        ]
    at = {"match": 50.0, "situation": "IV-56", "method": "joint", "peaks": "raw"}
    joint = simulated.sel(at)
    trials = int(joint.trials)
    listed += [
        Row(
            "IV-56: joint, false tracks a run",
            mean(float(joint.false), float(joint.false_error), trials),
            "",
            Mark(0.03, at_least=False),
        ),
        Row("IV-56: joint, RMSE of ρ", _rmse(joint, "rho", "m"), "", Mark(10.0, at_least=False)),
        Row(
            "IV-56: joint, RMSE of θ",
            _rmse(joint, "theta", "rad"),
            "",
            Mark(0.006, at_least=False),
        ),
    ]
    for situation in real.situation.values:
        top = lambda method, name=str(situation): _share(real, name, method, at_m=150.0)
        found = _share(real, str(situation), "joint", at_m=150.0, count="found_all")
        listed += [
            Row(f"{situation}: joint finds all, 150 m", found, "", Mark(0.98)),
            Row(f"{situation}: NHT raw, top 3 at 150 m", top("NHT"), "identifies"),
            Row(f"{situation}: HT raw, top 3 at 150 m", top("HT"), "unable"),
        ]
    return listed


def _share(
    scores: xr.Dataset,
    situation: str,
    method: str,
    form: str = "raw",
    *,
    at_m: float = 50.0,
    count: str = "top_k",
) -> Figure:
    cell = scores.sel(match=at_m, situation=situation, method=method, peaks=form)
    return rate(float(cell[count]), int(cell.trials))


def _rmse(cell: xr.Dataset, name: str, unit: str) -> Figure:
    ends = (float(cell[f"{name}_rmse{end}_{unit}"]) for end in ("", "_lower", "_upper"))
    return Figure(*ends, int(cell.trials), unit)
