import jax
import numpy as np
import pytest
from rich.console import Console

from jaxtrack.studies import parts
from jaxtrack.studies.registry import Context


def noise(key, params):
    return {"far": params["sigma_m"] * jax.random.normal(key, (2,)), "seen": params["sigma_m"] > 1}


@pytest.fixture
def context(tmp_path):
    return Context(tmp_path, 5, 0, Console(quiet=True), lambda *_: None)


def run(context, seed=0, trials=5, sigma_m=2.0):
    return parts.run_part(
        context, "IV-56", noise, jax.random.key(seed), trials, {"sigma_m": sigma_m}
    )


def test_what_is_there_is_not_computed_again(context, monkeypatch):
    first = run(context)
    monkeypatch.setattr(parts, "monte_carlo", lambda *_, **__: pytest.fail("computed again"))
    again = run(context)
    assert again.keys() == first.keys()
    for name in first:
        np.testing.assert_array_equal(again[name], first[name])
        assert again[name].dtype == first[name].dtype


@pytest.mark.parametrize("change", [{"seed": 1}, {"trials": 4}, {"sigma_m": 3.0}])
def test_another_run_does_not_take_it(context, change):
    run(context)
    changed = run(context, **change)
    fresh = run(context._replace(out=context.out / "fresh"), **change)
    np.testing.assert_array_equal(changed["far"], fresh["far"])
    assert len(changed["far"]) == change.get("trials", 5)


def test_another_program_does_not_take_it(context, monkeypatch):
    run(context)
    monkeypatch.setattr(parts, "_program", lambda: "another")
    with monkeypatch.context() as within:
        within.setattr(parts, "monte_carlo", lambda *_, **__: (_ for _ in ()).throw(KeyError))
        with pytest.raises(KeyError):
            run(context)


def test_an_interrupted_write_is_no_part(context):
    first = run(context)
    folder = context.out / parts.FOLDER
    (folder / "IV-56.npz").rename(folder / "IV-56.half.npz")
    np.testing.assert_array_equal(run(context)["far"], first["far"])
    assert [file.name for file in folder.iterdir()] == ["IV-56.npz"]


def test_nothing_stays_when_results_are_saved(context):
    run(context)
    parts.forget_parts(context)
    assert not any(context.out.iterdir())
