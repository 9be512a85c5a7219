/**
 * Where YAML 1.1, which PyYAML reads, differs from YAML 1.2, which js-yaml reads.
 *
 * In YAML 1.1 the lines within brackets and quotes may begin at any column, cells may be aligned with tabs, and a comment
 * may follow a bracket or a comma without a space. People write maps so:
 *
 *     tiles: [
 *     [straight/N,\t4way],# a row
 *     ]
 *
 * Outside brackets and quotes YAML 1.1 refuses tabs before the first word of a line, also on lines without words.
 */
import { check } from "./errors";

const SPACES = / */y;
const BLANK = /[ \t]+/y;
const LINE = /[^\n]*(?:\n|$)/y;
const COMMENT = /#[^\n]*/y;
const QUOTED = /"[^"\\]*(?:\\[^][^"\\]*)*"|'[^']*(?:''[^']*)*'/y;
/** The head of a block of text, up to the end of its line. */
const TEXT_BLOCK = /[|>][-+\d]*[ \t]*(?:#[^\n]*)?\n/y;
/** A word: up to a space, and within brackets up to a bracket or a comma. */
const WORD = /[^ \t\n]+/y;
const WORD_IN_BRACKETS = /[^ \t\n[\]{},]+/y;

const INDENT = " ".repeat(128);

/** Returns whether a line of a text begins with a tab. */
export const hasIndentingTab = (source: string): boolean => /(?:^|\n|-) *\t/.test(source);

/**
 * Returns a text whose lines within brackets and quotes are indented, with spaces instead of tabs between its words, and
 * with a space before each comment. Throws a `FileError` for a tab that YAML 1.1 refuses.
 */
export const relaxed = (source: string): string => new Scanner(source).run();

/** Copies a text, mark by mark and word by word. Each method copies what is its own and returns whether there was any. */
class Scanner {
  private readonly parts: string[] = [];
  private at = 0;
  /** The number of open brackets. */
  private depth = 0;
  /** The number of spaces before the first word of the line. */
  private indent: number;
  /** Whether a value may begin. Quotes, brackets and blocks of text do not begin within the words of a plain text. */
  private mayBegin = true;
  /** Whether a comment may begin: after a space, or after a mark that ends a value. */
  private mayComment = true;
  /** Whether a plain text may continue. Its lines may begin with tabs. */
  private isPlain = false;

  constructor(private readonly source: string) {
    this.indent = this.spaces();
  }

  run(): string {
    while (this.at < this.source.length) {
      if (this.blank() || this.comment() || this.quoted() || this.textBlock()) continue;
      if (this.lineEnd() || this.bracket()) continue;
      this.word();
    }
    return this.parts.join("");
  }

  private match(pattern: RegExp): string | null {
    pattern.lastIndex = this.at;
    return pattern.exec(this.source)?.[0] ?? null;
  }

  private copy(part: string, written = part): void {
    this.parts.push(written);
    this.at += part.length;
  }

  private spaces(): number {
    return this.match(SPACES)!.length;
  }

  private blank(): boolean {
    const blank = this.match(BLANK);
    if (blank === null) return false;
    const before = this.source[this.at - 1] ?? "\n";
    const isIndent = before === "\n" || (before === "-" && this.mayBegin);
    const continues = this.isPlain && blank.indexOf("\t") > this.indent;
    const isRefused = isIndent && !this.depth && !continues && blank.includes("\t");
    check(!isRefused, "expected readable YAML, got a tab before the first word of a line");
    this.copy(blank, blank.replaceAll("\t", " "));
    this.mayComment = true;
    return true;
  }

  private comment(): boolean {
    const comment = this.mayComment ? this.match(COMMENT) : null;
    if (comment === null) return false;
    this.copy(comment, ` ${comment}`);
    return true;
  }

  private quoted(): boolean {
    const quoted = this.mayBegin ? this.match(QUOTED) : null;
    if (quoted === null) return false;
    this.copy(quoted, quoted.replaceAll("\n", `\n${INDENT}`));
    this.mayBegin = this.isPlain = false;
    this.mayComment = true;
    return true;
  }

  /** Copies a block of text: its head, and all lines that are indented more. */
  private textBlock(): boolean {
    const head = this.mayBegin && !this.depth ? this.match(TEXT_BLOCK) : null;
    if (head === null) return false;
    this.copy(head);
    for (let line = this.match(LINE)!; line; line = this.match(LINE)!) {
      const isBlank = !line.trim();
      if (!isBlank && line.search(/[^ ]/) <= this.indent) break;
      this.copy(line);
    }
    this.indent = this.spaces();
    this.mayBegin = this.mayComment = true;
    this.isPlain = false;
    return true;
  }

  private lineEnd(): boolean {
    if (this.source[this.at] !== "\n") return false;
    this.copy("\n", this.depth ? `\n${INDENT}` : "\n");
    if (!this.depth && !this.isPlain) this.indent = this.spaces();
    this.mayBegin = this.mayComment = true;
    return true;
  }

  private bracket(): boolean {
    const mark = this.source[this.at];
    const opens = "[{".includes(mark);
    const closes = "]}".includes(mark);
    const isMark = (opens && this.mayBegin) || (this.depth > 0 && (opens || closes || mark === ","));
    if (!isMark) return false;
    this.copy(mark);
    this.depth += +opens - +closes;
    this.mayBegin = !closes;
    this.mayComment = true;
    this.isPlain = false;
    return true;
  }

  private word(): void {
    const word = this.match(this.depth ? WORD_IN_BRACKETS : WORD)!;
    this.copy(word);
    // Indicators, anchors and tags stand before a value.
    this.mayBegin = word.endsWith(":") || (this.mayBegin && /^[?-]$|^[&!]/.test(word));
    this.mayComment = false;
    this.isPlain = !this.mayBegin;
  }
}
