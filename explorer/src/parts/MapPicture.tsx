/** A map as lines or with tile pictures, and overlays. */
import { useEffect } from "preact/hooks";
import { useShared } from "../context";
import { mapShapes, overlayShapes, paint, type Overlay, type Shape } from "../drawing";
import type { Grid } from "../network/codes";
import { paintTiles, type Blend } from "../tiles";
import { useFittedCanvas } from "./canvas";

interface Props {
  readonly grid: Grid;
  readonly label: string;
  readonly pictures?: readonly number[] | null;
  readonly look?: "lines" | "tiles";
  readonly blend?: Blend;
  readonly overlays?: readonly Overlay[];
  /** More shapes over the map. */
  readonly above?: readonly Shape[];
}

const NO_OVERLAYS: readonly Overlay[] = [];

/** Draws a map as wide as the element around it. */
export function MapPicture({
  grid,
  label,
  pictures = null,
  look = "lines",
  blend,
  overlays = NO_OVERLAYS,
  above,
}: Props) {
  const { data, tiles } = useShared();
  const { canvas, width, clear } = useFittedCanvas();
  useEffect(() => {
    if (!width) return;
    const { context, scale } = clear(grid);
    if (look === "tiles" && tiles) {
      context.imageSmoothingQuality = "high";
      context.drawImage(
        paintTiles(grid, data, tiles, pictures, blend ?? { image: 1 }),
        0,
        0,
        canvas.current!.width,
        canvas.current!.height,
      );
    } else {
      paint(context, { shapes: mapShapes(grid, { lanes: scale > 14 }), texts: [] }, scale);
    }
    paint(context, overlayShapes(grid, new Set(overlays)), scale);
    if (above) paint(context, { shapes: above, texts: [] }, scale);
  }, [grid, width, look, tiles, pictures, blend, overlays, above, data, canvas, clear]);
  return (
    <canvas
      ref={canvas}
      class="map"
      role="img"
      aria-label={label}
      style={{ aspectRatio: `${grid.width} / ${grid.height}`, maxWidth: `${(90 * grid.width) / grid.height}vh` }}
    />
  );
}
