/** A map as lines or with tile pictures, and overlays. */
import { useEffect } from "preact/hooks";
import { useShared } from "../context";
import { objectShapes, overlayShapes, paint, type Overlay } from "../drawing";
import type { Grid } from "../network/codes";
import { edgeOf, NO_OBJECTS, type MapObject } from "../network/objects";
import { paintMap } from "../raster";
import { paintTiles, type Blend } from "../tiles";
import { fittedStyle, useFittedCanvas, type Frame } from "./canvas";

interface Props {
  readonly grid: Grid;
  readonly label: string;
  readonly pictures?: readonly number[] | null;
  readonly objects?: readonly MapObject[];
  readonly look?: "lines" | "tiles";
  readonly blend?: Blend;
  readonly overlays?: readonly Overlay[];
  /** The size that fills the element around it, by default the map's. */
  readonly frame?: Frame;
}

const NO_OVERLAYS: readonly Overlay[] = [];

/** Returns by how many tiles a picture is larger than the map on each side. Tile pictures end at the map's border. */
export const pictureEdge = (grid: Grid, objects: readonly MapObject[], look: "lines" | "tiles"): number =>
  look === "lines" ? edgeOf(objects, grid) : 0;

/** Draws a map as wide as the element around it. */
export function MapPicture({
  grid,
  label,
  pictures = null,
  objects = NO_OBJECTS,
  look = "lines",
  blend,
  overlays = NO_OVERLAYS,
  frame,
}: Props) {
  const { data, tiles } = useShared();
  const { canvas, width, clear } = useFittedCanvas();
  const edge = pictureEdge(grid, objects, look);
  useEffect(() => {
    if (!width) return;
    const { context, scale } = clear(grid, edge);
    if (look === "tiles" && tiles) {
      context.imageSmoothingQuality = "high";
      context.drawImage(
        paintTiles(grid, data, tiles, pictures, objects, blend ?? { image: 1 }),
        0,
        0,
        canvas.current!.width,
        canvas.current!.height,
      );
    } else {
      paintMap(context, grid, scale);
      paint(context, { shapes: objectShapes(objects, data.objects.kinds), texts: [] }, scale);
    }
    paint(context, overlayShapes(grid, new Set(overlays)), scale);
  }, [grid, edge, width, look, tiles, pictures, objects, blend, overlays, data, canvas, clear]);
  return <canvas ref={canvas} class="map" role="img" aria-label={label} style={fittedStyle(grid, edge, 90, frame)} />;
}
