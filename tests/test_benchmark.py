"""The benchmark's own arithmetic and manners; its numbers are a machine's, and no test's."""

import json

import pytest

from tog_mjx.studies.benchmarks import models, sections

KEYS = {
    "single": {"simulator", "what", "ms", "evaluations", "seconds_compile", "megabytes"},
    "start": {"simulator", "what", "seconds", "seconds_trace", "seconds_compile"},
    "batches": {"simulator", "what", "batch", "per_second", "seconds"},
    "crossover": {"simulator", "method", "knots", "ms", "variables"},
    "scaling": {"grows", "factor", "what", "ms", "megabytes"},
    "engines": {"model", "nv", "engine", "us_per_step", "of_mjx", "seconds_compile", "apart", "settled"},
}


def test_sections_that_need_no_mjx_are_printed_and_kept(run_script, tmp_path, monkeypatch):
    monkeypatch.setattr(sections, "SIMULATED", ("penalty",))
    out = tmp_path / "times.json"
    names = ["start", "batches", "crossover", "scaling"]
    status, said, _ = run_script(
        "benchmark.py", "--quick", "--repeats", "1", "--section", *names, "--float32", "--out", out
    )
    assert status == 0
    found = json.loads(out.read_text())
    assert found["machine"]["precision"] == "float32"
    for name in names:
        assert f"{name}, flip, float32" in said
        assert {frozenset(row) for row in found[name]} == {frozenset(KEYS[name])}
        assert all(row["seconds" if name in ("start", "batches") else "ms"] > 0 for row in found[name])
    assert {row["variables"] for row in found["crossover"]} == {2, 16}
    assert {row["batch"] for row in found["batches"]} == {64, 1024}
    assert out.with_suffix(".png").stat().st_size > 10_000


REFUSED = """
<mujoco model="refused">
  <option timestep="0.005" {option}/>
  <worldbody><geom type="box" size="1 1 0.1" pos="0 0 -0.1" solref="0.05 1"/>
    <body pos="0 0 0.049"><joint name="x" type="slide" axis="1 0 0"/><joint name="z" type="slide" axis="0 0 1"/>
      <geom type="cylinder" size="0.1 0.05" mass="1" solref="0.05 1"/></body></worldbody>
  <actuator><motor joint="x" ctrlrange="-1 1" ctrllimited="true"/></actuator>
</mujoco>"""


@pytest.mark.parametrize("option", ["", 'tolerance="1e-2"'])
def test_the_engines_of_a_model_that_mjx_refuses_are_held_against_differences(tmp_path, option):
    """A cylinder that slides on a box: no MJX, and a gradient that whole motions confirm, also where the solver of the
    model's own motions stops short."""
    path = tmp_path / "refused.xml"
    path.write_text(REFUSED.format(option=option))
    rows = models.engines([path], 1, lambda _: None)
    assert {frozenset(row) for row in rows} == {frozenset(KEYS["engines"])}
    assert [row["engine"] for row in rows] == [models.ONE, models.ALL]
    assert all(row["of_mjx"] is None and row["settled"] < 1e-4 and row["apart"] < 1e-4 for row in rows)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--repeats", "0"], "argument --repeats: 0 is too few"),
        (["--batch", "64", "0"], "argument --batch: 0 is too few"),
        (["--task", "juggle"], "invalid choice: 'juggle'"),
    ],
)
def test_bad_input_is_one_line_and_status_2(run_script, arguments, message):
    status, said, complaint = run_script("benchmark.py", *arguments)
    assert (status, said) == (2, "")
    assert message in complaint
    assert complaint.count("\n") == 1
