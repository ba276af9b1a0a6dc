"""MuJoCo's warnings while checks run: unheard, and heard again afterwards."""

import mujoco

from tog_mjx.checks.file.preflight import preflight
from tog_mjx.drawing import viewing
from tog_mjx.mjcf.scene import compile_model, scene_path
from tog_mjx.running.quiet import without_warnings

SINGULAR = "<mujoco><worldbody><body><joint/><joint/><geom size='0.1'/></body></worldbody></mujoco>"


def test_warnings_come_back_when_all_are_done():
    """A mass matrix that is singular is warned of."""
    model = mujoco.MjModel.from_xml_string(SINGULAR)
    said: list[str] = []
    mujoco.set_mju_user_warning(said.append)
    try:
        with without_warnings():
            with without_warnings():
                pass
            mujoco.mj_forward(model, mujoco.MjData(model))
        assert said == []
        mujoco.mj_forward(model, mujoco.MjData(model))
    finally:
        mujoco.set_mju_user_warning(None)
    assert len(said) == 1


def test_whoever_listens_before_a_scene_is_read_or_shown_listens_after():
    singular = mujoco.MjModel.from_xml_string(SINGULAR)
    said: list[str] = []
    mujoco.set_mju_user_warning(said.append)
    try:
        model = compile_model(scene_path("flip"))
        viewing.simulate(model, viewing.start(model), 0.01)
        mujoco.mj_forward(singular, mujoco.MjData(singular))
    finally:
        mujoco.set_mju_user_warning(None)
    assert len(said) == 1


def test_what_mujoco_warns_of_leaves_no_file(tmp_path, monkeypatch, capfd):
    path, folder = tmp_path / "scene.xml", tmp_path / "empty"
    path.write_text(SINGULAR)
    folder.mkdir()
    monkeypatch.chdir(folder)
    preflight(compile_model(path), path)
    assert capfd.readouterr().out == ""
    assert not list(folder.iterdir())
