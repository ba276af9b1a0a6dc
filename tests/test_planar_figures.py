"""Figures 1, 2, 4, 5 and 7 by what was drawn."""

import matplotlib.colors
import numpy as np
import pytest
from matplotlib.contour import QuadContourSet
from matplotlib.patches import Polygon
from states import state_of_box

from tog_mjx.drawing.figures.fading import SNAPSHOTS
from tog_mjx.engines.many import Motions
from tog_mjx.paper.gallery import table_1
from tog_mjx.paper.outcomes import LEVELS, best_motions, landscape_figure, motions_figure
from tog_mjx.paper.setups import draw_setups
from tog_mjx.paper.tasks import get_task
from tog_mjx.solving.descent import Descent, Status
from tog_mjx.studies.landscape import Landscape

HALF = 0.25


def corners(x: float, z: float, theta: float) -> np.ndarray:
    """Of the box, sorted."""
    c, s = np.cos(theta), np.sin(theta)
    square = HALF * np.array([[-1, -1], [-1, 1], [1, -1], [1, 1]])
    return in_order(square @ np.array([[c, s], [-s, c]]) + [x, z])


def in_order(points: np.ndarray) -> np.ndarray:
    return points[np.lexsort(points.T.round(6))]


def boxes(axes) -> list[Polygon]:
    return [patch for patch in axes.patches if patch.get_gid() == "box"]


def vertices(patch: Polygon) -> np.ndarray:
    return in_order(np.asarray(patch.get_xy())[:-1])


def descent(setpoints: np.ndarray, costs: list[float]) -> Descent:
    return Descent(np.array(costs), setpoints, np.zeros_like(setpoints), Status.EXHAUSTED, 0.0, 0.0)


def test_figure_1_shows_start_goal_and_guess():
    tasks = [get_task("flip"), get_task("grasp")]
    for axes, task in zip(draw_setups(tasks).axes, tasks, strict=True):
        start, goal = boxes(axes)
        np.testing.assert_allclose(vertices(start), corners(*task.scene.start[0][:3]), atol=1e-9)
        np.testing.assert_allclose(vertices(goal), corners(*task.goal), atol=1e-9)
        (guess,) = (line for line in axes.lines if line.get_label() == "setpoints, initial guess")
        np.testing.assert_allclose(np.asarray(guess.get_xydata()).ravel(), task.initial_guess)
        assert "(m)" in axes.get_xlabel()


@pytest.mark.parametrize("name", ["flip", "grasp"])
def test_the_goal_costs_nothing(name):
    task = get_task(name)
    assert float(task.cost(state_of_box(task, [*task.goal, 0, 0, 0]))) == 0


def test_figures_2_and_5_show_costs_guess_and_paths():
    task = get_task("grasp")
    points = task.plane.grid(20)
    costs = np.hypot(*points.T).reshape(20, 20)
    costs[3, 4] = np.nan
    path = np.array([[-0.05, 0.25, 0.05, 0.25], [0.1, 0.7, -0.1, 0.7], [0.2, 0.9, -0.2, 0.9]])
    figure = landscape_figure(task, "mjx", Landscape(points, costs), {"exact": descent(path, [0.5, 0.1, 0.3])})
    axes, bar = figure.axes
    (filled,) = (found for found in axes.collections if isinstance(found, QuadContourSet))
    np.testing.assert_array_equal(filled.levels, LEVELS["grasp"])
    drawn = {line.get_label(): np.asarray(line.get_xydata()) for line in axes.lines}
    np.testing.assert_array_equal(drawn["exact gradient"], path[:, :2])
    np.testing.assert_array_equal(drawn["initial guess"], path[:1, :2])
    best = [line for line in axes.lines if line.get_marker() == "*"]
    np.testing.assert_array_equal(np.asarray(best[0].get_xydata()), path[1:2, :2])
    assert (axes.get_xlim(), axes.get_ylim()) == task.window
    assert axes.get_xlabel() == "setpoint x of the left finger (m)"
    assert "cost" in bar.get_ylabel()


def test_figures_4_and_7_show_fading_boxes_tracks_and_setpoints():
    task = get_task("flip")
    moments = np.linspace(0, 1, 31)
    box = np.stack([moments - 1, 0.25 + 0 * moments, np.pi / 2 * (1 - moments), *np.zeros((3, 31))], axis=1)
    fingers = np.stack([moments - 1.3, 0.4 + moments, *np.zeros((2, 31))], axis=1)[:, None]
    setpoints = {"initial guess": np.array([0.2, 1.2]), "exact, best": np.array([0.2, 1.2])}
    motions = Motions(moments, np.stack([box, box]), np.stack([fingers, fingers]), np.array([0.123, 0.123]))
    figure = motions_figure(task, "penalty", setpoints, motions)
    assert [axes.get_title(loc="left") for axes in figure.axes] == [
        "initial guess: J = 0.1230",
        "exact, best: J = 0.1230",
    ]
    axes = figure.axes[1]
    drawn = boxes(axes)
    assert len(drawn) == SNAPSHOTS
    np.testing.assert_allclose(vertices(drawn[0]), corners(*box[0, :3]), atol=1e-9)
    np.testing.assert_allclose(vertices(drawn[3]), corners(*box[15, :3]), atol=1e-9)
    np.testing.assert_allclose(vertices(drawn[-1]), corners(*box[-1, :3]), atol=1e-9)
    alphas = [matplotlib.colors.to_rgba(patch.get_facecolor())[3] for patch in drawn]
    assert np.all(np.diff(alphas) > 0)
    assert alphas[-1] == 1
    lines = {line.get_label(): np.asarray(line.get_xydata()) for line in axes.lines}
    np.testing.assert_array_equal(lines["path of a finger"], fingers[:, 0, :2])
    np.testing.assert_array_equal(lines["setpoint"], [[0.2, 1.2]])


def test_table_1_is_the_papers():
    table = table_1([get_task("flip"), get_task("grasp")])
    assert table.header == ["setting", "box flip", "box grasp"]
    assert ["step, exact: alpha_1", "0.1", "0.5"] in table.rows
    assert ["iterations, stochastic", "10", "1000"] in table.rows
    assert ["sigma (m)", "0.5", "0.1"] in table.rows
    assert ["initial guess u (m)", "0, 0.25", "-0.05, 0.25, 0.05, 0.25"] in table.rows


def test_the_best_motions_end_at_the_costs_of_the_descent():
    task = get_task("flip")
    setpoints = np.array([task.initial_guess, [0.3, 0.9]])
    cost = 0.1
    under, motions = best_motions(task, "penalty", {"exact": descent(setpoints, [2.68, cost])})
    assert list(under) == ["initial guess", "exact, best"]
    np.testing.assert_array_equal(list(under.values()), setpoints)
    np.testing.assert_allclose(motions.costs[0], 2.6816, atol=1e-4)  # As the README's table has it.
    for box, found in zip(motions.box, motions.costs, strict=True):
        np.testing.assert_allclose(found, box[-1, 0] ** 2 + box[-1, 2] ** 2)
        np.testing.assert_allclose(box[0], task.scene.start[0])
