/** Small controls. */
import type { ComponentChildren, RefObject } from "preact";
import { nameOf } from "../words";

interface ChoiceProps<T extends string> {
  readonly label: string;
  readonly value: T;
  readonly options: readonly (readonly [value: T, name: string])[];
  readonly onChange: (value: T) => void;
}

/** A drop-down list. */
export function Choice<T extends string>({ label, value, options, onChange }: ChoiceProps<T>) {
  return (
    <label class="choice">
      <span>{label}</span>
      <select aria-label={label} value={value} onChange={(event) => onChange(event.currentTarget.value as T)}>
        {options.map(([option, name]) => (
          <option key={option} value={option}>
            {name}
          </option>
        ))}
      </select>
    </label>
  );
}

interface SegmentsProps<T extends string> extends ChoiceProps<T> {
  /** Whether the label is visible. */
  readonly titled?: boolean;
}

/** A row of buttons, of which one is pressed. */
export function Segments<T extends string>({ label, value, options, onChange, titled }: SegmentsProps<T>) {
  const buttons = (
    <div class="segments" role="group" aria-label={label}>
      {options.map(([option, name]) => (
        <button key={option} type="button" aria-pressed={option === value} onClick={() => onChange(option)}>
          {name}
        </button>
      ))}
    </div>
  );
  return titled ? (
    <div class="choice">
      <span aria-hidden="true">{label}</span>
      {buttons}
    </div>
  ) : (
    buttons
  );
}

interface SwitchProps {
  readonly on: boolean;
  readonly onChange: (on: boolean) => void;
  readonly colour?: string;
  readonly count?: number;
  readonly title?: string;
  readonly children: ComponentChildren;
}

/** A button that is on or off. */
export function Switch({ on, onChange, colour, count, title, children }: SwitchProps) {
  return (
    <button type="button" class="switch" aria-pressed={on} title={title} onClick={() => onChange(!on)}>
      {colour && <i style={{ background: colour }} />}
      {children}
      {count !== undefined && <b>{count}</b>}
    </button>
  );
}

interface WholeNumberProps {
  readonly label: string;
  readonly value: number;
  readonly least: number;
  readonly most: number;
  readonly onChange: (value: number) => void;
  readonly say: (message: string) => void;
}

/** A field for a whole number. It refuses any other entry in words, and shows its value again. */
export function WholeNumber({ label, value, least, most, onChange, say }: WholeNumberProps) {
  const enter = (input: HTMLInputElement) => {
    const entered = wholeNumber(input.value, least, most);
    if (entered !== null) return onChange(entered);
    say(`Expected a whole number from ${least} to ${most}, got ${input.value || "none"}`);
    input.value = `${value}`;
  };
  return (
    <label class="size">
      {label}{" "}
      <input type="number" min={least} max={most} value={value} onChange={(event) => enter(event.currentTarget)} />
    </label>
  );
}

/** Returns the number that a text is, or null unless it is a whole number from `least` to `most`. */
export function wholeNumber(text: string, least: number, most: number): number | null {
  const value = text.trim() ? Number(text) : NaN;
  return Number.isInteger(value) && value >= least && value <= most ? value : null;
}

const STEPS: Readonly<Record<string, readonly [right: number, down: number]>> = {
  ArrowLeft: [-1, 0],
  ArrowRight: [1, 0],
  ArrowUp: [0, -1],
  ArrowDown: [0, 1],
};

/** Returns the step of an arrow key, or null for any other key. */
export const stepOf = ({ key }: KeyboardEvent): readonly [right: number, down: number] | null => STEPS[key] ?? null;

export function toggled<T>(list: readonly T[], item: T, on: boolean): readonly T[] {
  return on ? [...list.filter((other) => other !== item), item] : list.filter((other) => other !== item);
}

/** Scrolls to an element whose top or whose greater part is not visible, as on narrow screens. */
export function reveal(part: RefObject<HTMLElement | null>): void {
  const { top, bottom, height } = part.current!.getBoundingClientRect();
  const seen = Math.min(bottom, innerHeight) - Math.max(top, 0);
  const isSeen = top > -40 && seen > 0.4 * Math.min(height, innerHeight);
  if (!isSeen) part.current!.scrollIntoView({ block: "start" });
}

export const quantityOptions = (names: readonly string[]) => names.map((name) => [name, nameOf(name)] as const);
