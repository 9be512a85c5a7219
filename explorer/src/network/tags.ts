/** The tag numbers of signs, given by the rule of `elitelanes_jax/maps/furnishing/street_names.py`. */
import { lengthOf } from "./numbers";
import type { MapObject, Position } from "./objects";

/** The tag numbers of each kind of sign that has some. */
export type SignTags = Readonly<Record<string, readonly number[]>>;

/** The tag numbers that are used on a map, and where. */
export class UsedTags {
  private readonly places = new Map<number, Position[]>();

  constructor(objects: readonly MapObject[]) {
    for (const thing of objects) this.use(thing);
  }

  private use({ tag, x, y }: MapObject): void {
    if (tag === undefined) return;
    const places = this.places.get(tag) ?? [];
    this.places.set(tag, [...places, [x, y]]);
  }

  /** Returns how far from a sign numbers are in use; infinity if none is. */
  distance({ x, y }: MapObject, numbers: readonly number[]): number {
    const places = numbers.flatMap((number) => this.places.get(number) ?? []);
    return places.reduce((least, [u, v]) => Math.min(least, lengthOf(x - u, y - v)), Infinity);
  }

  /** Returns a sign with the first number that is not in use, or with the one whose nearest use is farthest away. */
  give(sign: MapObject, numbers: readonly number[]): MapObject {
    let [tag, farthest] = [numbers[0], -1];
    for (const number of numbers) {
      const distance = this.distance(sign, [number]);
      if (distance > farthest) [tag, farthest] = [number, distance];
    }
    const tagged = { ...sign, tag };
    this.use(tagged);
    return tagged;
  }
}
