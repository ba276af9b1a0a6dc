"""Silhouettes against closed forms."""

import mujoco
import numpy as np
import pytest

from tog_mjx.drawing.figures import planar

ANGLE = 0.4
"""Counter-clockwise in the x-z plane: a rotation about -y."""


def only_outline(geom: str, extra: str = "") -> planar.Outline:
    model = mujoco.MjModel.from_xml_string(f"<mujoco>{extra}<worldbody>{geom}</worldbody></mujoco>")
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    (outline,) = [*planar.outlines(model, data), *planar.site_outlines(model, data)]
    return outline


def turned(points) -> np.ndarray:
    c, s = np.cos(ANGLE), np.sin(ANGLE)
    return np.asarray(points) @ np.array([[c, s], [-s, c]])


def area(polygon: np.ndarray) -> float:
    x, z = polygon.T
    return 0.5 * abs(float(x @ np.roll(z, -1) - z @ np.roll(x, -1)))


@pytest.mark.parametrize("element", ["geom", "site"])
def test_a_turned_boxs_outline_is_its_four_corners(element):
    pose = f'pos="1 5 2" euler="0 {-np.degrees(ANGLE)} 0"'
    outline = only_outline(f'<{element} name="b" type="box" size="0.3 0.2 0.1" {pose} rgba="1 0 0 .5"/>')
    expected = np.array([1, 2]) + turned([[0.3, 0.1], [-0.3, 0.1], [-0.3, -0.1], [0.3, -0.1]])
    assert outline.name == "b"
    np.testing.assert_allclose(outline.color, [1, 0, 0, 0.5])
    assert len(outline.polygon) == 4
    for corner in expected:
        assert np.linalg.norm(outline.polygon - corner, axis=1).min() < 1e-9
    np.testing.assert_allclose(area(outline.polygon), 0.6 * 0.2, rtol=1e-9)


def test_a_spheres_outline_is_its_circle():
    polygon = only_outline('<geom type="sphere" size="0.25" pos="-1 3 0.5"/>').polygon
    radii = np.linalg.norm(polygon - [-1, 0.5], axis=1)
    assert radii.max() <= 0.25 + 1e-12
    np.testing.assert_allclose(area(polygon), np.pi * 0.25**2, rtol=0.01)


def test_an_ellipsoids_outline_is_an_ellipse():
    polygon = only_outline('<geom type="ellipsoid" size="0.4 0.3 0.1"/>').polygon
    np.testing.assert_allclose(area(polygon), np.pi * 0.4 * 0.1, rtol=0.01)
    np.testing.assert_allclose(np.abs(polygon).max(axis=0), [0.4, 0.1], rtol=0.005)


def test_a_tilted_capsules_extent():
    radius, half = 0.1, 0.5
    outline = only_outline(f'<geom type="capsule" size="{radius} {half}" euler="0 {-np.degrees(ANGLE)} 0"/>')
    extent = half * np.abs([np.sin(ANGLE), np.cos(ANGLE)]) + radius
    np.testing.assert_allclose(outline.polygon.max(axis=0), extent, rtol=0.005)
    np.testing.assert_allclose(outline.polygon.min(axis=0), -extent, rtol=0.005)
    np.testing.assert_allclose(area(outline.polygon), np.pi * radius**2 + 4 * radius * half, rtol=0.01)


def test_a_cylinder_seen_from_its_side_is_a_rectangle():
    polygon = only_outline('<geom type="cylinder" size="0.2 0.5"/>').polygon
    np.testing.assert_allclose(np.abs(polygon).max(axis=0), [0.2, 0.5], rtol=0.005)
    np.testing.assert_allclose(area(polygon), 4 * 0.2 * 0.5, rtol=0.01)


def test_a_mesh_is_the_hull_of_its_vertices():
    asset = '<asset><mesh name="m" vertex="0 0 0  1 0 0  0 1 0  0 0 1"/></asset>'
    polygon = only_outline('<geom type="mesh" mesh="m"/>', asset).polygon
    np.testing.assert_allclose(area(polygon), 0.5, rtol=1e-6)


def test_the_ground_fills_what_is_below_it():
    polygon = only_outline('<geom type="plane" size="0 0 1"/>').polygon
    np.testing.assert_allclose(polygon[:, 1].max(), 0, atol=1e-9)
    assert polygon[:, 1].min() < -10
    assert np.ptp(polygon[:, 0]) > 20


def test_hidden_groups_and_transparent_geoms_are_left_out_and_near_ones_come_last():
    model = mujoco.MjModel.from_xml_string(
        """<mujoco><worldbody>
        <geom name="near" size="0.1" pos="0 -1 0"/>
        <geom name="far" size="0.1" pos="0 1 0"/>
        <geom name="hidden" size="0.1" group="3"/>
        <geom name="glass" size="0.1" rgba="1 1 1 0"/>
        <site name="unseen" group="4"/>
        </worldbody></mujoco>"""
    )
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    assert [outline.name for outline in planar.outlines(model, data)] == ["far", "near"]
    assert planar.site_outlines(model, data) == []
