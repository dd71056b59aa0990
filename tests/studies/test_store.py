import json

import jax
import numpy as np
import pytest
import xarray as xr

from jaxtrack.studies import store


@pytest.fixture
def datasets():
    share = np.array([[0.5, np.nan], [1.0, 0.25]])
    scores = xr.Dataset(
        {"share": (("situation", "estimator"), share, {"units": ""})},
        coords={"situation": ["I", "III-56"], "estimator": ["HT", "joint"]},
        attrs={"scenes": 40},
    )
    return {"scores": scores, "times": xr.Dataset({"seconds": ("run", np.arange(3.0))})}


def test_datasets_come_back_as_they_went(tmp_path, datasets):
    store.save(tmp_path, datasets, {"seed": 3})
    back, summary = store.load(tmp_path)
    assert list(back) == ["scores", "times"]
    for name, dataset in datasets.items():
        xr.testing.assert_equal(back[name], dataset)
    assert back["scores"].attrs == {"scenes": 40}
    assert float(back["scores"].share.sel(situation="III-56", estimator="joint")) == 0.25
    assert summary["seed"] == 3


def test_a_later_run_leaves_nothing_of_an_earlier_one(tmp_path, datasets):
    store.save(tmp_path, datasets, {"seed": 3, "more": 1})
    store.save(tmp_path, {"times": datasets["times"]}, {"seed": 4})
    back, summary = store.load(tmp_path)
    assert list(back) == ["times"]
    assert "more" not in summary
    assert not (tmp_path / store.RESULTS / "scores").exists()


def test_the_summary_is_strict_json_and_says_what_made_it(tmp_path):
    entries = {
        "gate": np.float32(2.5),
        "none": float("nan"),
        "rows": [jax.numpy.arange(2)],
        1: True,
    }
    store.save(tmp_path, {"a": xr.Dataset()}, entries)

    def refuse(constant):
        raise AssertionError(constant)

    text = (tmp_path / store.SUMMARY).read_text(encoding="utf-8")
    summary = json.loads(text, parse_constant=refuse)
    assert summary["gate"] == 2.5
    assert summary["none"] is None
    assert summary["rows"] == [[0, 1]]
    assert summary["1"] is True
    made = summary["made_with"]
    assert made["jax"] == jax.__version__
    assert made["dtype"] == "float64"
    assert made["devices"]
