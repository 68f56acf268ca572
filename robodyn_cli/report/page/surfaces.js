/* Bodies with a surface: what scene/mesh/surfaces.py makes. A part's vertices are the corners of the box around it. */

const LAMP = [-0.36, 0.64, 0.68]; // where light comes from: right, up, towards the eye
const EDGEWISE = 1e-3; // area of an outline over the square of its extent, below which a plate is seen from its side
const PALER = { solid: 0.75, shape: 0.62, payload: 0.45 }; // than the part's colour, in flat views
const SHADES = 20; // that are told apart, so that few attributes change from pose to pose

/* The places in space of the points of a surface. */
function placesOf(part, view) {
  const [origin, z, y, , x] = part.vertices.map((v) => view.place(v)), points = part.surface.points;
  const edges = [x, y, z].map((corner) => plus(corner, origin, -1));
  return Array.from({ length: points.shape[0] }, (_, k) =>
    edges.reduce((p, edge, n) => plus(p, edge, points[3 * k + n]), origin));
}

/* What is drawn of a body, as [path, depth, look]: its outline in a flat view, else the faces that look to the eye. */
function solid(part, view, colour, depth) {
  const seen = placesOf(part, view).map((p) => view.seen(p)), edge = mixed(colour, INK, 0.35);
  if (!seen.every(isPlace)) return [];
  if (view.flat) {
    const fill = mixed(colour, PAPER, PALER[part.kind]);
    return [[path(flatOutline(part, seen), true), depth - 1e-4, { colour: edge, fill }]];
  }
  const found = [];
  for (const face of part.surface.faces) {
    const rows = face.map((k) => seen[k]), normal = cross(...[1, 2].map((k) => upwards(plus(rows[k], rows[0], -1), view.scale)));
    const size = Math.hypot(...normal);
    if (!(size > 0) || (part.surface.closed && normal[2] <= 0)) continue;
    const light = Math.max(0, dot(normal, LAMP) / (normal[2] < 0 ? -size : size));
    const fill = mixed(colour, PAPER, Math.round(SHADES * (0.2 + 0.6 * light)) / SHADES);
    const look = part.kind !== "shape" ? { colour: edge, fill } : { colour: fill, fill, width: 0.7 };
    found.push([path(rows, true), rows.reduce((sum, p) => sum + p[2], 0) / rows.length, look]);
  }
  return found;
}

/* What is seen of a body in a flat view: its own outline where that is not seen edgewise, else the convex one. */
function flatOutline(part, seen) {
  const own = (part.surface.outline || []).map((k) => seen[k]);
  const twice = own.reduce((sum, p, k) => sum + p[0] * own[(k + 1) % own.length][1] - p[1] * own[(k + 1) % own.length][0], 0);
  const extent = Math.max(...[0, 1].map((n) => Math.max(...own.map((p) => p[n])) - Math.min(...own.map((p) => p[n]))));
  return own.length && Math.abs(twice) > 2 * EDGEWISE * extent * extent ? own : hull(seen);
}

/* A difference of places on the screen with y upwards, all in pixels. */
const upwards = (d, scale) => [d[0], -d[1], d[2] * scale];
