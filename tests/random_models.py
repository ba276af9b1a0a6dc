"""Random models: structures, which cost a compilation each, and the numbers in them, which cost none."""

from typing import NamedTuple

import mujoco
import numpy as np

JOINTS = {
    "free": '<freejoint name="r{i}"/>',
    # Off the centre of mass: at it MuJoCo's inverse weight of the body is zero, and its contacts infinitely stiff.
    "ball": '<joint name="r{i}" type="ball" pos="0 0 .1" stiffness="{a}" damping="{b}" limited="true" range="0 {c}"/>',
    "hinge": '<joint name="r{i}" axis="0 1 .2" pos="0 0 .1" stiffness="{a}" damping="{b}" armature="{c}"/>',
    "slide": '<joint name="r{i}" type="slide" axis=".1 0 1" stiffness="{a}" frictionloss="{b}"/>',
}
GEOMS = {
    "capsule": 'type="capsule" size="{a}" fromto="-.1 0 0 .1 .02 {b}"',
    "ellipsoid": 'type="ellipsoid" size="{a} {b} {c}"',
    "cylinder": 'type="cylinder" size="{a} {b}"',
    "box": 'type="box" size="{a} {b} {c}"',
}
EQUALITIES = {
    "connect": '<connect body1="b0" body2="b1" anchor=".2 0 {a}" solref="{t} {d}"/>',
    "weld": '<weld body1="b0" body2="b1" torquescale="{a}" solref="{t} {d}"/>',
    "joint": '<joint joint1="h0" joint2="h1" polycoef="{b} {a} {c} 0 .1" solref="{t} {d}"/>',
    "tendon": '<tendon tendon1="fixed" tendon2="spatial" polycoef="0 {a} 0 0 0" solref="{t} {d}"/>',
}
ACTUATORS = {
    "motor": '<motor joint="h0" gear="{a}"/>',
    "position": '<position joint="h1" kp="{a}" kv="{b}"/>',
    "velocity": '<velocity joint="h0" kv="{b}"/>',
    "intvelocity": '<intvelocity joint="h1" kp="{a}" actrange="-2 2"/>',
    "damper": '<damper joint="h0" kv="{b}" ctrlrange="0 1"/>',
    "cylinder": '<cylinder tendon="fixed" timeconst="{c}" area="{a}"/>',
    "muscle": '<muscle joint="h1" lengthrange="-1 1" force="{a}"/>',
    "filter": '<general tendon="spatial" dyntype="filterexact" dynprm="{c}" gainprm="{a}" biastype="affine"'
    ' biasprm="0 -{a} -{b}"/>',
    "site": '<general site="s0" refsite="anchor" gear="1 {a} 0 0 {b} {c}" gainprm="{a}" biastype="affine"'
    ' biasprm="{b} -{a} -{c}"/>',
    "root": '<motor joint="r0" gear="{a} {b} {c} {a} {b} {c}"/>',
}


class Structure(NamedTuple):
    """What makes a program: with it the numbers of a model may be any."""

    joints: tuple[str, ...]
    geoms: tuple[str, ...]
    condims: tuple[int, ...]
    equalities: tuple[str, ...]
    actuators: tuple[str, ...]
    cone: str
    integrator: str
    has_fluid: bool
    wraps: bool


def structure_of(seed: int, half: int, cone: str, integrator: str) -> Structure:
    """Two bodies near a floor, each with another one on a hinge, and what holds and pulls them.

    The two halves of a seed share out all joints, geoms, equalities and actuators.
    """
    rng = np.random.default_rng(seed)

    def share(choices: dict[str, str]) -> tuple[str, ...]:
        return tuple(np.array_split(rng.permutation(sorted(choices)), 2)[half].tolist())

    parts = share(JOINTS), share(GEOMS), share(EQUALITIES), share(ACTUATORS)
    condims = tuple(np.random.default_rng([seed, half]).permutation([1, 3, 4, 6])[:2].tolist())
    if cone == "elliptic":  # On which MJX knows no contact without friction.
        condims = tuple(max(condim, 3) for condim in condims)
    has_fluid = integrator != "implicitfast" and bool(rng.integers(2))
    return Structure(*parts[:2], condims, *parts[2:], cone, integrator, has_fluid, wraps=bool(half))


def model_of(structure: Structure, rng: np.random.Generator) -> mujoco.MjModel:
    """The structure with numbers of its own: sizes, masses, frictions, gains, time constants."""

    def numbers(factor: float = 1.0) -> dict[str, float]:
        drawn = rng.uniform([0.06, 0.07, 0.08, 0.02, 0.6], [0.12, 0.11, 0.1, 0.1, 1.5])
        return dict(zip("abctd", (drawn * [factor, factor, factor, 1, 1]).round(4).tolist(), strict=True))

    def surface(condim: int) -> str:
        given: dict[str, tuple | np.ndarray] = {
            "friction": rng.uniform([0.3, 0.01, 0.01], [1.5, 0.1, 0.1]),
            "solref": rng.uniform([0.02, 0.6], [0.06, 1.4]),
            "solimp": (rng.uniform(0.5, 0.9), 0.95, 0.01, 0.4, rng.uniform(1, 3)),
            "mass": (rng.uniform(0.3, 3),),
        }
        words = (f'{name}="{" ".join(f"{x:.4g}" for x in values)}"' for name, values in given.items())
        return " ".join([f'condim="{condim}"', *words])

    def uniform(low: float, high: float) -> str:
        return f"{rng.uniform(low, high):.4g}"

    bodies = ""
    for i, (joint, geom, condim) in enumerate(zip(structure.joints, structure.geoms, structure.condims, strict=True)):
        own = {**numbers(5), "c": 50} if joint == "ball" else numbers(5)
        bodies += f"""<body name="b{i}" pos="{0.5 * i} 0 {uniform(0.07, 0.1)}">{JOINTS[joint].format(i=i, **own)}
          <geom name="g{i}" {GEOMS[geom].format(**numbers())} {surface(condim)}/>
          <site name="s{i}" pos="0 .05 {uniform(0.02, 0.1)}"/>
          <body pos=".2 0 {uniform(0.02, 0.1)}">
            <joint name="h{i}" axis="0 1 {uniform(-1, 1)}" range="-20 20" limited="{["false", "true"][i]}"
              frictionloss="{uniform(0.01, 0.1)}" damping="{uniform(0, 0.1)}"/>
            <geom name="e{i}" type="{["sphere", "capsule"][i]}" size=".05 .06" pos=".1 0 .02" {surface(condim)}/>
          </body></body>"""
    wrapped = '<geom geom="post"/>' if structure.wraps else ""
    fluid = 'density="50" viscosity=".5"' if structure.has_fluid else ""
    return mujoco.MjModel.from_xml_string(f"""<mujoco>
      <option timestep="0.002" cone="{structure.cone}" integrator="{structure.integrator}" tolerance="1e-14"
        iterations="100" ls_iterations="50" impratio="{uniform(1, 3)}" {fluid}/>
      <default><geom contype="1" conaffinity="0"/></default>
      <worldbody><geom type="plane" size="9 9 .1" contype="0" conaffinity="1" friction=".1 .001 .001"/>
        <geom name="post" size=".1" pos=".3 .1 .4" contype="0"/><site name="anchor" pos="0 {uniform(0.2, 0.4)} .5"/>
        {bodies}</worldbody>
      <contact><pair geom1="e0" geom2="e1" condim="3"/></contact>
      <tendon>
        <fixed name="fixed" stiffness="{uniform(1, 5)}">
          <joint joint="h0" coef="1"/><joint joint="h1" coef="-.5"/></fixed>
        <spatial name="spatial" stiffness="{uniform(1, 9)}" damping="{uniform(0, 1)}" springlength=".3" limited="true"
          range="0 {uniform(0.9, 2)}"><site site="anchor"/>{wrapped}<site site="s1"/></spatial>
      </tendon>
      <equality>{"".join(EQUALITIES[name].format(**numbers()) for name in structure.equalities)}</equality>
      <actuator>{"".join(ACTUATORS[name].format(**numbers(10)) for name in structure.actuators)}</actuator>
      </mujoco>""")


def state_of(model: mujoco.MjModel, rng: np.random.Generator) -> np.ndarray:
    """(qpos, qvel, act, ctrl): the model's own pose, moved by centimetres and some degrees, in motion."""
    qpos = model.qpos0.copy()
    mujoco.mj_integratePos(model, qpos, rng.normal(size=model.nv) * 0.04, 1)
    rest = rng.normal(size=model.nv) * 0.5, rng.uniform(0.1, 0.9, model.na), rng.uniform(0.1, 0.9, model.nu)
    return np.concatenate([qpos, *rest])
