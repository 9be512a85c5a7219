import type { ComponentChildren } from "preact";
import { useShared } from "../context";
import { sceneOf, toSvg } from "../drawing";
import { save, savePng } from "../files";
import type { Grid } from "../network/codes";
import { FileError, stubs, toDuckietown, toMapJson } from "../network/formats";
import { paintTiles, type Blend } from "../tiles";

interface Props {
  /** The name of the files, without an ending. */
  readonly name: string;
  readonly grid: Grid;
  /** Makes the fields of the map file beside its codes. */
  readonly fields: () => Readonly<Record<string, unknown>>;
  readonly pictures?: readonly number[] | null;
  readonly blend?: Blend;
  /** More buttons. */
  readonly children?: ComponentChildren;
}

/** The buttons that save a map as a file. */
export function SaveButtons({ name, grid, fields, pictures = null, blend = { image: 1 }, children }: Props) {
  const { data, tiles, view, say } = useShared();
  const saveYaml = () => {
    try {
      save(`${name}.yaml`, toDuckietown(grid));
    } catch (error) {
      if (!(error instanceof FileError)) throw error;
      say(error.message);
    }
  };
  return (
    <span class="saves" role="group" aria-label="Save">
      <span aria-hidden="true">Save</span>
      <button type="button" onClick={() => save(`${name}.json`, toMapJson(grid, fields()), "application/json")}>
        map.json
      </button>
      <button
        type="button"
        onClick={saveYaml}
        title={stubs(grid) ? "Duckietown has no dead ends" : "for Duckietown's programs"}
      >
        YAML
      </button>
      <button
        type="button"
        onClick={() => save(`${name}.svg`, toSvg(sceneOf(grid, new Set(view.overlays))), "image/svg+xml")}
      >
        SVG
      </button>
      <button
        type="button"
        disabled={!tiles}
        onClick={() => void savePng(`${name}.png`, paintTiles(grid, data, tiles!, pictures, blend))}
      >
        PNG
      </button>
      {children}
    </span>
  );
}
