/** Whether objects keep clear of each other, by the rule of `elitelanes_jax/maps/furnishing/space.py`. */
import { footprint, type MapObject, type ObjectKinds, type Position } from "./objects";

const CLEARANCE = 0.01; // between footprints, in tiles

/** Returns the corners of an object's footprint, in tiles; of the square around it, if it is round. */
function outlineOf(thing: MapObject, kinds: ObjectKinds): Position[] {
  const [length, width] = footprint(thing, kinds).map((side) => side / 2);
  const [cosine, sine] = [Math.cos(thing.angle), Math.sin(thing.angle)];
  const corners = [
    [1, 1],
    [1, -1],
    [-1, -1],
    [-1, 1],
  ];
  return corners.map(([ahead, right]) => [
    thing.x + ahead * length * cosine + right * width * sine,
    thing.y - ahead * length * sine + right * width * cosine,
  ]);
}

/** Returns whether two rectangles overlap or nearly touch along the sides of one of them. */
function areClose(one: readonly Position[], other: readonly Position[]): boolean {
  for (const corners of [one, other]) {
    for (const index of [0, 1]) {
      const [[ax, ay], [bx, by]] = [corners[index], corners[index + 1]];
      const size = Math.hypot(bx - ax, by - ay);
      const [nx, ny] = [(bx - ax) / size, (by - ay) / size];
      const first = one.map(([x, y]) => x * nx + y * ny);
      const second = other.map(([x, y]) => x * nx + y * ny);
      if (Math.max(...first) + CLEARANCE <= Math.min(...second)) return false;
      if (Math.max(...second) + CLEARANCE <= Math.min(...first)) return false;
    }
  }
  return true;
}

/** Returns the objects that an object does not keep clear of. */
export function objectsInTheWay(thing: MapObject, others: readonly MapObject[], kinds: ObjectKinds): MapObject[] {
  const outline = outlineOf(thing, kinds);
  const reach = sizeOf(thing, kinds) + CLEARANCE;
  return others.filter((other) => {
    const distance = Math.max(Math.abs(other.x - thing.x), Math.abs(other.y - thing.y));
    return distance <= reach + sizeOf(other, kinds) && areClose(outline, outlineOf(other, kinds));
  });
}

/** Returns a distance that no corner of an object exceeds, in tiles. */
const sizeOf = (thing: MapObject, kinds: ObjectKinds): number => Math.hypot(...footprint(thing, kinds));
