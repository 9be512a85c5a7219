/** Texts and numbers as Python reads and writes them. */

const SPACES = "\t\n\v\f\r \x85\xa0\u1680\u2028\u2029\u202f\u205f\u3000";
const SEPARATORS = "\x1c\x1d\x1e\x1f";

/** Returns whether `float` ignores a character beside a number. */
const isSpace = (letter: string): boolean => SPACES.includes(letter) || (letter >= "\u2000" && letter <= "\u200a");
/** Returns whether `str.strip` removes a character. JavaScript's `trim` removes other ones. */
const isStripped = (letter: string): boolean => isSpace(letter) || SEPARATORS.includes(letter);

/** Returns a text without the spaces at its ends. */
export function strip(text: string, isRemoved = isStripped): string {
  let start = 0;
  let end = text.length;
  while (start < end && isRemoved(text[start])) start++;
  while (start < end && isRemoved(text[end - 1])) end--;
  return text.slice(start, end);
}

export const isAscii = (text: string): boolean => !/[\u0080-\uffff]/.test(text);

const DECIMAL = /^\p{Nd}$/u;

/** Returns the value of a decimal digit of any script. Unicode has the digits of a script in order, from 0 to 9. */
function digitOf(letter: string): string {
  const code = letter.codePointAt(0)!;
  let first = code;
  while (DECIMAL.test(String.fromCodePoint(first - 1))) first--;
  return `${(code - first) % 10}`;
}

const NUMBER = /^[+-]?(?:\d+(?:\.\d*)?|\.\d+)(?:e[+-]?\d+)?$/i;

/** Reads a number as Python's `float` does. Returns NaN for a text that is no number, and for "nan" and "inf". */
export function floatOf(text: string): number {
  const plain = isAscii(text) ? text : text.replace(/\p{Nd}/gu, digitOf);
  const number = strip(plain, isSpace);
  return NUMBER.test(number) ? Number(number) : NaN;
}

/** Returns `value` minus the nearest multiple of `unit`, exactly, as C's `remainder` does. Halves go to even multiples. */
export function remainder(value: number, unit: number): number {
  const size = Math.abs(value);
  const rest = size % unit;
  const complement = unit - rest;
  let nearest = rest;
  if (rest > complement) nearest = -complement;
  else if (rest === complement) nearest = rest - 2 * ((0.5 * (size - rest)) % unit);
  return value < 0 ? -nearest : nearest;
}

/** Rounds to the nearest whole number. Halves go to even numbers. */
export function rint(value: number): number {
  const near = Math.round(value);
  return Math.abs(value % 1) === 0.5 && near % 2 ? near - 1 : near;
}

/** Returns a number rounded to some decimals, as Python's `round` does. Halves go to even digits. */
export function roundTo(value: number, decimals: number): number {
  const scaled = 10 ** decimals * value;
  // A number is exactly halfway only if it is an odd multiple of 1 / (2 · 10ᵈ), and then one of 1 / 2ᵈ⁺¹.
  const isHalfway = Number.isInteger(2 ** (decimals + 1) * value) && Math.abs(scaled % 1) === 0.5;
  return isHalfway ? rint(scaled) / 10 ** decimals : Number(value.toFixed(decimals));
}

/** Returns a number rounded to six decimals, as positions in files are. */
export const sixDecimals = (value: number): number => roundTo(value, 6);

/** Returns an angle in degrees, from one in radians, as Python's `degrees` does. */
export const degreesIn = (radians: number): number => radians * (180 / Math.PI);

const SPLIT = 2 ** 27 + 1;

/** Returns a square as the sum of two floats, exactly (Dekker, 1971). */
function squareOf(value: number): [high: number, low: number] {
  const scaled = SPLIT * value;
  const upper = scaled - (scaled - value);
  const lower = value - upper;
  const high = value * value;
  return [high, upper * upper - high + 2 * upper * lower + lower * lower];
}

/** Returns the length of a vector as Python's `dist` does: rounded once. `Math.hypot` rounds several times. */
export function lengthOf(x: number, y: number): number {
  const [[a, b], [c, d]] = [squareOf(x), squareOf(y)];
  const sum = a + c;
  const rest = (a > c ? a - sum + c : c - sum + a) + b + d;
  const root = Math.sqrt(sum);
  if (!root) return 0;
  const [high, low] = squareOf(root);
  return root + (sum - high - low + rest) / (2 * root);
}
