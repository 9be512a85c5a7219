/** The name of a cell for people, and with its index in files for messages. See `elitelanes_jax/_util/cells.py`. */

/** Returns the letters of a column: A to Z, then AA, AB and so on. */
export function columnName(column: number): string {
  const letter = String.fromCharCode(65 + (column % 26));
  return column < 26 ? letter : columnName(Math.floor(column / 26) - 1) + letter;
}

/** Returns the name of a cell, such as C2. Row 1 is the northern one. */
export const cellName = (row: number, column: number): string => `${columnName(column)}${row + 1}`;

/** Returns the name of a cell for a message, with its index in files: C2 ([1, 2]). */
export const describeCell = (row: number, column: number): string => `${cellName(row, column)} ([${row}, ${column}])`;
