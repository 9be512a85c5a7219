// Prints what the built module's kernel makes of the grids in a JSON file: `node kernel.mjs MODULE FILE`.
import { readFileSync } from "node:fs";
import { pathToFileURL } from "node:url";

const [module, file] = process.argv.slice(2);
const { kernel } = await import(pathToFileURL(module).href);
const { grids, weights, alphabet, town } = JSON.parse(readFileSync(file, "utf8"));
const mask = alphabet.reduce((bits, code) => bits | (1 << code), 0);

const gridOf = (rows) => ({ height: rows.length, width: rows[0].length, codes: Uint8Array.from(rows.flat()) });
const made = grids.map(({ rows, dirty, fixed }) => {
  const grid = gridOf(rows);
  const metrics = kernel.measure(grid, mask);
  return {
    metrics: [...metrics],
    town: town && kernel.measureTown(grid),
    fitness: kernel.fitness(metrics, weights),
    repaired: dirty && [false, true].map((fill) => [...kernel.repair(grid, { dirty, fixed, fill }).codes]),
  };
});
process.stdout.write(JSON.stringify(made));
