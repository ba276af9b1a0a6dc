"""What the page on touch-downs says is so: its table is that of its numbers, and they are those of the code."""

import re
import runpy
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from tog_mjx.engines import precision

FOLDER = Path(__file__).parent.parent / "scripts" / "findings"
PAGE = (FOLDER / "touch.md").read_text()
TABLE = pd.read_csv(FOLDER / "touch.csv")


@pytest.fixture(scope="module")
def study() -> dict:
    return runpy.run_path(str(FOLDER / "touch.py"))


def test_the_table_is_that_of_the_numbers(study):
    said = re.findall(r"^\| (flip|grasp) \| (.*?) \|$", PAGE.partition("## What it gives")[2], re.MULTILINE)
    found = study["summary"](TABLE)
    assert len(said) == len(found) == 18
    kept = pd.read_csv(FOLDER / "touch_table.csv")
    pd.testing.assert_frame_equal(kept, found, rtol=1e-4)
    for (task, cells), row in zip(said, found.itertuples(index=False), strict=True):
        mm, gradient, *numbers = cells.replace("*", "").split(" | ")
        assert (task, mm, gradient) == (row.task, f"{row.sigma * 1e3:.0f} mm", row.gradient)
        for said_number, number in zip(numbers, row[3:10], strict=True):
            digits = len(said_number.partition(".")[2])
            np.testing.assert_allclose(float(said_number), number, rtol=0, atol=0.5001 * 10**-digits)


@pytest.mark.parametrize("task", ["flip", "grasp"])
def test_the_gradients_are_those_of_the_code(study, task):
    rows = TABLE[(TABLE.task == task) & (TABLE.sigma == 0.003)]
    with precision("penalty"):
        found = study["gradients"](task, study["points"](task))
        truth, noise = study["smoothed"](task, study["points"](task)[:4], (0.003,), pairs=64)
    for name, gradients in found.items():
        np.testing.assert_allclose(gradients, rows[[f"{name}, x", f"{name}, z"]], rtol=1e-5, atol=1e-9)
    kept = rows[["smoothed, x", "smoothed, z"]].to_numpy()[:4]
    apart, size = np.linalg.norm(truth[:, 0] - kept, axis=1), np.linalg.norm(truth[:, 0], axis=1)
    assert (apart <= (4 * noise[:, 0] + 1e-5) * size).all()  # 1e-5: the digits kept.


def test_where_the_paper_lifts_the_box_autodiff_and_the_landscape_disagree(study):
    with precision("penalty"):
        at = study["lifting_point"]()
        found = study["gradients"]("grasp", at[None])
        truth, noise = study["smoothed"]("grasp", at[None], (0.003,), pairs=256)
    np.testing.assert_allclose(at, (-0.0382, 0.5336), rtol=0, atol=5e-5)
    np.testing.assert_allclose(found["autodiff"][0], (-0.224, -0.750), rtol=0, atol=5e-4)
    np.testing.assert_allclose(found["saltation"][0], (0.016, 0.026), rtol=0, atol=6e-4)
    smoothed = np.array([0.014, 0.029])
    assert np.linalg.norm(truth[0, 0] - smoothed) < 4 * noise[0, 0] * np.linalg.norm(smoothed)
    assert noise[0, 0] < 0.25


def test_over_many_jumps_the_gradient_with_the_jumps_is_the_slope(study):
    with precision("penalty"):
        at = study["points"]("grasp")[0]
        found = study["across"](at)
    np.testing.assert_allclose(at, (0.274, 0.540), rtol=0, atol=5e-4)
    np.testing.assert_allclose([found["J"], found["saltation"], found["autodiff"]], (-0.057, -0.047, -0.002), atol=5e-4)
