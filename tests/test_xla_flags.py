"""XLA ends the process on a flag that it does not know: no script of this package does."""

import os
import subprocess
import sys
from pathlib import Path

import jaxlib.version
import pytest

from tog_mjx.running import xla_flags
from tog_mjx.running.errors import InputError

ROOT = Path(__file__).parents[1]
OPTIONS = "--xla_backend_extra_options=xla_cpu_small_while_loop_byte_threshold=1000000"


def test_a_script_tells_a_bad_flag_in_one_line():
    done = subprocess.run(
        [sys.executable, ROOT / "scripts/check_step.py", ROOT / "tests/scenes/incline.xml"],
        env=os.environ | {"XLA_FLAGS": "--xla_nonsense=1"},
        capture_output=True,
        text=True,
    )
    assert done.returncode == 2
    assert done.stderr.count("\n") == 1
    assert done.stderr.startswith("check_step.py: jaxlib ")


@pytest.mark.parametrize(
    ("flags", "said"),
    [
        ("--xla_nonsense=1 --xla_dump_hlo_as_text=false", "Unknown flag in XLA_FLAGS: --xla_nonsense=1"),
        ("--xla_force_host_platform_device_count=two", "Couldn't interpret value two for flag"),
        ("nowhere/flags.txt", 'Could not open file "nowhere/flags.txt"'),
    ],
)
def test_a_bad_flag_of_the_users_is_told(monkeypatch, flags, said):
    monkeypatch.setenv("XLA_FLAGS", flags)
    with pytest.raises(InputError, match=f"refuses XLA_FLAGS='{flags}': {said}"):
        xla_flags.tune_compiler()


def test_settings_that_jaxlib_does_not_know_are_left_out(monkeypatch):
    more = {"xla_of_yesterday": "true", "xla_dump_hlo_as_text": "perhaps", "xla_dump_hlo_as_dot": "false"}
    monkeypatch.setattr(xla_flags, "_SETTINGS", xla_flags._SETTINGS | more)
    monkeypatch.setenv("XLA_FLAGS", "")
    xla_flags.tune_compiler()
    found = os.environ["XLA_FLAGS"]
    assert OPTIONS in found
    assert "--xla_dump_hlo_as_dot=false" in found
    assert "yesterday" not in found
    assert "perhaps" not in found
    # JAX itself takes what is left.
    program = "import jax; assert jax.numpy.arange(3).sum() == 3"
    subprocess.run([sys.executable, "-c", program], check=True, env=os.environ | {"JAX_PLATFORMS": "cpu"})


def test_a_jaxlib_that_is_known_to_take_them_is_not_asked(monkeypatch):
    asked = xla_flags._complaint.__wrapped__
    with monkeypatch.context() as patch:
        patch.setattr(xla_flags, "_TAKEN_BY", ())
        takes_them = asked(xla_flags._OURS) == ""
    assert takes_them or jaxlib.version.__version__ not in xla_flags._TAKEN_BY
    monkeypatch.setattr(xla_flags, "_TAKEN_BY", (jaxlib.version.__version__,))
    monkeypatch.setattr(xla_flags, "subprocess", None)
    assert asked(xla_flags._OURS) == ""
    with pytest.raises(AttributeError):  # Of any other flags it is.
        asked(xla_flags._OURS + " --xla_dump_hlo_as_dot=false")


def test_what_somebody_chose_stays(monkeypatch, tmp_path):
    chosen = "--xla_backend_extra_options=xla_cpu_small_while_loop_byte_threshold=2"
    file = tmp_path / "flags.txt"
    file.write_text(chosen)
    monkeypatch.setenv("XLA_FLAGS", chosen)
    xla_flags.tune_compiler()
    assert os.environ["XLA_FLAGS"].startswith(chosen)
    assert OPTIONS not in os.environ["XLA_FLAGS"]
    monkeypatch.setenv("XLA_FLAGS", str(file))  # To which nothing can be added.
    xla_flags.tune_compiler()
    assert os.environ["XLA_FLAGS"] == str(file)
