/** Quantities that are not whole: how they are written, ranged and coloured. */
import { expect, test } from "vitest";
import { quantileOf, type Run } from "../src/data";
import { binName } from "../src/network/features";
import { describe } from "../src/parts/HeatMap";
import { scaleOf } from "../src/parts/Legend";
import { weightsText } from "../src/parts/WeightSliders";
import { fromHash, openRun, START, toHash } from "../src/state";
import { filterText, histogram } from "../src/views/Maps";
import { markText, number, valueText } from "../src/words";

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
  ["turn_share", 100, 200, ["<30%", "30%", "40%+"]],
  ["turns", 2, 4, ["≤5", "6–7", "8+"]],
  ["mean_block", 1500, 3000, ["<4.5", "4.5", "6+"]],
  ["components", 1, 1, ["1", "2", "3+"]],
  ["straight_share", 250, 0, ["0%", "25%", "50%+"]],
] as const)("the bins of %s, %d wide from %d, say which are open", (metric, width, start, names) => {
  const axis = { metric, bins: 3, width, start, target: null };
  expect([0, 1, 2].map((bin) => binName(axis, bin))).toEqual(names);
});

test.each([
  [2 / 3, "67 %"],
  [1 / 3, "33 %"],
  [0.995, "100 %"],
  [0.9949, "99 %"],
  [0.005, "1 %"],
  [0.0049, "0 %"],
  [0.665, "67 %"],
  [1, "100 %"],
])("a share of %d is written as %s", (share, text) => {
  expect(valueText("coverage", Math.floor(1000 * share))).toBe(text);
});

test("marks of an axis have the digits that they have", () => {
  expect([125, 200, 1000].map((mark) => markText("symmetry", mark))).toEqual(["12.5 %", "20 %", "100 %"]);
  expect([markText("turns", 3), markText("mean_block", 1500)]).toEqual(["3", "1.50"]);
});

test.each([
  [[20, 10, 4, 1], "shelf=20,10,4,1"],
  [[0, 0, 0, 0], "shelf=0,0,0,0"],
  [null, ""],
])("the address keeps the shelf %s", (shelf, hash) => {
  expect(toHash({ ...START, shelf })).toBe(hash);
  expect(fromHash(hash).shelf).toEqual(shelf);
});

test.each(["1,2,3", "1,2,3,4,5", "a,b,c,d", "-1,2,3,4", "1.5,2,3,4"])("the shelf %s in an address is none", (text) => {
  expect(fromHash(`shelf=${text}`).shelf).toBeNull();
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

test.each(["größe", "日", "नाम", "__proto__"])("the address keeps the range of a feature named %s", (name) => {
  const where = Object.fromEntries([[name, [1, 5] as const]]);
  expect(Object.entries(fromHash(toHash({ ...START, where })).where)).toEqual([[name, [1, 5]]]);
});

test("a scale of fractions has fractions, a scale of whole numbers has none", () => {
  expect(scaleOf(Float64Array.of(0, 0.5), "fitness", "linear").at(0.5)).toBe(0.25);
  expect(scaleOf(Float64Array.of(0, 5), "fitness", "linear").at(0.5)).toBe(3);
});

test.each([1e-12, 1, 1e12])("half of the values that equal one are below it, at a scale of %d", (unit) => {
  expect(quantileOf(Float64Array.of(unit, 2 * unit, 2 * unit, 3 * unit), 2 * unit)).toBe(0.5);
});

test("the text of the ranges has those that filter the run", () => {
  const run = { quantities: ["fitness", "crossings", "corners", "symmetry"] } as unknown as Run;
  const range = [2, 250] as const;
  expect(filterText(run, { crossings: range, corners: range, largest_block: range, symmetry: range })).toBe(
    "crossings=2..250 symmetry=0.002..0.25",
  );
});

test("another run begins without ranges, the same one keeps them", () => {
  const view = { ...START, run: 1, where: { crossings: [2, 5] } } as const;
  expect(openRun(view, 0)).toEqual({ run: 0, map: null, niche: null, where: {} });
  expect(openRun(view, 1, 7)).toEqual({ run: 1, map: 7, niche: null, where: view.where });
});

test("bars count whole numbers and fractions, and a single value has none", () => {
  expect(histogram(Float64Array.of(0, 1, 1, 3), 0, 3, 1)).toEqual([1, 2, 0, 1]);
  expect(histogram(Float64Array.of(0.5, 0.5), 0.5, 0.5, 0)).toEqual([]);
});

test("a niche whose value is not known is not vacant", () => {
  const axis = { metric: "crossings", bins: 2, width: 3, start: 0, target: null };
  const run = { axes: [axis] } as unknown as Run;
  expect(describe(run, 0, "above_floor", NaN, 4)).toBe("Not known here: Crossings 0–2");
  expect(describe(run, 1, "above_floor", NaN, -1)).toBe("Vacant: Crossings 3+");
  expect(describe(run, 0, "above_floor", 12, 4)).toBe("Above the proven floor 12: Crossings 0–2");
});

test("the text of the weights has the run's own and the changed ones", () => {
  const defaults = { crossings: 0, bridges: 100, tiles: 0 };
  const usual = { ...defaults, bridges: 7, symmetry: -3 };
  const names = [...Object.keys(defaults), "symmetry"];
  expect(weightsText(names, { ...usual, crossings: 500 }, usual, defaults)).toBe("crossings=500 bridges=7 symmetry=-3");
  expect(weightsText(names, { ...usual, bridges: 100 }, usual, defaults)).toBe("bridges=100 symmetry=-3");
});
