"""What is told of a number of the model: what moves along with it, and what stays behind."""

import mujoco
from test_parameter import BALL

from tog_mjx.checks.file.preflight import preflight
from tog_mjx.checks.told.finding import Level


def told(model: mujoco.MjModel, wrt: str, path=None) -> list[tuple[Level, str]]:
    words = ("moves along", "leaves behind", "moves alone")
    remarks = preflight(model, path, wrt=wrt)
    return [(some.level, some.what) for some in remarks if any(word in some.what for word in words)]


def test_what_stays_behind_is_told(tmp_path):
    path = tmp_path / "ball.xml"
    path.write_text(BALL.format(0.1))
    model = mujoco.MjModel.from_xml_path(str(path))
    moved = "body_mass, body_subtreemass, dof_M0, dof_invweight0, geom_rbound"
    along = f"actuator_acc0, body_inertia, body_invweight0, {moved}"
    what = f"geom_size[1, 0] moves along, to first order, what the compiler derives from it: {along}"
    assert told(model, "geom_size[1, 0]", path) == [(Level.FINE, what)]
    behind = "leaves behind what the compiler derives from it: body_inertia, body_ipos, body_iquat, body_mass"
    assert told(model, "geom_size[1, 0]") == [(Level.CARE, f"geom_size[1, 0] {behind}")]
    assert told(model, "body_mass[1]") == [
        (Level.CARE, "body_mass[1] leaves behind what the compiler derives from it: body_inertia")
    ]
    alone = "field:geom_size[1, 0]", path
    assert told(model, *alone) == [(Level.FINE, f"geom_size[1, 0] moves alone, as asked for: {along} stay as they are")]
    # Of the floor, of a number that a sphere has not, and of what nothing follows from.
    for wrt in ("geom_size[0, 0]", "geom_size[1, 1]", "geom_friction", "opt.gravity[2]"):
        assert told(model, wrt) == []
    model.body_mass[1] *= 2  # No longer that of the file.
    assert told(model, "geom_size[1, 0]", path)[0][0] == Level.CARE
