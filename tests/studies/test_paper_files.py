"""The papers' studies as files: they fit their functions, and say what their studies say."""

import pathlib
import re

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxtrack.sensors import motion_elements_scene, situations
from jaxtrack.studies.ccm import looks
from jaxtrack.studies.ccm import trial as ccm_trial
from jaxtrack.studies.csht import cells as csht_cells
from jaxtrack.studies.csht import paper as csht_paper
from jaxtrack.studies.csht import report
from jaxtrack.studies.csht import trial as csht_trial
from jaxtrack.studies.design import design_of, read_design
from jaxtrack.studies.functions import shipped_studies, shipped_study
from jaxtrack.studies.moment import paper as moment_paper
from jaxtrack.studies.moment import trial as moment_trial
from jaxtrack.studies.nht import scenes, scores
from jaxtrack.studies.nht import trial as nht_trial
from jaxtrack.studies.run import run_study
from jaxtrack.studies.tracking import trial as tracking_trial
from jaxtrack.studies.trials import programs_of, variables_of

KEY = jax.random.key(11)
# A method and the fewest cells of each study that tests run.
TINY = {
    "ccm": "known",
    "ccm_pings": "known",
    "ccm_side_by_side": "known",
    "crossing": "improved",
    "csht_estimation": "SHT",
    "csht_estimation_noise": "SHT",
    "csht_tracking": "kalman_paper",
    "csht_tracking_noise": "kalman_paper",
    "moment_tracking": "shape",
    "nht": "MHT",
    "nht_radar": "MHT",
    "nht_sparse": "MHT",
}


def reduced(name, methods, **cell):
    """The file with some of its methods, in one cell: that of its fields' last values."""
    file = shipped_study(name)
    whole = read_design(file)
    text = file.read_text(encoding="utf-8").partition("\n[[compare]]")[0]
    for method in whole.methods:
        if method.name not in methods:
            text = re.sub(rf"\[method\.{method.name}\]\n(?:[^\[\n].*\n)*", "", text)
    one = lambda field, values: cell.get(field, values[-1])
    for part in (whole.scene, *whole.methods):
        for field, values in part.grid.items():
            value = one(field, values)
            shown = f'"{value}"' if isinstance(value, str) else f"{value}"
            text = re.sub(rf"^{field} = {{ grid = .* }}", f"{field} = {shown}", text, flags=re.M)
    text = re.sub(r"^trials = .*", "trials = 2", text, flags=re.M)
    text = re.sub(r"^chunk = .*", "chunk = 2", text, flags=re.M)
    text = re.sub(r"^micro_batch = .*", "micro_batch = 1", text, flags=re.M)
    text = re.sub(r"^until = .*", "", text, flags=re.M)
    return design_of(text, file.parent, name)


def figures(name, method, **cell):
    """What a file's metrics say of trial `KEY` in one cell."""
    (program,) = programs_of(reduced(name, (method,), **cell))
    first = jax.tree.map(lambda x: x[0], program.params)
    return jax.jit(program.trial)(KEY, first)


def equal(found, wanted):
    assert set(found) == set(wanted)
    for name, value in wanted.items():
        np.testing.assert_allclose(found[name], value, rtol=1e-7, err_msg=name)


def test_every_study_is_tried_and_told_of():
    assert set(TINY) == set(shipped_studies())
    told = (pathlib.Path(__file__).parents[2] / "docs" / "studies.md").read_text()
    assert set(re.findall(r"^\| `(\w+)` \|", told, re.M)) == set(TINY)
    with pytest.raises(ValueError, match="there are: ccm, "):
        shipped_study("nothing")


@pytest.mark.parametrize("name", TINY)
def test_a_file_fits_its_functions(name):
    design = read_design(shipped_study(name))
    assert f"jaxtrack study run {name}\n" in design.file.text
    assert design.trials % design.chunk == 0
    variables = variables_of(design, programs_of(reduced(name, (TINY[name],))))
    assert set(variables) == {f"{TINY[name]}.{metric.name}" for metric in design.metrics}


def compared(study, name, metric, method, **fields):
    """What a file says in a cell; None where nothing."""
    found = [
        one.at(fields)
        for one in read_design(shipped_study(study)).compare
        if (one.name, metric in one.metrics, method in one.methods) == (name, True, True)
    ]
    (figure,) = [figure for figure in found if figure is not None] or [None]
    return figure


def test_every_papers_file_is_compared_with_its_paper():
    for name in set(TINY) - {"crossing"}:
        design = read_design(shipped_study(name))
        assert all(one.source for one in design.compare)
        wanted = "paper's claim" if name == "ccm_side_by_side" else "paper"
        assert any(wanted in f"{one.name} {one.source}" for one in design.compare), name


def test_bounds_of_the_files_are_the_marks_of_the_studies():
    for cell in csht_cells.CELLS:
        study = "csht_estimation" if cell.sigma_m == 3.0 else "csht_estimation_noise"
        fields = {"false_alarms": "literal", **cell._asdict()}
        of = lambda metric, at=(study, fields): compared(at[0], "wanted", metric, "joint", **at[1])
        mark, _ = report._wanted(*cell)
        assert of("number_right") == (None if mark is None else mark.bound)
        what = "RATES" if cell.sigma_m == 3.0 else "SIGMA"
        printed = getattr(csht_paper, f"POSITION_BY_{what}")["CSHT"]
        if cell.p_miss > 0.3:
            assert of("position_ospa_m") is None
        elif what == "RATES":
            place = csht_paper.RATES.index(cell.p_miss), csht_paper.RATES.index(cell.p_false)
            assert of("position_ospa_m") == printed[place]
        else:
            assert of("position_ospa_m") == printed[csht_paper.SIGMAS_M.index(cell.sigma_m)]


def test_the_buckets_distances_are_those_of_the_papers_tables():
    for motion, name in enumerate(("static", "hovering", "following")):
        for features in ("hu", "zernike"):
            for optimised, word in enumerate(("", ", optimised")):
                cell = {"motion": motion, "surroundings": 0, "moments.features": features}
                cell["moments.optimised"] = optimised
                figure = compared("moment_tracking", "paper", "s_m", "moments", **cell)
                printed = moment_paper.TABLES[name].get(features + word)
                assert figure == (printed and printed.s_m)


@pytest.mark.slow
@pytest.mark.parametrize("name", sorted(set(TINY) - {"csht_tracking"}))
def test_two_trials_of_a_file_run(name, tmp_path):
    outcome = run_study(reduced(name, (TINY[name],)), tmp_path)
    assert outcome.complete
    assert np.isfinite(list(outcome.found.mean.data_vars.values())).all()


def test_two_trials_of_the_quickest_run(tmp_path):
    ideal = {"sigma_m": 0.0, "clutter_per_scan": 0.0}
    outcome = run_study(reduced("nht_sparse", ("IHT",), **ideal), tmp_path)
    assert outcome.complete
    assert float(outcome.found.mean["IHT.perfect"]) == 1.0


@pytest.mark.slow
def test_sonar_windows_are_the_studys():
    for variant, rates in (
        ("literal", csht_cells.Rates(0.3, 0.5, 3.0)),
        ("one a scan", csht_cells.Rates(0.1, 0.7, 3.0)),
    ):
        sonar = csht_cells.sonar_of(variant, rates)
        place = csht_cells.CELLS.index(rates)
        gate = jnp.asarray(csht_cells.shipped_gates()[variant][place])
        inputs = csht_trial.Inputs(motion_elements_scene()._replace(sonar=sonar), gate)
        one = jax.jit(csht_trial.trial(csht_cells.VARIANTS[variant].false_alarms))
        outcome = one(KEY, inputs)
        for name in ("SHT", "CSHT", "joint", "floor"):
            errors = outcome.errors[name]
            cell = {"false_alarms": variant, "p_miss": rates.p_miss, "p_false": rates.p_false}
            equal(
                figures("csht_estimation", name, **cell),
                {
                    "number_right": errors.count == outcome.targets,
                    "position_ospa_m": errors.position_m,
                    "velocity_ospa_m_s": errors.velocity_m_s,
                },
            )


@pytest.mark.slow
def test_crossing_targets_are_the_studys():
    design = read_design(shipped_study("nht_sparse"))
    gates = {method.name: method.fields["gate"] for method in design.methods}
    inputs = scenes.simulated_inputs("IV", 10.0, 10.0, gates["joint"])
    outcome = jax.jit(nht_trial.trial(nht_trial.SHAPES["10"]))(KEY, inputs)
    for name, at in {
        "joint": ("joint", "raw"),
        "MHT_smoothed": ("MHT", "smoothed"),
        "NHT_wide": ("NHT wide", "raw"),
    }.items():
        score = scores.scores(outcome.lines[at], inputs.truth, 50.0, gates[name])
        wanted = {"top_3": score.top_k, "perfect": score.perfect}
        wanted |= {"found": score.found, "false": score.false}
        equal(figures("nht_sparse", name, sigma_m=10.0, clutter_per_scan=10.0), wanted)


@pytest.mark.slow
@pytest.mark.parametrize("source", ["echoes", "centroids"])
def test_meetings_are_the_studys(source):
    situation = situations()["C" if source == "echoes" else "B"]
    known = looks.known_of(source, situation.sensor)
    inputs = ccm_trial.Inputs(situation, looks.SOURCES.index(source), known, 1e-3)
    outcome = jax.jit(ccm_trial.trial)(KEY, jax.tree.map(jnp.asarray, inputs))
    cell = {"angle_deg": 60.0, "clutter_per_m2": 0.02, "echoes": 4.0, "source": source}
    name = "ccm" if source == "echoes" else "ccm_pings"
    for rule in ("jpda", "cloud", "known"):
        score = outcome.scores[rule]
        wanted = {"swapped_or_lost": score.swap | score.loss, "squared_m2": score.squared_m2.mean()}
        equal(figures(name, rule, **cell), wanted)


@pytest.mark.slow
def test_sweeps_of_the_bucket_are_the_studys():
    scene = moment_trial.SCENES.index(("hovering", "two_objects"))
    inputs = jax.tree.map(jnp.asarray, moment_trial.Inputs(scene, moment_trial.DraggedBucket()))
    outcome = jax.jit(moment_trial.trial)(KEY, inputs)
    gap_m = np.linalg.norm(outcome.error_m, axis=-1)
    crossed = np.asarray(outcome.crossed)
    cell = {"motion": 1, "surroundings": 1, "features": "zernike", "optimised": 1}
    for method, name in (("moments", "zernike, optimised"), ("shape", "shape")):
        gap = gap_m[moment_trial.METHODS.index(name)]
        wanted = {"s_m": gap[crossed].mean(), "lost": gap[-5:].mean() > 3.0}
        equal(figures("moment_tracking", method, **cell), wanted)


@pytest.mark.slow
def test_targets_that_come_and_go_are_the_studys():
    inputs = tracking_trial.inputs_of(csht_cells.Rates(0.1, 0.3, 3.0))
    outcome = jax.jit(tracking_trial.trial("per_beam"))(KEY, inputs)
    cell = {"false_alarms": "per_beam", "p_miss": 0.1, "p_false": 0.3}
    for method, name in (("CSHT", "hough CSHT"), ("kalman_paper", "kalman paper")):
        wanted = {}
        for truth, word in (("visible", ""), ("table", "_table_7")):
            score = outcome.scores[truth][name]
            wanted |= {
                f"cardinality{word}_m": score.cardinality.mean(),
                f"localization{word}_m": score.localization.mean(),
                f"ospa{word}_m": score.distance.mean(),
            }
        equal(figures("csht_tracking", method, **cell), wanted)
