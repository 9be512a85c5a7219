/** The masks of a tile: sliders of colour, a brush, and what the road reaches. */
import { useEffect, useLayoutEffect, useRef, useState } from "preact/hooks";
import { SIDES } from "../network/codes";
import { Choice, Segments, stepOf, Switch } from "../parts/Controls";
import { moved, openSides, stroked, type Colour, type MaskName } from "./masks";
import { ask, coloured, kindOfCode, KINDS, kindWord, masksOf, type Tile } from "./work";

const MASK_WORDS = [
  ["road", "Road"],
  ["red", "Stop lines"],
  ["yellow", "Lane separators"],
] as const;
const INKS: Readonly<Record<MaskName, readonly [number, number, number]>> = {
  road: [70, 160, 255],
  red: [255, 0, 90],
  yellow: [255, 230, 0],
};
const PARTS = [
  ["Hue", 179],
  ["Saturation", 255],
  ["Value", 255],
] as const;

interface Props {
  readonly tile: Tile;
  /** Changes the latest tile, not the one that is drawn. Steps of one name in a row are undone together. */
  readonly onChange: (make: (tile: Tile) => Tile, step?: string) => void;
  readonly onColours: (mask: MaskName, colour: Colour) => void;
  readonly say: (text: string) => void;
}

/** Returns the picture of a tile, or null until it is loaded. */
function usePicture(id: string): HTMLImageElement | null {
  const [picture, setPicture] = useState<HTMLImageElement | null>(null);
  useEffect(() => {
    const image = new Image();
    image.onload = () => setPicture(image);
    image.src = `pictures/${id}`;
    return () => (image.onload = null);
  }, [id]);
  return picture;
}

/** Paints the picture of a tile, and its masks over it, the one that is corrected the strongest. */
function paint(canvas: HTMLCanvasElement, picture: HTMLImageElement, tile: Tile, strongest: MaskName | null): void {
  const { side } = tile;
  canvas.width = side;
  canvas.height = side;
  const context = canvas.getContext("2d", { willReadFrequently: true })!;
  context.drawImage(picture, 0, 0, side, side);
  if (!strongest) return;
  const pixels = context.getImageData(0, 0, side, side);
  const masks = masksOf(tile);
  for (const [mask] of MASK_WORDS) {
    const share = mask === strongest ? 0.65 : 0.2;
    const ink = INKS[mask];
    masks[mask].forEach((bit, pixel) => {
      if (!bit) return;
      for (let channel = 0; channel < 3; channel++) {
        const at = 4 * pixel + channel;
        pixels.data[at] += (ink[channel] - pixels.data[at]) * share;
      }
    });
  }
  context.putImageData(pixels, 0, 0);
}

export function MaskView({ tile, onChange, onColours, say }: Props) {
  const [mask, setMask] = useState<MaskName>("road");
  const [tool, setTool] = useState<"paint" | "erase">("paint");
  const [size, setSize] = useState(8);
  const [shows, setShows] = useState(true);
  const [pending, setPending] = useState<Colour | null>(null);
  const [cursor, setCursor] = useState<readonly [number, number] | null>(null);
  const canvas = useRef<HTMLCanvasElement>(null);
  const stroke = useRef<{ last: readonly [number, number]; name: string } | null>(null);
  const wanted = useRef(0);
  const picture = usePicture(tile.id);
  const { side } = tile;
  const colour = pending ?? tile.colours[mask];
  const radius = (size / 200) * side;

  useLayoutEffect(() => {
    if (picture) paint(canvas.current!, picture, tile, shows ? mask : null);
  }, [picture, tile, mask, shows]);

  /** Shows the slider at once, and the mask when the command has computed it. Only the last request counts. */
  const slide = async (next: Colour) => {
    const request = ++wanted.current;
    setPending(next);
    try {
      const colours = { ...tile.colours, [mask]: next };
      const bits = await ask<string>("mask", { id: tile.id, mask, colours });
      if (request !== wanted.current) return;
      onChange((now) => coloured(now, mask, next, bits), `colours ${tile.id} ${mask}`);
    } catch (error) {
      say((error as Error).message);
    }
    if (request === wanted.current) setPending(null);
  };
  const place = (event: PointerEvent): readonly [number, number] => {
    const box = canvas.current!.getBoundingClientRect();
    return [((event.clientX - box.left) / box.width) * side, ((event.clientY - box.top) / box.height) * side];
  };
  const draw = (from: readonly [number, number], to: readonly [number, number], name: string) => {
    const value = tool === "paint" ? 1 : -1;
    onChange(({ strokes, ...now }) => {
      const changed = stroked(strokes[mask], side, from, to, radius, value);
      return { ...now, strokes: { ...strokes, [mask]: changed } };
    }, name);
  };
  const down = (event: PointerEvent) => {
    if (event.button) return;
    canvas.current!.setPointerCapture(event.pointerId);
    stroke.current = { last: place(event), name: `stroke ${performance.now()}` };
    setCursor(null);
    draw(stroke.current.last, stroke.current.last, stroke.current.name);
  };
  const move = (event: PointerEvent) => {
    if (!stroke.current) return;
    const next = place(event);
    draw(stroke.current.last, next, stroke.current.name);
    stroke.current.last = next;
  };
  const up = () => (stroke.current = null);
  const keys = (event: KeyboardEvent) => {
    const at = cursor ?? [side / 2, side / 2];
    const step = stepOf(event);
    if (step) {
      const reach = Math.max(1, radius / 2);
      const next = [at[0] + step[0] * reach, at[1] + step[1] * reach].map((part) => Math.min(Math.max(part, 0), side));
      setCursor([next[0], next[1]]);
      if (event.shiftKey) draw(at, [next[0], next[1]], `keys ${tile.id}`);
    } else if (event.key === "Enter" || event.key === " ") {
      draw(at, at, "");
      setCursor(at);
    } else return;
    event.preventDefault();
  };
  const code = openSides(masksOf(tile).road, side);
  const reached = SIDES.filter(({ bit }) => code & bit).map(({ name }) => name);
  const fits = kindOfCode(code) === tile.kind;
  return (
    <div class="split">
      <section class="panel" aria-label="Masks">
        <div class="bar">
          <Segments label="Mask" value={mask} options={MASK_WORDS} onChange={setMask} />
          <Segments
            label="Brush"
            value={tool}
            options={[
              ["paint", "Paint"],
              ["erase", "Erase"],
            ]}
            onChange={setTool}
          />
          <label class="slider">
            <span>Brush</span>
            <input
              type="range"
              min="1"
              max="30"
              value={size}
              aria-label="Width of the brush in percent of a tile"
              onInput={(event) => setSize(Number(event.currentTarget.value))}
            />
          </label>
          <Switch on={shows} onChange={setShows}>
            Show masks
          </Switch>
        </div>
        <div class="easel">
          <canvas
            ref={canvas}
            class="masked"
            tabIndex={0}
            role="application"
            aria-roledescription="mask editor"
            aria-label={`Masks of ${tile.name}. Arrow keys move the brush, with Shift they draw, Enter draws a dot.`}
            onPointerDown={down}
            onPointerMove={move}
            onPointerUp={up}
            onPointerCancel={up}
            onKeyDown={keys}
            onBlur={() => setCursor(null)}
          />
          {cursor && (
            <i
              style={{
                left: `${(cursor[0] / side) * 100}%`,
                top: `${(cursor[1] / side) * 100}%`,
                width: `${size}%`,
              }}
            />
          )}
        </div>
        <p class="note">Draw on the picture to add to a mask or to take from it. Ctrl+Z undoes.</p>
      </section>
      <section class="panel side" aria-label="Colours and kind">
        <h2>{tile.name}</h2>
        <p class={fits ? "fits" : "warning"} aria-live="polite">
          The road reaches {reached.join(", ") || "no side"}
          {fits
            ? "."
            : `, which is ${code ? `a ${kindWord(kindOfCode(code))}` : "no tile"}, not a ${kindWord(tile.kind)}.`}
        </p>
        <div class="bar">
          <Choice
            label="Kind"
            value={tile.kind}
            options={Object.keys(KINDS).map((kind) => [kind, kindWord(kind)] as const)}
            onChange={(kind) => onChange((now) => ({ ...now, kind }))}
          />
          <Switch on={tile.leftOut} onChange={(leftOut) => onChange((now) => ({ ...now, leftOut }))}>
            Leave out
          </Switch>
        </div>
        <fieldset>
          <legend>Colours of {MASK_WORDS.find(([name]) => name === mask)![1].toLowerCase()}</legend>
          {PARTS.map(([word, most], part) =>
            (["from", "to"] as const).map((limit, end) => (
              <label class="slider" key={word + limit}>
                <span>
                  {word} {limit}
                </span>
                <input
                  type="range"
                  min="0"
                  max={most}
                  value={colour[part][end]}
                  aria-label={`${word} ${limit}`}
                  onInput={(event) => void slide(moved(colour, part, end as 0 | 1, Number(event.currentTarget.value)))}
                />
                <b>{colour[part][end]}</b>
              </label>
            )),
          )}
          {!tile.byColours[mask] && (
            <p class="note">
              This mask was not made from these colours. Moving a slider replaces it; Undo brings it back.
            </p>
          )}
        </fieldset>
        <div class="buttons">
          <button type="button" onClick={() => onColours(mask, colour)}>
            Use for all tiles
          </button>
          <button
            type="button"
            disabled={!tile.strokes[mask]}
            onClick={() => onChange((now) => ({ ...now, strokes: { ...now.strokes, [mask]: null } }))}
          >
            Remove brush strokes
          </button>
        </div>
      </section>
    </div>
  );
}
