"""Figures on disk carry their title and what they show, in words."""

import numpy as np
import pytest

from jaxtrack import plots
from jaxtrack.plots.saving import described
from jaxtrack.studies.report.papers import texts_in


def panels(*names):
    curve = (np.arange(3.0), np.ones(3), np.full(3, 0.1))
    return {name: {"joint": curve, "σ known": curve} for name in names}


def test_titles_panels_axes_and_keys_are_told():
    figure = plots.error_curves(
        panels("Noise", "Clutter"), x_label="σ, m", y_label="OSPA, m", title="Errors"
    )
    text = described(figure)
    assert text.startswith("Errors. Noise: OSPA, m mean")
    assert "Clutter: " in text
    assert "over σ, m" in text
    assert text.endswith("Shown: joint, σ known.")


def test_colours_and_spaces_without_axes_are_told():
    votes = np.arange(30.0).reshape(5, 6)
    both = {"standard": votes, "joint": votes}
    figure = plots.accumulations(both, 100.0, title="Votes", marks=[(10.0, 1.0)])
    text = described(figure)
    assert text.startswith("Votes. standard")
    assert "joint" in text
    figure = plots.loss_map(
        np.arange(3.0), np.arange(4.0), np.ones((3, 4)), {}, x_label="a", y_label="b"
    )
    assert "Colours: mean loss" in described(figure)


@pytest.mark.parametrize(("title", "told"), [("Errors by σ", "Errors by σ"), ("", "a figure")])
def test_a_file_has_both_inside_and_is_the_same_twice(tmp_path, title, told):
    figure = plots.error_curves(panels(""), x_label="σ, m", y_label="OSPA, m", title=title)
    path = tmp_path / "a_figure.png"
    plots.save(figure, path)
    png = path.read_bytes()
    words = texts_in(png)
    assert words["Title"] == told
    assert words["Description"] == described(figure)
    plots.save(figure, path)
    assert path.read_bytes() == png
