import type { RefObject } from "preact";
import { useEffect, useRef } from "preact/hooks";

/** Returns a reference for an element that takes the focus if a change of `content` removed the focused element. */
export function useKeptFocus(content: string): RefObject<HTMLDivElement | null> {
  const element = useRef<HTMLDivElement>(null);
  const before = useRef(content);
  useEffect(() => {
    const changed = before.current !== content;
    before.current = content;
    if (changed && document.activeElement === document.body) element.current!.focus({ preventScroll: true });
  }, [content]);
  return element;
}
