/** The view, and its text in the page's address. */
import { OVERLAYS, type Overlay } from "./drawing";
import type { Seed } from "./data";
import { TILE_KINDS, type Shelf } from "./network/shelf";
import { LAYERS, type Layer } from "./tiles";

export const VIEWS = ["archive", "maps", "compare", "draw", "run"] as const;
export type ViewName = (typeof VIEWS)[number];

export const VIEW_NAMES: Readonly<Record<ViewName, string>> = {
  archive: "Archive",
  maps: "Maps",
  compare: "Compare",
  draw: "Draw",
  run: "Run",
};

export type Ranges = Readonly<Record<string, readonly [low: number, high: number]>>;

export interface View {
  readonly view: ViewName;
  readonly run: number;
  readonly seed: Seed;
  /** The bins of a niche, such as 12-0-0-0-1. */
  readonly niche: string | null;
  /** The index of the open elite; it overrides the niche. */
  readonly map: number | null;
  readonly colour: string;
  readonly scale: "linear" | "rank";
  /** The horizontal axis. All others are vertical. */
  readonly across: string | null;
  readonly look: "lines" | "tiles";
  readonly layers: readonly Layer[];
  readonly blend: number;
  readonly overlays: readonly Overlay[];
  readonly where: Ranges;
  readonly sort: string;
  readonly descending: boolean;
  /** Pinned maps to compare: run and elite. */
  readonly pins: readonly (readonly [run: number, elite: number])[];
  /** The tiles of each kind that a lab has; null for those of the run's record. */
  readonly shelf: Shelf | null;
}

export const START: View = {
  view: "archive",
  run: 0,
  seed: "best",
  niche: null,
  map: null,
  colour: "fitness",
  scale: "rank",
  across: null,
  look: "lines",
  layers: ["image"],
  blend: 0.6,
  overlays: [],
  where: {},
  sort: "fitness",
  descending: false,
  pins: [],
  shelf: null,
};

/** Returns the change of a view that opens a run. The ranges stay only if the run stays, because they are of its maps. */
export const openRun = (view: View, run: number, map: number | null = null): Partial<View> => ({
  run,
  map,
  niche: null,
  where: run === view.run ? view.where : START.where,
});

/** Writes a view as the part of an address after the #, without fields at their start values. */
export function toHash(view: View): string {
  const words: Record<string, string> = {
    view: view.view,
    run: `${view.run}`,
    seed: `${view.seed}`,
    niche: view.niche ?? "",
    map: view.map === null ? "" : `${view.map}`,
    colour: view.colour,
    scale: view.scale,
    across: view.across ?? "",
    look: view.look,
    layers: view.layers.join(","),
    blend: `${view.blend}`,
    overlays: view.overlays.join(","),
    where: whereText(view.where).replaceAll(" ", ","),
    sort: (view.descending ? "-" : "") + view.sort,
    pins: view.pins.map((pin) => pin.join(".")).join(","),
    shelf: view.shelf?.join(",") ?? "",
  };
  const before = view === START ? {} : Object.fromEntries(new URLSearchParams(toHash(START)));
  return Object.entries(words)
    .filter(([key, word]) => (view === START ? true : word !== before[key]))
    .map(([key, word]) => `${key}=${encodeURIComponent(word).replaceAll("%2C", ",").replaceAll("%3D", "=")}`)
    .join("&");
}

/** Reads a view. Missing and invalid fields get their start values. */
export function fromHash(hash: string): View {
  const words = new URLSearchParams(hash.replace(/^#/, ""));
  const one = <T extends string>(key: string, known: readonly T[], start: T): T =>
    known.find((word) => word === words.get(key)) ?? start;
  const whole = (key: string): number | null =>
    /^\d{1,9}$/.test(words.get(key) ?? "") ? Number(words.get(key)) : null;
  const some = <T extends string>(key: string, known: readonly T[], start: readonly T[]): readonly T[] =>
    words.has(key) ? known.filter((word) => words.get(key)!.split(",").includes(word)) : start;
  const seed = words.get("seed");
  const sort = words.get("sort") ?? START.sort;
  const blend = Number(words.get("blend") ?? START.blend);
  return {
    view: one("view", VIEWS, START.view),
    run: whole("run") ?? START.run,
    seed: seed === "count" || seed === "best" ? seed : (whole("seed") ?? START.seed),
    niche: /^\d+(-\d+)*$/.test(words.get("niche") ?? "") ? words.get("niche") : null,
    map: whole("map"),
    colour: words.get("colour") ?? START.colour,
    scale: one("scale", ["linear", "rank"], START.scale),
    across: words.get("across") || null,
    look: one("look", ["lines", "tiles"], START.look),
    layers: some("layers", LAYERS, START.layers),
    blend: blend >= 0 && blend <= 1 ? blend : START.blend,
    overlays: some("overlays", OVERLAYS, START.overlays),
    where: parseWhere((words.get("where") ?? "").replaceAll(",", " ")),
    sort: sort.replace(/^-/, ""),
    descending: sort.startsWith("-"),
    pins: (words.get("pins") ?? "")
      .split(",")
      .flatMap((pin) => {
        const found = /^(\d{1,4})\.(\d{1,9})$/.exec(pin);
        return found ? [[Number(found[1]), Number(found[2])] as const] : [];
      })
      .slice(0, 4),
    shelf: SHELF.test(words.get("shelf") ?? "") ? words.get("shelf")!.split(",").map(Number) : START.shelf,
  };
}

/** Writes ranges as `--where` takes them. There, shares are from 0 to 1; here, they are in thousandths. */
export function whereText(ranges: Ranges, unit: (name: string) => number = () => 1): string {
  return Object.entries(ranges)
    .map(([name, [low, high]]) => {
      const text = (value: number) => (Number.isFinite(value) ? `${value / unit(name)}` : "");
      return low === high ? `${name}=${text(low)}` : `${name}=${text(low)}..${text(high)}`;
    })
    .join(" ");
}

const SHELF = new RegExp(`^\\d{1,6}(?:,\\d{1,6}){${TILE_KINDS.length - 1}}$`);
const NUMBER = /(-?\d+(?:\.\d+)?(?:e[-+]?\d+)?)?/.source;
/** Features have the names of Python, with letters of any script. */
const RANGE = new RegExp(`^(\\p{XID_Continue}+)=${NUMBER}(?:(\\.\\.)${NUMBER})?$`, "u");

function parseWhere(text: string): Ranges {
  const ranges: (readonly [name: string, limits: readonly [low: number, high: number]])[] = [];
  for (const word of text.split(" ")) {
    const parts = RANGE.exec(word);
    if (!parts) continue;
    const [, name, first, dots, last] = parts;
    const low = Number(first ?? -Infinity);
    ranges.push([name, [low, dots ? Number(last ?? Infinity) : low]]);
  }
  return Object.fromEntries(ranges);
}
