"""The preflight of the gallery of verdicts: of each fault that can be read in the file, and of none in sound scenes."""

import tomllib
from pathlib import Path

import mujoco
import pytest

from tog_mjx.checks.file.preflight import Remark, preflight
from tog_mjx.checks.told.finding import Finding, Level
from tog_mjx.mjcf.scene import models_folder

GALLERY = Path(__file__).parent / "scenes" / "verdicts"
EXPECTED = {entry["file"]: entry for entry in tomllib.loads((GALLERY / "expected.toml").read_text())["scene"]}


def gallery_remarks(entry: dict) -> list[Remark]:
    path = GALLERY / entry["file"]
    model = mujoco.MjModel.from_xml_path(str(path))
    assert model.site(entry["output"]).id >= 0
    return preflight(model, path, None, entry["wrt"], entry.get("differentiation", "implicit"))


def test_the_gallery_is_complete_and_its_sound_scenes_have_no_remark():
    assert sorted(EXPECTED) == sorted(path.name for path in GALLERY.glob("*.xml"))
    for entry in EXPECTED.values():
        if entry["verdict"] == "trust" and "engine" not in entry:
            assert gallery_remarks(entry) == []


@pytest.mark.parametrize(
    ("file", "what", "where"),
    [
        ("unconverged_solver.xml", "<option iterations='2'>", "unconverged_solver.xml:5"),
        ("native_elliptic.xml", "<option cone='elliptic'>", "native_elliptic.xml:5"),
        ("coarse_step.xml", "geom floor with geom ball: a vibration of 70.7 rad/s", "coarse_step.xml:9"),
        ("kink_at_touch.xml", "they touch exactly", "kink_at_touch.xml:10"),
        ("control_at_limit.xml", "another derivative to either side", "control_at_limit.xml:8"),
        ("saturated_control.xml", "the derivative in the control is zero", "saturated_control.xml:8"),
        ("box_on_plane.xml", "MJX chooses its points", "box_on_plane.xml:11"),
        ("far_from_origin.xml", "body ball is 1e+06 m from the origin", "far_from_origin.xml:8"),
        ("unsupported.xml", "the collision of geom pole (cylinder)", "unsupported.xml:6"),
    ],
)
def test_faults_of_the_gallery_that_can_be_read_are_told(file, what, where):
    (remark,) = [remark for remark in gallery_remarks(EXPECTED[file]) if what in remark.what]
    assert where in remark.where
    assert remark.blocks == (file == "unsupported.xml")


def test_only_a_check_that_was_run_can_say_that_a_feature_does_no_harm():
    """Where the time step was not halved there is no number, and the fear stays."""
    feared = Remark(Level.CARE, "a stiff spring", "", "soften it", measured_by="time step")
    found = [feared.finding([Finding("time step", Level.FINE, "", value)]) for value in (None, 0.01)]
    assert [some.level for some in found] == [Level.CARE, Level.FINE]
    assert "has measured" not in found[0].sentence


def test_the_projects_scenes_have_no_fault():
    scenes = [models_folder() / f"{name}.xml" for name in ("flip", "grasp")]
    scenes += sorted((Path(__file__).parent / "scenes").glob("*.xml"))
    for path in scenes:
        assert all(remark.level < Level.FAULT for remark in preflight(mujoco.MjModel.from_xml_path(str(path)), path))
