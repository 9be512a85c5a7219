import { useEffect, useState } from "preact/hooks";

/**
 * Returns whether a notebook is searching, and a function that starts its search.
 *
 * @param listen calls its argument with each message of the notebook; returns a function that ends this
 */
export function useSearch(
  listen: ((hear: (message: string) => void) => () => void) | undefined,
  say: (text: string) => void,
): [searching: boolean, start: () => void] {
  const [searching, setSearching] = useState(false);
  useEffect(
    () =>
      listen?.((text) => {
        setSearching(false);
        say(text);
      }),
    [listen, say],
  );
  return [searching, () => setSearching(true)];
}
