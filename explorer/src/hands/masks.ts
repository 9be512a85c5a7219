/** Masks of a tile, a byte of 0 or 1 for each pixel: their bits from and to the server, the brush, ranges of colours. */
import { EAST, NORTH, SOUTH, WEST } from "../network/codes";

export type MaskName = "road" | "red" | "yellow";
export type Mask = Uint8Array;
/** The pixels that the brush has set, 1, and cleared, -1. They stay when the colours change. */
export type Strokes = Int8Array;
/** From and to, limits included, of hue (0 to 179), saturation and value (0 to 255). A range of hues may wrap around. */
export type Range = readonly [from: number, to: number];
export type Colour = readonly [hue: Range, saturation: Range, value: Range];
export type Colours = Readonly<Record<MaskName, Colour>>;

/** The least part of a side in road if the road reaches it, as in tiles/tileset.py. */
const TOUCHES = 0.1;

export function unpack(text: string, side: number): Mask {
  const bytes = atob(text);
  return Uint8Array.from(
    { length: side * side },
    (_, pixel) => (bytes.charCodeAt(pixel >> 3) >> (7 - (pixel & 7))) & 1,
  );
}

export function pack(mask: Mask): string {
  const bytes = new Uint8Array(Math.ceil(mask.length / 8));
  mask.forEach((bit, pixel) => (bytes[pixel >> 3] |= bit << (7 - (pixel & 7))));
  let text = "";
  for (const byte of bytes) text += String.fromCharCode(byte);
  return btoa(text);
}

/** Returns a mask with what the brush has changed. */
export function painted(base: Mask, strokes: Strokes | null): Mask {
  return strokes ? base.map((bit, pixel) => (strokes[pixel] ? +(strokes[pixel] > 0) : bit)) : base;
}

/** Returns the strokes with one more: pixels within `radius` of the line between two points, in pixels, get a value. */
export function stroked(
  strokes: Strokes | null,
  side: number,
  [fromX, fromY]: readonly [number, number],
  [toX, toY]: readonly [number, number],
  radius: number,
  value: 1 | -1,
): Strokes {
  const changed = strokes?.slice() ?? new Int8Array(side * side);
  const [alongX, alongY] = [toX - fromX, toY - fromY];
  const square = alongX ** 2 + alongY ** 2;
  const within = (least: number) => Math.min(Math.max(Math.round(least), 0), side - 1);
  for (let y = within(Math.min(fromY, toY) - radius - 1); y <= within(Math.max(fromY, toY) + radius); y++) {
    for (let x = within(Math.min(fromX, toX) - radius - 1); x <= within(Math.max(fromX, toX) + radius); x++) {
      const [awayX, awayY] = [x + 0.5 - fromX, y + 0.5 - fromY];
      const share = square ? Math.min(Math.max((awayX * alongX + awayY * alongY) / square, 0), 1) : 0;
      if (Math.hypot(awayX - share * alongX, awayY - share * alongY) <= radius) changed[y * side + x] = value;
    }
  }
  return changed;
}

/** Returns the code of the sides that a road reaches. */
export function openSides(road: Mask, side: number): number {
  const share = (first: number, step: number) => {
    let count = 0;
    for (let index = 0; index < side; index++) count += road[first + index * step];
    return count / side >= TOUCHES;
  };
  return (
    (share(0, 1) ? NORTH : 0) |
    (share(side - 1, side) ? EAST : 0) |
    (share(side * (side - 1), 1) ? SOUTH : 0) |
    (share(0, side) ? WEST : 0)
  );
}

/** Returns a colour after one end of a range was moved. The other end of saturation or value gives way; hues wrap. */
export function moved(colour: Colour, part: number, end: 0 | 1, value: number): Colour {
  const [from, to] = colour[part];
  const range: Range =
    end === 0 ? [value, part ? Math.max(to, value) : to] : [part ? Math.min(from, value) : from, value];
  return colour.map((other, index) => (index === part ? range : other)) as unknown as Colour;
}
