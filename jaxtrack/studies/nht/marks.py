"""The marks of the study `nht`, fixed before its runs, beside what the paper says."""

import xarray as xr

from jaxtrack.studies.nht.trial import FORMS
from jaxtrack.studies.tables import Figure, Mark, Row, mean, rate

# "Every method 1.00" is read to the two decimals it is given in.
EVERY = Mark(0.995)


def rows(simulated: xr.Dataset, real: xr.Dataset) -> list[Row]:
    """Return every figure that has a mark, and those that the paper speaks of without one.

    Shares are at a match of 50 m, raw peaks, unless said otherwise; "top 3": the three strongest
    lines are the three targets; "perfect": at the gate all are found and nothing else is.
    """
    top = lambda name, *at, **more: _share(simulated, f"{name}, top 3", *at, **more)
    perfect = lambda name, *at: _share(simulated, f"{name}, perfect", *at, count="perfect")
    worst = min(
        (top("", "I", method, form).ours.value, method, form)
        for method, forms in FORMS.items()
        for form in forms
    )
    name = f"I: worst of all methods ({worst[1]} {worst[2]})"
    return [
        top(name, "I", *worst[1:], paper="all good", mark=EVERY),
        top("II: NHT", "II", "NHT", at_m=100.0, paper="good", mark=Mark(0.80)),
        top("II: HT smoothed", "II", "HT", "smoothed", paper="good", mark=Mark(0.95)),
        top("II: HT", "II", "HT", at_m=100.0, paper="good"),
        top("II: MHT", "II", "MHT", at_m=100.0, paper="poor"),
        perfect("III-56: NHT", "III-56", "NHT")._replace(paper="good", mark=Mark(0.93)),
        perfect("III-56: IHT", "III-56", "IHT")._replace(paper="good", mark=Mark(0.93)),
        top("III-56: HT", "III-56", "HT", paper="poor", mark=Mark(0.15, at_least=False)),
        *(
            top(f"{situation}: {method}", situation, method, at_m=100.0, paper=paper)
            for situation in ("IV-10", "IV-56")
            for method, paper in (("NHT", "good"), ("NHT wide", ""), ("NHT cov", ""))
        ),
        perfect("IV-10: joint", "IV-10", "joint")._replace(mark=Mark(0.97)),
        perfect("IV-56: joint", "IV-56", "joint")._replace(mark=Mark(0.95)),
        *_joint_errors(simulated),
        *(row for situation in real.situation.values for row in _real(real, str(situation))),
    ]


def _joint_errors(simulated: xr.Dataset) -> list[Row]:
    cell = simulated.sel(match=50.0, situation="IV-56", estimator="joint", peaks="raw")
    trials = int(cell.trials)
    false = mean(float(cell.false), float(cell.false_error), trials)

    def error(name: str, unit: str) -> Figure:
        value, lower, upper = (
            float(cell[f"{name}_rmse{end}_{unit}"]) for end in ("", "_lower", "_upper")
        )
        return Figure(value, lower, upper, trials, unit)

    at_most = lambda bound: Mark(bound, at_least=False)
    return [
        Row("IV-56: joint, false tracks a run", false, mark=at_most(0.03)),
        Row("IV-56: joint, RMSE of ρ", error("rho", "m"), mark=at_most(10.0)),
        Row("IV-56: joint, RMSE of θ", error("theta", "rad"), mark=at_most(0.006)),
    ]


def _real(real: xr.Dataset, situation: str) -> list[Row]:
    name = f"{situation}: joint, finds all at 150 m"
    found = _share(real, name, situation, "joint", at_m=150.0, count="found_all", mark=Mark(0.98))
    words = {"HT": "unable", "MHT": "unable", "IHT": "unable", "NHT": "identifies"}
    words |= {"NHT spread": "", "NHT wide": ""}
    return [found] + [
        _share(
            real,
            f"{situation}: {method}, top 3 at 300 m",
            situation,
            method,
            at_m=300.0,
            paper=word,
        )
        for method, word in words.items()
    ]


def _share(
    scores: xr.Dataset,
    name: str,
    situation: str,
    method: str,
    form: str = "raw",
    *,
    at_m: float = 50.0,
    count: str = "top_k",
    paper: str = "",
    mark: Mark | None = None,
) -> Row:
    cell = scores.sel(match=at_m, situation=situation, estimator=method, peaks=form)
    suffix = "" if " at " in name else f" at {at_m:.0f} m"
    return Row(name + suffix, rate(float(cell[count]), int(cell.trials)), paper, mark)
