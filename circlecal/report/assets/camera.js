// From pixels to metres with the camera of a frame: what circlecal.geometry.camera and surface do, for one point.
globalThis.circlecalCamera = (() => {
  "use strict";
  const ROUNDS = 12, TOLERANCE_M = 1e-6, TOLERANCE_R = 1e-6;

  // Newton's iteration on the radius r of r (1 + k1 r^2 + k2 r^4) = target, in half widths of the picture
  const undistort = (camera, x, y) => {
    const [fx, fy] = camera.focal, [k1, k2] = camera.kappa;
    const dx = x - camera.principal[0], dy = y - camera.principal[1];
    const target = Math.hypot(dx, (dy * fx) / fy) / (camera.width / 2);
    let r = target;
    for (let round = 0; round < ROUNDS; round++) {
      const r2 = r * r;
      r -= (r * (1 + k1 * r2 + k2 * r2 * r2) - target) / (1 + 3 * k1 * r2 + 5 * k2 * r2 * r2);
    }
    const r2 = r * r, grows = 1 + 3 * k1 * r2 + 5 * k2 * r2 * r2;
    // beyond the fold of a barrel no point is seen
    const off = Math.abs(r * (1 + k1 * r2 + k2 * r2 * r2) - target);
    if (!Number.isFinite(r) || r < 0 || !(grows > 0) || !(off < TOLERANCE_R)) return null;
    const factor = target > 0 ? r / target : 1;
    return [(dx * factor) / fx, (dy * factor) / fy];
  };

  const RIDGE = 2;  // half the ridge of a hipped roof, in reference lengths
  const beyondRidge = (camera, x) => Math.abs(x) / camera.reference - RIDGE;
  const drop = (camera, x, y) => {
    const t = Math.abs(y) / camera.reference;
    if (camera.shape === "parabola") return camera.crown * t * t;
    if (camera.shape === "hip") return camera.crown * Math.max(t, beyondRidge(camera, x));
    return camera.shape === "roof" ? camera.crown * t : 0;
  };
  const slope = (camera, x, y) => {
    const t = y / camera.reference, steepness = camera.crown / camera.reference;
    if (camera.shape === "parabola") return [0, 2 * steepness * t];
    if (camera.shape === "hip" && beyondRidge(camera, x) > Math.abs(t)) return [steepness * Math.sign(x), 0];
    return [0, camera.shape === "roof" || camera.shape === "hip" ? steepness * Math.sign(t) : 0];
  };

  // The field point (metres) that is seen at a pixel; null above the horizon.
  const toField = (camera, x, y) => {
    if (!camera) return null;
    if (camera.homography) {
      const [u, v, w] = camera.homography.map((row) => row[0] * x + row[1] * y + row[2]);
      return w > 0 ? [u / w, v / w] : null;
    }
    const seen = undistort(camera, x, y);
    if (!seen) return null;
    const R = camera.R, [px, py, pz] = camera.position;
    const ray = [0, 1, 2].map((k) => R[0][k] * seen[0] + R[1][k] * seen[1] + R[2][k]);
    if (!(ray[2] * -pz > 0)) return null;
    const reach = -pz / ray[2], flat = [px + reach * ray[0], py + reach * ray[1]], toward = [px - flat[0], py - flat[1]];
    let share = 0;
    for (let round = 0; round < ROUNDS; round++) {
      const u = flat[0] + share * toward[0], v = flat[1] + share * toward[1], [byX, byY] = slope(camera, u, v);
      share -= (share * pz - drop(camera, u, v)) / (pz - byX * toward[0] - byY * toward[1]);
    }
    const point = [flat[0] + share * toward[0], flat[1] + share * toward[1]];
    return share < 1 && Math.abs(share * pz - drop(camera, point[0], point[1])) < TOLERANCE_M ? point : null;
  };

  // A field point as people read it; what rounds to nothing has no sign.
  const tell = (point) => `${point.map((value) => (Number(value.toFixed(2)) + 0).toFixed(2)).join(", ")} m`;

  // A value of a grid over the picture (sigma in px or m) at a pixel, bilinear; null where a neighbour is not known.
  const atGrid = (grid, values, width, height, x, y) => {
    if (!grid) return null;
    const u = Math.min(Math.max(((x + 0.5) / width) * grid.columns - 0.5, 0), grid.columns - 1);
    const v = Math.min(Math.max(((y + 0.5) / height) * grid.rows - 0.5, 0), grid.rows - 1);
    const c = Math.min(Math.floor(u), grid.columns - 2), r = Math.min(Math.floor(v), grid.rows - 2);
    const at = (dr, dc) => values[(r + dr) * grid.columns + c + dc];
    const around = [at(0, 0), at(0, 1), at(1, 0), at(1, 1)];
    if (around.some((value) => value === null || value === undefined)) return null;
    const s = u - c, t = v - r;
    return (1 - t) * ((1 - s) * around[0] + s * around[1]) + t * ((1 - s) * around[2] + s * around[3]);
  };

  // Transparent blue to yellow to red over 0.5 to 50 px at 1920 px width: a colour (RGBA) for a standard deviation.
  const SCALE = [0.5, 2, 5, 15, 50];
  const COLOURS = [[38, 120, 210], [40, 170, 150], [235, 205, 60], [240, 130, 40], [215, 45, 40]];
  const heat = (sigma) => {
    if (sigma === null || !Number.isFinite(sigma)) return [0, 0, 0, 0];
    const place = SCALE.findIndex((limit) => sigma < limit);
    if (place === 0) return [...COLOURS[0], 150];
    if (place < 0) return [...COLOURS.at(-1), 165];
    const share = Math.log(sigma / SCALE[place - 1]) / Math.log(SCALE[place] / SCALE[place - 1]);
    return [...COLOURS[place].map((value, k) => Math.round(COLOURS[place - 1][k] + share * (value - COLOURS[place - 1][k]))), 155];
  };
  return { toField, tell, atGrid, heat, SCALE, COLOURS };
})();
