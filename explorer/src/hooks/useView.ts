import { useCallback, useEffect, useState } from "preact/hooks";
import { fromHash, START, toHash, type View } from "../state";

/** Writes a hash to the page's address, if the browser lets the page change it. */
function keepAddress(hash: string): void {
  try {
    history.replaceState(null, "", hash ? `#${hash}` : location.pathname);
  } catch (error) {
    // A frame of another page may have no origin, as with srcdoc, blob: and data:. Then its address stays.
    if (!(error instanceof DOMException)) throw error;
  }
}

/** Returns the view and a function that changes it. If `addressed`, the page's address keeps the view. */
export function useView(addressed: boolean): [view: View, show: (change: Partial<View>) => void] {
  const [view, setView] = useState<View>(() => (addressed ? fromHash(location.hash) : START));
  const show = useCallback((change: Partial<View>) => setView((before) => ({ ...before, ...change })), []);
  useEffect(() => {
    if (!addressed) return;
    const hash = toHash(view);
    if (hash !== location.hash.slice(1)) keepAddress(hash);
  }, [addressed, view]);
  useEffect(() => {
    if (!addressed) return;
    const read = () => setView(fromHash(location.hash));
    addEventListener("hashchange", read);
    return () => removeEventListener("hashchange", read);
  }, [addressed]);
  return [view, show];
}
