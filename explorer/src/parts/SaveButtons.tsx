import type { ComponentChildren } from "preact";
import { useShared } from "../context";
import { sceneOf, toSvg } from "../drawing";
import { save, savePng } from "../files";
import { describeCell } from "../network/cells";
import type { Grid } from "../network/codes";
import { FileError } from "../network/errors";
import { stubs, toDuckietown, toMapJson } from "../network/formats";
import { roadEnds } from "../network/links";
import type { MapObject } from "../network/objects";
import { planSvg } from "../plan";
import { paintTiles, type Blend } from "../tiles";
import { counted } from "../words";

interface Props {
  /** The name of the files, without an ending. */
  readonly name: string;
  readonly grid: Grid;
  readonly objects: readonly MapObject[];
  /** Makes the fields of the map file beside the codes and the objects. */
  readonly fields: () => Readonly<Record<string, unknown>>;
  readonly pictures?: readonly number[] | null;
  readonly blend?: Blend;
  /** More buttons. */
  readonly children?: ComponentChildren;
}

/** The buttons that save a map as a file. */
export function SaveButtons({ name, grid, objects, fields, pictures = null, blend = { image: 1 }, children }: Props) {
  const { data, tiles, view, say } = useShared();
  const { kinds } = data.objects;
  /** Saves a file, or says why it cannot be made. Says where roads end. */
  const saveFile = (file: string, make: () => string, type?: string) => {
    try {
      save(file, make(), type);
      const ends = roadEnds(grid);
      if (ends.length) {
        const first = describeCell(Math.floor(ends[0] / grid.width), ends[0] % grid.width);
        say(`${file}: roads end at ${counted(ends.length, "tile", "tiles")}, the first at ${first}`);
      }
    } catch (error) {
      if (!(error instanceof FileError)) throw error;
      say(error.message);
    }
  };
  return (
    <span class="saves" role="group" aria-label="Save">
      <span aria-hidden="true">Save</span>
      <button
        type="button"
        onClick={() =>
          saveFile(
            `${name}.json`,
            () => toMapJson(grid, { ...fields(), ...(objects.length && { objects }) }),
            "application/json",
          )
        }
      >
        map.json
      </button>
      <button
        type="button"
        onClick={() => saveFile(`${name}.yaml`, () => toDuckietown(grid, objects))}
        title={stubs(grid) ? "Duckietown has no dead ends" : "for Duckietown's programs"}
      >
        YAML
      </button>
      <button
        type="button"
        onClick={() =>
          saveFile(`${name}.svg`, () => toSvg(sceneOf(grid, objects, kinds, new Set(view.overlays))), "image/svg+xml")
        }
      >
        SVG
      </button>
      <button
        type="button"
        disabled={!tiles}
        onClick={() => void savePng(`${name}.png`, paintTiles(grid, data, tiles!, pictures, objects, blend))}
      >
        PNG
      </button>
      <button
        type="button"
        onClick={() => saveFile(`${name}-plan.svg`, () => planSvg(grid, objects, kinds, data.plan), "image/svg+xml")}
        title="tiles, tape and objects to build the map from, and a check-list, as SVG for A4"
      >
        Plan
      </button>
      {children}
    </span>
  );
}
