"""Many points: the values are those of the function, and a killed computation goes on where it was."""

import numpy as np
import pytest

from tog_mjx.running import batches, digests
from tog_mjx.running.batches import CHUNK, map_kept, map_points
from tog_mjx.running.storage import load_result, save_result

POINTS = np.random.default_rng(0).normal(size=(4 * CHUNK - 3, 2))


def row_sum(points):
    return points.sum(1)


def row_max(points):
    return points.max(1)


def test_values_of_every_point_the_last_chunk_included():
    said: list[int] = []
    found = map_points(lambda points: {"sum": points.sum(1), "twice": 2 * points}, POINTS, said.append)
    np.testing.assert_allclose(found["sum"], POINTS.sum(1))
    np.testing.assert_array_equal(found["twice"], 2 * POINTS)
    assert said == [CHUNK, 2 * CHUNK, 3 * CHUNK, len(POINTS)]


def test_a_killed_computation_goes_on_where_it_was(tmp_path, monkeypatch):
    monkeypatch.setattr(batches, "_SECONDS_BETWEEN_WRITES", 0)
    path = tmp_path / "values.npz"

    def die(done):
        if done == 2 * CHUNK:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        map_kept(row_sum, POINTS, path, die)
    said: list[int] = []
    found = map_kept(row_sum, POINTS, path, said.append)
    np.testing.assert_allclose(found, POINTS.sum(1))
    rest = (len(POINTS) - CHUNK) // 3  # The first chunk was on disk; what is left makes three equal ones.
    assert said == [CHUNK + rest, CHUNK + 2 * rest, len(POINTS)]

    said.clear()
    np.testing.assert_array_equal(map_kept(row_sum, POINTS, path, said.append), found)
    assert said == []


@pytest.mark.parametrize(
    "values", [np.zeros(len(POINTS) + 1), np.zeros((5, 2)), np.zeros(5, complex), np.array(["a"] * 5)]
)
def test_values_that_cannot_be_its_own_begin_anew(tmp_path, values):
    path = tmp_path / "values.npz"
    map_kept(row_sum, POINTS, path)
    save_result(path, {"values": values}, load_result(path)[1])
    np.testing.assert_allclose(map_kept(row_sum, POINTS, path), POINTS.sum(1))


def scaled(factor):
    return lambda points: factor * points.sum(1)


@pytest.mark.parametrize("spoil", ["function", "number in it", "points", "damage"])
def test_another_function_other_points_or_a_damaged_file_begin_anew(tmp_path, spoil):
    path = tmp_path / "values.npz"
    map_kept(scaled(2), POINTS, path)
    function = {"function": row_max, "number in it": scaled(3)}.get(spoil, scaled(2))
    points = POINTS + 1e-12 if spoil == "points" else POINTS
    if spoil == "damage":
        path.write_bytes(path.read_bytes()[:-100])
    said: list[int] = []
    np.testing.assert_allclose(map_kept(function, points, path, said.append), function(points), rtol=1e-15, atol=1e-15)
    assert said[-1] == len(POINTS)


def test_an_equal_function_is_the_same(tmp_path):
    said: list[int] = []
    kept = map_kept(scaled(2), POINTS, tmp_path / "values.npz")
    again = map_kept(scaled(2), POINTS, tmp_path / "values.npz", said.append)
    assert not said
    np.testing.assert_array_equal(again, kept)


def test_what_another_compiler_made_begins_anew(tmp_path, monkeypatch):
    map_kept(row_sum, POINTS, tmp_path / "values.npz")
    monkeypatch.setattr(digests.jaxlib.version, "__version__", "9.9")
    said: list[int] = []
    map_kept(row_sum, POINTS, tmp_path / "values.npz", said.append)
    assert said[-1] == len(POINTS)


def test_a_gpu_takes_many_more_at_a_time(monkeypatch):
    assert batches.chunk_size(10_000, 64) == 64
    monkeypatch.setattr(batches.jax, "default_backend", lambda: "gpu")
    assert batches.chunk_size(10_000, 64) == 10_000
    assert batches.chunk_size(20_000, 64) == 10_000
