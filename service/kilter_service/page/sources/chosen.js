// Rows of one campaign that are chosen: a byte for each row, so that choosing 100 000 of them is one pass over bytes.
export class Chosen {
  constructor() {
    this.bytes = new Uint8Array(1024);
    this.size = 0;
  }

  has(row) {
    return this.bytes[row] === 1;
  }

  put(row, on) {
    if (row >= this.bytes.length) {
      const more = new Uint8Array(Math.max(row + 1, 2 * this.bytes.length));
      more.set(this.bytes);
      this.bytes = more;
    }
    this.size += Number(on) - this.bytes[row];
    this.bytes[row] = Number(on);
  }

  /** The first rows from `first` to `last`, at most `most` of them. */
  within(first, last, most) {
    const found = [];
    for (let row = this.bytes.indexOf(1, first); row >= 0 && row <= last && found.length < most; row = this.bytes.indexOf(1, row + 1)) found.push(row);
    return found;
  }

  /** As an address writes them: 3,7-9. */
  written() {
    const runs = [];
    for (let from = this.bytes.indexOf(1); from >= 0; ) {
      const end = this.bytes.indexOf(0, from);
      const after = end < 0 ? this.bytes.length : end;
      runs.push(after - from > 1 ? `${from}-${after - 1}` : from);
      from = end < 0 ? -1 : this.bytes.indexOf(1, after);
    }
    return runs.join(",");
  }

  static read(text) {
    const made = new Chosen();
    for (const part of text.split(",")) {
      const [from, to = from] = part.split("-").map(Number);
      for (let row = from; row <= to; row += 1) made.put(row, true);
    }
    return made;
  }
}
