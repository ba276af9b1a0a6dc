"""What of this machine the commands will use, what is missing, and the line that installs it.

Exit status: 0 where nothing essential is missing, else 1. The table is Markdown, to be pasted into a report of a fault.
"""

import contextlib
import importlib
import importlib.metadata as metadata
import json
import os
import platform
import re
import shutil
import sys
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import NamedTuple

from packaging.requirements import Requirement
from rich import box
from rich.console import Console
from rich.markup import escape
from rich.table import Table

from tog_mjx.running import probes
from tog_mjx.running.arguments import ArgumentParser
from tog_mjx.running.caches import CACHE_VARIABLE, cache_folder, unwritable
from tog_mjx.running.errors import printable

GIVES = {
    "studies": "tog study",
    "video": "tog view --mp4",
    "clients": "gradients through environments of brax and of MuJoCo Playground",
    "browser": "tests of the pages",
}
"""What an extra of the package is for."""
BACKENDS = ("egl", "osmesa", "glfw") if sys.platform == "linux" else ("glfw",)
OFFSCREEN = {"egl": "apt-get install libegl1 libgl1-mesa-dri", "osmesa": "apt-get install libosmesa6"}
BROWSERS = ("chromium", "chromium-browser", "google-chrome", "firefox")


class Part(NamedTuple):
    """One line: what it is, what was found, and what is to be done where that is not enough."""

    name: str
    found: str
    remedy: str = ""
    is_essential: bool = False


def main() -> None:
    ArgumentParser(description=__doc__.splitlines()[0]).parse_args()
    console = Console(stderr=True)
    with console.status("trying JAX and OpenGL") if console.is_terminal else contextlib.nullcontext():
        found = parts()
    Console(width=None if Console().is_terminal else 200, highlight=False).print(table(found))
    missing = [part.name for part in found if part.remedy and part.is_essential]
    print(f"missing, and essential: {', '.join(missing)}" if missing else "nothing essential is missing")
    sys.exit(int(bool(missing)))


def parts() -> list[Part]:
    """All there is to say; what has to be tried is tried at once."""
    with ThreadPoolExecutor() as pool:
        tried = {backend: pool.submit(probes.try_opengl, backend) for backend in BACKENDS}
        jax = pool.submit(probes.try_jax)
        found = [Part("Python", f"{platform.python_version()}, {sys.executable}"), *packages()]
        found += [*devices(jax.result()), *opengl({name: one.result() for name, one in tried.items()})]
    return [*found, *ffmpeg(), browser(), cache(), Part("XLA_FLAGS", os.environ.get("XLA_FLAGS") or "none of yours")]


def packages() -> Iterator[Part]:
    """Those that the package needs, with their versions, and its extras."""
    try:
        yield Part("tog_mjx", f"{metadata.version('tog_mjx')}, {Path(__file__).parents[1]}")
        needed = [Requirement(line) for line in metadata.requires("tog_mjx") or ()]
    except metadata.PackageNotFoundError:
        yield Part("tog_mjx", f"not installed, {Path(__file__).parents[1]}", "pip install . in its folder")
        return
    for one in needed:
        if one.marker is None or one.marker.evaluate({"extra": ""}):
            state = version(one)
            yield Part(one.name, state, "" if fits(one) else install(one), True)
    yield Part("jaxlib", version(Requirement("jaxlib")))
    for extra, gives in GIVES.items():
        holds = [one for one in needed if one.marker and f'extra == "{extra}"' in str(one.marker)]
        wanting = [one for one in holds if not fits(one)]
        remedy = f"for {gives}: {install(*wanting)}" if wanting else ""
        if holds:
            yield Part(f"extra {extra}", ", ".join(f"{one.name} {version(one)}" for one in holds), remedy)


def version(one: Requirement) -> str:
    try:
        return metadata.version(one.name)
    except metadata.PackageNotFoundError:
        return "missing"


def fits(one: Requirement) -> bool:
    return (has := version(one)) != "missing" and one.specifier.contains(has, prereleases=True)


def install(*wanting: Requirement) -> str:
    return " ".join(["pip install", *(f"'{one.name}{one.specifier}'" for one in wanting)])


def devices(tried: probes.Tried) -> Iterator[Part]:
    """JAX's, as a command has them, and why it has no GPU where there is one."""
    if tried.failed:
        is_flag = "XLA_FLAGS" in tried.complaint
        remedy = "mend or unset XLA_FLAGS" if is_flag else "to compute at all: pip install --upgrade jax mujoco-mjx"
        yield Part("JAX", printable(tried.complaint), remedy, True)
        return
    found = json.loads(tried.said)
    kinds = {kind: found["devices"].count(kind) for kind in found["devices"]}
    yield Part("JAX computes on", ", ".join(f"{count} x {kind}" for kind, count in kinds.items()))
    yield Part("XLA flags of commands", found["flags"] or "none")
    has_gpu = any(kind.lower() != "cpu" for kind in kinds)
    is_of_gpu = re.search("plugin|cuda|rocm|gpu|tpu|nvidia", tried.complaint, re.IGNORECASE)
    if is_of_gpu or (shutil.which("nvidia-smi") and not has_gpu):
        remedy = "for a GPU: pip install 'jax[cuda12]'; without one: pip uninstall the plugin that is named"
        yield Part("GPU", printable(tried.complaint if is_of_gpu else "JAX does not see the one that is here"), remedy)


def opengl(tried: dict[str, probes.Tried]) -> Iterator[Part]:
    """The backends of MuJoCo. Of those that need no display one is enough."""
    can_render = any(not tried[name].failed for name in tried if name in OFFSCREEN)
    for name, one in tried.items():
        remedy = ""
        if one.failed and name in OFFSCREEN and not can_render:
            remedy = f"for animations as MuJoCo renders them: {OFFSCREEN[name]}"
        if one.failed and name == "glfw":
            display = os.environ.get("DISPLAY") or "not set"
            remedy = f"for a window: a display (DISPLAY is {display}); without one: tog view --web"
        wish = " (MUJOCO_GL)" if os.environ.get("MUJOCO_GL", "").lower() == name else ""
        yield Part(f"OpenGL, {name}{wish}", printable(one.complaint) if one.failed else "renders", remedy)
    if (wished := os.environ.get("MUJOCO_GL", "").lower()) and (wished not in tried or tried[wished].failed):
        yield Part("MUJOCO_GL", wished, "nothing renders with it: unset MUJOCO_GL")


def ffmpeg() -> Iterator[Part]:
    """Brought by the extra `video`, which is told of already where it is missing."""
    try:
        yield Part("ffmpeg", importlib.import_module("imageio_ffmpeg").get_ffmpeg_exe())
    except ImportError:
        return
    except RuntimeError as error:
        yield Part(
            "ffmpeg", printable(str(error)), f"for {GIVES['video']}: pip install --force-reinstall imageio-ffmpeg"
        )


def browser() -> Part:
    found = next((path for name in BROWSERS if (path := shutil.which(name))), None)
    if sys.platform != "linux":
        return Part("browser", found or "the system's")
    remedy = "for the pages on this machine: apt-get install chromium; tog view --web serves other computers too"
    return Part("browser", found or "missing", "" if found else remedy)


def cache() -> Part:
    """Of compiled functions."""
    folder, how = cache_folder(), f"{CACHE_VARIABLE}=FOLDER moves it, {CACHE_VARIABLE}=off turns it off"
    if folder is None:
        return Part("cache", f"{CACHE_VARIABLE}=off", f"to compile once: unset {CACHE_VARIABLE}")
    if complaint := unwritable(folder):
        return Part("cache", f"{folder} cannot be written ({complaint})", f"to compile once: {CACHE_VARIABLE}=FOLDER")
    sizes = [file.stat().st_size for file in folder.rglob("*") if file.is_file()]
    return Part("cache", f"{folder}, {sum(sizes) / 1e6:.0f} MB in {len(sizes)} files; {how}")


def table(found: list[Part]) -> Table:
    made = Table(box=box.MARKDOWN)
    for column in ("", "what", "found", "remedy"):
        made.add_column(column, overflow="fold")
    for part in found:
        word, colour = (
            ("fine", "green") if not part.remedy else ("fault", "red") if part.is_essential else ("care", "yellow")
        )
        made.add_row(f"[{colour}]{word}[/]", *map(escape, (part.name, part.found, part.remedy)))
    return made


def run() -> None:
    main()
