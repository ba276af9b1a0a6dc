"""Results of runs: what a file must hold to count as one."""

import numpy as np
import pytest

from tog_mjx.paper import comparison
from tog_mjx.paper import gradient_agreement as agreement
from tog_mjx.paper.comparison import Run
from tog_mjx.paper.gradient_agreement import MJX, Gradients, Piece
from tog_mjx.running.storage import DamagedFileError, load_result, save_result
from tog_mjx.solving.descent import Status
from tog_mjx.solving.record import load_descent, save_descent

RUN = Run("penalty", "flip", "exact", iterations=2)


@pytest.fixture(scope="module")
def descent():
    return comparison.compute(RUN)


def test_there_and_back_with_what_held_out_starts_say(descent, tmp_path):
    judged = descent._replace(held_out=np.array([2.0, np.nan, np.inf]))
    save_descent(tmp_path / "a.npz", judged, {"seed": 1})
    back, settings = load_descent(tmp_path / "a.npz")
    assert settings == {"seed": 1}
    np.testing.assert_array_equal(back.held_out, judged.held_out)
    save_descent(tmp_path / "a.npz", judged._replace(held_out=np.zeros(2)), {})
    with pytest.raises(DamagedFileError, match="held_out are not numbers of shape"):
        load_descent(tmp_path / "a.npz")


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
        (None, {"costs": np.array([1.0 + 1j, 2.0, 3.0])}, None, {}),
        (None, {"setpoints": np.zeros((2, 2))}, None, {}),
        (None, {"setpoints": np.full((3, 2), np.nan)}, None, {}),
        (None, {}, None, {"seconds_run": float("inf")}),
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
        load_descent(path)


def test_a_result_that_does_not_fit_its_settings_is_damaged(descent, tmp_path):
    """Fewer iterates than it says, or setpoints of another task."""
    short = descent._replace(**{name: getattr(descent, name)[:2] for name in ("costs", "setpoints", "gradients")})
    wide = descent._replace(setpoints=np.zeros((3, 4)), gradients=np.zeros((3, 4)))
    for wrong, message in ((short, "1 iterations, not 2"), (wide, "4 setpoints, not 2")):
        comparison.save(RUN, wrong, tmp_path)
        with pytest.raises(DamagedFileError, match=message):
            comparison.load(RUN, tmp_path)
    comparison.save(RUN, short._replace(status=Status.NON_FINITE), tmp_path)
    assert comparison.load(RUN, tmp_path).iterations == 1


@pytest.mark.parametrize(
    "wrong", [{"gradients": np.zeros((3, 4))}, {"change": np.zeros(3, complex)}, {"seconds_run": float("nan")}]
)
def test_gradients_that_were_kept_are_judged_too(tmp_path, wrong):
    piece, right = Piece("flip", MJX, 3, 0), Gradients(np.zeros((3, 2)), np.full((3, 2), np.nan), np.zeros(3), 0.0, 1.0)
    agreement.save(piece, right, tmp_path)
    assert agreement.load(piece, tmp_path).seconds_run == 1
    agreement.save(piece, right._replace(**wrong), tmp_path)
    with pytest.raises(DamagedFileError, match="mjx"):
        agreement.load(piece, tmp_path)


def test_settings_tell_runs_apart():
    assert RUN.settings() == Run("penalty", "flip", "exact", seed=9, iterations=2).settings()
    for other in (Run("mjx", "flip", "exact", iterations=2), Run("penalty", "flip", "exact", iterations=3)):
        assert RUN.settings() != other.settings()
    seeds = [Run("penalty", "flip", "stochastic", seed=seed).settings() for seed in (0, 1)]
    assert seeds[0] != seeds[1]
