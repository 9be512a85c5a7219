/** Quantities that are not whole: how they are written, ranged and coloured. */
import { expect, test } from "vitest";
import { quantileOf } from "../src/data";
import { scaleOf } from "../src/parts/Legend";
import { fromHash, START, toHash } from "../src/state";
import { number } from "../src/words";

test.each([
  [0.1 + 0.2, "0.3"],
  [-2.71828183, "−2.7183"],
  [12345.678, "12,346"],
  [12345, "12,345"],
  [-0, "0"],
])("%d is written as %s", (value, text) => {
  expect(number(value)).toBe(text);
});

test.each([
  [-0.25, 1.5],
  [Math.fround(0.1), 1e21],
  [-1e-7, Infinity],
  [-Infinity, 3],
  [0.5, 0.5],
])("the address keeps the range %d to %d", (low, high) => {
  expect(fromHash(toHash({ ...START, where: { fitness: [low, high] } })).where).toEqual({ fitness: [low, high] });
});

test("a scale of fractions has fractions, a scale of whole numbers has none", () => {
  expect(scaleOf(Float64Array.of(0, 0.5), "fitness", "linear").at(0.5)).toBe(0.25);
  expect(scaleOf(Float64Array.of(0, 5), "fitness", "linear").at(0.5)).toBe(3);
});

test.each([1e-12, 1, 1e12])("half of the values that equal one are below it, at a scale of %d", (unit) => {
  expect(quantileOf(Float64Array.of(unit, 2 * unit, 2 * unit, 3 * unit), 2 * unit)).toBe(0.5);
});
