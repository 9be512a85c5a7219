/** The shortest loop of roads. */
import type { Grid } from "./codes";
import { neighboursOf } from "./links";

/** Returns the cells of the shortest loop, clockwise from the first one; none without a loop. */
export function gridlockLoop(grid: Grid): number[] {
  const neighbours = neighboursOf(grid);
  let loop: number[] = [];
  neighbours.forEach((linked, first) => {
    // The first cell of a loop leads east and south. The loop's other cells come after it.
    const [east, south] = [first + 1, first + grid.width];
    if (!linked.includes(east) || !linked.includes(south) || east === south) return;
    const most = loop.length ? loop.length - 2 : grid.codes.length;
    const found = close(neighbours, first, east, south, most);
    if (found.length) loop = found;
  });
  return loop;
}

/** Returns the least of the shortest loops with these three cells, of at most `most` cells; none without one. */
function close(neighbours: readonly number[][], first: number, east: number, south: number, most: number): number[] {
  const steps = new Map([[south, 0]]);
  const waiting = [south];
  for (const cell of waiting) {
    const next = steps.get(cell)! + 1;
    if (cell === east || next > most - 2) break;
    for (const other of neighbours[cell]) {
      if (other <= first || steps.has(other)) continue;
      steps.set(other, next);
      waiting.push(other);
    }
  }
  if (!steps.has(east)) return [];
  const loop = [first, east];
  for (let cell = east; cell !== south; loop.push(cell)) {
    const nearer = steps.get(cell)! - 1;
    cell = Math.min(...neighbours[cell].filter((other) => steps.get(other) === nearer));
  }
  return loop;
}
