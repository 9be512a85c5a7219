/** The whole page. */
import { useMemo, useState } from "preact/hooks";
import { SharedContext, type Shared } from "./context";
import type { Data, Run } from "./data";
import { editorOf } from "./editor";
import { useDark } from "./hooks/useDark";
import { useDrawing } from "./hooks/useDrawing";
import { useDrop } from "./hooks/useDrop";
import { useKeptFocus } from "./hooks/useKeptFocus";
import { useMessage } from "./hooks/useMessage";
import { useTiles } from "./hooks/useTiles";
import { useView } from "./hooks/useView";
import { emptyGrid } from "./network/codes";
import type { Weights } from "./network/measure";
import type { MapObject } from "./network/objects";
import { Header } from "./parts/Header";
import { objectsOf } from "./record";
import { openElite, validView } from "./selection";
import { VIEW_NAMES } from "./state";
import { Archive } from "./views/Archive";
import { Compare } from "./views/Compare";
import { Draw } from "./views/Draw";
import { Maps } from "./views/Maps";
import { RunView } from "./views/RunView";

interface Props {
  readonly data: Data;
  /** Whether the page's address keeps the view. */
  readonly addressed: boolean;
  /** Receives the map that is drawn, and its objects. */
  readonly onMap?: (rows: number[][], objects: readonly MapObject[]) => void;
}

export function App({ data, addressed, onMap }: Props) {
  const [anyView, show] = useView(addressed);
  const [message, say] = useMessage();
  const tiles = useTiles(data, say);
  const [dark, onTheme] = useDark();
  const { editor: drawn, edit, draw, openFiles } = useDrawing({ kinds: data.objects.kinds, onMap, show, say });
  const [over, dropHandlers] = useDrop(openFiles);
  const [changed, setChanged] = useState<{ readonly run: Run; readonly weights: Weights } | null>(null);

  const view = useMemo(() => validView(anyView, data), [anyView, data]);
  const run = data.runs[view.run];
  const open = openElite(run, view);
  const start = open >= 0 ? editorOf(run.grid(open), objectsOf(run, open)) : editorOf(emptyGrid(run.height, run.width));
  const editor = drawn ?? start;
  const body = useKeptFocus(`${view.view} ${view.pins.length}`);

  const shared = useMemo<Shared>(
    () => ({ data, view, run, tiles, dark, show, draw, say }),
    [data, view, run, tiles, dark, show, draw, say],
  );
  return (
    <SharedContext.Provider value={shared}>
      <div class={`elx ${dark ? "dark" : "light"}${over ? " drop" : ""}`} {...dropHandlers}>
        <Header onTheme={onTheme} />
        <div class="body" role="tabpanel" aria-label={VIEW_NAMES[view.view]} tabIndex={-1} ref={body}>
          {view.view === "archive" && <Archive />}
          {view.view === "maps" && <Maps />}
          {view.view === "compare" && <Compare />}
          {view.view === "draw" && (
            <Draw
              editor={editor}
              onEdit={edit}
              weights={changed?.run === run ? changed.weights : run.weights}
              onWeights={(weights) => setChanged(weights && { run, weights })}
              onFiles={openFiles}
            />
          )}
          {view.view === "run" && <RunView />}
        </div>
        <p class={`message${message.text && message.shown ? " shown" : ""}`} role="status" aria-live="polite">
          {message.text}
        </p>
      </div>
    </SharedContext.Provider>
  );
}
