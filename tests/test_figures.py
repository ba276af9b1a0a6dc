"""The figures show the numbers they are given, and need no display."""

import numpy as np
import pytest
from matplotlib.image import imread

from tog_mjx.drawing.figures import draw_descents
from tog_mjx.drawing.figures.style import save_figure
from tog_mjx.paper.published import published
from tog_mjx.solving.descent import Descent, Status


def descent(costs) -> Descent:
    costs = np.asarray(costs, float)
    return Descent(costs, np.zeros((len(costs), 2)), np.zeros((len(costs), 2)), Status.EXHAUSTED, 0.0, 0.0)


@pytest.mark.parametrize("task", ["flip", "grasp"])
def test_curves_best_iterates_and_published_traces(task):
    runs = {"exact": descent([2.7, 1.0, 0.1, 0.3]), "stochastic": descent(np.linspace(2.7, 0.5, 400))}
    axes = draw_descents(task, "mjx", runs).axes[0]
    drawn = {line.get_label(): np.asarray(line.get_ydata(), float) for line in axes.lines}
    np.testing.assert_array_equal(drawn["exact gradient"], runs["exact"].costs)
    np.testing.assert_array_equal(drawn["stochastic gradient"], runs["stochastic"].costs)
    np.testing.assert_array_equal(drawn["published, exact"], published(task, "exact").costs)
    points = [np.asarray(line.get_xydata(), float) for line in axes.lines]
    assert {tuple(xy[0]) for xy in points if len(xy) == 1} == {(2.0, 0.1), (399.0, 0.5)}
    assert "iteration" in axes.get_xlabel()
    assert task in axes.get_ylabel()


def test_one_method_alone_and_a_file(tmp_path):
    save_figure(draw_descents("flip", "penalty", {"exact": descent([1.0, 0.5])}), tmp_path / "figure.png")
    image = imread(tmp_path / "figure.png")
    assert image.shape[0] > 400
    assert image.std() > 0.01
