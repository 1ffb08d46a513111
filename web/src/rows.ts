// Rows of tables. They are reused and only changes are written, because a table rebuilt fifty times a second can neither
// be read nor selected.

export function write(cell: Element, text: string): void {
  if (cell.textContent !== text) cell.textContent = text;
}

/** Gives `body` one row of `cells` texts per key, in order, reusing rows. */
export function rows(body: HTMLElement, wanted: Map<string, string[]>): HTMLTableRowElement[] {
  const present = new Map([...body.children].map((row) => [(row as HTMLElement).dataset.key, row as HTMLTableRowElement]));
  const made = [...wanted].map(([key, cells]) => {
    const row = present.get(key) ?? document.createElement("tr");
    present.delete(key);
    row.dataset.key = key;
    while (row.cells.length < cells.length) row.insertCell();
    cells.forEach((text, index) => write(row.cells[index], text));
    return row;
  });
  for (const row of present.values()) row.remove();
  made.forEach((row, index) => {
    if (body.children[index] !== row) body.insertBefore(row, body.children[index] ?? null);
  });
  return made;
}
