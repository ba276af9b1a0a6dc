"""What MJX cannot step: refused beforehand as stock MJX fails, or a finding where only the attempt can tell."""

import jax
import mujoco
import pytest

import tog_mjx as tog
from tog_mjx.checks.file.preflight import preflight
from tog_mjx.checks.told.finding import Level
from tog_mjx.mjcf.supported import step_failure
from tog_mjx.stepping._mjx import make_data, put_model


def test_the_elliptic_cone_needs_geoms_that_can_meet():
    """Stock MJX indexes an empty array of contacts."""
    xml = """<mujoco><option cone="{}"/><worldbody><body><joint axis="0 1 0" limited="{}" range="-20 20"/>
      <geom size="0.1" pos="1 0 0"/></body></worldbody></mujoco>"""
    refused = mujoco.MjModel.from_xml_string(xml.format("elliptic", "true"))
    (remark,) = preflight(refused)
    assert remark.blocks
    with pytest.raises(TypeError, match="Indexer"):
        jax.eval_shape(tog.step, put_model(refused), make_data(refused))
    for fine in (("pyramidal", "true"), ("elliptic", "false")):
        assert preflight(mujoco.MjModel.from_xml_string(xml.format(*fine))) == []


LIMITED = """<mujoco><option><flag {flag}/></option><worldbody><geom type="plane" size="5 5 .1" {off}/>
  <body><joint range="-20 20"/><geom name="ball" size=".1" {off}/><site name="tip"/></body></worldbody>
  <sensor>{sensor}</sensor></mujoco>"""
OFF = 'contype="0" conaffinity="0"'


@pytest.mark.parametrize(
    ("sensor", "off", "flag", "refused"),
    [
        ('<touch site="tip"/>', OFF, 'gravity="enable"', True),
        ('<touch site="tip"/>', "", 'contact="disable"', True),
        ('<touch site="tip"/>', "", 'gravity="enable"', False),
        ('<touch site="tip"/>', OFF, 'sensor="disable"', False),
        ('<touch site="tip"/>', OFF, 'limit="disable"', False),
        ('<contact geom1="ball" data="force"/>', OFF, 'gravity="enable"', True),
        ('<contact geom1="ball" data="found" reduce="maxforce"/>', OFF, 'gravity="enable"', True),
        ('<contact geom1="ball" data="found"/>', OFF, 'gravity="enable"', False),
        ('<rangefinder site="tip"/>', "", 'gravity="enable"', True),
        ('<rangefinder site="tip"/>', "", 'sensor="disable"', False),
    ],
)
def test_a_sensor_of_what_is_not_there_is_refused_as_stock_mjx_fails(sensor, off, flag, refused):
    model = mujoco.MjModel.from_xml_string(LIMITED.format(sensor=sensor, off=off, flag=flag))
    blocking = [remark.what for remark in preflight(model) if remark.blocks]
    assert [what.startswith("sensor number 0 (") for what in blocking] == [True] * refused
    assert bool(step_failure(model)) == refused


def test_a_rangefinder_needs_a_material():
    xml = LIMITED.format(sensor='<rangefinder site="tip"/>', off="", flag='gravity="enable"')
    model = mujoco.MjModel.from_xml_string(
        xml.replace("<worldbody>", '<asset><material name="any"/></asset><worldbody>')
    )
    assert not any(remark.blocks for remark in preflight(model))
    assert step_failure(model) == ""


def test_what_nobody_knew_mjx_cannot_step_is_a_finding(monkeypatch):
    """As long as stock MJX fails too, and then C MuJoCo's gradient is judged; what fails here alone is raised."""
    model = mujoco.MjModel.from_xml_string(
        LIMITED.format(sensor='<touch site="tip"/>', off=OFF, flag='gravity="enable"')
    )
    monkeypatch.setattr("tog_mjx.checks.scene_verdict.preflight", lambda *_: [])
    verdict = tog.check_scene(model, wrt="qvel", steps=2)
    finding = verdict.findings[0]
    assert (finding.check, finding.level, verdict.engine) == ("motion", Level.FINE, "mujoco")
    assert "at least one array to concatenate" in finding.sentence
    monkeypatch.setattr("tog_mjx.checks.told.failure.step_failure", lambda _: "")
    with pytest.raises(ValueError, match="at least one array"):
        tog.check_scene(model, wrt="qvel", steps=2)


def test_a_scene_too_large_for_memory_is_a_finding(monkeypatch):
    def exhaust(*_):
        raise jax.errors.JaxRuntimeError("RESOURCE_EXHAUSTED: Out of memory allocating 720765081192 bytes.")

    monkeypatch.setattr("tog_mjx.checks.measured.recorded.Simulation.run", exhaust)
    model = mujoco.MjModel.from_xml_string(LIMITED.format(sensor="", off="", flag='gravity="enable"'))
    said = []
    verdict = tog.check_scene(model, wrt="qvel", steps=2, report=lambda *some: said.append(some))
    on_c = tog.check_scene(model, wrt="qvel", steps=2, engine="mujoco")
    finding, *others = verdict.findings
    assert (finding.check, finding.level) == ("motion", Level.FINE)
    assert finding.sentence.endswith("does not fit into memory: Out of memory allocating 720765081192 bytes.")
    assert "maxhullvert" in finding.remedy
    assert (tuple(others), verdict.line, verdict.engine) == (on_c.findings, on_c.line, "mujoco")
    # Before MJX's motion is tried, C MuJoCo has answered.
    first = next(found for _, found in said if found)
    assert (first.check, first.level) == ("C MuJoCo", Level.FINE)
    assert first.sentence.endswith(f"on the gradient of its own motion: {on_c.line}")
    assert [name for name, found in said if not found][:3] == ["preflight", "C MuJoCo", "motion"]
