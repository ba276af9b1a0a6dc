"""The released program's mathematics once more, in plain NumPy float64, for the tests alone.

One number at a time, with every constant written out: slow, and too plain to share a mistake with the JAX version.
"""

import math

import numpy as np

G, DT, M_BOX, M_FINGER, SIDE = 9.81, 0.001, 1.0, 0.1, 0.5
K_C, MU, C, K_D = 1000.0, 0.7, 2.0, 2.0
D_C, PSI = 2 * math.sqrt(M_BOX * K_C), 0.7 / 2.0
TASK = {
    "flip": (600, 10.0, [-1.0, 0.25, math.pi / 2], [(-1.25, 0.4)]),
    "grasp": (500, 40.0, [0.0, 0.25, 0.0], [(-0.3, 0.25), (0.3, 0.25)]),
}


def _floor(z: float, vx: float, vz: float) -> tuple[float, float]:
    phi = min(0.0, z)
    normal = -K_C * phi - (D_C * vz if phi < 0 else 0.0)
    mu = C * vx if abs(vx) <= PSI else math.copysign(MU, vx)
    return -mu * normal, normal


def _box_finger(px: float, pz: float, vx: float, vz: float) -> tuple[float, float]:
    """Force on the finger, all in the box's frame."""
    dx, dz = abs(px) - SIDE / 2, abs(pz) - SIDE / 2
    phi = min(0.0, min(0.0, max(dx, dz)) + math.hypot(max(1e-3, dx), max(1e-3, dz)))
    n = {(1, 0): (1, 0), (1, 1): (0, 1), (0, 1): (-1, 0), (0, 0): (0, -1)}[pz > -px, pz > px]
    vn = vx * n[0] + vz * n[1]
    tx, tz = vx - vn * n[0], vz - vn * n[1]
    size = math.hypot(tx + 1e-3, tz + 1e-3)
    factor = C if size <= PSI else MU / (size + 1e-3)
    normal = -K_C * phi - (D_C * vn if phi < 0 else 0.0)
    return normal * (n[0] - factor * tx), normal * (n[1] - factor * tz)


def cost(task: str, u: np.ndarray) -> float:
    """J(u) of the released program."""
    horizon, k_p, (x, z, a), starts = TASK[task]
    vx = vz = w = 0.0
    fingers = [[fx, fz, 0.0, 0.0] for fx, fz in starts]
    inertia = M_BOX * SIDE**2 / 6
    for _ in range(horizon - 1):
        c, s = math.cos(a), math.sin(a)
        force_x, force_z, torque = 0.0, -M_BOX * G, 0.0
        for cx, cz in ((-0.25, 0.25), (0.25, 0.25), (-0.25, -0.25), (0.25, -0.25)):
            rx, rz = c * cx - s * cz, s * cx + c * cz
            fx, fz = _floor(z + rz, vx - math.sqrt(2) * w * rz, vz + math.sqrt(2) * w * rx)
            force_x, force_z, torque = force_x + fx, force_z + fz, torque + rx * fz - rz * fx
        accelerations = []
        for i, (px, pz, ux, uz) in enumerate(fingers):
            ox, oz, rx, rz = px - x, pz - z, ux - vx, uz - vz
            lx, lz = c * ox + s * oz, -s * ox + c * oz
            bx, bz = _box_finger(lx, lz, c * rx + s * rz + w * lz, -s * rx + c * rz - w * lx)
            fx, fz = c * bx - s * bz, s * bx + c * bz
            gx, gz = _floor(pz, ux, uz)
            force_x, force_z, torque = force_x - fx, force_z - fz, torque - (ox * fz - oz * fx)
            accelerations.append(
                (
                    (k_p * (u[2 * i] - px) - K_D * ux + gx + fx) / M_FINGER,
                    (k_p * (u[2 * i + 1] - pz) - K_D * uz + gz + fz) / M_FINGER - G,
                )
            )
        x, z, a = x + DT * vx, z + DT * vz, a + DT * w
        vx, vz, w = vx + DT * force_x / M_BOX, vz + DT * force_z / M_BOX, w + DT * torque / inertia
        for finger, (ax, az) in zip(fingers, accelerations, strict=True):
            finger[0], finger[1] = finger[0] + DT * finger[2], finger[1] + DT * finger[3]
            finger[2], finger[3] = finger[2] + DT * ax, finger[3] + DT * az
    if task == "flip":
        return x**2 + a**2
    return (z - 1) ** 2 + 0.1 * (x**2 + a**2 + vx**2 + vz**2 + w**2)
