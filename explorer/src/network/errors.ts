/** Errors whose message is for the user: of a file that cannot be read, or of a map that has no such file. */
export class FileError extends Error {}

export function check(holds: boolean, message: string): void {
  if (!holds) throw new FileError(message);
}
