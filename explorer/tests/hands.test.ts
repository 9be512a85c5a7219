/** The page for hands: views of photographs, masks and their brush, ranges of colours, undo. */
import { expect, test } from "vitest";
import { advanced, begun, redone, undone } from "../src/hands/history";
import { moved, openSides, pack, painted, stroked, unpack, type Colour } from "../src/hands/masks";
import { areConvex, outlineOf, pixelOf, viewOf, type Point } from "../src/hands/view";
import {
  allColoured,
  corrected,
  joined,
  KINDS,
  kindOfCode,
  refitted,
  sureCells,
  withCode,
  type Photograph,
  type Proposal,
  type Tile,
} from "../src/hands/work";
import { rotateCode } from "../src/network/codes";
import { wholeNumber } from "../src/parts/Controls";

const CORNERS: readonly Point[] = [
  [120, 80],
  [640, 130],
  [600, 520],
  [60, 470],
];

test("a view leads each corner of the floor to its pixel", () => {
  const view = viewOf(CORNERS, 3, 4, 800, 640);
  const places: Point[] = [
    [0, 0],
    [4, 0],
    [4, 3],
    [0, 3],
  ];
  places.forEach((place, corner) => {
    const [x, y] = pixelOf(view, place);
    expect(x).toBeCloseTo(CORNERS[corner][0], 9);
    expect(y).toBeCloseTo(CORNERS[corner][1], 9);
  });
});

// As `View(np.array([[200, 10, 50], [-5, 180, 40], [.01, .05, 1]]), .04, 800, 640).pixels_of(...)` of Python.
test("a lens bends the view as in Python", () => {
  const homography = [
    [200, 10, 50],
    [-5, 180, 40],
    [0.01, 0.05, 1],
  ];
  const view = { homography, radial: 0.04, width: 800, height: 640 };
  const [x, y] = pixelOf(view, [1.5, 2.25]);
  expect([x, y]).toEqual([expect.closeTo(330.277113, 6), expect.closeTo(388.125573, 6)]);
  const outline = outlineOf(view, 0, 0);
  expect(outline[0]).toEqual(pixelOf(view, [0, 0]));
  expect(outline[17]).toEqual(pixelOf(view, [1, 1]));
});

test("corners that cross, turn inwards or go counter-clockwise are seen", () => {
  const [first, second, third, fourth] = CORNERS;
  expect(areConvex(CORNERS)).toBe(true);
  expect(areConvex([first, third, second, fourth])).toBe(false);
  expect(areConvex([first, fourth, third, second])).toBe(false);
  expect(areConvex([first, second, [200, 200], fourth])).toBe(false);
});

test("bits of a mask are packed and unpacked, also where a byte is not full", () => {
  const mask = Uint8Array.from({ length: 25 }, (_, pixel) => +(pixel % 3 === 0));
  expect(unpack(pack(mask), 5)).toEqual(mask);
  expect(pack(Uint8Array.from([1, 0, 0, 0, 0, 0, 0, 1, 1]))).toBe(btoa("\x81\x80"));
});

test("the brush sets and clears the pixels near its line, and leaves the base as it is", () => {
  const base = new Uint8Array(100);
  const drawn = stroked(null, 10, [2, 5], [8, 5], 1, 1);
  const mask = painted(base, drawn);
  for (let y = 0; y < 10; y++) {
    for (let x = 0; x < 10; x++) {
      const along = Math.min(Math.max(x + 0.5, 2), 8);
      expect(mask[10 * y + x]).toBe(+(Math.hypot(x + 0.5 - along, y + 0.5 - 5) <= 1));
    }
  }
  const erased = stroked(drawn, 10, [5, 5], [5, 5], 20, -1);
  expect(painted(base.fill(1), erased)).toEqual(new Uint8Array(100));
  expect(drawn.includes(-1)).toBe(false);
});

test("a road reaches a side with a tenth of it", () => {
  const road = new Uint8Array(400);
  road[9] = 1;
  expect(openSides(road, 20)).toBe(0);
  road[10] = 1;
  expect(openSides(road, 20)).toBe(8);
  for (const row of [9, 10]) road[20 * row + 19] = 1;
  expect(openSides(road, 20)).toBe(12);
});

test("ends of a range give way, but hues wrap around", () => {
  const red: Colour = [
    [165, 10],
    [100, 255],
    [90, 200],
  ];
  expect(moved(red, 0, 0, 170)[0]).toEqual([170, 10]);
  expect(moved(red, 1, 1, 50)).toEqual([
    [165, 10],
    [50, 50],
    [90, 200],
  ]);
  expect(moved(red, 2, 0, 230)[2]).toEqual([230, 230]);
});

test("steps of one name are undone together", () => {
  let history = begun(0);
  history = advanced(history, 1, "slider");
  history = advanced(history, 2, "slider");
  history = advanced(history, 3);
  history = advanced(history, 4);
  history = undone(undone(history));
  expect(history.present).toBe(2);
  expect(redone(history).present).toBe(3);
  expect(undone(history).present).toBe(0);
  expect(undone(undone(history)).present).toBe(0);
  // After an undo, a slider of the same name begins a new step.
  expect(undone(advanced(history, 9, "slider")).present).toBe(2);
  expect(advanced(history, 9).future).toEqual([]);
});

test("kinds have the codes of their rotations, counter-clockwise", () => {
  for (const [kind, codes] of Object.entries(KINDS)) {
    codes.forEach((code, index) => {
      expect(kindOfCode(code)).toBe(kind);
      expect(rotateCode(code, 1)).toBe(codes[(index + 1) % codes.length]);
    });
  }
  expect(kindOfCode(0)).toBe("empty");
});

test("a corrected cell is sure", () => {
  const proposal = { codes: [[5, 6, 0]], sure: [[0.2, 0.9, 0.9]] } as unknown as Proposal;
  expect(sureCells(proposal)).toBe(1);
  const corrected = withCode(proposal, 0, 0, 10);
  expect([corrected.codes, sureCells(corrected), proposal.codes[0][0]]).toEqual([[[10, 6, 0]], 2, 5]);
});

test("a kind that is set during a fit stays, unless the fit has another size", () => {
  const proposal = { codes: [[5, 6]], sure: [[0.2, 0.9]] } as unknown as Proposal;
  const photograph = { name: "floor", rows: 1, columns: 2, proposal } as unknown as Photograph;
  const changed = corrected(photograph, 0, 0, 10);
  const fit = { codes: [[3, 9]], sure: [[0.2, 0.9]] } as unknown as Proposal;
  expect(refitted(changed, 1, 2, fit).proposal!.codes).toEqual([[10, 9]]);
  expect(refitted(changed, 2, 1, fit)).toMatchObject({ rows: 2, proposal: fit, corrected: [] });
});

test("one colour for all tiles keeps what was changed while its masks were computed", () => {
  const red: Colour = [
    [165, 10],
    [100, 255],
    [90, 200],
  ];
  const tile = (id: string) => ({ id, side: 1, base: {}, strokes: {}, colours: {}, byColours: {} }) as unknown as Tile;
  const strokes = { red: Int8Array.of(1) };
  const now = [{ ...tile("a"), kind: "turn", leftOut: true, strokes } as unknown as Tile, tile("c")];
  const bits = new Map(["a", "b"].map((id) => [id, pack(Uint8Array.of(1))]));
  const [first, second] = allColoured(now, "red", red, bits);
  expect(first).toMatchObject({
    kind: "turn",
    leftOut: true,
    strokes,
    colours: { red },
    base: { red: Uint8Array.of(1) },
  });
  expect(second).toBe(now[1]);
});

test.each([
  ["4", 4],
  ["40", 40],
  ["", null],
  ["0", null],
  ["41", null],
  ["44444", null],
  ["2.5", null],
])("of the entry %j for the rows, the number is %s", (text, number) => {
  expect(wholeNumber(text, 1, 40)).toBe(number);
});

test("new tiles with names that are taken get the next ones", () => {
  const tile = (name: string) => ({ name, kind: name.slice(0, -2) }) as unknown as Tile;
  const tiles = joined([tile("turn_1"), tile("turn_3")], [tile("turn_1"), tile("turn_3"), tile("straight_1")]);
  expect(tiles.map(({ name }) => name)).toEqual(["turn_1", "turn_3", "turn_2", "turn_4", "straight_1"]);
});
