"""`tog doctor`: each thing that is missing is told with what brings it, also where what is missing is JAX."""

import importlib.metadata as metadata
import os
import signal
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace

import pytest

from tog_mjx.commands import doctor
from tog_mjx.commands.doctor import Part
from tog_mjx.running.errors import InputError
from tog_mjx.running.probes import Tried, try_jax, try_opengl
from tog_mjx.running.xla_flags import tune_compiler

ROOT = Path(__file__).parent.parent
NEEDED = [
    "jax>=0.10.2",
    "mujoco>=4.0",
    "colorama; sys_platform == 'none'",
    "pandas>=3; extra == 'studies'",
    "evosax>=0.3.2; extra == 'studies'",
    "imageio-ffmpeg>=0.6; extra == 'video'",
    "pytest>=9; extra == 'test'",
]
WORKS, FAILS = Tried("", "", False), Tried("", "ImportError: no EGL", True)


def shadow(folder: Path, monkeypatch, **modules: str) -> None:
    """Modules that programs find before those that are installed: their text by name."""
    for name, text in modules.items():
        (folder / name.replace(".", "/")).mkdir(parents=True)
        (folder / name.replace(".", "/") / "__init__.py").write_text(text)
    monkeypatch.setenv("PYTHONPATH", f"{folder}{os.pathsep}{ROOT}")


@pytest.fixture
def installed(monkeypatch) -> dict[str, str]:
    """What is installed, by name."""
    versions = {"tog_mjx": "1.0", "jax": "0.11.0", "jaxlib": "0.11.0", "mujoco": "4.1", "pandas": "3.0"}
    versions |= {"evosax": "0.3.2", "imageio-ffmpeg": "0.8"}

    def version(name: str) -> str:
        if name not in versions:
            raise metadata.PackageNotFoundError(name)
        return versions[name]

    monkeypatch.setattr(metadata, "version", version)
    monkeypatch.setattr(metadata, "requires", lambda _: NEEDED)
    return versions


@pytest.mark.usefixtures("installed")
def test_packages_that_are_there_are_told_with_their_versions():
    found = [(part.name, part.found, part.remedy) for part in doctor.packages()][1:]
    assert found == [
        ("jax", "0.11.0", ""),
        ("mujoco", "4.1", ""),
        ("jaxlib", "0.11.0", ""),
        ("extra studies", "pandas 3.0, evosax 0.3.2", ""),
        ("extra video", "imageio-ffmpeg 0.8", ""),
    ]


@pytest.mark.parametrize(
    ("changes", "part"),
    [
        ({"jax": ""}, Part("jax", "missing", "pip install 'jax>=0.10.2'", True)),
        ({"mujoco": "3.9"}, Part("mujoco", "3.9", "pip install 'mujoco>=4.0'", True)),
        (
            {"pandas": "", "evosax": "0.3.0"},
            Part(
                "extra studies",
                "pandas missing, evosax 0.3.0",
                "for tog study: pip install 'pandas>=3' 'evosax>=0.3.2'",
            ),
        ),
        (
            {"imageio-ffmpeg": ""},
            Part("extra video", "imageio-ffmpeg missing", "for tog view --mp4: pip install 'imageio-ffmpeg>=0.6'"),
        ),
    ],
)
def test_a_package_that_is_missing_or_too_old_is_told_with_its_line(installed, changes, part):
    for name, version in changes.items():
        installed.pop(name) if not version else installed.update({name: version})
    assert [some for some in doctor.packages() if some.remedy] == [part]


def test_a_copy_that_is_not_installed_is_told(installed):
    del installed["tog_mjx"]
    (part,) = doctor.packages()
    assert part.found == f"not installed, {ROOT / 'tog_mjx'}"
    assert part.remedy == "pip install . in its folder"


def test_a_broken_cuda_plugin_is_one_line_and_jax_goes_on(tmp_path, monkeypatch):
    """JAX itself prints a traceback."""
    broken = "def initialize():\n    raise RuntimeError('libcudart.so.12: cannot open')"
    shadow(tmp_path, monkeypatch, **{"jax_plugins.xla_cuda12": broken})
    monkeypatch.setenv("JAX_NUM_CPU_DEVICES", "3")
    monkeypatch.setenv("XLA_FLAGS", "--xla_dump_hlo_as_dot=false")
    where, flags, gpu = doctor.devices(try_jax())
    assert (where.found, where.remedy) == ("3 x cpu", "")
    assert flags.found.startswith("--xla_dump_hlo_as_dot=false ")
    assert gpu.found.endswith("RuntimeError: libcudart.so.12: cannot open")
    assert "xla_cuda12" in gpu.found
    assert "\n" not in gpu.found
    assert "pip install 'jax[cuda12]'" in gpu.remedy
    assert not gpu.is_essential


def test_a_card_that_jax_does_not_see_is_told(monkeypatch):
    said = Tried('{"devices": ["cpu"], "flags": ""}', "", False)
    monkeypatch.setattr(doctor.shutil, "which", lambda name: "/usr/bin/nvidia-smi" if name == "nvidia-smi" else None)
    for remark in ("", "RuntimeWarning: of something else"):
        *_, gpu = doctor.devices(said._replace(complaint=remark))
        assert gpu.found == "JAX does not see the one that is here"
        assert "pip install 'jax[cuda12]'" in gpu.remedy
    seen = said._replace(said='{"devices": ["NVIDIA H100", "NVIDIA H100"], "flags": ""}')
    where, flags = doctor.devices(seen)
    assert (where.found, flags.found) == ("2 x NVIDIA H100", "none")
    monkeypatch.setattr(doctor.shutil, "which", lambda _: None)
    assert len(list(doctor.devices(said._replace(complaint="RuntimeWarning: of something else")))) == 2


def test_without_jax_all_else_is_told(tmp_path, monkeypatch):
    shadow(tmp_path, monkeypatch, jax="raise ImportError('jaxlib is not that of jax')")
    command = [sys.executable, "-m", "tog_mjx", "doctor"]
    done = subprocess.run(command, capture_output=True, text=True, env=os.environ | {"MUJOCO_GL": "egl"})
    assert (done.returncode, done.stderr) == (1, "")
    rows = {cells[2].strip(): cells for line in done.stdout.splitlines() if len(cells := line.split("|")) == 6}
    assert rows["JAX"][1].strip() == "fault"
    assert rows["JAX"][3].strip() == "ImportError: jaxlib is not that of jax"
    assert "pip install --upgrade jax" in rows["JAX"][4]
    assert rows["numpy"][1].strip() == "fine"
    assert {"OpenGL, egl (MUJOCO_GL)", "cache", "Python"} <= set(rows)
    assert done.stdout.splitlines()[-1] == "missing, and essential: JAX"


def test_flags_that_xla_refuses_have_a_remedy_of_their_own(monkeypatch):
    monkeypatch.setenv("XLA_FLAGS", "--xla_nonsense=1")
    with pytest.raises(InputError) as refused:
        tune_compiler()
    (part,) = doctor.devices(Tried("", f"InputError: {refused.value}", True))
    assert part.found.startswith("InputError: jaxlib ")
    assert part.remedy == "mend or unset XLA_FLAGS"
    assert part.is_essential


def test_an_opengl_that_fails_is_told_though_it_ends_its_process(tmp_path, monkeypatch):
    shadow(
        tmp_path,
        monkeypatch,
        OpenGL="raise ImportError('no libEGL here')",
        glfw="import os, signal\nos.kill(os.getpid(), signal.SIGSEGV)",
    )
    tried = {"egl": try_opengl("egl"), "glfw": try_opengl("glfw")}
    assert tried["egl"].failed
    assert "no libEGL here" in tried["egl"].complaint
    assert tried["glfw"].complaint == f"ended by signal {signal.SIGSEGV.value}"
    monkeypatch.delenv("MUJOCO_GL", raising=False)
    monkeypatch.setenv("DISPLAY", ":7")
    egl, window = doctor.opengl(tried)
    assert egl.remedy == "for animations as MuJoCo renders them: apt-get install libegl1 libgl1-mesa-dri"
    assert window.remedy == "for a window: a display (DISPLAY is :7); without one: tog view --web"


def test_one_opengl_without_a_display_is_enough(monkeypatch):
    monkeypatch.delenv("MUJOCO_GL", raising=False)
    tried = {"egl": FAILS, "osmesa": WORKS}
    assert [part.remedy for part in doctor.opengl(tried)] == ["", ""]
    monkeypatch.setenv("MUJOCO_GL", "egl")
    *_, wish = doctor.opengl(tried)
    assert wish == Part("MUJOCO_GL", "egl", "nothing renders with it: unset MUJOCO_GL")


def test_an_encoder_and_a_browser_that_are_missing_are_told(monkeypatch):
    def lost():
        raise RuntimeError("No ffmpeg exe could be found")

    monkeypatch.setitem(sys.modules, "imageio_ffmpeg", SimpleNamespace(get_ffmpeg_exe=lost))
    (part,) = doctor.ffmpeg()
    assert part.found == "No ffmpeg exe could be found"
    assert part.remedy == "for tog view --mp4: pip install --force-reinstall imageio-ffmpeg"
    monkeypatch.setattr(sys, "platform", "linux")
    monkeypatch.setenv("PATH", "")
    assert doctor.browser().found == "missing"
    assert "apt-get install chromium" in doctor.browser().remedy


def test_the_cache_is_weighed_and_told(tmp_path, monkeypatch):
    monkeypatch.delenv("JAX_COMPILATION_CACHE_DIR", raising=False)
    monkeypatch.setenv("TOG_MJX_CACHE", str(tmp_path))
    (tmp_path / "deep").mkdir()
    for name in ("a", "deep/b"):
        (tmp_path / name).write_bytes(bytes(1_500_000))
    assert doctor.cache().found.startswith(f"{tmp_path}, 3 MB in 2 files; TOG_MJX_CACHE=FOLDER moves it")
    monkeypatch.setenv("TOG_MJX_CACHE", str(tmp_path / "a" / "b"))
    assert doctor.cache().found == f"{tmp_path / 'a' / 'b'} cannot be written (Not a directory)"
    assert "TOG_MJX_CACHE=FOLDER" in doctor.cache().remedy
    monkeypatch.setenv("TOG_MJX_CACHE", "off")
    assert doctor.cache().remedy == "to compile once: unset TOG_MJX_CACHE"


def test_the_status_is_that_of_what_is_essential(monkeypatch, run_script):
    care = Part("[red]video", "missing", "pip install it")
    monkeypatch.setattr(doctor, "parts", lambda: [care])
    status, said, _ = run_script("tog", "doctor")
    assert (status, said.splitlines()[-1]) == (0, "nothing essential is missing")
    assert "| care | [red]video | missing | pip install it |" in said
    monkeypatch.setattr(doctor, "parts", lambda: [care, care._replace(name="jax", is_essential=True)])
    status, said, _ = run_script("tog", "doctor")
    assert (status, said.splitlines()[-1]) == (1, "missing, and essential: jax")
