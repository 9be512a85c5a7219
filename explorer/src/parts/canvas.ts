/** The width of an element, and a canvas that fills its width at the resolution of the screen. */
import type { RefObject } from "preact";
import { useCallback, useEffect, useLayoutEffect, useRef, useState } from "preact/hooks";
import type { Grid } from "../network/codes";

interface Fitted {
  readonly canvas: RefObject<HTMLCanvasElement | null>;
  /** In pixels of the page, 0 until it is laid out. */
  readonly width: number;
  /** Clears the canvas for a map, and returns what to draw with: pixels of the screen a cell, and one of the page. */
  readonly clear: (grid: Grid) => { context: CanvasRenderingContext2D; scale: number; ratio: number };
}

/** Tells whether a part has been on the screen: what it can do without at first may come then. */
export function useShown(): boolean {
  const [shown, setShown] = useState(false);
  useEffect(() => {
    const frame = requestAnimationFrame(() => setTimeout(() => setShown(true)));
    return () => cancelAnimationFrame(frame);
  }, []);
  return shown;
}

/** Returns the width of an element in pixels of the page, 0 until it is laid out. */
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

export function useFittedCanvas(): Fitted {
  const canvas = useRef<HTMLCanvasElement>(null);
  const width = useWidth(canvas);
  const clear = useCallback(
    (grid: Grid) => {
      const ratio = window.devicePixelRatio || 1;
      const scale = (width * ratio) / grid.width;
      canvas.current!.width = Math.round(grid.width * scale);
      canvas.current!.height = Math.round(grid.height * scale);
      return { context: canvas.current!.getContext("2d")!, scale, ratio };
    },
    [width],
  );
  return { canvas, width, clear };
}
