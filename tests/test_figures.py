"""The figures show the numbers they are given, and need no display."""

import numpy as np
import pytest
from matplotlib.image import imread

from tog_mjx.drawing.figures import draw_descents, draw_landscape
from tog_mjx.drawing.figures.style import save_figure
from tog_mjx.paper.outcomes import descents_figure
from tog_mjx.paper.published import published
from tog_mjx.paper.tasks import get_task
from tog_mjx.solving.descent import Descent, Status


def descent(costs) -> Descent:
    costs = np.asarray(costs, float)
    return Descent(costs, np.zeros((len(costs), 2)), np.zeros((len(costs), 2)), Status.EXHAUSTED, 0.0, 0.0)


@pytest.mark.parametrize("task", ["flip", "grasp"])
def test_curves_best_iterates_and_published_traces(task):
    runs = {"exact": descent([2.7, 1.0, 0.1, 0.3]), "stochastic": descent(np.linspace(2.7, 0.5, 400))}
    axes = descents_figure(get_task(task), "mjx", runs).axes[0]
    drawn = {line.get_label(): np.asarray(line.get_ydata(), float) for line in axes.lines}
    np.testing.assert_array_equal(drawn["exact gradient"], runs["exact"].costs)
    np.testing.assert_array_equal(drawn["stochastic gradient"], runs["stochastic"].costs)
    np.testing.assert_array_equal(drawn["published, exact"], published(task, "exact").costs)
    points = [np.asarray(line.get_xydata(), float) for line in axes.lines]
    assert {tuple(xy[0]) for xy in points if len(xy) == 1} == {(2.0, 0.1), (399.0, 0.5)}
    assert "iteration" in axes.get_xlabel()
    assert task in axes.get_ylabel()


def test_one_method_alone_and_a_file(tmp_path):
    save_figure(draw_descents({"exact": np.array([1.0, 0.5])}), tmp_path / "figure.png")
    image = imread(tmp_path / "figure.png")
    assert image.shape[0] > 400
    assert image.std() > 0.01


def test_figures_take_arrays_of_any_problem():
    """Of which the paper knows nothing: neither the names of variables and methods, nor a published run."""
    x, y = np.meshgrid(np.linspace(-3, 1, 5), np.linspace(2, 4, 5))
    surface = np.stack([x, y], -1).reshape(-1, 2), x**2 + y
    path = np.array([[0.5, 3.0, 7.0], [0.2, 2.5, 8.0], [0.4, 2.2, 9.0]]), np.array([3.0, 1.0, 2.0])
    names = ("force of the ram (N)", "tilt (rad)")
    drawn = draw_landscape(surface, np.linspace(2, 9, 8), {"L-BFGS": path}, path[0][0, :2], title="push", names=names)
    axes = drawn.axes[0]
    assert (axes.get_xlabel(), axes.get_ylabel(), axes.get_title(loc="left")) == (*names, "push")
    assert (axes.get_xlim(), axes.get_ylim()) == ((-3, 1), (2, 4))
    lines = {line.get_label(): np.asarray(line.get_xydata()) for line in axes.lines}
    np.testing.assert_array_equal(lines["L-BFGS"], path[0][:, :2])
    (best,) = (line for line in axes.lines if line.get_marker() == "*")
    np.testing.assert_array_equal(np.asarray(best.get_xydata()), [[0.2, 2.5]])
    axes = draw_descents({"L-BFGS": path[1], "exact, adam": path[1] / 2}, title="push").axes[0]
    curves = {line.get_label(): np.asarray(line.get_ydata(), float) for line in axes.lines}
    np.testing.assert_array_equal(curves["L-BFGS"], path[1])
    np.testing.assert_array_equal(curves["exact gradient"], path[1] / 2)
    assert not [name for name in curves if "published" in str(name)]
