/** The tiles that a drawing uses, and how many earlier drawings are kept. */
import { expect, test } from "vitest";
import { done, editorOf, resized, undo, type Editor } from "../src/editor";
import { emptyGrid, type Grid } from "../src/network/codes";
import { inventoryText, shelfFrom, usedTiles } from "../src/network/shelf";
import { gridOfText } from "./grids";

test("tiles are counted by kind, without dead ends and empty cells", () => {
  expect(usedTiles(gridOfText("0123/4567/89ab/cdef"))).toEqual([2, 4, 4, 1]);
});

test("a shelf is written as --inventory takes it, and read from the record of a run", () => {
  expect(inventoryText([20, 10, 4, 1])).toBe("straight=20 turn=10 crossing3=4 crossing4=1");
  expect(shelfFrom({ straight: 20, crossing3: 4 })).toEqual([20, 0, 4, 0]);
  expect([shelfFrom(null), shelfFrom(undefined), shelfFrom("straight=2")]).toEqual([null, null, null]);
});

/** Returns an editor after `strokes` strokes, each in another cell. */
function drawn(grid: Grid, strokes: number): Editor {
  let editor = editorOf(grid);
  for (let cell = 0; cell < strokes; cell++) {
    const codes = editor.grid.codes.slice();
    codes[cell] = 15;
    editor = done(editor, { ...editor, grid: { ...grid, codes } });
  }
  return editor;
}

test.each([
  [20, 20, 250, 200],
  [1024, 1024, 40, 32],
])("of %d x %d tiles, %d strokes keep %d", (height, width, strokes, kept) => {
  const editor = drawn(emptyGrid(height, width), strokes);
  expect(editor.past).toHaveLength(kept);
  expect(undo(editor).grid.codes[strokes - 1]).toBe(0);
});

test("another size keeps the objects that a file may have there", () => {
  const object = (x: number) => ({ kind: "duckie", x, y: 0.5, angle: 0, height: 0.08 });
  const objects = [-1.00009, -1.1, 3.00009, 4].map(object);
  const { objects: left } = resized(editorOf(emptyGrid(2, 3), objects), 2, 2);
  expect(left.map(({ x }) => x)).toEqual([-1.00009, 3.00009]);
});
