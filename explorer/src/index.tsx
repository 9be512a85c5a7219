/** The module of the widget and of the page. The page has a small substitute for the widget's model. */
import { render as mount } from "preact";
import { App } from "./App";
import { unpack, type Values } from "./data";
import { fitness, measure } from "./network/measure";
import { fromDuckietown, readMap, toDuckietown, toFix, toMapJson } from "./network/formats";
import { feature } from "./network/features";
import { repair } from "./network/repair";
import { placeSigns, signFaults } from "./network/signs";
import { measureTown } from "./network/town";

/** The part of anywidget's model that is used here. */
interface Model {
  get(name: string): unknown;
  set(name: string, value: unknown): void;
  save_changes(): void;
  on(event: string, callback: () => void): void;
  off(event: string, callback: () => void): void;
}

function bytesOf(value: unknown): Uint8Array<ArrayBuffer> {
  if (value instanceof DataView) return new Uint8Array(value.buffer as ArrayBuffer, value.byteOffset, value.byteLength);
  return value as Uint8Array<ArrayBuffer>;
}

function render({ model, el }: { readonly model: Model; readonly el: HTMLElement }): () => void {
  let version = 0;
  const show = async () => {
    const current = ++version;
    try {
      const data = await unpack(model.get("values") as Values, bytesOf(model.get("blob")));
      if (current !== version) return;
      mount(
        <App
          key={current}
          data={data}
          addressed={model.get("addressed") === true}
          onMap={(rows, objects) => {
            model.set("grid", rows);
            model.set("objects", objects);
            model.save_changes();
          }}
        />,
        el,
      );
      requestAnimationFrame(() => performance.mark("elitelanes-shown"));
    } catch (error) {
      el.textContent = `The explorer cannot show this: ${error instanceof Error ? error.message : String(error)}`;
      throw error;
    }
  };
  const draw = () => void show();
  model.on("change:blob", draw);
  draw();
  return () => {
    model.off("change:blob", draw);
    mount(null, el);
  };
}

/** Returns the page's substitute for a notebook's model. */
function pageModel(): Model {
  const text = (id: string) => document.getElementById(id)!.textContent;
  const letters = atob(text("elitelanes-blob"));
  const packed = new Uint8Array(letters.length);
  for (let index = 0; index < letters.length; index++) packed[index] = letters.charCodeAt(index);
  const values = new Map<string, unknown>([
    ["values", JSON.parse(text("elitelanes-values"))],
    ["blob", packed],
    ["addressed", true],
  ]);
  return {
    get: (name) => values.get(name),
    set: (name, value) => void values.set(name, value),
    save_changes: () => undefined,
    on: () => undefined,
    off: () => undefined,
  };
}

const page = typeof document === "undefined" ? null : document.getElementById("elitelanes-explorer");
if (page) render({ model: pageModel(), el: page });

/** The functions that tests compare with Python. */
export const kernel = {
  feature,
  fitness,
  fromDuckietown,
  measure,
  measureTown,
  placeSigns,
  readMap,
  repair,
  signFaults,
  toDuckietown,
  toFix,
  toMapJson,
};

export default { render };
