"""What a result was made with: a digest of the scene and one of the program, or one of a function.

A result that was kept is read again only if they are the same. The program is the module that makes the result, all
modules of this package that it imports, and theirs, by name: a name that a package only passes on stands for the module
it comes from. Of the code comments and docstrings do not count.
"""

import ast
import functools
import hashlib
import importlib.metadata
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import jax
import jaxlib.version
import mujoco
import numpy as np

_PACKAGE = Path(__file__).parent.parent
DRAWS = ("tog_mjx.drawing", "tog_mjx.running.console", "tog_mjx.running.progress")
"""Parts of this package without influence on a result."""
COMPUTES = {
    "jax": ("jax", "jaxlib"),
    "jaxlib": ("jaxlib",),
    "mujoco": ("mujoco", "mujoco-mjx"),
    "numpy": ("numpy",),
    "optax": ("optax",),
    "evosax": ("evosax",),
    "scipy": ("scipy",),
}
"""Libraries that compute, by what is imported, with their distributions: their versions count where they are used."""


def scene_digest(model: mujoco.MjModel) -> str:
    """SHA-256 of the compiled scene: any change of a number in its MJCF file changes it."""
    binary = np.empty(mujoco.mj_sizeModel(model), np.uint8)
    mujoco.mj_saveModel(model, None, binary)
    return hashlib.sha256(binary.tobytes()).hexdigest()


def made_with(model: mujoco.MjModel, module: str) -> dict[str, str]:
    """Both digests, for the settings of a result that `module` makes and keeps."""
    return {"scene": scene_digest(model), "program": program_digest(module)}


def lowered(function: Callable, *arguments: Any) -> jax.stages.Lowered:
    """What JAX makes of a function of such arguments: the same on whatever device it will run."""
    return jax.jit(function).trace(*arguments).lower(lowering_platforms=("cpu",))


def function_digest(function: jax.stages.Lowered, *arrays: np.ndarray) -> str:
    """SHA-256 of all that the values of a `lowered` function depend on, any number in it and its compiler, and of
    arrays."""
    digest = hashlib.sha256(f"{function.as_text()}{jaxlib.version.__version__}".encode())
    for array in arrays:
        digest.update(np.ascontiguousarray(array).tobytes())
    return digest.hexdigest()


@functools.cache
def program_digest(module: str, package: Path = _PACKAGE) -> str:
    """SHA-256 of the code behind `module` ("tog_mjx.mjcf.scene"), and of the versions of the libraries that it uses.

    `package` is the folder that `tog_mjx` stands for.
    """
    digest = hashlib.sha256()
    for name in sorted(modules_behind(module, package)):
        if file := _file(name, package):
            digest.update(f"{name}\n{_parsed(file).code}\n".encode())
        for library in COMPUTES.get(name, ()):
            digest.update(f"{library}=={_version(library)}\n".encode())
    return digest.hexdigest()


def modules_behind(module: str, package: Path = _PACKAGE) -> set[str]:
    """The module, what it imports and what that imports: modules of this package, and libraries by their first name."""
    found, left = set[str](), [module]
    while left:
        name = left.pop()
        file = _file(name, package)
        if name in found or f"{name}.".startswith(tuple(f"{part}." for part in DRAWS)):
            continue
        found.add(name if file else name.partition(".")[0])
        left += [_origin(*some, package) for some in _parsed(file).imports] if file else []
    return found


def _origin(module: str, name: str, package: Path) -> str:
    """The module that `from module import name` is about: the name may be one, or a package may pass it on."""
    file = _file(module, package)
    if file is None or not name:
        return module
    if _file(f"{module}.{name}", package):
        return f"{module}.{name}"
    passed_on = [some for some, its_name in _parsed(file).imports if its_name == name and file.stem == "__init__"]
    return _origin(passed_on[0], name, package) if passed_on else module


@functools.cache
def _file(module: str, package: Path) -> Path | None:
    """The file of a module of this package; None of any other."""
    root, *parts = module.split(".")
    path = package.joinpath(*parts)
    files = [path / "__init__.py", path.with_suffix(".py")] if root == _PACKAGE.name else []
    return next((file.resolve() for file in files if file.is_file()), None)


class _Parsed(NamedTuple):
    """Of a file the code without comments and docstrings, and what it imports: (module, name in it, or "" for all)."""

    code: str
    imports: tuple[tuple[str, str], ...]


@functools.cache
def _parsed(file: Path) -> _Parsed:
    tree = ast.parse(file.read_text())
    imports = [some for node in ast.walk(tree) for some in _imported(node)]
    return _Parsed(ast.unparse(_WithoutText().visit(tree)), tuple(imports))


def _imported(node: ast.AST) -> list[tuple[str, str]]:
    match node:
        case ast.Import(names=names):
            return [(alias.name, "") for alias in names]
        case ast.ImportFrom(module=str(module), names=names):
            return [(module, alias.name) for alias in names]
        case ast.Call(func=ast.Attribute(attr="import_module"), args=[ast.Constant(value=str(module))]):
            return [(module, "")]
    return []


class _WithoutText(ast.NodeTransformer):
    """Removes docstrings; comments are gone when a file has been parsed."""

    def visit_Expr(self, node: ast.Expr) -> ast.Expr | None:
        return None if isinstance(node.value, ast.Constant) else node


def _version(library: str) -> str:
    try:
        return importlib.metadata.version(library)
    except importlib.metadata.PackageNotFoundError:  # Those of studies may be missing where none is made.
        return "none"
