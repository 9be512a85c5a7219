/** Names and meanings of quantities, and numbers as text. */
import { isShare, SHARE_UNIT, unitOf, type Axis } from "./network/features";
import { degreesOf, type MapObject } from "./network/objects";

interface Words {
  readonly name: string;
  readonly meaning: string;
}

export const WORDS: Readonly<Record<string, Words>> = {
  fitness: {
    name: "Fitness",
    meaning: "what the search minimises, by default a weighted sum of the metrics; lower is better",
  },
  above_floor: {
    name: "Above the proven floor",
    meaning: "fitness minus the proven minimum of the niche",
  },
  filled: { name: "Seeds that fill the niche", meaning: "number of seeds that found a map in the niche" },
  components: { name: "Components", meaning: "parts of the network that no road connects" },
  cyclomatic: { name: "Cyclomatic number", meaning: "independent cycles: faces that roads enclose" },
  dead_ends: { name: "Dead ends", meaning: "tiles with one connection, or with one that is not returned" },
  boundary_violations: { name: "Boundary violations", meaning: "tiles with a road that leaves the grid" },
  bridges: { name: "Bridges", meaning: "roads whose removal splits the network" },
  crossings: { name: "Crossings", meaning: "tiles with three or four connections" },
  adjacent_crossings: { name: "Adjacent crossings", meaning: "linked pairs of crossings, each counted twice" },
  adjacent_crossing_score: {
    name: "Adjacent crossing score",
    meaning: "sum of the connections of all linked pairs of crossings",
  },
  adjacent_turns: { name: "Adjacent turns", meaning: "pairs of turns side by side" },
  straight_score: { name: "Straight score", meaning: "sum of the squared lengths of straight runs" },
  straights: { name: "Straights", meaning: "tiles with two connections on opposite sides" },
  turns: { name: "Turns", meaning: "tiles with two connections on neighbouring sides" },
  crowded_crossings: { name: "Crowded crossings", meaning: "a crossing beside a crossing or a turn" },
  unlinked_neighbours: { name: "Unlinked neighbours", meaning: "neighbouring tiles without a link" },
  tiles: { name: "Tiles", meaning: "cells with a road" },
  empty_cells: { name: "Empty cells", meaning: "cells without a road" },
  edges: { name: "Links", meaning: "neighbouring tiles that both connect to each other" },
  mismatches: { name: "Mismatches", meaning: "connections within the grid that are not returned" },
  off_alphabet: { name: "Off alphabet", meaning: "tiles that the search must not use" },
  straight_share: { name: "Straight share", meaning: "straights divided by tiles" },
  turn_share: { name: "Turn share", meaning: "turns divided by tiles" },
  crossing_share: { name: "Crossing share", meaning: "crossings divided by tiles" },
  coverage: { name: "Coverage", meaning: "tiles divided by cells" },
  crossings3: { name: "Three-way crossings", meaning: "tiles with three connections" },
  crossings4: { name: "Four-way crossings", meaning: "tiles with four connections" },
  largest_block: {
    name: "Largest block",
    meaning: "area of the largest face, in squares between the middles of roads",
  },
  smallest_block: { name: "Smallest block", meaning: "area of the smallest face" },
  mean_block: { name: "Mean block", meaning: "mean area of the faces" },
  block_spread: {
    name: "Spread of blocks",
    meaning: "mean difference of a face's area from the mean area, divided by the mean area",
  },
  small_blocks: { name: "Small blocks", meaning: "faces with an area of at most 4" },
  loops_per_tile: { name: "Loops per tile", meaning: "cyclomatic number divided by tiles" },
  longest_street: { name: "Longest street", meaning: "most links from a crossing or dead end to the next" },
  shortest_street: { name: "Shortest street", meaning: "fewest links from a crossing or dead end to the next" },
  mean_street: { name: "Mean street", meaning: "mean number of links from a crossing or dead end to the next" },
  border_share: {
    name: "Border share",
    meaning: "share of the tiles on the sides of the smallest box around the town",
  },
  box_fill: { name: "Fill of the box", meaning: "share of that box's cells that have tiles" },
  box_share: { name: "Share of the box", meaning: "share of the grid that the box covers" },
  box_length: { name: "Length of the box", meaning: "longer side of the box divided by the shorter one" },
  symmetry: { name: "Symmetry", meaning: "share of the box's cells that equal its mirror image or half turn" },
  repetition: { name: "Repetition", meaning: "share of the tiles whose 3 × 3 cells equal another tile's" },
  adjacent_turns_per_tile: { name: "Turns side by side", meaning: "pairs of adjacent turns divided by tiles" },
  signable: { name: "Signable", meaning: "share of the crossings without a road at their four corners" },
  gridlock_number: {
    name: "Gridlock number",
    meaning: "most robots that can never block each other for ever: tiles of the shortest loop - 1",
  },
  mean_detour: {
    name: "Mean detour",
    meaning: "length of shortest ways divided by their length on a full grid of streets",
  },
};

/** Returns the name of a kind of object, such as "stop sign". */
export function objectName(kind: string): string {
  const name = kind
    .replace("other:", "")
    .replace("4_way", "4-way")
    .replaceAll("_", " ")
    .replace("trafficlight", "traffic light");
  return name.startsWith("sign ") ? `${name.slice(5)} sign` : name;
}

/** Describes an object: its kind, its tag, its position in tiles and its angle. */
export const describeObject = ({ kind, tag, x, y, angle }: MapObject): string =>
  `${objectName(kind)}${tag === undefined ? "" : `, tag ${tag}`}, x ${number(x)}, y ${number(y)}, angle ${degreesOf(angle)}°`;

/** Words for the two bins of a flag. */
const FLAGS: Readonly<Record<string, readonly [string, string]>> = {
  components: ["one piece", "several"],
  dead_ends: ["none", "some"],
  adjacent_crossings: ["none", "some"],
  adjacent_turns: ["none", "some"],
  bridges: ["none", "some"],
};

export const nameOf = (quantity: string): string =>
  WORDS[quantity]?.name ?? quantity[0].toUpperCase() + quantity.slice(1).replaceAll("_", " ");

/** Returns the words for a bin, or null if the axis is no flag. A flag has two bins, the first with one value. */
export function flagWords(axis: Axis, bin: number): string | null {
  return axis.bins === 2 && axis.width === 1 ? (FLAGS[axis.metric]?.[bin] ?? null) : null;
}

const whole = new Intl.NumberFormat("en", { maximumFractionDigits: 0 });

const fraction = new Intl.NumberFormat("en", { maximumSignificantDigits: 5 });

/** Writes a number. Fractions are kept below 10,000, with five digits. */
export function number(value: number): string {
  const text =
    Number.isInteger(value) || Math.abs(value) >= 10_000
      ? whole.format(Math.round(value) || 0)
      : fraction.format(value);
  return text.replace("-", "−");
}

/** Writes a count with its noun: 1 map, 2 maps. */
export const counted = (count: number, noun: string, nouns: string): string =>
  `${number(count)} ${count === 1 ? noun : nouns}`;

/**
 * Writes the value of a quantity. Shares are in whole per cent.
 *
 * The thousandths of a share are rounded down: two thirds are 666. Its tenth rounds to the same per cent as the share.
 */
export function valueText(quantity: string, value: number): string {
  if (Number.isNaN(value)) return "–";
  if (isShare(quantity)) return `${Math.round((100 * value) / SHARE_UNIT)} %`;
  return unitOf(quantity) > 1 ? (value / SHARE_UNIT).toFixed(2) : number(value);
}

/** Writes a value between others, such as a mark of an axis, with the digits that it has. */
export function markText(quantity: string, value: number): string {
  return isShare(quantity) ? `${+((100 * value) / SHARE_UNIT).toFixed(1)} %` : valueText(quantity, value);
}
