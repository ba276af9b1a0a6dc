"""Every element of a scene is found in the file and line where it is written."""

from pathlib import Path

import mujoco

from tog_mjx.mjcf.lines import Lines

MAIN = """<mujoco>
  <option timestep="0.001"/>
  <default>
    <geom size="0.1"/>
  </default>
  <include file="parts/wall.xml"/>
  <option cone="elliptic">
    <flag gravity="disable"/>
  </option>
  <worldbody>
    <geom name="floor" type="plane" size="1 1 1"/>
    <body name="cart">
      <freejoint/>
      <geom/>
      <frame pos="0 0 1">
        <geom/>
        <body>
          <joint name="hinge"/>
          <geom name="arm"/>
          <joint type="slide"/>
        </body>
      </frame>
      <geom/>
    </body>
    <body name="many">
      <replicate count="3" offset="1 0 0">
        <geom/>
      </replicate>
    </body>
  </worldbody>
  <contact>
    <exclude body1="cart" body2="many"/>
    <pair geom1="floor" geom2="arm"/>
  </contact>
  <actuator>
    <motor joint="hinge"/>
    <motor name="second" joint="hinge"/>
  </actuator>
</mujoco>
"""
WALL = """<mujocoinclude>
  <worldbody>
    <body><geom name="wall" size="1"/></body>
  </worldbody>
  <sensor><clock name="time"/></sensor>
</mujocoinclude>
"""


def scene(folder: Path) -> tuple[mujoco.MjModel, Lines]:
    (folder / "parts").mkdir()
    (folder / "parts" / "wall.xml").write_text(WALL)
    path = folder / "main.xml"
    path.write_text(MAIN)
    model = mujoco.MjModel.from_xml_path(str(path))
    return model, Lines(model, path)


def test_named_elements_are_found_also_where_they_are_included(tmp_path):
    model, lines = scene(tmp_path)
    places = {
        ("geom", "floor"): "main.xml:11", ("geom", "arm"): "main.xml:19", ("geom", "wall"): "wall.xml:3",
        ("body", "cart"): "main.xml:12", ("joint", "hinge"): "main.xml:18", ("actuator", "second"): "main.xml:37",
        ("sensor", "time"): "wall.xml:5",
    }  # fmt: skip
    for (kind, name), place in places.items():
        assert lines.place(kind, getattr(model, kind)(name).id) == place


def test_elements_without_a_name_are_found_by_their_order_in_body_and_section(tmp_path):
    model, lines = scene(tmp_path)
    first = int(model.body("cart").geomadr[0])
    assert [lines.place("geom", first + i) for i in range(3)] == ["main.xml:14", "main.xml:16", "main.xml:23"]
    assert lines.place("joint", int(model.body("cart").jntadr[0])) == "main.xml:13"
    assert lines.place("joint", model.joint("hinge").id + 1) == "main.xml:20"
    assert lines.place("body", model.body("cart").id + 1) == "main.xml:17"
    assert lines.place("body", 0) == "wall.xml:2"
    assert lines.place("pair", 0) == "main.xml:33"
    assert lines.place("actuator", 0) == "main.xml:36"


def test_replicated_elements_are_told_by_their_body(tmp_path):
    model, lines = scene(tmp_path)
    assert model.body("many").geomnum == 3
    assert {lines.place("geom", int(model.body("many").geomadr[0]) + i) for i in range(3)} == {"main.xml:25"}


def test_options_and_flags_are_found_where_they_are_given_last(tmp_path):
    _, lines = scene(tmp_path)
    assert lines.place_of_option("timestep") == "main.xml:2"
    assert lines.place_of_option("cone") == "main.xml:7"
    assert lines.place_of_option("gravity") == "main.xml:8"
    assert lines.place_of_option("solver") == ""


def test_what_is_no_mjcf_file_has_no_lines(tmp_path):
    model = mujoco.MjModel.from_xml_string("<mujoco><worldbody><geom size='1'/></worldbody></mujoco>")
    urdf, binary = tmp_path / "robot.urdf", tmp_path / "scene.mjb"
    urdf.write_text("<robot name='r'><link name='l'/></robot>")
    mujoco.mj_saveModel(model, str(binary), None)
    for path in (None, urdf, binary, tmp_path / "absent.xml"):
        lines = Lines(model, path)
        assert lines.place("geom", 0) == ""
        assert lines.place_of_option("cone") == ""
