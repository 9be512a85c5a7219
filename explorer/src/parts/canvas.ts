/** The width of an element, and a canvas that fills its width at the resolution of the screen. */
import type { RefObject } from "preact";
import { useCallback, useEffect, useLayoutEffect, useRef, useState } from "preact/hooks";
import type { Grid } from "../network/codes";

interface Fitted {
  readonly canvas: RefObject<HTMLCanvasElement | null>;
  /** The width in pixels of the page, 0 before layout. */
  readonly width: number;
  /**
   * Clears the canvas for a map and `edge` tiles around it. `scale` is screen pixels per tile, `ratio` screen pixels per
   * page pixel. The origin is the map's north-west corner.
   */
  readonly clear: (grid: Grid, edge?: number) => { context: CanvasRenderingContext2D; scale: number; ratio: number };
}

/** Returns false for the first frame, so that slow parts appear after it. */
export function useShown(): boolean {
  const [shown, setShown] = useState(false);
  useEffect(() => {
    const frame = requestAnimationFrame(() => setTimeout(() => setShown(true)));
    return () => cancelAnimationFrame(frame);
  }, []);
  return shown;
}

/** Returns the width of an element in pixels of the page, 0 before layout. */
export function useWidth(element: RefObject<HTMLElement | null>): number {
  const [width, setWidth] = useState(0);
  useLayoutEffect(() => {
    const measure = () => setWidth(element.current!.clientWidth);
    const observer = new ResizeObserver(measure);
    observer.observe(element.current!);
    measure();
    return () => observer.disconnect();
  }, [element]);
  return width;
}

/** A height and a width in tiles. */
export type Frame = Pick<Grid, "height" | "width">;

/** Returns the size of a map with `edge` tiles around it. */
export const framed = ({ height, width }: Frame, edge: number): Frame => ({
  height: height + 2 * edge,
  width: width + 2 * edge,
});

/**
 * Returns the style of a canvas for a map with `edge` tiles around it. A map as large as `frame` is as wide as the element
 * around it, or as high as a percentage of the window. All maps of a frame have one scale.
 */
export function fittedStyle(map: Frame, edge: number, most: number, frame = framed(map, edge)) {
  const { height, width } = framed(map, edge);
  const share = (100 * width) / frame.width;
  return { aspectRatio: `${width / height}`, maxWidth: `min(${share}%, ${(most * width) / frame.height}vh)` };
}

export function useFittedCanvas(): Fitted {
  const canvas = useRef<HTMLCanvasElement>(null);
  const width = useWidth(canvas);
  const clear = useCallback(
    (grid: Grid, edge = 0) => {
      const ratio = window.devicePixelRatio || 1;
      const scale = (width * ratio) / (grid.width + 2 * edge);
      canvas.current!.width = Math.round(width * ratio);
      canvas.current!.height = Math.round((grid.height + 2 * edge) * scale);
      const context = canvas.current!.getContext("2d")!;
      context.translate(edge * scale, edge * scale);
      return { context, scale, ratio };
    },
    [width],
  );
  return { canvas, width, clear };
}
