/** The page of `elitelanes tiles edit`. */
import { render } from "preact";
import { useCallback, useEffect, useRef, useState } from "preact/hooks";
import { save as saveFile } from "../files";
import { useDark } from "../hooks/useDark";
import { useMessage } from "../hooks/useMessage";
import { Segments } from "../parts/Controls";
import { advanced, begun, redone, undone } from "./history";
import type { Colour, MaskName } from "./masks";
import { MaskView } from "./MaskView";
import { PhotographView } from "./PhotographView";
import {
  allColoured,
  ask,
  askFile,
  joined,
  tileOf,
  toSave,
  type Photograph,
  type Proposal,
  type Saved,
  type Served,
  type Tile,
  type Work,
} from "./work";

function Page({ served }: { readonly served: Served }) {
  const [history, setHistory] = useState(() =>
    begun<Work>({
      tiles: served.tiles.map((tile) => tileOf(tile, served.colours, null)),
      photographs: served.photographs,
    }),
  );
  const work = history.present;
  const [view, setView] = useState<"photographs" | "masks">(served.photographs.length ? "photographs" : "masks");
  const [photograph, setPhotograph] = useState(0);
  const [shown, setShown] = useState(served.tiles[0]?.id ?? "");
  const [saved, setSaved] = useState<Work>(work);
  const [problems, setProblems] = useState(served.tiles.length ? served.problems : null);
  const [busy, setBusy] = useState(false);
  const [ended, setEnded] = useState(false);
  const [message, say] = useMessage();
  const [dark, onTheme] = useDark();
  const isUnsaved = work !== saved;
  /** The unsaved work that Finish has warned about. */
  const warned = useRef<Work | null>(null);

  /** Changes what is there when the change comes, because answers of the command come later. */
  const change = useCallback(
    (make: (work: Work) => Work, step?: string) => setHistory((now) => advanced(now, make(now.present), step)),
    [],
  );
  const changeTile = (id: string, make: (tile: Tile) => Tile, step?: string) =>
    change((now) => ({ ...now, tiles: now.tiles.map((tile) => (tile.id === id ? make(tile) : tile)) }), step);
  const changePhotograph = (number: number, make: (photograph: Photograph) => Photograph) =>
    change((now) => ({
      ...now,
      photographs: now.photographs.map((other, index) => (index === number ? make(other) : other)),
    }));
  useEffect(() => {
    const keys = (event: KeyboardEvent) => {
      const key = event.key.toLowerCase();
      if (!(event.ctrlKey || event.metaKey) || !["z", "y"].includes(key)) return;
      event.preventDefault();
      setHistory(key === "y" || event.shiftKey ? redone : undone);
    };
    const leave = (event: BeforeUnloadEvent) => isUnsaved && !ended && event.preventDefault();
    addEventListener("keydown", keys);
    addEventListener("beforeunload", leave);
    return () => {
      removeEventListener("keydown", keys);
      removeEventListener("beforeunload", leave);
    };
  }, [isUnsaved, ended]);

  /** Runs a request, and says why it failed. */
  const during = async (action: () => Promise<void>) => {
    setBusy(true);
    try {
      await action();
    } catch (error) {
      say((error as Error).message);
    }
    setBusy(false);
  };
  const cut = (proposal: Proposal) =>
    during(async () => {
      const tiles = await ask<Served["tiles"]>("cut", { photo: photograph, proposal });
      change((now) => {
        const others = now.tiles.filter((tile) => tile.photograph !== photograph);
        const known = new Set(others.map(({ id }) => id));
        const fresh = tiles.filter(({ id }) => !known.has(id));
        const cuts = fresh.map((tile) => tileOf(tile, served.colours, photograph));
        return { ...now, tiles: joined(others, cuts) };
      });
      setShown(tiles[0].id);
      setView("masks");
    });
  const colourAll = (mask: MaskName, colour: Colour) =>
    during(async () => {
      const bits = new Map<string, string>();
      for (const { id, colours } of work.tiles) {
        bits.set(id, await ask<string>("mask", { id, mask, colours: { ...colours, [mask]: colour } }));
      }
      change((now) => ({ ...now, tiles: allColoured(now.tiles, mask, colour, bits) }));
      const others = work.tiles.filter(({ byColours }) => !byColours[mask]).length;
      if (others) say(`Masks that were not made from colours were replaced in ${others} tiles. Undo brings them back`);
    });
  const save = () =>
    during(async () => {
      const answer = await ask<Saved>("save", toSave(work.tiles));
      setSaved(work);
      setProblems(answer.problems);
      const earlier = answer.kept ? `. The earlier set is ${answer.kept}` : "";
      say(`Saved ${answer.names.length} tiles in ${served.folder}${earlier}`);
    });
  const saveZip = () =>
    during(async () => {
      const name = `${served.folder.split(/[\\/]/).pop()!}.zip`;
      saveFile(name, await askFile("zip", toSave(work.tiles)));
      say(`The set is in ${name}. ${served.folder} is as it was`);
    });
  const finish = () => {
    if (isUnsaved && warned.current !== work) {
      warned.current = work;
      return say("There are changes that are not saved. Save them, or press Finish again");
    }
    void during(async () => {
      await ask("finish", null);
      setEnded(true);
    });
  };
  const tile = work.tiles.find(({ id }) => id === shown) ?? work.tiles[0];
  const theme = dark ? "dark" : "light";
  if (ended) {
    return (
      <div class={`elx hands ${theme}`}>
        <div class="panel empty">
          <h2>Finished</h2>
          <p class="lead">The command has ended. You can close this page.</p>
        </div>
      </div>
    );
  }
  return (
    <div class={`elx hands ${theme}`}>
      <header class="top">
        <h1>Tiles by hand</h1>
        <span class="name">{served.folder}</span>
        {work.photographs.length > 0 && (
          <Segments
            label="View"
            value={view}
            options={[
              ["photographs", "Photographs"],
              ["masks", `Masks (${work.tiles.length})`],
            ]}
            onChange={setView}
          />
        )}
        <div class="buttons">
          <button type="button" disabled={!history.past.length} onClick={() => setHistory(undone)}>
            Undo
          </button>
          <button type="button" disabled={!history.future.length} onClick={() => setHistory(redone)}>
            Redo
          </button>
          <button type="button" class="main" disabled={busy || !work.tiles.length} onClick={() => void save()}>
            {isUnsaved ? "Save" : "Saved"}
          </button>
          <button
            type="button"
            disabled={busy || !work.tiles.length}
            title="the browser saves the set in one file"
            onClick={() => void saveZip()}
          >
            Zip
          </button>
          <button type="button" onClick={finish}>
            Finish
          </button>
        </div>
        <button type="button" class="theme" aria-label={dark ? "Light colours" : "Dark colours"} onClick={onTheme}>
          {dark ? "☀" : "☾"}
        </button>
      </header>
      <div class="body">
        {view === "photographs" && work.photographs.length > 1 && (
          <ul class="strip" aria-label="Photographs">
            {work.photographs.map(({ name }, index) => (
              <li key={index}>
                <button type="button" aria-pressed={index === photograph} onClick={() => setPhotograph(index)}>
                  <img src={`photographs/${index}`} alt="" />
                  {name}
                </button>
              </li>
            ))}
          </ul>
        )}
        {view === "masks" && (
          <ul class="strip" aria-label="Tiles">
            {work.tiles.map(({ id, name, kind, leftOut }) => (
              <li key={id} class={leftOut ? "out" : ""}>
                <button type="button" aria-pressed={id === tile.id} onClick={() => setShown(id)}>
                  <img src={`pictures/${id}`} alt="" />
                  {name.startsWith(`${kind}_`) ? name : `${name}: ${kind}`}
                </button>
              </li>
            ))}
          </ul>
        )}
        {view === "photographs" && (
          <PhotographView
            key={photograph}
            photograph={work.photographs[photograph]}
            index={photograph}
            onChange={(make) => changePhotograph(photograph, make)}
            onCut={(proposal) => void cut(proposal)}
            say={say}
          />
        )}
        {view === "masks" && tile && (
          <MaskView
            key={tile.id}
            tile={tile}
            onChange={(make, step) => changeTile(tile.id, make, step)}
            onColours={(mask, colour) => void colourAll(mask, colour)}
            say={say}
          />
        )}
        {view === "masks" && !tile && <p class="lead">There are no tiles yet. Cut them out of a photograph.</p>}
        {problems && (
          <section class="panel problems" aria-label="Check">
            <h2>Check of the saved set</h2>
            {problems.length > 0 ? (
              <ul>
                {problems.map((problem) => (
                  <li key={problem}>{problem}</li>
                ))}
              </ul>
            ) : (
              <p class="note">No problems.</p>
            )}
          </section>
        )}
        <p class={`message${message.text && message.shown ? " shown" : ""}`} role="status" aria-live="polite">
          {message.text}
        </p>
      </div>
    </div>
  );
}

const page = document.getElementById("elitelanes-hands")!;
ask<Served>("state").then(
  (served) => render(<Page served={served} />, page),
  (error: unknown) => (page.textContent = (error as Error).message),
);
