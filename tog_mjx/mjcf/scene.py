"""From an MJCF file to a Scene: the compiled model, the names in it, and the physical parameters read from it.

The MJCF file is the single source of truth: whatever a simulator needs to know is read here from the compiled model,
and the penalty constants from its `<custom><numeric>` elements. Nothing is written twice.
"""

import contextlib
import functools
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import jax
import jax.numpy as jnp
import mujoco
import numpy as np

from tog_mjx.mjcf.contact import PenaltyLaw
from tog_mjx.mjcf.supported import check_supported
from tog_mjx.running.errors import InputError, near, require_kind
from tog_mjx.running.quiet import without_warnings
from tog_mjx.running.types import AnyArray
from tog_mjx.stepping.mjx_state import default_start

_PACKAGE = Path(__file__).parent.parent


@dataclass(frozen=True, eq=False)
class Scene:
    """A compiled MJCF scene. `model` is MuJoCo's; treat it as read-only. Compared and hashed by identity.

    Of a scene of one box and its F fingers it knows which number is which: joints [3 + 2F], actuators [2F]. Of another
    one, `fingers` is empty and the rest raises InputError.

    Units: the model's; of a planar scene m, rad, kg, s.
    Gradient: none but that of `planar` and `of_joints`, which pick numbers out of arrays.
    """

    name: str
    model: mujoco.MjModel

    @functools.cached_property
    def fingers(self) -> tuple[str, ...]:
        """The bodies named finger1, finger2, ... in the order of their numbers."""
        names = (self.model.body(i).name for i in range(self.model.nbody))
        found = [n for n in names if n.startswith("finger") and n.removeprefix("finger").isdigit()]
        return tuple(sorted(found, key=lambda n: int(n.removeprefix("finger"))))

    @functools.cached_property
    def joints(self) -> np.ndarray:
        """Addresses in qpos (and in qvel: all joints are scalar) of box x, z, theta, each finger's x, z. [3 + 2F]
        InputError: for a scene that lacks one of them."""
        names = ["box_x", "box_z", "box_theta", *(f"{finger}_{axis}" for finger in self.fingers for axis in "xz")]
        return np.array([self._named("jnt", name).qposadr[0] for name in names])

    @functools.cached_property
    def actuators(self) -> np.ndarray:
        """Indices in ctrl of the fingers' setpoints, finger-major: x, z of finger1, then of finger2. [2F]
        InputError: for a scene that lacks one of them."""
        ids = [self._named("actuator", f"{finger}_{axis}").id for finger in self.fingers for axis in "xz"]
        return np.array(ids, np.int32)  # Which JAX has whatever its x64 flag.

    @property
    def is_planar(self) -> bool:
        """Whether it is a scene of one box and its fingers."""
        names = {mujoco.mj_id2name(self.model, mujoco.mjtObj.mjOBJ_JOINT, i) for i in range(self.model.njnt)}
        return {"box_x", "box_z", "box_theta", "finger1_x", "finger1_z"} <= names

    def planar(self, qpos: AnyArray, qvel: AnyArray) -> tuple[AnyArray, AnyArray]:
        """Of positions [..., nq] and velocities: box (x, z, theta, vx, vz, omega) [..., 6], fingers (x, z, vx, vz)
        [..., F, 4]."""
        xp = jnp if isinstance(qpos, jax.Array) else np
        joints = xp.asarray(self.joints)
        q, v = qpos[..., joints], qvel[..., joints]
        fingers = [some[..., 3:].reshape(*some.shape[:-1], -1, 2) for some in (q, v)]
        return xp.concatenate([q[..., :3], v[..., :3]], axis=-1), xp.concatenate(fingers, axis=-1)

    @staticmethod
    def of_joints(box: AnyArray, fingers: AnyArray) -> tuple[jax.Array, jax.Array]:
        """Positions and velocities [3 + 2F] of `joints`: the inverse of `planar`."""
        positions = jnp.concatenate([box[:3], fingers[:, :2].ravel()])
        return positions, jnp.concatenate([box[3:], fingers[:, 2:].ravel()])

    @property
    def start(self) -> tuple[np.ndarray, np.ndarray]:
        """Box [6] and fingers [F, 4] at the keyframe `start`, else the first one, else the initial pose."""
        box, fingers = self.planar(self._start.qpos, self._start.qvel)
        return np.asarray(box), np.asarray(fingers)

    @property
    def initial_guess(self) -> np.ndarray:
        """The setpoints u [2F] of that start."""
        return np.array(self._start.ctrl[self.actuators])

    @functools.cached_property
    def _start(self) -> mujoco.MjData:
        return default_start(self.model)

    def numeric(self, name: str) -> float:
        """The value of `<custom><numeric name=... data=...>`. InputError: for a scene without it."""
        return float(self._named("numeric", name).data[0])

    @functools.cached_property
    def physics(self) -> "Physics":
        """The physical parameters of a planar scene of one box and its fingers; see `Physics`.

        Raises:
          InputError: names the element that the scene lacks, or in which its fingers differ.
        """
        model = self.model
        box, fingers = self._named("body", "box"), [self._named("body", f) for f in self.fingers]
        if not fingers:
            raise InputError(f"scene {self.name}: no body is named finger1; name the fingers finger1, finger2, ...")
        half = self._named("geom", "box").size[[0, 2]]
        corners = [g for g in range(model.ngeom) if model.geom_bodyid[g] == box.id and self._touches_floor(g)]
        if not corners:
            raise InputError(
                f"scene {self.name}: no <contact><pair> of a sphere of the box and the geom floor; add them"
            )
        radius = [float(self._named("geom", f).size[0]) for f in self.fingers]
        gain = model.actuator_gainprm[self.actuators, 0]
        damping = -model.actuator_biasprm[self.actuators, 2]
        mass = [float(body.mass[0]) for body in fingers]
        for what, values in (("mass", mass), ("radius", radius), ("kp", gain), ("kv", damping)):
            if np.ptp(values):
                raise InputError(
                    f"scene {self.name}: the fingers differ in {what} ({values}); give all of them the same"
                )
        return Physics(
            gravity=-float(model.opt.gravity[2]),
            timestep=float(model.opt.timestep),
            box_mass=float(box.mass[0]),
            box_inertia=self._inertia_about_y(box),
            box_half=half,
            corners=model.geom_pos[corners][:, [0, 2]],
            corner_radius=float(model.geom_size[corners[0], 0]),
            finger_mass=mass[0],
            finger_radius=radius[0],
            finger_stiffness=float(gain[0]),
            finger_damping=float(damping[0]),
            corner_floor=self._law("corner_floor", corners[0]),
            finger_floor=self._law("finger_floor", self._named("geom", self.fingers[0]).id),
            finger_box=self._law("finger_box", self._named("geom", self.fingers[0]).id),
        )

    def _inertia_about_y(self, body) -> float:
        """The moment of inertia about the body's y axis, whatever its principal axes."""
        if np.abs(body.ipos).max() > 0:
            raise InputError(
                f"scene {self.name}: body {body.name} has its centre of mass at {body.ipos}; put it at its origin"
            )
        rotation = np.zeros(9)
        mujoco.mju_quat2Mat(rotation, body.iquat)
        y = rotation.reshape(3, 3)[1]
        return float(y**2 @ body.inertia)

    def _law(self, kind: str, geom: int) -> PenaltyLaw:
        """The penalty law of a kind of contact, from the scene's constants and the friction of the pair itself."""
        other = self._named("geom", kind.split("_")[1]).id
        return PenaltyLaw(
            stiffness=self.numeric("contact_stiffness"),
            damping=self.numeric("contact_damping"),
            friction=float(self.model.pair_friction[self.pair(geom, other), 0]),
            viscosity=self.numeric(f"viscous_friction_{kind}"),
            slope=self.numeric("friction_slope"),
        )

    def pair(self, geom1: int, geom2: int) -> int:
        """The number of the contact pair of two geoms. InputError: for geoms that are none."""
        model = self.model
        for i in range(model.npair):
            if {int(model.pair_geom1[i]), int(model.pair_geom2[i])} == {geom1, geom2}:
                return i
        names = model.geom(geom1).name, model.geom(geom2).name
        raise InputError(f"scene {self.name}: no <contact><pair> of the geoms {names[0]} and {names[1]}; add it")

    def _touches_floor(self, geom: int) -> bool:
        floor = self._named("geom", "floor").id
        pairs = zip(self.model.pair_geom1, self.model.pair_geom2, strict=True)
        return any({geom, floor} == {int(a), int(b)} for a, b in pairs)

    def _named(self, kind: str, name: str):
        """MuJoCo's view of an element, or one clear line where the scene lacks it."""
        try:
            return getattr(self.model, kind)(name)
        except KeyError:
            raise InputError(
                f"scene {self.name}: it has no {kind} named {name}, which the planar simulators need"
            ) from None


class Physics(NamedTuple):
    """Physical parameters of a planar scene, SI units. All fields are leaves of the pytree.

    Lengths: `box_half` [2] half sides along the box's x and z; `corners` [C, 2] in the box's frame. `finger_stiffness`
    and `finger_damping` are k_p and k_d of the stiffness control; the laws are those of the three kinds of contact.
    """

    gravity: float
    timestep: float
    box_mass: float
    box_inertia: float
    box_half: np.ndarray
    corners: np.ndarray
    corner_radius: float
    finger_mass: float
    finger_radius: float
    finger_stiffness: float
    finger_damping: float
    corner_floor: PenaltyLaw
    finger_floor: PenaltyLaw
    finger_box: PenaltyLaw


def models_folder() -> Path:
    """Where the scenes lie: inside an installed package, beside it in a checkout."""
    installed = _PACKAGE / "models"
    return installed if installed.is_dir() else _PACKAGE.parent / "models"


def scene_names() -> list[str]:
    """The scenes that come with the package: every MJCF file in `models` that is a whole model."""
    return sorted(path.stem for path in models_folder().glob("*.xml") if "<mujoco " in path.read_text())


def scene_path(scene: str | Path) -> Path:
    """The file of a scene, given by its name ("flip", "grasp") or as the path of any MJCF file.

    Raises:
      InputError: if there is neither such a scene nor such a file.
    """
    if str(scene) in scene_names():
        return models_folder() / f"{scene}.xml"
    require_kind("the scene", scene, (str, Path), f"name one of {', '.join(scene_names())} or give a path")
    path, names = Path(scene), scene_names()
    try:
        is_file = path.is_file()
    except OSError:  # A name that no file system takes.
        is_file = False
    if not is_file:
        where = ""
        with contextlib.suppress(OSError, ValueError):
            where = "" if path.is_absolute() else f" in {Path.cwd()}"
            names += [str(other) for other in path.parent.glob("*.xml")]
        raise InputError(
            f"{scene}: no such scene or file{where}; name one of {', '.join(scene_names())} "
            f"or give the path of an MJCF file{near(scene, names)}"
        )
    return path


def compile_model(path: Path) -> mujoco.MjModel:
    """Compiles an MJCF file with MuJoCo, which may hold more than MJX can simulate.

    Raises:
      InputError: one line for a file that is malformed.
    """
    try:
        path.open("rb").close()
        if path.suffix == ".mjb":
            raise ValueError("it is a compiled model; give the MJCF file that it was made from")
        with without_warnings():
            model = mujoco.MjModel.from_xml_path(str(path))
        model.names.decode()
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror})") from None
    except UnicodeError:
        raise InputError(f"{path}: its name or a name in it is not in UTF-8; save it in that encoding") from None
    except ValueError as error:
        raise InputError(f"{path}: MuJoCo cannot read it: {' '.join(str(error).split())}") from None
    require_time_step(model, str(path))
    return model


def require_time_step(model: mujoco.MjModel, what: str) -> None:
    """Raises InputError, of `what`, for a time step that is none."""
    if not 0 < model.opt.timestep < np.inf:
        raise InputError(f"{what}: <option timestep> is {model.opt.timestep}; give a positive number of seconds")


def load_scene(scene: str | Path) -> Scene:
    """Compiles a scene, given by its name or as the path of any MJCF file, and checks that MJX can simulate it.

    Raises:
      InputError: one line for a file that is missing, malformed, or uses a feature that MJX lacks.
    """
    path = scene_path(scene)
    model = compile_model(path)
    check_supported(model, path)
    return Scene(path.stem, model)
