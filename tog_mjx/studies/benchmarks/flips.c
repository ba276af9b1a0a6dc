/* The penalty simulator's flip (see simulators/penalty.py) as a plain loop: LANES motions side by side in SIMD registers,
   blocks of them on all cores. It is a rival to measure against, and nothing else uses it. */
#include <math.h>
#define LANES 16

typedef struct { float stiffness, damping, friction, viscosity; } law;

/* Force (n, t) of the MuJoCo-limit law; zero where the bodies are apart. */
static inline __attribute__((always_inline)) void contact(law c, float distance, float vn, float vt, float *n, float *t) {
  float normal = -c.stiffness * distance - c.damping * vn, tangential = -c.viscosity * vt;
  float size = fabsf(tangential), mu = c.friction, edge = (normal + mu * size) / (1 + mu * mu);
  int inside = size <= mu * normal, polar = normal <= -mu * size;
  float force = inside ? normal : polar ? 0 : edge;
  float friction = inside ? tangential : polar ? 0 : copysignf(mu * edge, tangential);
  *n = distance < 0 ? force : 0;
  *t = distance < 0 ? friction : 0;
}

/* u: setpoints [n, 2]; p: parameters, in the order of benchmarks/rivals.py; cost: [n]. */
void flips(const float *u, int n, int steps, const float *p, float *cost) {
  const float g = p[0], dt = p[1], mass = p[2], inertia = p[3], hx = p[4], hz = p[5], corner_radius = p[6];
  const float finger_mass = p[7], radius = p[8], kp = p[9], kd = p[10];
  const law corner_floor = {p[11], p[12], p[13], p[14]}, finger_floor = {p[15], p[16], p[17], p[18]};
  const law finger_box = {p[19], p[20], p[21], p[22]};
  const float *corner = p + 23, *start = p + 31;
  #pragma omp parallel for schedule(static)
  for (int first = 0; first < n; first += LANES) {
    float s[10][LANES], ux[LANES], uz[LANES];
    for (int l = 0; l < LANES; l++) {
      int i = first + l < n ? first + l : n - 1;
      ux[l] = u[2 * i];
      uz[l] = u[2 * i + 1];
      for (int k = 0; k < 10; k++) s[k][l] = start[k];
    }
    for (int step = 0; step < steps; step++) {
      #pragma omp simd
      for (int l = 0; l < LANES; l++) {
        float x = s[0][l], z = s[1][l], angle = s[2][l], vx = s[3][l], vz = s[4][l], spin = s[5][l];
        float fx = s[6][l], fz = s[7][l], fvx = s[8][l], fvz = s[9][l];
        float cos = cosf(angle), sin = sinf(angle), force_x = 0, force_z = 0, torque = 0, normal, tangential;
        for (int k = 0; k < 4; k++) {
          float ax = cos * corner[2 * k] - sin * corner[2 * k + 1], az = sin * corner[2 * k] + cos * corner[2 * k + 1];
          float distance = z + az - corner_radius;
          az = distance * 0.5f - z;
          contact(corner_floor, distance, vz + spin * ax, vx - spin * az, &normal, &tangential);
          force_x += tangential;
          force_z += normal;
          torque += ax * normal - az * tangential;
        }
        float ox = fx - x, oz = fz - z, lx = cos * ox + sin * oz, lz = -sin * ox + cos * oz;
        float bx = fabsf(lx) - hx, bz = fabsf(lz) - hz, qx = bx > 0 ? bx : 0, qz = bz > 0 ? bz : 0;
        float squared = qx * qx + qz * qz;
        int inside = squared == 0, face = bx > bz;
        float outside = sqrtf(inside ? 1 : squared), distance = inside ? (face ? bx : bz) : outside;
        float nx = copysignf(inside ? (face ? 1 : 0) : qx / outside, lx);
        float nz = copysignf(inside ? (face ? 0 : 1) : qz / outside, lz);
        float wx = cos * nx - sin * nz, wz = sin * nx + cos * nz, gap = distance - radius, reach = radius + gap * 0.5f;
        float ax = ox - wx * reach, az = oz - wz * reach, rx = fvx - vx + spin * az, rz = fvz - vz - spin * ax;
        contact(finger_box, gap, rx * wx + rz * wz, -rx * wz + rz * wx, &normal, &tangential);
        float gx = normal * wx - tangential * wz, gz = normal * wz + tangential * wx;
        force_x -= gx;
        force_z -= gz;
        torque -= ax * gz - az * gx;
        contact(finger_floor, fz - radius, fvz, fvx, &normal, &tangential);
        gx += tangential + kp * (ux[l] - fx) - kd * fvx;
        gz += normal + kp * (uz[l] - fz) - kd * fvz;
        s[3][l] = vx += dt * force_x / mass;
        s[4][l] = vz += dt * (force_z / mass - g);
        s[5][l] = spin += dt * torque / inertia;
        s[8][l] = fvx += dt * gx / finger_mass;
        s[9][l] = fvz += dt * (gz / finger_mass - g);
        s[0][l] = x + dt * vx;
        s[1][l] = z + dt * vz;
        s[2][l] = angle + dt * spin;
        s[6][l] = fx + dt * fvx;
        s[7][l] = fz + dt * fvz;
      }
    }
    for (int l = 0; l < LANES && first + l < n; l++) cost[first + l] = s[0][l] * s[0][l] + s[2][l] * s[2][l];
  }
}
