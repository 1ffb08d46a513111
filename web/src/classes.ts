// A network's result for the frame, drawn over the image: regions of raised (compressed) and lowered (damaged)
// conductivity are outlined and hatched, so that the image's colours stay visible between the lines.

import type { Classes } from "./protocol";

/** Canvas words with blue, green, red from the highest byte; the legend in page.css has the same colours. */
const COMPRESSED = 0xf0e600;
const DAMAGED = 0x7a3bff;
/** Smallest probability inside a region. */
const LIKELY = 0.5;
/** Pixels of the canvas along its longer side, about: lines are thinner than a pixel of the image. */
const FINE = 256;
/** Distance between the hatching's lines, in pixels of the canvas. */
const HATCH = 9;
/** Opacity of the hatching, of 255. */
const LINE = 190;
/** Opacity of a region's edge, of 255. */
const EDGE = 255;

export class ClassOverlay {
  private readonly context: CanvasRenderingContext2D;
  private pixels: ImageData | null = null;
  private shown: Classes | null = null;

  constructor(readonly canvas: HTMLCanvasElement) {
    this.context = canvas.getContext("2d")!;
  }

  draw(classes: Classes | null): void {
    this.shown = classes;
    if (!classes) {
      this.context.clearRect(0, 0, this.canvas.width, this.canvas.height);
      return;
    }
    const { rows, cols, lowered, raised } = classes;
    const fine = Math.max(1, Math.round(FINE / Math.max(rows, cols)));
    const [height, width] = [fine * rows, fine * cols];
    if (this.pixels?.width !== width || this.pixels.height !== height) {
      [this.canvas.width, this.canvas.height] = [width, height];
      this.pixels = this.context.createImageData(width, height);
    }
    const words = new Uint32Array(this.pixels.data.buffer).fill(0);
    this.region(words, raised, rows, cols, fine, COMPRESSED, 1);
    this.region(words, lowered, rows, cols, fine, DAMAGED, -1);
    this.context.putImageData(this.pixels, 0, 0);
  }

  /** Outlines and hatches the region of one class; `slant` is the direction of its lines. */
  private region(words: Uint32Array, values: Float32Array, rows: number, cols: number, fine: number, colour: number, slant: number): void {
    if (!values.some((value) => value > LIKELY)) return;
    const [height, width] = [fine * rows, fine * cols];
    const across = Float32Array.from({ length: width }, (_, x) => Math.min(Math.max((x + 0.5) / fine - 0.5, 0), cols - 1));
    const isIn = new Uint8Array(width * height);
    for (let y = 0; y < height; y += 1) {
      const down = Math.min(Math.max((y + 0.5) / fine - 0.5, 0), rows - 1);
      const [top, part] = [Math.floor(down) * cols, down % 1];
      const next = part > 0 ? top + cols : top;
      for (let x = 0; x < width; x += 1) {
        const [left, share] = [Math.floor(across[x]), across[x] % 1];
        const right = share > 0 ? left + 1 : left;
        const above = values[top + left] * (1 - share) + values[top + right] * share;
        const below = values[next + left] * (1 - share) + values[next + right] * share;
        isIn[y * width + x] = above * (1 - part) + below * part > LIKELY ? 1 : 0;
      }
    }
    for (let at = 0; at < isIn.length; at += 1) {
      if (!isIn[at]) continue;
      const [x, y] = [at % width, Math.floor(at / width)];
      const isEdge = !(x > 0 && x < width - 1 && isIn[at - 1] && isIn[at + 1] && isIn[at - width] && isIn[at + width]);
      const isLine = (((x + slant * y) % HATCH) + HATCH) % HATCH === 0;
      if (isEdge || isLine) words[at] = (((isEdge ? EDGE : LINE) << 24) | colour) >>> 0;
    }
  }

  /** Probabilities at a place, given as shares of width and height from the top left, as text; empty if unknown. */
  describe(across: number, down: number): string {
    if (!this.shown || across < 0 || across >= 1 || down < 0 || down >= 1) return "";
    const { rows, cols, lowered, raised } = this.shown;
    const index = Math.floor(down * rows) * cols + Math.floor(across * cols);
    const percent = (value: number) => `${(100 * value).toFixed(0)} %`;
    return `compressed ${percent(raised[index])}, damaged ${percent(lowered[index])}`;
  }
}
