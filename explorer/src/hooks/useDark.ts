import { useCallback, useEffect, useState } from "preact/hooks";

const QUERY = "(prefers-color-scheme: dark)";
/** What JupyterLab, marimo and VS Code write at the page's body. */
const ATTRIBUTES = ["data-jp-theme-light", "data-theme", "data-vscode-theme-kind"];

function notebookIsDark(): boolean | null {
  const { jpThemeLight, vscodeThemeKind, theme } = document.body.dataset;
  if (jpThemeLight) return jpThemeLight === "false";
  if (vscodeThemeKind) return !vscodeThemeKind.endsWith("light");
  return theme ? theme === "dark" : null;
}

const surroundingsAreDark = () => notebookIsDark() ?? matchMedia(QUERY).matches;

/** Returns whether colours are dark, and a function that switches them. The notebook or the system sets the default. */
export function useDark(): [dark: boolean, toggle: () => void] {
  const [around, setAround] = useState(surroundingsAreDark);
  const [chosen, setChosen] = useState<boolean | null>(null);
  const dark = chosen ?? around;
  useEffect(() => {
    const changed = () => setAround(surroundingsAreDark());
    const query = matchMedia(QUERY);
    query.addEventListener("change", changed);
    const observer = new MutationObserver(changed);
    observer.observe(document.body, { attributes: true, attributeFilter: ATTRIBUTES });
    return () => {
      query.removeEventListener("change", changed);
      observer.disconnect();
    };
  }, []);
  return [dark, useCallback(() => setChosen(!dark), [dark])];
}
