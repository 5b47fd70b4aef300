// The rows of the last ten minutes: as they came for FINE_S, older ones in bins of COARSE_S.
//
// A row is [kind, session, t, ...]; see gateway/views/hmi/traces.py, which makes the same bins of what was before the page.

const FINE_S = 21, COARSE_S = 2, LONGEST_S = 600;
const BANDS = { s: [3, 6, 8], t: [3, 5], d: [3] }; // where the lows are; the highs stand after them
const LARGEST = { d: [5] }; // of these the largest counts; of the others the newest

export class History {
  constructor() {
    this.fine = { s: [], t: [], d: [] };
    this.coarse = { s: [], t: [], d: [] };
  }

  take(row) {
    const list = this.fine[row[0]], last = list.at(-1);
    if (last && (row[1] !== last[1] || row[2] < last[2])) list.length = this.coarse[row[0]].length = 0; // another clock
    list.push(row);
    let old = 0;
    while (list[old][2] < row[2] - FINE_S) old++;
    if (old > 50) for (const past of list.splice(0, old)) this.fold(past);
  }

  // A row from before this page, or one that has grown old.
  fold(row) {
    const bins = this.coarse[row[0]], last = bins.at(-1), slot = (of) => Math.floor(of[2] / COARSE_S);
    if (!last || slot(last) !== slot(row) || last[1] !== row[1]) bins.push([...row]);
    else {
      const before = [...last];
      last.splice(0, last.length, ...row);
      for (const low of BANDS[row[0]]) {
        last[low] = of(Math.min, before[low], row[low]);
        last[low + 1] = of(Math.max, before[low + 1], row[low + 1]);
      }
      for (const place of LARGEST[row[0]] ?? []) last[place] = of(Math.max, before[place], row[place]);
    }
    while (bins.length && bins[0][2] < row[2] - LONGEST_S) bins.shift();
  }

  // The rows of a kind from a time on.
  since(kind, t) {
    const fine = this.fine[kind];
    const rows = t < (fine[0]?.[2] ?? Infinity) ? [...this.coarse[kind], ...fine] : fine;
    return rows.filter((row) => row[2] >= t);
  }

  get newest() {
    return this.fine.s.at(-1)?.[2] ?? null;
  }
}

const of = (choose, a, b) => (a === null ? b : b === null ? a : choose(a, b));
