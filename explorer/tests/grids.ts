import { gridOf, type Grid } from "../src/network/codes";

/** Returns the grid of a case: hexadecimal digits, the rows apart by slashes. */
export const gridOfText = (text: string): Grid =>
  gridOf(text.split("/").map((row) => Array.from(row, (digit) => parseInt(digit, 16))));
