"""MuJoCo, imported also where the variable MUJOCO_GL names an OpenGL that does not work: no function of this package
draws with it in this process."""

import importlib
import os
import sys
import warnings


def _import_mujoco() -> None:
    try:
        importlib.import_module("mujoco")
    except Exception as error:  # Whatever the OpenGL library makes of it.
        wish = os.environ.get("MUJOCO_GL")
        if not wish:
            raise
        os.environ["MUJOCO_GL"] = "disable"
        try:
            mujoco = importlib.import_module("mujoco")
        finally:
            os.environ["MUJOCO_GL"] = wish
        # What the first attempt has loaded is no part of the second one's package by itself.
        for name, module in list(sys.modules.items()):
            if name.rpartition(".")[0] == "mujoco":
                setattr(mujoco, name.removeprefix("mujoco."), module)
        reason = str(error).strip().splitlines()[0]
        message = f"MUJOCO_GL={wish} does not work here ({reason}): this process has no OpenGL"
        remedy = "unset it, or choose egl, osmesa, glfw or disable"
        # With a place of its own: Python would print a line of code after any other.
        warnings.warn_explicit(f"{message}; {remedy}", RuntimeWarning, "tog_mjx", 1)


_import_mujoco()
