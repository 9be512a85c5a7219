/** Small maps in rows: Tab leads to the open one, arrow keys to the others. */
import { useShared } from "../context";
import { objectsOf } from "../record";
import { MapPicture } from "./MapPicture";

interface Props {
  readonly elites: readonly number[];
  readonly open: number;
  readonly onOpen: (elite: number) => void;
  readonly caption: (elite: number) => string;
}

export function Gallery({ elites, open, onOpen, caption }: Props) {
  const { run } = useShared();
  const entry = elites.includes(open) ? open : elites[0];
  const keys = (event: KeyboardEvent) => {
    const list = event.currentTarget as HTMLElement;
    const buttons = [...list.querySelectorAll("button")];
    const now = buttons.indexOf(document.activeElement as HTMLButtonElement);
    const columns = buttons.filter((button) => button.offsetTop === buttons[0].offsetTop).length;
    const by = {
      ArrowLeft: -1,
      ArrowRight: 1,
      ArrowUp: -columns,
      ArrowDown: columns,
      Home: -now,
      End: buttons.length - 1 - now,
    }[event.key];
    if (by === undefined) return;
    event.preventDefault();
    buttons[now + by]?.focus();
  };
  return (
    <ul class="gallery" onKeyDown={keys}>
      {elites.map((elite) => (
        <li key={elite}>
          <button
            type="button"
            aria-pressed={elite === open}
            tabIndex={elite === entry ? 0 : -1}
            onClick={() => onOpen(elite)}
          >
            <MapPicture grid={run.grid(elite)} label={run.label(elite)} objects={objectsOf(run, elite)} />
            <span>{caption(elite)}</span>
          </button>
        </li>
      ))}
    </ul>
  );
}
