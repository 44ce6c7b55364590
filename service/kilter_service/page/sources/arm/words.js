// Numbers and tables beside the picture, as the rest of the page writes them.
export function mm(value) {
  if (value === null || value === undefined || !Number.isFinite(value)) return "–";
  if (value === 0) return "0 mm";
  const small = Math.abs(value) < 0.1;
  const [shown, digits, unit] = small ? [value * 1e3, Math.abs(value) < 0.01 ? 2 : 3, "µm"] : [value, 3, "mm"];
  const decimals = digits - 1 - Math.floor(Math.log10(Math.abs(shown)));
  return `${decimals > 0 ? shown.toFixed(Math.min(decimals, 9)) : Math.round(shown)} ${unit}`;
}

/** The unit of lengths that are compared, in mm: that of the largest. Returns its name and how many are a mm. */
export function unitOf(largest) {
  return Math.abs(largest) < 0.1 ? ["µm", 1e3] : ["mm", 1];
}

export function quantile(values, share) {
  const sorted = [...values].sort((a, b) => a - b);
  return sorted.length ? sorted[Math.round(share * (sorted.length - 1))] : 0;
}

export function length(vector) {
  return Math.hypot(...vector);
}

/** An element of SVG. */
export function drawn(name, attributes, ...children) {
  const one = document.createElementNS("http://www.w3.org/2000/svg", name);
  Object.entries(attributes).forEach(([attribute, value]) => one.setAttribute(attribute, value));
  one.append(...children);
  return one;
}

/** A line of a table, whose first cell is its head. */
export function row(cells, tag) {
  const line = document.createElement("tr");
  cells.forEach((text, k) => {
    const cell = document.createElement(k === 0 || tag === "th" ? "th" : "td");
    cell.scope = tag === "th" ? "col" : "row";
    if (k > 0) cell.className = "number";
    cell.textContent = text;
    if (cell.tagName === "TD") cell.removeAttribute("scope");
    line.append(cell);
  });
  return line;
}

/** Fill a table; `names` (CAMPAIGN/ROW) tell which row of a campaign each line is. */
export function fill(table, head, rows, names = []) {
  table.tHead.replaceChildren(row(head, "th"));
  table.tBodies[0].replaceChildren(...rows.map((cells) => row(cells)));
  names.forEach((name, k) => (table.tBodies[0].rows[k].dataset.row = name));
  window.kilter.rows.equip(table);
}
