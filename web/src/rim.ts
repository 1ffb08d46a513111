// For skins whose rim crosses pixels: paints the image slightly beyond the rim and clips it along the outline.

import type { Point, Scene } from "./protocol";

/** Number of pixels painted beyond the rim. */
const BEYOND = 2;

/** True if a point lies in the rings, excluding holes: a line to the right has an odd number of crossings. */
function isWithin([x, y]: Point, rings: Point[][]): boolean {
  let crossings = 0;
  for (const ring of rings) {
    for (let index = 0; index < ring.length; index += 1) {
      const [ax, ay] = ring[index];
      const [bx, by] = ring[(index + 1) % ring.length];
      if (ay > y !== by > y && x < ax + ((y - ay) / (by - ay)) * (bx - ax)) crossings += 1;
    }
  }
  return crossings % 2 === 1;
}

export class Rim {
  /** Pixels beyond the rim, nearest to the skin first. */
  private readonly beyond: number[] = [];
  private readonly rows: number;
  private readonly cols: number;
  private filled = new Float32Array(0);

  constructor({ grid, outline_mm }: Pick<Scene, "grid" | "outline_mm">) {
    [this.rows, this.cols] = [grid.rows, grid.cols];
    const [width, height] = [(grid.x_max_mm - grid.x_min_mm) / grid.cols, (grid.y_max_mm - grid.y_min_mm) / grid.rows];
    const centre = (index: number): Point => [
      grid.x_min_mm + ((index % grid.cols) + 0.5) * width,
      grid.y_max_mm - (Math.floor(index / grid.cols) + 0.5) * height,
    ];
    const isInside = Array.from({ length: grid.rows * grid.cols }, (_, index) => isWithin(centre(index), outline_mm));
    for (let ring = 0; ring < BEYOND; ring += 1) {
      const next = [...isInside.keys()].filter((index) => !isInside[index] && this.beside(index).some((other) => isInside[other]));
      for (const index of next) isInside[index] = true;
      this.beyond.push(...next);
    }
  }

  /** The values, with those beyond the rim set to the mean of their neighbours. Valid until the next call. */
  fill(values: Float32Array, rows: number, cols: number): Float32Array {
    if (rows !== this.rows || cols !== this.cols) return values;
    if (this.filled.length !== values.length) this.filled = new Float32Array(values.length);
    this.filled.set(values);
    for (const index of this.beyond) {
      if (!Number.isNaN(values[index])) continue;
      let sum = 0;
      let count = 0;
      for (const other of this.beside(index)) {
        if (Number.isNaN(this.filled[other])) continue;
        sum += this.filled[other];
        count += 1;
      }
      if (count > 0) this.filled[index] = sum / count;
    }
    return this.filled;
  }

  private beside(index: number): number[] {
    const [row, col] = [Math.floor(index / this.cols), index % this.cols];
    const found: number[] = [];
    for (let y = Math.max(row - 1, 0); y <= Math.min(row + 1, this.rows - 1); y += 1) {
      for (let x = Math.max(col - 1, 0); x <= Math.min(col + 1, this.cols - 1); x += 1) {
        if (y !== row || x !== col) found.push(y * this.cols + x);
      }
    }
    return found;
  }
}
