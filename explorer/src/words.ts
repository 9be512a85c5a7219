/** Words for quantities, and numbers as text. */
import { isShare, SHARE_UNIT, unitOf, type Axis } from "./network/features";

interface Words {
  readonly name: string;
  readonly meaning: string;
}

export const WORDS: Readonly<Record<string, Words>> = {
  fitness: { name: "Fitness", meaning: "weighted sum of the metrics; lower is better" },
  above_floor: {
    name: "Above the proven floor",
    meaning: "fitness above the lowest that is possible, where that is proven",
  },
  filled: { name: "Seeds that fill the niche", meaning: "how many seeds found a map here" },
  components: { name: "Components", meaning: "pieces that no road connects" },
  cyclomatic: { name: "Cyclomatic number", meaning: "independent cycles: faces that roads enclose" },
  dead_ends: { name: "Dead ends", meaning: "tiles with one connection, or with one that is not returned" },
  boundary_violations: { name: "Boundary violations", meaning: "tiles with a road that leaves the grid" },
  bridges: { name: "Bridges", meaning: "roads without which the network falls apart" },
  crossings: { name: "Crossings", meaning: "tiles with three or four connections" },
  adjacent_crossings: { name: "Adjacent crossings", meaning: "linked pairs of crossings, counted from both" },
  adjacent_crossing_score: {
    name: "Adjacent crossing score",
    meaning: "connections of both tiles, over linked pairs of crossings",
  },
  adjacent_turns: { name: "Adjacent turns", meaning: "pairs of turns side by side" },
  straight_score: { name: "Straight score", meaning: "sum of the squared lengths of straight runs" },
  straights: { name: "Straights", meaning: "tiles with two connections on opposite sides" },
  turns: { name: "Turns", meaning: "tiles with two connections that meet" },
  crowded_crossings: { name: "Crowded crossings", meaning: "a crossing beside a crossing or a turn" },
  unlinked_neighbours: { name: "Unlinked neighbours", meaning: "roads side by side without a link" },
  tiles: { name: "Tiles", meaning: "cells with a road" },
  empty_cells: { name: "Empty cells", meaning: "cells without a road" },
  edges: { name: "Links", meaning: "neighbouring tiles that both connect to each other" },
  mismatches: { name: "Mismatches", meaning: "connections within the grid that are not returned" },
  off_alphabet: { name: "Off alphabet", meaning: "tiles that the search may not use" },
  straight_share: { name: "Straight share", meaning: "straights among the tiles" },
  turn_share: { name: "Turn share", meaning: "turns among the tiles" },
  crossing_share: { name: "Crossing share", meaning: "crossings among the tiles" },
  coverage: { name: "Coverage", meaning: "tiles among all cells" },
  largest_block: {
    name: "Largest block",
    meaning: "area of the largest face, in squares between the middles of roads",
  },
  smallest_block: { name: "Smallest block", meaning: "area of the smallest face" },
  mean_block: { name: "Mean block", meaning: "mean area of the faces" },
  block_spread: { name: "Spread of blocks", meaning: "mean difference of a face's area from their mean, to the mean" },
  small_blocks: { name: "Small blocks", meaning: "faces with an area of at most 4" },
  loops_per_tile: { name: "Loops per tile", meaning: "cyclomatic number to tiles" },
  longest_street: { name: "Longest street", meaning: "links from a crossing or dead end to the next" },
  shortest_street: { name: "Shortest street", meaning: "links from a crossing or dead end to the next" },
  mean_street: { name: "Mean street", meaning: "mean of the streets' links" },
  border_share: { name: "Border share", meaning: "tiles along the sides of the smallest box around the town" },
  box_fill: { name: "Fill of the box", meaning: "cells of that box that have tiles" },
  box_share: { name: "Share of the box", meaning: "part of the grid that the box covers" },
  box_length: { name: "Length of the box", meaning: "its longer side to the shorter one" },
  symmetry: { name: "Symmetry", meaning: "cells of the box as in its mirror image or half turn" },
  repetition: { name: "Repetition", meaning: "tiles whose 3 × 3 cells some other tile has too" },
  adjacent_turns_per_tile: { name: "Turns side by side", meaning: "pairs of adjacent turns to tiles" },
  mean_detour: { name: "Mean detour", meaning: "way by road to way on a full grid of streets" },
};

/** What the two bins of a flag mean. */
const FLAGS: Readonly<Record<string, readonly [string, string]>> = {
  components: ["one piece", "several"],
  dead_ends: ["none", "some"],
  adjacent_crossings: ["none", "some"],
  adjacent_turns: ["none", "some"],
  bridges: ["none", "some"],
};

export const nameOf = (quantity: string): string =>
  WORDS[quantity]?.name ?? quantity[0].toUpperCase() + quantity.slice(1).replaceAll("_", " ");

/** Returns words for a bin of a flag: two bins of which the first holds one value. */
export function flagWords(axis: Axis, bin: number): string | null {
  return axis.bins === 2 && axis.width === 1 ? (FLAGS[axis.metric]?.[bin] ?? null) : null;
}

const whole = new Intl.NumberFormat("en", { maximumFractionDigits: 0 });

export function number(value: number): string {
  return whole.format(Math.round(value) || 0).replace("-", "−");
}

/** Writes the value of a quantity; shares in per cent. */
export function valueText(quantity: string, value: number): string {
  if (Number.isNaN(value)) return "–";
  if (isShare(quantity)) return `${((100 * value) / SHARE_UNIT).toFixed(1)} %`;
  return unitOf(quantity) > 1 ? (value / SHARE_UNIT).toFixed(2) : number(value);
}
