"""XLA ends the process on a flag that it does not know: no script of this package does."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

from tog_mjx import xla_flags

ROOT = Path(__file__).parents[1]
OPTIONS = "--xla_backend_extra_options=xla_cpu_small_while_loop_byte_threshold=1000000"


@pytest.mark.parametrize(
    ("flags", "said"),
    [
        ("--xla_nonsense=1 --xla_dump_hlo_as_text=false", "Unknown flag in XLA_FLAGS: --xla_nonsense=1"),
        ("--xla_force_host_platform_device_count=two", "Couldn't interpret value two for flag"),
        ("nowhere/flags.txt", 'Could not open file "nowhere/flags.txt"'),
    ],
)
def test_a_users_flag_that_jaxlib_refuses_is_told_in_one_line(flags, said):
    done = subprocess.run(
        [sys.executable, ROOT / "scripts/check_step.py", ROOT / "tests/scenes/incline.xml"],
        env=os.environ | {"XLA_FLAGS": flags},
        capture_output=True,
        text=True,
    )
    assert done.returncode == 2
    assert done.stderr.count("\n") == 1
    assert done.stderr.startswith("check_step.py: jaxlib ")
    assert f"refuses XLA_FLAGS='{flags}': {said}" in done.stderr


def tuned(monkeypatch, chosen: str, **more: str) -> str:
    """XLA_FLAGS after `tune_compiler`, and that jaxlib takes them."""
    monkeypatch.setattr(xla_flags, "_SETTINGS", xla_flags._SETTINGS | more)
    monkeypatch.setenv("XLA_FLAGS", chosen)
    xla_flags.tune_compiler()
    program = "import jax; assert jax.numpy.arange(3).sum() == 3"
    subprocess.run([sys.executable, "-c", program], check=True, env=os.environ | {"JAX_PLATFORMS": "cpu"})
    return os.environ["XLA_FLAGS"]


def test_settings_that_jaxlib_does_not_know_are_left_out(monkeypatch):
    found = tuned(monkeypatch, "", xla_of_yesterday="true", xla_dump_hlo_as_text="perhaps", xla_dump_hlo_as_dot="false")
    assert OPTIONS in found
    assert "--xla_dump_hlo_as_dot=false" in found
    assert "yesterday" not in found
    assert "perhaps" not in found


def test_what_somebody_chose_stays(monkeypatch, tmp_path):
    chosen = "--xla_backend_extra_options=xla_cpu_small_while_loop_byte_threshold=2"
    assert tuned(monkeypatch, chosen).startswith(chosen)
    assert OPTIONS not in tuned(monkeypatch, chosen)
    file = tmp_path / "flags.txt"
    file.write_text(chosen)
    assert tuned(monkeypatch, str(file)) == str(file)
