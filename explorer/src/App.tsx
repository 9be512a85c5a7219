/** The whole page. */
import { useCallback, useEffect, useMemo, useRef, useState } from "preact/hooks";
import { SharedContext, type Shared } from "./context";
import type { Data } from "./data";
import { editorOf, type Editor } from "./editor";
import { emptyGrid, rowsOf, type Grid } from "./network/codes";
import { FileError, readMap } from "./network/formats";
import type { Weights } from "./network/measure";
import { Choice } from "./parts/Controls";
import { fromHash, START, toHash, VIEWS, type View, type ViewName } from "./state";
import { loadTiles, type TilePictures } from "./tiles";
import { Archive, selectedNiche } from "./views/Archive";
import { Compare } from "./views/Compare";
import { Draw } from "./views/Draw";
import { Maps } from "./views/Maps";
import { RunView } from "./views/RunView";

const VIEW_NAMES: Readonly<Record<ViewName, string>> = { archive: "Archive", maps: "Maps", compare: "Compare", draw: "Draw", run: "Run" };

type Theme = "auto" | "light" | "dark";

interface Props {
  readonly data: Data;
  /** Whether the page's address keeps the view. */
  readonly addressed: boolean;
  /** Is told the map that is drawn. */
  readonly onGrid?: (rows: number[][]) => void;
  /** Is told the map that is open. */
  readonly onSelect?: (run: number, elite: number) => void;
  readonly onContinue?: (rows: number[][]) => void;
  /** Listens to what a notebook has to say; returns what ends that. */
  readonly listen?: (tell: (message: string) => void) => () => void;
}

const MOST_BYTES = 8 * 2 ** 20; // of a map file; one of 1024 x 1024 tiles has 3 MB

export function App({ data, addressed, onGrid, onSelect, onContinue, listen }: Props) {
  const [view, setView] = useState<View>(() => (addressed ? fromHash(location.hash) : START));
  const [tiles, setTiles] = useState<TilePictures | null>(null);
  const [theme, setTheme] = useState<Theme>("auto");
  const [message, setMessage] = useState("");
  const [unseen, setUnseen] = useState(false);
  const [drawn, setDrawn] = useState<Editor | null>(null);
  const [weights, setWeights] = useState<Weights | null>(null);
  const [searches, setSearches] = useState(false);
  const [over, setOver] = useState(false);
  const shown = useRef<View>(view);
  const body = useRef<HTMLDivElement>(null);
  const first = useRef(true);
  const dark = useDark(theme);
  const place = Math.min(view.run, data.runs.length - 1);
  const run = data.runs[place];

  const show = useCallback((change: Partial<View>) => {
    shown.current = { ...shown.current, ...change };
    setView(shown.current);
  }, []);
  const say = useCallback((text: string, only = false) => {
    setUnseen(only);
    setMessage(text.length > 300 ? `${text.slice(0, 299)}…` : text);
  }, []);
  const seed = (typeof view.seed === "number" && view.seed >= run.seeds) || run.seeds === 1 ? "best" : view.seed;
  const elites = run.elites(seed === "count" ? "best" : seed);
  const open = view.map !== null && view.map < run.count ? view.map : elites[selectedNiche(run, view.niche, view.map, elites)];
  const edit = useCallback((editor: Editor) => {
    setDrawn(editor);
    onGrid?.(rowsOf(editor.grid));
  }, [onGrid]);
  const draw = useCallback((grid: Grid) => {
    edit(editorOf(grid));
    show({ view: "draw" });
  }, [edit]);
  const openFiles = async (files: ArrayLike<File>) => {
    const file = files[0];
    if (!file) return say("A map.json or a Duckietown map can be dropped here");
    try {
      if (file.size > MOST_BYTES) throw new FileError(`${file.name}: expected at most 8 MiB`);
      const { grid, given } = readMap(await file.text(), file.name);
      edit(editorOf(grid, given ?? undefined));
      show({ view: "draw" });
      say(`${file.name}: ${grid.height} × ${grid.width} tiles${files.length > 1 ? `; the first of ${files.length} files` : ""}`);
    } catch (error) {
      say(error instanceof FileError ? error.message : `${file.name}: cannot be read`);
    }
  };

  useEffect(() => void loadTiles(data.tiles).then(setTiles, () => setMessage("The tile pictures cannot be shown")), [data]);
  useEffect(() => {
    if (!addressed) return;
    const hash = toHash(view);
    if (hash !== location.hash.slice(1)) history.replaceState(null, "", hash ? `#${hash}` : location.pathname);
  }, [view]);
  useEffect(() => {
    if (!addressed) return;
    const back = () => {
      shown.current = fromHash(location.hash);
      setView(shown.current);
    };
    addEventListener("hashchange", back);
    return () => removeEventListener("hashchange", back);
  }, []);
  useEffect(() => {
    if (!message) return;
    const timer = setTimeout(() => setMessage(""), 4000 + 40 * message.length);
    return () => clearTimeout(timer);
  }, [message]);
  useEffect(() => void (open >= 0 && onSelect?.(place, open)), [place, open]);
  useEffect(() => setWeights(null), [run]);
  useEffect(() => listen?.((text) => {
    setSearches(false);
    say(text);
  }), []);
  useEffect(() => {
    // What was pressed may be gone with its view: keys go on from the new one.
    if (!first.current && document.activeElement === document.body) body.current!.focus({ preventScroll: true });
    first.current = false;
  }, [view.view, view.pins.length]);
  useEffect(() => void requestAnimationFrame(() => performance.mark("elitelanes-shown")), []);

  const editor = drawn ?? editorOf(open >= 0 ? run.grid(open) : emptyGrid(run.height, run.width));
  const shared: Shared = useMemo(
    () => ({
      data, run, tiles, dark, show, draw, say,
      view: { ...view, run: place, seed, pins: view.pins.filter(([one, elite]) => one < data.runs.length && elite < data.runs[one].count) },
    }),
    [data, view, place, run, tiles, dark],
  );
  const tabs = VIEWS.filter((name) => name !== "run" || data.runs.length > 1 || run.history || Object.keys(run.record).length);
  const tab = (event: KeyboardEvent) => {
    const now = tabs.indexOf(view.view);
    const place = { ArrowLeft: now - 1 + tabs.length, ArrowRight: now + 1, Home: 0, End: tabs.length - 1 }[event.key];
    if (place === undefined) return;
    event.preventDefault();
    const next = tabs[place % tabs.length];
    show({ view: next });
    ((event.currentTarget as HTMLElement).children[tabs.indexOf(next)] as HTMLElement).focus();
  };
  return (
    <SharedContext.Provider value={shared}>
      <div
        class={`elx ${dark ? "dark" : "light"}${over ? " drop" : ""}`}
        onDragOver={(event) => (event.preventDefault(), setOver(true))}
        onDragLeave={() => setOver(false)}
        onDrop={(event) => {
          event.preventDefault();
          setOver(false);
          void openFiles(event.dataTransfer?.files ?? []);
        }}
      >
        <header class="top">
          <h1>
            <svg viewBox="0 0 24 24" aria-hidden="true">
              <rect width="24" height="24" rx="6" />
              <path class="road" d="M12 24V14a6 6 0 0 1 6-6h6M12 14V0M0 16h12" />
              <path class="lane" d="M12 24V14a6 6 0 0 1 6-6h6" />
            </svg>
            Elite Lanes
          </h1>
          {data.runs.length > 1 ? (
            <Choice
              label="Run"
              value={`${place}`}
              options={data.runs.map((one, number) => [`${number}`, one.name] as const)}
              onChange={(number) => show({ run: Number(number), niche: null, map: null, where: {} })}
            />
          ) : (
            <span class="name">{data.title || run.name}</span>
          )}
          <div class="tabs" role="tablist" aria-label="Views" onKeyDown={tab}>
            {tabs.map((name) => (
              <button
                key={name}
                type="button"
                role="tab"
                aria-selected={view.view === name}
                tabIndex={view.view === name ? 0 : -1}
                onClick={() => show({ view: name })}
              >
                {VIEW_NAMES[name]}
                {name === "compare" && shared.view.pins.length > 0 && <b>{shared.view.pins.length}</b>}
              </button>
            ))}
          </div>
          <button
            type="button"
            class="theme"
            aria-label={dark ? "Light colours" : "Dark colours"}
            title={dark ? "Light colours" : "Dark colours"}
            onClick={() => setTheme(dark ? "light" : "dark")}
          >
            {dark ? "☀" : "☾"}
          </button>
        </header>
        <div class="body" role="tabpanel" aria-label={VIEW_NAMES[view.view]} tabIndex={-1} ref={body}>
          {view.view === "archive" && <Archive />}
          {view.view === "maps" && <Maps />}
          {view.view === "compare" && <Compare />}
          {view.view === "draw" && (
            <Draw
              editor={editor}
              onEdit={edit}
              weights={weights ?? run.weights}
              onWeights={setWeights}
              onFiles={openFiles}
              onContinue={onContinue ? () => (setSearches(true), onContinue(rowsOf(editor.grid))) : null}
              searches={searches}
            />
          )}
          {view.view === "run" && <RunView />}
        </div>
        <p class={`message${message && !unseen ? " shown" : ""}`} role="status" aria-live="polite">{message}</p>
      </div>
    </SharedContext.Provider>
  );
}

/** Tells whether a notebook is dark, by what JupyterLab, VS Code and marimo write at the page's body; null elsewhere. */
function notebookIsDark(): boolean | null {
  const { jpThemeLight, vscodeThemeKind, theme } = document.body.dataset;
  if (jpThemeLight) return jpThemeLight === "false";
  if (vscodeThemeKind) return !vscodeThemeKind.endsWith("light");
  return theme ? theme === "dark" : null;
}

/** Tells whether the colours are dark: as was chosen, as the notebook is, or as the system wishes. */
function useDark(theme: Theme): boolean {
  const query = useMemo(() => matchMedia("(prefers-color-scheme: dark)"), []);
  const [system, setSystem] = useState(() => notebookIsDark() ?? query.matches);
  useEffect(() => {
    const changed = () => setSystem(notebookIsDark() ?? query.matches);
    query.addEventListener("change", changed);
    const observer = new MutationObserver(changed);
    observer.observe(document.body, { attributes: true, attributeFilter: ["data-jp-theme-light", "data-theme", "data-vscode-theme-kind"] });
    return () => {
      query.removeEventListener("change", changed);
      observer.disconnect();
    };
  }, []);
  return theme === "auto" ? system : theme === "dark";
}
