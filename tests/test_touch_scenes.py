"""Gradients with jumps on MJX, scene by scene: the table is that of its numbers, and they are those of the code."""

import runpy
from pathlib import Path

import jax.numpy as jnp
import numpy as np
import pandas as pd
import pytest

FOLDER = Path(__file__).parent.parent / "scripts" / "findings"
PAGE = (FOLDER / "touch.md").read_text()
TABLE = pd.read_csv(FOLDER / "touch_scenes.csv")


@pytest.fixture(scope="module")
def study() -> dict:
    return runpy.run_path(str(FOLDER / "touch_scenes.py"))


def test_the_table_is_that_of_the_numbers(study):
    assert list(TABLE.scene.unique()) == [scene["name"] for scene in study["scenes"]()]
    said = [line for line in PAGE.splitlines() if " ms | " in line]
    assert said == study["page"](TABLE).splitlines()


@pytest.mark.parametrize("name", ["limit of a hinge", "limit of a tendon", "bounce, margin with gap"])
def test_the_numbers_are_those_of_the_code(study, name):
    timestep = 0.002
    (row,) = TABLE[(TABLE.scene == name) & (TABLE.timestep == timestep)].itertuples()
    scene = next(scene for scene in study["scenes"]() if scene["name"] == name)
    function = study["function_of"](scene, timestep)
    at = study["window"](scene["half"], study["POINTS"])
    values, slopes = study["derivatives"](function, "saltation")(jnp.asarray(at), timestep, function.steps)
    np.testing.assert_allclose(values[::16], study["in_c"](function, at[::16]), rtol=0, atol=1e-9)
    np.testing.assert_allclose(study["mean"](scene, np.asarray(slopes)), row.saltation, rtol=1e-4)
    np.testing.assert_allclose(study["slope"](scene, timestep), row.slope, rtol=1e-4)
    left, before = abs(row.saltation - row.slope), abs(row.autodiff - row.slope)
    assert left <= (1 - study["BARS"][timestep]) * before
