/** Earlier and later states for undo and redo. States share what did not change. */

export interface History<T> {
  readonly past: readonly T[];
  readonly present: T;
  readonly future: readonly T[];
  /** Names the last step, so that the next of the same name belongs to it, as while a slider moves. */
  readonly step: string;
}

const MOST_STEPS = 60;

export const begun = <T>(present: T): History<T> => ({ past: [], present, future: [], step: "" });

/** Returns the history with a new state. A step of the same name that is not empty replaces the last one. */
export function advanced<T>({ past, present, step }: History<T>, next: T, name = ""): History<T> {
  const earlier = name && name === step ? past : [...past, present].slice(-MOST_STEPS);
  return { past: earlier, present: next, future: [], step: name };
}

export function undone<T>(history: History<T>): History<T> {
  const { past, present, future } = history;
  if (!past.length) return history;
  return { past: past.slice(0, -1), present: past[past.length - 1], future: [present, ...future], step: "" };
}

export function redone<T>(history: History<T>): History<T> {
  const { past, present, future } = history;
  if (!future.length) return history;
  return { past: [...past, present], present: future[0], future: future.slice(1), step: "" };
}
