/** The tiles that a lab has, and what a map that is drawn uses and leaves of them. */
import { useShared } from "../context";
import type { Grid } from "../network/codes";
import { inventoryText, TILE_KINDS, usedTiles, type Shelf } from "../network/shelf";
import { inventoryOf } from "../record";
import { counted, number } from "../words";
import { TileIcon } from "./TilePalette";

const MOST = 100_000;

export function ShelfTable({ grid }: { readonly grid: Grid }) {
  const { run, view, show, say } = useShared();
  const shelf = view.shelf ?? inventoryOf(run);
  const used = usedTiles(grid);
  const change = (index: number, input: HTMLInputElement) => {
    const count = input.value === "" ? 0 : Number(input.value);
    if (Number.isInteger(count) && count >= 0 && count <= MOST) {
      // A kind without a number has no tiles, as for --inventory.
      const counts = shelf ?? TILE_KINDS.map(() => 0);
      return show({ shelf: counts.map((other, kind) => (kind === index ? count : other)) });
    }
    say(`Expected a whole number from 0 to ${number(MOST)}, got ${input.value}`);
    input.value = shelf ? `${shelf[index]}` : "";
  };
  return (
    <details class="shelf" open={shelf !== null}>
      <summary>
        Shelf
        <span aria-live="polite">{shelf && `: ${verdict(shelf, used)}`}</span>
      </summary>
      <table>
        <thead>
          <tr>
            <th scope="col">Tile</th>
            <th scope="col">Used</th>
            <th scope="col">On the shelf</th>
            <th scope="col">Left</th>
          </tr>
        </thead>
        <tbody>
          {TILE_KINDS.map(({ kind, names, code }, index) => {
            const left = shelf && shelf[index] - used[index];
            return (
              <tr key={kind}>
                <th scope="row">
                  <TileIcon code={code} />
                  {names[0].toUpperCase() + names.slice(1)}
                </th>
                <td>{number(used[index])}</td>
                <td>
                  <input
                    type="number"
                    min="0"
                    max={MOST}
                    aria-label={`${names} on the shelf`}
                    value={shelf ? shelf[index] : ""}
                    onChange={(event) => change(index, event.currentTarget)}
                  />
                </td>
                <td class={left !== null && left < 0 ? "worse" : ""}>{left === null ? "–" : number(left)}</td>
              </tr>
            );
          })}
        </tbody>
      </table>
      {shelf && (
        <div class="bar">
          <code class="where">--inventory {inventoryText(shelf)}</code>
          {view.shelf && (
            <button type="button" onClick={() => show({ shelf: null })}>
              Reset
            </button>
          )}
        </div>
      )}
    </details>
  );
}

/** Says whether the tiles of a shelf are enough. */
function verdict(shelf: Shelf, used: Shelf): string {
  const lacking = TILE_KINDS.flatMap(({ name, names }, index) => {
    const count = used[index] - shelf[index];
    return count > 0 ? [counted(count, name, names)] : [];
  });
  return lacking.length ? `it lacks ${lacking.join(", ")}` : "enough tiles";
}
