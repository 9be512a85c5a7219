/** The lines of a plan are those of Python's plan. tests/explorer/kernel_cases.py writes them. */
import { readFileSync } from "node:fs";
import { expect, test } from "vitest";
import { gridOf } from "../src/network/codes";
import type { MapObject, ObjectKinds } from "../src/network/objects";
import type { PlanValues } from "../src/network/plan";
import { planSvg } from "../src/plan";
import { objectName } from "../src/words";

interface Planned {
  readonly rows: number[][];
  readonly objects: MapObject[];
  /** The metres of each colour of tape, as the bill has them. */
  readonly tape: string[];
  /** The kinds of the objects in the order of the check-list. */
  readonly kinds: string[];
  /** For each object of the check-list, its position and direction. */
  readonly positions: string[];
}

const { kinds, plan, planned } = JSON.parse(readFileSync(new URL("cases.json", import.meta.url), "utf8")) as {
  kinds: ObjectKinds;
  plan: PlanValues;
  planned: Planned;
};

const svg = planSvg(gridOf(planned.rows), planned.objects, kinds, plan);
const texts = [...svg.matchAll(/<text [^>]*>([^<]*)<\/text>/g)].map(([, text]) => text.trim());
const after = (heading: string): string[] => texts.slice(texts.indexOf(heading) + 1);

test("the bill has the metres of tape", () => {
  expect(after("Tape").slice(0, planned.tape.length)).toEqual(planned.tape);
});

test("the check-list has all objects, in order, with their positions and directions", () => {
  const list = after("(metres from the north-west corner)").slice(0, 2 * planned.kinds.length);
  const names = planned.kinds.map((kind, index) => `\u2610 ${index + 1} ${objectName(kind)}`);
  expect(list.filter((_, line) => line % 2 === 0)).toEqual(names);
  expect(list.filter((_, line) => line % 2 === 1)).toEqual(planned.positions);
});

test("the bill has all letters of a long name", () => {
  const [kind] = planned.kinds.filter((name) => name.length > 60);
  expect(after("Signs and objects").join("")).toContain(`1 ×${objectName(kind)}`);
});
