import functools
import io
import itertools
import json

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import xarray as xr
from rich.console import Console

from jaxtrack.hough import Grid, Sizes, neutrosophic
from jaxtrack.metrics import MAX_DISCRIMINATION, least_squares_line
from jaxtrack.sensors import crossing_targets, observe
from jaxtrack.studies import STUDIES, Context, store, tables
from jaxtrack.studies.nht import marks
from jaxtrack.studies.nht import report as nht_report
from jaxtrack.studies.nht import scores as nht_scores
from jaxtrack.studies.nht import study as nht
from jaxtrack.studies.nht.times import shape_for
from jaxtrack.studies.nht.trial import FORMS, METHODS, PEAKS, SHAPES, Outcome, forms_of
from jaxtrack.studies.nht.words import target_votes
from jaxtrack.types import Lines


def made_up(situations, share, trials=200):
    """A dataset in which every count is this share of the trials."""
    cells = (2, len(situations), len(METHODS), len(PEAKS))
    full = lambda value: (("match", "situation", "estimator", "peaks"), np.full(cells, value))
    counts = dict.fromkeys(("top_k", "perfect", "found_all"), full(share * trials))
    errors = {
        f"{name}_rmse{end}_{unit}": full(value)
        for name, unit, value in (("rho", "m", 8.0), ("theta", "rad", 0.0045))
        for end in ("", "_lower", "_upper")
    }
    rest = {"trials": full(trials), "false": full(0.01), "false_error": full(0.005)}
    match_m = nht.MATCH_M if "I" in situations else nht.REAL_MATCH_M
    coords = {"match": list(match_m), "situation": list(situations)}
    coords |= {"estimator": list(METHODS), "peaks": list(PEAKS)}
    return xr.Dataset({**counts, **errors, **rest}, coords)


def verdicts(simulated, real):
    rows = marks.rows(simulated, real)
    return {row.what: tables.verdict(row.ours, row.mark) for row in rows}


def test_marks_pass_fail_and_say_smoke():
    all_of = lambda share, n=200: verdicts(
        made_up(nht.SITUATIONS, share, n), made_up(nht.REAL, share, n)
    )
    high, low, few = all_of(1.0), all_of(0.0), all_of(1.0, 10)
    wanted = {name: word for name, word in high.items() if word}
    assert len(wanted) == 13
    assert [name for name, word in wanted.items() if word == "fails"] == [
        "III-56: HT, top 3 at 50 m"
    ]
    passing = [name for name, word in low.items() if word == "pass"]
    assert passing == [
        "III-56: HT, top 3 at 50 m",
        "IV-56: joint, false tracks a run",
        "IV-56: joint, RMSE of ρ",
        "IV-56: joint, RMSE of θ",
    ]
    assert {few[name] for name in wanted} == {"smoke"}


def test_the_mark_of_situation_one_is_held_by_the_worst_method():
    simulated = made_up(nht.SITUATIONS, 1.0)
    simulated.top_k.loc[{"situation": "I", "estimator": "MHT", "peaks": "smoothed"}] = 180
    rows = marks.rows(simulated, made_up(nht.REAL, 1.0))
    assert "MHT smoothed" in rows[0].what
    assert tables.verdict(rows[0].ours, rows[0].mark) == "fails"


@pytest.mark.parametrize(
    ("values", "agree", "against"),
    [
        ([1.0, 5.0, 6.0, 2.0], 4, []),
        ([1.0, 1.0, 6.0, 2.0], 2, ["HT < MHT", "MHT > NHT"]),  # equal numbers are no order
        ([np.nan] * 4, 0, ["HT < MHT", "HT < IHT", "MHT > NHT", "IHT > NHT"]),
    ],
)
def test_orders_are_counted_where_the_papers_words_differ(values, agree, against):
    assert nht_report.agreement(values, ("slight", "serious", "serious", "slight")) == (
        agree,
        against,
    )


def test_the_papers_table_2_is_whole():
    for words in nht_report.WORDS.values():
        assert list(words) == ["discrimination", "divergence", "decline"]
        assert all(len(row) == len(nht_report.COMPARED) for row in words.values())
    assert set(nht_report.WORDS) == set(nht.PRIMARY)


def test_errors_of_lines_that_match_nothing_are_no_numbers():
    methods = list(nht_report.FORMS)
    forms = sorted({form for forms in nht_report.FORMS.values() for form in forms})
    dims = ("match", "situation", "estimator", "peaks")
    whole = lambda value: (dims, np.full((1, 2, len(methods), len(forms)), value))
    scores = xr.Dataset(
        {name: whole(0.5) for name in ("found", "false", "redundant", "theta_rmse_rad")}
        | {"rho_rmse_m": whole(2.0), "trials": whole(30)},
        {"match": [50.0], "situation": ["I", "II"], "estimator": methods, "peaks": forms},
    )
    scores["rho_rmse_m"][0, 1] = scores["theta_rmse_rad"][0, 1] = np.nan
    _, ideal, noise = nht_report.means(scores, "Lines", match_m=50.0).columns
    assert set(ideal.cells) == {"0.50/0.50/0.50\n2.0 m 0.5000"}
    assert set(noise.cells) == {"0.50/0.50/0.50\nnone matched"}


def lines_of(truth, trials, votes=9.0, rho_error_m=0.0):
    """The true lines in every trial, and an empty table's rest."""
    path = jnp.swapaxes(truth.state[..., :2], 0, 1)
    rho, theta = jax.vmap(least_squares_line)(path)
    pad = lambda x: np.broadcast_to(np.pad(np.asarray(x), (0, 5)), (trials, 8)).copy()
    return Lines(
        pad(rho + rho_error_m), pad(theta), pad(np.full(3, votes)), pad(np.ones(3)).astype(bool)
    )


def cell_of(lines, gate=5.0):
    scene = nht.simulated_inputs("IV", 10.0, 10.0)
    trials = len(lines.mask)
    outcome = Outcome(
        None,
        {("joint", "raw"): lines},
        {("joint", "raw"): np.zeros(trials, bool)},
        {"HT": np.full((trials, 3), 2.0)},
        {"HT": np.full((trials, 3), 0.25)},
    )
    gates = {("joint", "raw"): gate}
    return nht_scores.Cell("IV-10", SHAPES["10"], scene, jax.random.key(0), gates, outcome)


def test_scores_of_known_lines():
    truth = crossing_targets("IV", 10.0).truth
    lines = lines_of(truth, 6, rho_error_m=3.0)
    lines.votes[0, 0] = 4.0  # below the gate in one trial
    lines.mask[1, 3], lines.votes[1, 3], lines.rho_m[1, 3] = True, 7.0, -3000.0  # false in another
    scores = nht_scores.dataset([cell_of(lines)], (50.0, 2.0))
    at = {"situation": "IV-10", "estimator": "joint", "peaks": "raw"}
    wide, narrow = scores.sel(at).sel(match=50.0), scores.sel(at).sel(match=2.0)
    assert int(wide.trials) == 6
    assert int(wide.perfect) == 4
    assert int(wide.found_all) == 5
    assert int(wide.top_k) == 6
    assert float(wide.false) == pytest.approx(1 / 6)
    assert float(wide.found) == pytest.approx(17 / 6)
    assert float(wide.rho_rmse_m) == pytest.approx(3.0)
    assert float(wide.discrimination) == pytest.approx(MAX_DISCRIMINATION)
    assert int(narrow.top_k) == 0
    assert float(scores.divergence.sel(situation="IV-10", estimator="HT")) == 2.0
    assert np.isnan(scores.top_k.sel(estimator="HT")).all()


def test_gates_let_the_stated_rate_pass():
    rng = np.random.default_rng(1)
    votes = np.sort(rng.exponential(size=(400, 8)))[:, ::-1].copy()
    lines = Lines(votes, votes, votes, np.ones((400, 8), bool))
    outcome = Outcome(None, {("HT", "raw"): lines, ("joint", "raw"): lines}, {}, {}, {})
    gates = nht_scores.derive_gates(outcome)
    assert (votes >= gates["HT", "raw"]).sum() == 20
    assert (votes >= gates["joint", "raw"]).sum() == 8
    table = nht_scores.gates_dataset({"10": gates}, 400).gate
    assert float(table.sel(clutter="10", estimator="HT", peaks="raw")) == gates["HT", "raw"]


def test_every_form_is_looked_at_and_only_cells_are_smoothed():
    assert set(forms_of(SHAPES["10"])) == {(m, form) for m in METHODS for form in FORMS[m]}
    assert {form for _, form in forms_of(SHAPES["real"])} == {"raw"}
    assert [m for m in METHODS if "smoothed" in FORMS[m]] == ["HT", "MHT", "IHT", "NHT"]


def test_arrays_for_run_times_hold_the_clutter_they_are_made_for():
    sizes = [shape_for(clutter) for clutter in (0.0, 10.0, 56.0, 112.0)]
    for smaller, larger in itertools.pairwise(sizes):
        assert all(a <= b for a, b in zip(smaller[:6], larger[:6], strict=True))
    assert sizes[1].detections >= 26
    assert sizes[1].gated_pairs >= 121
    assert sizes[1].hypotheses >= 1863
    assert sizes[2][:5] == SHAPES["56"][:5]


@functools.cache
def words(situation):
    scene = crossing_targets(situation, 10.0)
    radar = scene.radar._replace(p_detect=1.0)
    params = neutrosophic.NeutrosophicParams(Grid())
    sizes = Sizes(pairs=192, predecessors=24)

    @jax.jit
    def run(key):
        scans = observe(key, scene.truth, radar, detections=32)
        return target_votes(scans, scene.truth, params, sizes)

    return jax.tree.map(np.asarray, jax.vmap(run)(jax.random.split(jax.random.key(0), 40)))


def test_without_noise_a_targets_votes_meet_in_one_cell():
    divergence, decline = words("III")
    for method in nht_report.COMPARED:
        assert divergence[method].max() < 0.5
        # A true line on the border of two cells may part its votes by rounding.
        assert np.median(decline[method]) == pytest.approx(0.0, abs=1e-6)


@pytest.mark.slow
def test_noise_scatters_pairs_more_than_detections():
    divergence, decline = words("II")
    # A detection's curve passes the true line at σ / Δρ = 2 cells.
    assert divergence["HT"].mean() == pytest.approx(2.0, abs=0.2)
    assert divergence["MHT"].mean() > 5 * divergence["HT"].mean()
    assert divergence["NHT"].mean() < divergence["MHT"].mean()
    assert decline["HT"].mean() < decline["MHT"].mean()
    np.testing.assert_array_equal(divergence["IHT"], divergence["MHT"])


@pytest.mark.slow
def test_a_tiny_run_writes_all_its_files_and_gives_no_verdict(tmp_path):
    screen = io.StringIO()
    counted = {}
    report = lambda what, done, total: counted.__setitem__(what, (done, total))
    context = Context(tmp_path, 2, 7, Console(file=screen, width=160), report)
    STUDIES["nht"].run(context)

    text = screen.getvalue()
    assert "smoke" in text
    assert "pass" not in text
    assert "fails" not in text
    groups, summary = store.load(tmp_path)
    assert list(groups) == ["gates", "simulated", "real", "times"]
    assert list(groups["simulated"].situation.values) == list(nht.SITUATIONS)
    # The joint vote's table of pairs is full now and then, which is reported.
    others = groups["simulated"].overflow.drop_sel(estimator="joint")
    assert float(others.max()) == 0.0
    assert (groups["times"].seconds > 0).all()
    assert summary["seed"] == 7
    assert {row["verdict"] for row in summary["marks"]} == {"smoke", ""}
    json.dumps(summary, allow_nan=False)
    figures = {path.name.split("_")[1] for path in tmp_path.glob("figure_*.png")}
    assert figures == {"02", *(f"{n:02}" for n in range(4, 16))}
    assert len(list(tmp_path.glob("*.png"))) == 19
    assert all(done == total for done, total in counted.values())

    # The same seed gives the same results, another one others.
    gates, _ = nht.derive(context)
    cells, again = nht.simulate_all(context, gates), nht.simulate_all(context, gates)
    other = nht.simulate_all(context._replace(seed=8), gates)
    for name, cell in cells.items():
        jax.tree.map(np.testing.assert_array_equal, cell.outcome, again[name].outcome)
        same = cell.outcome.scans.position_m == other[name].outcome.scans.position_m
        assert not same.all()
    assert named(gates) == summary["gates"]


def named(gates):
    return {name: {" ".join(at): x for at, x in table.items()} for name, table in gates.items()}
