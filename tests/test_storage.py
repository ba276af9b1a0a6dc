"""Files are written whole or not at all, and damage is found."""

import os
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest

from tog_mjx.running.errors import InputError
from tog_mjx.running.storage import DamagedFileError, atomic_write, check_writable, load_result, save_json, save_result

ARRAYS = {"costs": np.linspace(0, 1, 500), "setpoints": np.arange(6.0).reshape(3, 2)}


@pytest.fixture
def saved(tmp_path):
    path = tmp_path / "deep" / "result.npz"
    save_result(path, ARRAYS, {"seed": 3, "nested": {"a": [1, 2]}})
    return path


def test_there_and_back(saved):
    arrays, attributes = load_result(saved)
    assert attributes == {"seed": 3, "nested": {"a": [1, 2]}}
    assert arrays.keys() == ARRAYS.keys()
    for name, array in ARRAYS.items():
        np.testing.assert_array_equal(arrays[name], array)
    assert [p.name for p in saved.parent.iterdir()] == ["result.npz"]


@pytest.mark.parametrize("keep", [0, 10, 0.5, 0.99])
def test_a_truncated_file_is_damaged(saved, keep):
    content = saved.read_bytes()
    saved.write_bytes(content[: int(keep if keep >= 1 else keep * len(content))])
    with pytest.raises(DamagedFileError, match=r"result\.npz"):
        load_result(saved)


def test_a_flipped_bit_in_an_array_is_damage(saved):
    content = bytearray(saved.read_bytes())
    content[content.index(ARRAYS["costs"].tobytes()) + 100] ^= 1
    saved.write_bytes(content)
    with pytest.raises(DamagedFileError, match="CRC"):
        load_result(saved)


def test_another_programs_file_is_damaged(tmp_path):
    path = tmp_path / "other.npz"
    np.savez(path, x=np.zeros(2))
    with pytest.raises(DamagedFileError, match="attributes"):
        load_result(path)


def test_an_interrupted_write_leaves_the_old_file(tmp_path):
    path = tmp_path / "file"
    path.write_bytes(b"old")

    def interrupted():
        with atomic_write(path) as file:
            file.write(b"new, but only ha")
            raise RuntimeError

    with pytest.raises(RuntimeError):
        interrupted()
    assert path.read_bytes() == b"old"


def test_what_a_killed_program_left_unfinished_is_removed_when_it_is_old(tmp_path):
    old, recent, other = (
        tmp_path / name for name in (".a.npz.abcd1234.partial", ".b.npz.abcd1234.partial", "c.partial")
    )
    for path in (old, recent, other):
        path.write_bytes(b"half")
    for path in (old, other):
        os.utime(path, (0, 0))
    save_json(tmp_path / "x.json", [])
    assert {path.name for path in tmp_path.iterdir()} == {recent.name, other.name, "x.json"}


def test_a_folder_that_cannot_be_written_is_one_line(tmp_path):
    (tmp_path / "file").write_text("not a folder")
    with pytest.raises(InputError, match="cannot be written"):
        save_json(tmp_path / "file" / "summary.json", [])
    assert (tmp_path / "file").read_text() == "not a folder"


def test_outputs_of_one_name_or_that_of_an_input_are_refused(tmp_path):
    scene, page = tmp_path / "scene.xml", tmp_path / "page.html"
    check_writable(page, tmp_path / "verdict.json", inputs=[scene])
    with pytest.raises(InputError, match="two files would have that name"):
        check_writable(page, tmp_path / "." / "page.html", inputs=[scene])
    with pytest.raises(InputError, match=r"scene.xml: it is read"):
        check_writable(page, scene, inputs=[scene])


def test_a_result_holds_no_python_objects(tmp_path):
    with pytest.raises(TypeError, match=r"result\.npz: x: an array of Python objects"):
        save_result(tmp_path / "result.npz", {"x": np.array([None]), "y": np.zeros(2)}, {})
    assert not list(tmp_path.iterdir())


def test_json_holds_no_nan(tmp_path):
    with pytest.raises(ValueError, match="JSON compliant"):
        save_json(tmp_path / "x.json", [float("nan")])


def test_two_writers_of_one_file_do_not_mix(tmp_path):
    path = tmp_path / "shared.npz"

    def write(value):
        for _ in range(40):
            save_result(path, {"x": np.full(5000, value)}, {"value": value})
            arrays, attributes = load_result(path)
            assert (arrays["x"] == attributes["value"]).all()

    with ThreadPoolExecutor(2) as pool:
        for done in [pool.submit(write, value) for value in (1, 2)]:
            done.result()
    assert [p.name for p in tmp_path.iterdir()] == ["shared.npz"]
