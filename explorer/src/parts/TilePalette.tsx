/** The sixteen tiles to choose from. */
import { mapShapes } from "../drawing";
import { emptyGrid, KIND_OF } from "../network/codes";

export function TilePalette({ tile, onTile }: { readonly tile: number; readonly onTile: (tile: number) => void }) {
  return (
    <div class="palette" role="group" aria-label="Tile to set">
      {Array.from({ length: 16 }, (_, code) => (
        <button
          key={code}
          type="button"
          aria-pressed={code === tile}
          aria-label={`code ${code}, ${KIND_OF[code]}`}
          title={`code ${code}, ${KIND_OF[code]}`}
          onClick={() => onTile(code)}
        >
          <TileIcon code={code} />
        </button>
      ))}
    </div>
  );
}

/** A small drawing of a tile. */
export function TileIcon({ code }: { readonly code: number }) {
  const shapes = mapShapes({ height: 1, width: 1, codes: Uint8Array.of(code) }, { lanes: false }).slice(0, -1);
  return (
    <svg viewBox="0 0 1 1" aria-hidden="true" class="tile">
      {shapes.concat(code ? [] : mapShapes(emptyGrid(1, 1))).map((shape, index) => (
        <path key={index} d={shape.d} fill={shape.fill ?? "none"} stroke={shape.stroke} stroke-width={shape.width} />
      ))}
    </svg>
  );
}
