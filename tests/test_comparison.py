"""Results of runs: what a file must hold to count as one."""

import numpy as np
import pytest

from tog_mjx import comparison
from tog_mjx.comparison import Run
from tog_mjx.storage import DamagedFileError, load_result, save_result

RUN = Run("penalty", "flip", "exact", iterations=2)


@pytest.fixture(scope="module")
def descent():
    return comparison.compute(RUN)


def test_there_and_back(descent, tmp_path):
    comparison.save(RUN, descent, tmp_path)
    back = comparison.load(RUN, tmp_path)
    for name in ("costs", "setpoints", "gradients"):
        np.testing.assert_array_equal(getattr(back, name), getattr(descent, name))
    assert back[3:] == descent[3:]


@pytest.mark.parametrize(
    ("arrays_without", "arrays_with", "attributes_without", "attributes_with"),
    [
        ("costs", {}, None, {}),
        (None, {"costs": np.array([])}, None, {}),
        (None, {"costs": np.array([1.0, np.nan, 2.0])}, None, {}),
        (None, {"costs": np.array(["a", "b", "c"])}, None, {}),
        (None, {"setpoints": np.zeros((2, 2))}, None, {}),
        (None, {}, "settings", {}),
        (None, {}, None, {"settings": [1]}),
        (None, {}, None, {"status": "perhaps"}),
        (None, {}, "seconds_run", {}),
    ],
)
def test_a_file_that_is_no_whole_result_is_damaged(
    descent, tmp_path, arrays_without, arrays_with, attributes_without, attributes_with
):
    comparison.save(RUN, descent, tmp_path)
    path = RUN.path(tmp_path)
    arrays, attributes = load_result(path)
    arrays, attributes = arrays | arrays_with, attributes | attributes_with
    arrays.pop(arrays_without, None)
    attributes.pop(attributes_without, None)
    save_result(path, arrays, attributes)
    with pytest.raises(DamagedFileError, match=r"exact\.npz"):
        comparison.read(path)


def test_settings_tell_runs_apart():
    assert RUN.settings() == Run("penalty", "flip", "exact", seed=9, iterations=2).settings()
    for other in (Run("mjx", "flip", "exact", iterations=2), Run("penalty", "flip", "exact", iterations=3)):
        assert RUN.settings() != other.settings()
    seeds = [Run("penalty", "flip", "stochastic", seed=seed).settings() for seed in (0, 1)]
    assert seeds[0] != seeds[1]
