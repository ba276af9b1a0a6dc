"""Many points: the values are those of the function, and a killed computation goes on where it was."""

import numpy as np
import pytest

from tog_mjx.running import batches
from tog_mjx.running.batches import CHUNK, map_kept, map_points
from tog_mjx.running.storage import save_result

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
        map_kept(row_sum, POINTS, path, {"a": 1}, die)
    said: list[int] = []
    found = map_kept(row_sum, POINTS, path, {"a": 1}, said.append)
    np.testing.assert_allclose(found, POINTS.sum(1))
    rest = (len(POINTS) - CHUNK) // 3  # The first chunk was on disk; what is left makes three equal ones.
    assert said == [CHUNK + rest, CHUNK + 2 * rest, len(POINTS)]

    said.clear()
    np.testing.assert_array_equal(map_kept(row_sum, POINTS, path, {"a": 1}, said.append), found)
    assert said == []


@pytest.mark.parametrize(
    "values", [np.zeros(len(POINTS) + 1), np.zeros((5, 2)), np.zeros(5, complex), np.array(["a"] * 5)]
)
def test_values_that_cannot_be_its_own_begin_anew(tmp_path, values):
    path = tmp_path / "values.npz"
    save_result(path, {"values": values}, {"settings": {"a": 1, "points": len(POINTS)}})
    np.testing.assert_allclose(map_kept(row_sum, POINTS, path, {"a": 1}), POINTS.sum(1))


@pytest.mark.parametrize("spoil", ["settings", "damage"])
def test_other_settings_or_a_damaged_file_begin_anew(tmp_path, spoil):
    path = tmp_path / "values.npz"
    map_kept(row_sum, POINTS, path, {"a": 1})
    if spoil == "damage":
        path.write_bytes(path.read_bytes()[:-100])
    said: list[int] = []
    found = map_kept(row_max, POINTS, path, {"a": 1 if spoil == "damage" else 2}, said.append)
    assert said[-1] == len(POINTS)
    np.testing.assert_array_equal(found, POINTS.max(1))


def test_a_gpu_takes_many_more_at_a_time(monkeypatch):
    assert batches.chunk_size(10_000, 64) == 64
    monkeypatch.setattr(batches.jax, "default_backend", lambda: "gpu")
    assert batches.chunk_size(10_000, 64) == 10_000
    assert batches.chunk_size(20_000, 64) == 10_000
