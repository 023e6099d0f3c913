"use strict";
// The page of a study: tables of which only the rows in sight exist, and the dots of the scatter.
(() => {
  const ROW = 30; // height of a row in pixels, as in the style sheet
  const AROUND = 10; // rows beyond each end of what is in sight
  const NEAR = 14; // how far from a dot the pointer may be, in units of the figure
  const WORDS = { "": "", yes: "use", "with care": "with care", no: "exclude" }; // what people choose
  const FIELDS = ["recording", "use", "note", "who", "when", "result"]; // columns of decisions.csv
  const FORMULA = /^(?:[=@\uff1d\uff20\uff0b\uff0d\t\r\n]|[+-](?![0-9.eE+-]*$)|0[0-9]+$|[0-9]{16,}$|[0-9]+[eE][0-9]+$)/; // as in core/errors.py
  const KEPT = `accelcal decisions ${location.pathname}`;
  const data = JSON.parse(document.getElementById("data").textContent);
  const $ = (id) => document.getElementById(id);
  const grouped = new Intl.NumberFormat("en").format;

  function element(name, settings = {}, ...children) {
    const made = document.createElement(name);
    for (const [key, value] of Object.entries(settings)) made.setAttribute(key, value);
    made.append(...children);
    return made;
  }

  const texts = {
    text: (column, row) => column.values[row],
    choice: (column, row) => column.names[column.values[row]],
    mg: (column, row) => {
      const value = column.values[row];
      return value === null ? "" : value.toFixed(value >= 10 ? 1 : value >= 1 ? 2 : 3);
    },
    number: (column, row) => column.values[row] === null ? "" : String(column.values[row]),
    minutes: (column, row) => column.values[row] === null ? ""
      : new Date(column.values[row] * 60000).toISOString().replace("T", " ").slice(0, -8),
    message: (column, row) => {
      const value = column.values[row];
      return value === 0 ? "" : column.names[value[0]].map((part, at) => at ? value[at] + part : part).join("");
    },
  };
  texts.decision = (column, row) => WORDS[decisions.row(row)?.[1] ?? ""];
  texts.note = (column, row) => decisions.row(row)?.[2] ?? "";
  const numeric = (column) => column.kind === "number" || column.kind === "mg";
  const shown = (column, row) => texts[column.kind](column, row);

  // What a column is sorted by: a number for each row, NaN for what is not known.
  function ranks(column) {
    if (!column.ranks) {
      const count = column.values.length;
      column.ranks = new Float64Array(count);
      if (!numeric(column) && column.kind !== "choice" && column.kind !== "minutes") {
        const words = Array.from({ length: count }, (_, row) => shown(column, row));
        const order = [...new Set(words)].sort();
        const place = new Map(order.map((word, at) => [word, at]));
        words.forEach((word, row) => { column.ranks[row] = word === "" ? NaN : place.get(word); });
      } else {
        column.values.forEach((value, row) => { column.ranks[row] = value === null ? NaN : value; });
      }
    }
    return column.ranks;
  }

  class Grid {
    constructor(name, table) {
      this.box = $(`${name}-grid`);
      this.table = table;
      this.columns = table.columns;
      this.count = table.columns[0].values.length;
      this.order = Uint32Array.from({ length: this.count }, (_, row) => row);
      this.rows = this.order;
      this.wanted = null;
      this.drawn = new Map();
      this.status = $(`${name}-count`);
      this.build();
    }

    build() {
      this.above = element("td", { colspan: this.columns.length });
      this.below = element("td", { colspan: this.columns.length });
      this.last = element("tr", { class: "space", "aria-hidden": "true" }, this.below);
      this.body = element("tbody", {}, element("tr", { class: "space", "aria-hidden": "true" }, this.above), this.last);
      this.heads = this.columns.map((column) => this.head(column));
      const head = element("thead", {}, element("tr", { "aria-rowindex": 1 }, ...this.heads));
      this.grid = element("table", { "aria-labelledby": this.box.getAttribute("aria-labelledby") }, this.widths(), head, this.body);
      this.box.append(this.grid);
      this.box.classList.toggle("short", this.count < 12);
      this.box.hidden = false;
      this.box.addEventListener("scroll", () => this.draw());
      this.box.addEventListener("keydown", (event) => this.step(event));
      this.update();
    }

    widths() {
      const cols = this.columns.map((column) => {
        const col = element("col");
        col.style.width = `${column.width}rem`;
        return col;
      });
      return element("colgroup", {}, ...cols);
    }

    head(column) {
      const button = element("button", { type: "button" }, column.label);
      const head = element("th", { scope: "col" }, button);
      if (numeric(column)) head.className = "number";
      button.addEventListener("click", () => this.sort(column, head));
      return head;
    }

    sort(column, head) {
      const down = head.getAttribute("aria-sort") === "ascending";
      this.heads.forEach((one) => one.removeAttribute("aria-sort"));
      head.setAttribute("aria-sort", down ? "descending" : "ascending");
      const by = ranks(column), way = down ? -1 : 1;
      this.order.sort((one, other) => {
        const first = by[one], second = by[other];
        if (first === second || (first !== first && second !== second)) return one - other;
        if (first !== first) return 1;
        if (second !== second) return -1;
        return way * (first - second);
      });
      this.update();
    }

    filter(wanted) {
      this.wanted = wanted;
      this.update();
    }

    update() {
      this.rows = this.wanted ? this.order.filter(this.wanted) : this.order;
      this.grid.setAttribute("aria-rowcount", this.rows.length + 1);
      for (const row of this.drawn.values()) row.remove();
      this.drawn.clear();
      this.box.scrollTop = 0;
      this.draw();
      const all = `${grouped(this.count)} ${this.table.what}${this.count === 1 ? "" : "s"}`;
      const sorted = this.heads.find((head) => head.hasAttribute("aria-sort"));
      const by = sorted ? `, sorted by ${sorted.textContent}, ${sorted.getAttribute("aria-sort")}` : "";
      this.status.textContent = (this.rows.length === this.count ? all : `${grouped(this.rows.length)} of ${all}`) + by;
    }

    // Rows in sight and some around them; those that stay keep their elements, and so the focus.
    draw() {
      const first = Math.max(0, Math.floor(this.box.scrollTop / ROW) - AROUND);
      const height = this.box.clientHeight || 500;
      const end = Math.min(this.rows.length, first + Math.ceil(height / ROW) + 2 * AROUND);
      for (const [at, row] of this.drawn) {
        if (at < first || at >= end) { row.remove(); this.drawn.delete(at); }
      }
      let next = this.last;
      for (let at = end - 1; at >= first; at -= 1) {
        if (!this.drawn.has(at)) {
          const row = this.line(this.rows[at], at);
          this.drawn.set(at, row);
          this.body.insertBefore(row, next);
        }
        next = this.drawn.get(at);
      }
      this.above.style.height = `${first * ROW}px`;
      this.below.style.height = `${(this.rows.length - end) * ROW}px`;
    }

    line(row, at) {
      const cells = this.columns.map((column, index) => {
        const text = shown(column, row);
        const cell = element("td", numeric(column) ? { class: "number" } : {});
        if (column.kind === "decision" || column.kind === "note") {
          cell.append(decisions.field(column.kind, row));
          return cell;
        }
        const link = index === 0 ? address(this.table, row) : null;
        if (link) cell.append(element("a", { href: link }, element("bdi", {}, text)));
        else if (column.kind === "text" || column.key === "device") cell.append(element("bdi", {}, text));
        else cell.textContent = text;
        if (column.key === "outcome") cell.className = text.replace(" ", "_");
        if (text.length > 20) cell.title = text;
        return cell;
      });
      return element("tr", { "aria-rowindex": at + 2 }, ...cells);
    }

    // Arrow keys go from the link of one row to the next, the other keys scroll.
    step(event) {
      const row = event.target.closest("tbody tr");
      const steps = { ArrowDown: 1, ArrowUp: -1, PageDown: 15, PageUp: -15, Home: -Infinity, End: Infinity };
      if (!row || event.target.matches("select, input") || !(event.key in steps) || event.altKey || event.metaKey) return;
      event.preventDefault();
      const at = Number(row.getAttribute("aria-rowindex")) - 2;
      this.go(Math.min(this.rows.length - 1, Math.max(0, at + steps[event.key])));
    }

    go(at) {
      const head = this.heads[0].offsetHeight, sight = this.box.clientHeight - head - ROW;
      const top = at * ROW;
      if (top < this.box.scrollTop) this.box.scrollTop = top;
      else if (top > this.box.scrollTop + sight) this.box.scrollTop = top - sight;
      this.draw();
      const link = this.drawn.get(at).querySelector("a");
      if (link) link.focus({ preventScroll: true });
    }
  }

  // The page of a recording: 1 for one that is named as the recording is, 0 for none.
  function address(table, row) {
    const page = table.pages[row];
    if (!page) return null;
    if (page !== 1) return page;
    const name = `${table.columns[0].values[row].replace(/\.[^./]+$/, "")}.html`;
    return `./${name.split("/").map(encodeURIComponent).join("/")}`;
  }

  function column(table, key) {
    return table.columns.find((one) => one.key === key);
  }

  // What people decide, by the path of the recording: the rows of decisions.csv, and those chosen here since.
  class Decisions {
    constructor(rows, table, more) {
      this.more = more;
      this.paths = table.columns[0].values;
      this.results = table.results;
      this.file = new Map();
      for (const row of rows) this.file.set(row[0], [...(this.file.get(row[0]) ?? []), row]);
      this.chosen = new Map();
      this.unsaved = false;
      this.kept = true;
      const own = (key, width) => ({ key, label: key, kind: key, width, values: this.paths });
      this.columns = [own("decision", 7.5), own("note", 14)];
      table.columns.splice(3, 0, ...this.columns);
      this.restore();
      $("save-decisions").addEventListener("click", () => this.save());
      $("who").addEventListener("input", () => this.keep());
      addEventListener("beforeunload", (event) => { if (this.unsaved && !this.kept) event.preventDefault(); });
      $("decide").hidden = false;
      this.say("");
    }

    // A decision as it stands: of rows that contradict each other the most cautious one.
    of(path) {
      if (this.chosen.has(path)) return this.chosen.get(path);
      const rows = this.file.get(path) ?? [];
      return ["no", "with care", "yes"].map((use) => rows.findLast((row) => row[1] === use)).find((row) => row) ?? null;
    }

    row(row) {
      return this.of(this.paths[row]);
    }

    field(kind, row) {
      const path = this.paths[row], now = this.of(path);
      const field = kind === "note" ? element("input", { maxlength: 500 }) : element("select");
      field.setAttribute("aria-label", `${kind} on ${path}`);
      if (kind === "note") field.disabled = !now;
      else for (const [value, text] of Object.entries(WORDS)) field.append(element("option", { value }, text));
      field.value = (kind === "note" ? now?.[2] : now?.[1]) ?? "";
      if (now) field.title = now.slice(2, 5).filter((text) => text).join(", ");
      field.addEventListener("change", () => this.choose(row, kind, field));
      return field;
    }

    choose(row, kind, field) {
      const path = this.paths[row], now = this.of(path);
      const use = kind === "note" ? now[1] : field.value, note = kind === "note" ? field.value.trim() : now?.[2] ?? "";
      this.chosen.set(path, use ? [path, use, note, $("who").value.trim(), moment(), this.results[row]] : null);
      const beside = field.closest("tr").querySelector("td input");
      beside.disabled = !use;
      beside.value = use ? note : "";
      for (const column of this.columns) delete column.ranks;
      this.unsaved = true;
      this.keep();
      this.say("not saved yet");
    }

    rows() {
      const others = [...this.file].filter(([path]) => !this.chosen.has(path)).flatMap(([, rows]) => rows);
      const chosen = [...this.chosen.values()].filter((row) => row);
      return [...others, ...chosen.map((row) => row.with(3, row[3] || $("who").value.trim()))];
    }

    save() {
      if (this.more) return this.say(`not saved: decisions.csv has ${grouped(this.more)} more, change it in a spreadsheet`);
      const lines = [FIELDS, ...this.rows()].map((row) => row.map(cell).join(",")).join("\r\n");
      const link = element("a", { download: "decisions.csv" });
      link.href = URL.createObjectURL(new Blob([`\ufeff${lines}\r\n`], { type: "text/csv" }));
      link.click();
      setTimeout(() => URL.revokeObjectURL(link.href), 60000);
      this.unsaved = false;
      this.say("saved as a download: move it into the folder of the results (over an older decisions.csv), and run the study again");
    }

    say(what) {
      const count = this.rows().length;
      $("decided-count").textContent = count || what
        ? [`${grouped(count)} decision${count === 1 ? "" : "s"}`, what].filter((text) => text).join(", ")
        : "To decide on a recording, use the columns decision and note of the table.";
    }

    // Marks outlive a reload where the browser allows it; those that decisions.csv has overtaken are dropped.
    keep() {
      const chosen = [...this.chosen].map(([path, row]) => [path, row, JSON.stringify(this.file.get(path) ?? null)]);
      try {
        localStorage.setItem(KEPT, JSON.stringify({ who: $("who").value, chosen }));
      } catch {
        this.kept = false;
      }
    }

    restore() {
      try {
        const { who, chosen } = JSON.parse(localStorage.getItem(KEPT)) ?? { who: "", chosen: [] };
        $("who").value = String(who);
        const fits = (row) => row === null || (row.length === FIELDS.length && row.every((text) => typeof text === "string"));
        for (const [path, row, before] of chosen) {
          if (fits(row) && before === JSON.stringify(this.file.get(path) ?? null)) this.chosen.set(path, row);
        }
        this.unsaved = this.chosen.size > 0;
      } catch {
        this.kept = false;
      }
    }
  }

  function moment() {
    const now = new Date(), ahead = -now.getTimezoneOffset(), two = (number) => String(Math.floor(number)).padStart(2, "0");
    const local = new Date(now.getTime() + ahead * 60000).toISOString().slice(0, 19), size = Math.abs(ahead);
    return `${local}${ahead < 0 ? "-" : "+"}${two(size / 60)}:${two(size % 60)}`;
  }

  // A cell that no spreadsheet calculates.
  function cell(text) {
    const plain = FORMULA.test(text) ? `'${text}` : text;
    return /[",;\t\r\n]/.test(plain) ? `"${plain.replaceAll('"', '""')}"` : plain;
  }

  const decisions = new Decisions(data.decisions, data.recordings, data.decisions_not_listed);
  const recordings = new Grid("recordings", data.recordings);
  if ($("devices-grid")) new Grid("devices", data.devices);

  const wanted = { text: $("wanted-text"), outcome: $("wanted-outcome"), problem: $("wanted-problem") };
  const outcome = column(data.recordings, "outcome"), problem = column(data.recordings, "problem");

  function choices(select, first, names) {
    for (const [value, text] of [["", first], ...names]) select.append(element("option", { value }, text));
  }

  // All that is searched in of each recording, in small letters; made when it is first needed.
  let searched = null;
  function haystack() {
    const keys = ["path", "device", "message"].map((key) => column(data.recordings, key));
    searched ??= Array.from({ length: recordings.count }, (_, row) => keys.map((one) => shown(one, row)).join("\n").toLowerCase());
    return searched;
  }

  function choose() {
    const text = wanted.text.value.trim().toLowerCase();
    const of = outcome.names.indexOf(wanted.outcome.value);
    const any = wanted.problem.value === "any", with_ = problem.names.indexOf(wanted.problem.value), none = problem.names.indexOf("");
    const words = text ? haystack() : null;
    recordings.filter((row) => (of < 0 || outcome.values[row] === of)
      && (!wanted.problem.value || (any ? problem.values[row] !== none : problem.values[row] === with_))
      && (!words || words[row].includes(text)));
  }

  function reset(values) {
    for (const [key, field] of Object.entries(wanted)) field.value = values[key] ?? "";
    choose();
  }

  choices(wanted.outcome, "any", outcome.names.map((name) => [name, name]));
  const kinds = problem.names.filter((name) => name).map((name) => [name, name]);
  choices(wanted.problem, "with or without", [["any", "any problem"], ...kinds]);
  for (const field of Object.values(wanted)) field.addEventListener("input", choose);
  $("wanted-all").addEventListener("click", () => reset({}));
  for (const link of document.querySelectorAll("[data-outcome]")) {
    link.addEventListener("click", () => reset({ outcome: link.dataset.outcome }));
  }
  $("recordings-filters").hidden = false;
  $("recordings-help").hidden = false;

  // The dot nearest to the pointer, or that the arrow keys have come to, is a link to its recording.
  function dots(svg) {
    const axes = data.recordings.scatter;
    const columns = ["before", "after"].map((key) => column(data.recordings, key));
    const [before, after] = columns.map((one) => one.values);
    const place = (mg, [low, high, begin, end]) => {
      const power = Math.min(Math.max(Math.log10(Math.max(mg, 1e-9)), low), high);
      return begin + ((power - low) / (high - low)) * (end - begin);
    };
    const found = [];
    after.forEach((mg, row) => {
      if (mg !== null) found.push({ row, x: place(before[row], axes.before), y: place(mg, axes.after) });
    });
    found.sort((one, other) => after[other.row] - after[one.row]);
    const made = (name, settings) => {
      const one = document.createElementNS("http://www.w3.org/2000/svg", name);
      for (const [key, value] of Object.entries(settings)) one.setAttribute(key, value);
      return one;
    };
    const circle = made("circle", { id: "dot", r: 6 }), link = made("a", { id: "at-dot" });
    link.append(circle);
    let at = 0;
    const show = (to, say) => {
      at = to;
      const { row, x, y } = found[at];
      const name = column(data.recordings, "path").values[row];
      const text = `${name}: ${shown(columns[0], row)} mg before, ${shown(columns[1], row)} mg after`;
      circle.setAttribute("cx", x);
      circle.setAttribute("cy", y);
      link.setAttribute("href", address(data.recordings, row) ?? "#recordings");
      link.setAttribute("aria-label", `${text}; arrow keys go to the next smaller or larger error`);
      if (say) $("dot-says").textContent = text;
    };
    show(0, false);
    svg.append(link);
    $("dot-says").textContent = "Point at a dot, or go from dot to dot with the arrow keys; Enter opens the recording's page.";
    const pointed = (event) => {
      const box = svg.getBoundingClientRect(), factor = svg.viewBox.baseVal.width / box.width;
      const x = (event.clientX - box.left) * factor, y = (event.clientY - box.top) * factor;
      let nearest = -1, least = NEAR * NEAR;
      found.forEach((dot, index) => {
        const away = (dot.x - x) ** 2 + (dot.y - y) ** 2;
        if (away < least) { least = away; nearest = index; }
      });
      if (nearest >= 0) show(nearest, true);
    };
    svg.addEventListener("pointermove", pointed);
    svg.addEventListener("pointerdown", pointed);
    link.addEventListener("focus", () => show(at, true));
    link.addEventListener("click", () => {
      const { row } = found[at];
      if (!address(data.recordings, row)) reset({ text: column(data.recordings, "path").values[row] });
    });
    link.addEventListener("keydown", (event) => {
      const step = { ArrowRight: 1, ArrowDown: 1, ArrowLeft: -1, ArrowUp: -1 }[event.key];
      if (!step) return;
      event.preventDefault();
      show((at + step + found.length) % found.length, true);
    });
  }
  if ($("scatter")) dots($("scatter"));
})();
